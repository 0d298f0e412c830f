"""What is told of a campaign's solutions: the JSON document hil.solution/1, and to which runs to see, and why."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.campaign import Campaign
from hil.files.document import picked, plain
from hil.solve.omissions import what_is_wrong
from hil.solve.repeats import SensorRepeats, repeats
from hil.solve.residuals import EXCESS
from hil.solve.runs import RunSolution, solve_campaign
from hil.solve.wrong_rows import pooled
from procedures.verdict import Judgement, Verdict
from procedures.words import numbered

SCHEMA = "hil.solution/1"

_UNKNOWN = {"sd": None, "low": None, "high": None}
_EXCEEDS = re.compile(EXCESS.format("([0-9.e+]+)"))


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
    beside = {name: {key: found[key] for key in _UNKNOWN} for name, found in uncertain.items()}
    return {
        **picked(each, "run runs sensor model method"),
        "parameters": {name: vars(e) | beside.get(name, _UNKNOWN) for name, e in each.parameters.items()},
        "combinations": {name: vars(estimate) for name, estimate in each.combinations.items()},
        "covariance": None if np.all(np.isnan(each.covariance)) else plain(each.covariance),
        "covariance_order": list(each.parameters),
        **picked(each, "condition_number residual_rms_deg_per_hr degrees_of_freedom unobservable"),
        "verdict": str(each.verdict),
        **picked(each, "reason assumed"),
    }


def not_passed_of(solutions: Sequence[RunSolution]) -> dict[str, dict[str, list[int]]]:
    """Return the runs to which somebody has to see, by verdict, the worst first, and by sensor."""
    found: dict[str, dict[str, list[int]]] = {}
    for verdict in (each for each in reversed(Verdict) if each is not Verdict.PASS):
        of: dict[str, list[int]] = {str(number): [] for number in sorted({each.sensor for each in solutions})}
        for each in solutions:
            of[str(each.sensor)] += each.runs if each.verdict is verdict else ()
        if any(of.values()):
            found[str(verdict)] = {number: sorted(set(runs)) for number, runs in of.items()}
    return found


def not_passed(of_sensors: Mapping[str, Mapping[str, Sequence[int]]]) -> dict[str, list[int]]:
    """Return those that some sensor does not pass, by verdict alone."""
    return {verdict: sorted({run for own in of.values() for run in own}) for verdict, of in of_sensors.items()}


def of_sensors_in_words(
    found: Mapping[str, Mapping[str, Sequence[int]]], but: Collection[int] = ()
) -> Iterator[tuple[str, str]]:
    """Yield verdicts with the runs that have them, `but` some, and in which sensors where it is not in all."""
    for verdict, of in found.items():
        alike: dict[tuple[int, ...], list[int]] = {}
        for number, runs in of.items():
            alike.setdefault(tuple(run for run in runs if run not in but), []).append(int(number))
        for runs, sensors in ((runs, sensors) for runs, sensors in alike.items() if runs):
            where = f" of {numbered('sensor', sensors)}" if len(alike) > 1 else ""
            yield verdict, f"{numbered('run', runs)}{where} ({verdict})"


def not_solved(campaign: Campaign) -> dict[str, Any]:
    """Return the runs in means to which somebody has to see, as every document that rests on them has them."""
    odd = not_passed_of(solve_campaign(pooled(campaign)))
    return {"runs_not_solved": not_passed(odd), "runs_not_solved_by_sensor": odd}


def first_in_words(document: Mapping[str, Any], what: str) -> list[str]:
    """Say to which runs a document has somebody see before `what` is used; nothing where all pass."""
    runs = ", ".join(said for _, said in of_sensors_in_words(document.get("runs_not_solved_by_sensor", {})))
    first = f"before {what} is used, see to what hil solve does not pass (hil report says why)"
    return [f"{first}: {runs}"] if runs else []


def reasons(solutions: Sequence[RunSolution]) -> Iterator[tuple[Verdict, str, str]]:
    """Yield each reason once, the worst first: the verdict that it gives, for which sensors and runs, and itself.

    Of several runs whose residuals exceed what is allowed it is said from how much to how much.
    """
    said_of: dict[tuple[Verdict, str], dict[int, list[int]]] = {}
    excess: dict[tuple[Verdict, str], dict[str, float]] = {}
    for each in solutions:
        for verdict, sentence in dict.fromkeys(
            (of.verdict, said) for of in each.causes for said in of.reason.split("; ")
        ):
            key = verdict, sentence
            if (times := _EXCEEDS.match(sentence)) is not None:
                key = verdict, EXCESS + sentence.partition(": ")[2]
                excess.setdefault(key, {})[sentence] = float(times[1])
            said_of.setdefault(key, {}).setdefault(each.sensor, []).extend(each.runs)
    for key, sentences in excess.items():
        first, *more = sentences
        ends = " to ".join(dict.fromkeys(f"{end(sentences.values()):g}" for end in (min, max)))
        said = EXCESS.format(ends) + "".join(first.partition(": ")[1:]) if more else first
        said_of[key[0], said] = said_of.pop(key)
    together: dict[tuple[Verdict, str], list[str]] = {}
    for (verdict, sentence), by_sensor in said_of.items():
        where = "; ".join(f"sensor {number}, {numbered('run', runs)}" for number, runs in by_sensor.items())
        first = numbered("run", next(iter(by_sensor.values())))
        together.setdefault((verdict, where), []).append(sentence.removeprefix(f"{first} "))
    for (verdict, where), several in sorted(together.items(), key=lambda each: -Judgement(each[0][0], "").severity):
        yield verdict, where, "; ".join(several)
