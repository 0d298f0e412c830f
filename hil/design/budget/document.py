"""The error budget as the JSON document hil.budget/1, before a night and after it.

    budget_document(planned_scenes(sweep, bench), sweep.title, repeats=3)
    budget_document(measured_scenes(campaign, bench, shown), campaign.title, repeats=3, observed=shown)

Each sensor has the budget of one run, and the totals of all: where no other is asked for, of the one that is known
worst, by its sources and by what `hil solve` states of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.campaign import FloatArray
from hil.design.budget.budget import DRAWS, Budget, as_solved, mean_of_repeats, moves_most, repeats_of
from hil.design.budget.scenes import RunScene
from hil.errors import InputError
from hil.files.document import picked, plain
from hil.solve.repeats import SensorRepeats
from procedures.words import numbered


@dataclass(frozen=True)
class Asked:
    """What is asked of a budget: which run (None: the worst), how many repeats are averaged, how many draws.

    None repeats: as many as were made at that run's temperature.
    """

    run: int | None = None
    repeats: int | None = None
    draws: int = DRAWS
    seed: int = 0


def budget_document(
    scenes: Mapping[int, Sequence[RunScene]],
    title: str,
    asked: Asked,
    *,
    simulated: bool = False,
    observed: Mapping[int, SensorRepeats] | None = None,
) -> dict[str, Any]:
    """Return the budget of each sensor that has every rate of some collect.

    Raises `InputError` for a run that is not there, or where no sensor has one.
    """
    without = [
        f"sensor {number}: {why}"
        for number, runs in scenes.items()
        if (why := _why_none([each.run for each in runs], asked.run, (observed or {}).get(number)))
    ]
    if len(without) == len(scenes):
        raise InputError("; ".join(without) or "no collect was measured")
    sensors = {
        str(number): _sensor(runs, asked, (observed or {}).get(number))
        for number, runs in scenes.items()
        if runs and asked.run in (None, *(each.run for each in runs))
    }
    return {
        "schema": "hil.budget/1",
        "title": title,
        "simulated": simulated,
        "repeats": max(each["repeats"] for each in sensors.values()),
        **picked(asked, "draws seed"),
        "sensors": sensors,
        "without": without,
    }


def _why_none(runs: Sequence[int], asked: int | None, observed: SensorRepeats | None) -> str:
    if not runs:
        return "no collect has every rate: no budget"
    if asked is None or asked in runs:
        return ""
    failed = observed is not None and asked in observed.not_used
    why = f"run {asked} FAILed by what was recorded, and has no budget" if failed else f"there is no run {asked}"
    return f"{why}; choose of {numbered('run', runs)} with --run"


def _sensor(runs: Sequence[RunScene], asked: Asked, observed: SensorRepeats | None) -> dict[str, Any]:
    alone = {each.run: Budget(each.scene, each.sources, each.form, draws=0) for each in runs}
    whole = {run: mean_of_repeats(each, repeats_of(each, None), run, observed, None) for run, each in alone.items()}
    means = {run: mean for mean in (observed.means if observed else ()) for run in mean.runs}
    chosen = max(runs, key=lambda e: (e.run == asked.run, e.run in means, float(np.nansum(whole[e.run] ** 2))))
    budget = Budget(chosen.scene, chosen.sources, chosen.form, asked.draws, asked.seed)
    mean = means.get(chosen.run)
    made = repeats_of(budget, mean)
    repeats = np.full_like(made, asked.repeats) if asked.repeats else made
    of_mean = budget
    if observed is not None and mean is not None and np.array_equal(repeats, made):
        of_mean = moves_most(runs, mean, observed)[1]
    return {
        "run": chosen.run,
        "repeats": int(repeats.max()),
        "repeats_of": dict(zip(budget.names, repeats.tolist(), strict=True)),
        "temperature_degC": chosen.at[0],
        "temperature_of": chosen.at[1],
        "positions": chosen.scene.conditions.position[np.argsort(chosen.scene.conditions.start_s)].tolist(),
        "form": chosen.form.name,
        "acting_on": chosen.base_origin,
        "noise_deg_per_hr": float(np.sqrt(np.nanmean(chosen.scene.noise**2))),
        "parameters": dict(zip(budget.names, budget.units, strict=True)),
        "sources": [
            {
                **picked(each.source, "id title size unit origin varies"),
                "parameters": _both(budget, each.analytic, each.simulated),
            }
            for each in budget.shares
        ],
        "total": _both(budget, budget.total(), budget.everything),
        "mean_of_repeats": named(budget, mean_of_repeats(of_mean, repeats, chosen.run, observed, mean)),
        "run_to_run": named(budget, budget.from_run_to_run),
        "observed_run_to_run": {} if observed is None else observed.document()["run_to_run"],
        "as_solved": named(budget, as_solved(budget, chosen.run, observed)) if observed is not None else {},
        "as_solved_for": [] if observed is None else _said(observed),
        "mean_as_solved": {}
        if mean is None
        else {"runs": list(mean.runs), **{n: plain(v.sd) for n, v in mean.values.items()}},
        "mean_as_solved_of": {} if mean is None else {n: v.runs for n, v in mean.values.items()},
        "left_out": list(chosen.left_out),
        "why_left_out": dict(chosen.left_out),
        "agrees": budget.agrees,
        "too_large": budget.too_large,
        "runs": [
            {"run": each.run, "temperature_degC": each.at[0], "total": named(budget, alone[each.run].total())}
            for each in runs
        ],
    }


def _both(budget: Budget, analytic: FloatArray, simulated: FloatArray) -> dict[str, dict[str, float | None]]:
    error = budget.simulation_error(simulated)
    return {
        name: dict(zip(("analytic", "monte_carlo", "monte_carlo_error"), of, strict=True))
        for name, *of in zip(budget.names, *plain([analytic, simulated, error]), strict=True)
    }


def named(budget: Budget, values: FloatArray) -> dict[str, float | None]:
    """Return what is of each parameter, (p,), by their names; None where it is not known."""
    return {name: plain(value) for name, value in zip(budget.names, values, strict=True)}


def _said(observed: SensorRepeats) -> list[str]:
    """Return what is to be known of what repeats show, which stands beside it; or why they show nothing."""
    if not observed.repeated:
        return observed.sentences()
    by_temperature = [*observed.uneven_in_words, *observed.visits_in_words]
    return [*observed.visited_once, *observed.between.in_words, *by_temperature]
