"""The solutions of a campaign as the JSON document hil.solution/1: each run, the means, and what repeats show."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.campaign import Campaign
from hil.files.document import picked
from hil.solve.omissions import what_is_wrong
from hil.solve.repeats import SensorRepeats, repeats
from hil.solve.runs import RunSolution, finite

SCHEMA = "hil.solution/1"

_UNKNOWN = {"sd": None, "low": None, "high": None}


def solution_document(campaign: Campaign, solutions: Sequence[RunSolution]) -> dict[str, Any]:
    """Return what `hil solve --json` prints: finite numbers, null where a thing is not known."""
    shown = repeats(campaign, solutions)
    return {
        "schema": SCHEMA,
        **picked(campaign, "campaign=title simulated warnings"),
        "solutions": [_solution_entry(each, shown[each.sensor]) for each in solutions],
        **what_is_wrong(campaign),
        "repeats": {str(number): each.document() for number, each in shown.items()},
    }


def _solution_entry(each: RunSolution, shown: SensorRepeats) -> dict[str, Any]:
    uncertain = {name: value.document() for name, value in shown.of_run(each).items()}
    beside = {name: {key: found[key] for key in ("sd", "low", "high")} for name, found in uncertain.items()}
    covariance: list[list[float | None]] | None = [[finite(value) for value in row] for row in each.covariance]
    if np.all(np.isnan(each.covariance)):
        covariance = None
    return {
        **picked(each, "run runs sensor model method"),
        "parameters": {name: vars(e) | beside.get(name, _UNKNOWN) for name, e in each.parameters.items()},
        "combinations": {name: vars(estimate) for name, estimate in each.combinations.items()},
        "covariance": covariance,
        "covariance_order": list(each.parameters),
        **picked(each, "condition_number residual_rms_deg_per_hr degrees_of_freedom unobservable"),
        "verdict": str(each.verdict),
        "reason": each.reason,
        "assumed": list(each.assumed),
    }
