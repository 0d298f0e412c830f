"""Bad runs in the words and numbers of the result: one finding, its places, a note, and what to measure again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hil.campaign import Campaign
from hil.reconcile.bad_data.runs import FALSE, BadRun
from hil.reconcile.result import LEFT_OUT, Disagreement, FoundEffect, runs_in_words, without_collects


def run_findings(bad: Sequence[BadRun], campaign: Campaign) -> list[FoundEffect]:
    """Return bad runs as one finding that no effect of the catalogue describes; none where there are none."""
    if not bad:
        return []
    numbers, said = _numbers(bad), [_in_words(b, campaign) for b in bad]
    return [
        FoundEffect(
            id=f"empirical: {numbers}",
            title=f"{numbers.capitalize()} {'do' if 'runs' in numbers else 'does'} not agree with the others "
            "in any way that an effect of the catalogue does",
            equation="; ".join(said),
            parameters=[_parameter(b, campaign) for b in bad],
            probability=1.0 - FALSE,
            confusable_with=[],
            kind="empirical",
            shape={LEFT_OUT: float(len({(b.sensor, b.run) for b in bad}))},
            sensors=tuple(sorted({b.sensor for b in bad})),
            physics="No effect of the catalogue behaves like this; what is certain is which runs differ, not why. "
            + "; ".join(said)
            + ".",
            experiment=f"Look at {numbers}; repeat {'them' if 'runs' in numbers else 'it'}.",
        )
    ]


def run_places(bad: Sequence[BadRun], campaign: Campaign) -> list[Disagreement]:
    """Return where bad runs differ and by how much (rms over the run's rows)."""
    places = [
        Disagreement(
            {"sensor": b.sensor, "channel": _channel(b, campaign), "runs": [b.run]},
            b.size,
            b.usual / float(np.sqrt(len(b.rows))),
            FALSE,
        )
        for b in bad
    ]
    return sorted(places, key=lambda place: -place.size_deg_per_hr)


def run_notes(bad: Sequence[BadRun], campaign: Campaign) -> list[str]:
    """Say that bad runs were left out, and what the gap is then about."""
    if not bad:
        return []
    said = "; ".join(_in_words(b, campaign) for b in bad)
    return [f"{_numbers(bad)}: left out of the search, and the gap is that of the others, before and after ({said})"]


def run_experiment(bad: Sequence[BadRun], further: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the next experiment with what bad runs ask for said first; as it is where there are none."""
    if not bad:
        return further
    numbers = _numbers(bad)
    why = f"look at {numbers}; repeat {'them' if 'runs' in numbers else 'it'}"
    if further is not None:
        return {**further, "why": f"{why}; then: {further['why']}"}
    return without_collects(why)


def _numbers(bad: Sequence[BadRun]) -> str:
    return runs_in_words(b.run for b in bad)


def _channel(bad: BadRun, campaign: Campaign) -> str:
    return list(campaign.sensors[bad.sensor].conditions.sensor.channels)[bad.channel]


def _in_words(bad: BadRun, campaign: Campaign) -> str:
    here = f"sensor {bad.sensor}, {_channel(bad, campaign)}, run {bad.run}"
    return here + {
        "sign": ": the rates of the others times -1, a sign",
        "dead": ": next to nothing, a dead channel or another unit",
        "factor": f": the rates of the others times {bad.factor:.3g}, a unit or a scale",
    }.get(bad.kind, f": off by {bad.size:.3g} deg/hr rms, where runs scatter by {bad.usual:.2g}")


def _parameter(bad: BadRun, campaign: Campaign) -> Mapping[str, Any]:
    """The factor that was recognised, or how far the run is off."""
    at = f"run {bad.run}, {_channel(bad, campaign)}"
    if not bad.kind:
        error = bad.usual / float(np.sqrt(len(bad.rows)))
        return {"name": "off", "value": bad.size, "se": error, "unit": "deg/hr", "at": at, "sensor": bad.sensor}
    error = bad.usual / max(bad.size, 1e-12) * abs(bad.factor - 1.0) / float(np.sqrt(len(bad.rows)))
    return {"name": "times", "value": bad.factor, "se": error, "unit": "1", "at": at, "sensor": bad.sensor}
