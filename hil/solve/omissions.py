"""What of a campaign is missing, left out, mended or not settled: as every command documents it and says it."""

from collections.abc import Collection, Mapping, Sequence
from itertools import product
from typing import Any

from hil.campaign import Campaign
from hil.solve.temperatures import unsettled
from hil.solve.wrong_rows import USED, Wrong, clipped_rows, failed, pooled, wrong_rows
from procedures.words import listed, numbered, significant

AS_ZERO = "taken as zero, neither measured nor printed"
_OF_RUNS = {
    "runs_not_used": "{} FAILed by what was recorded: in no mean, in no other run's ±, in no search",
    "runs_used_though_failed": "every run FAILed by what was recorded: no number of it is to be used",
    "runs_without_rows": "no row of {}, which another sensor has",
}


def what_is_wrong(campaign: Campaign) -> dict[str, Any]:
    """Return what is wrong with rows and runs of all sensors: keys `rows`, and those of `without`, of every document.

    Rows are those of runs that are in means: of the others each solution's reason says it. `rows_seen_from`, deg/hr by
    sensor, is there for one of which so few runs were made that a collect off by less is not seen.
    """
    every = wrong_rows(campaign)
    seen_from = {str(number): found.sees_from for number, found in every.items() if found.sees_from is not None}
    rows = [each for found in every.values() for each in found.rows]
    return _keys(campaign, rows) | ({"rows_seen_from": seen_from} if seen_from else {})


def by_records(campaign: Campaign) -> dict[str, Any]:
    """Return the same keys for what the records alone say, quickly: `rows` are those that stand at a channel's limit.

    So treated are campaigns that are `pooled` and `usable`. Keys of which there is nothing to say are left out.
    """
    judged = [rows for number, rows in campaign.sensors.items() if failed(campaign, number)]  # as what is clipped is
    clipped = [each for rows in judged for each in clipped_rows(rows)]
    return {name: of for name, of in _keys(campaign, clipped).items() if of}


def _keys(campaign: Campaign, rows: Sequence[Wrong]) -> dict[str, Any]:
    not_used = pooled(campaign).not_used
    return {"rows": [each.document() for each in rows if each.run not in not_used[each.sensor]], **without(campaign)}


def without(campaign: Campaign) -> dict[str, Any]:
    """Return keys `missing`, of what was asked for; `runs_not_used`, by sensor; `runs_not_settled`: sensor, runs, why.

    And `runs_used_though_failed` where every run FAILs, so that all are used; `runs_without_rows` of a sensor where
    another has some; `taken_as_zero`, parameters that nobody measured.
    """
    used = pooled(campaign)
    made = {number: set(rows.conditions.run.tolist()) for number, rows in campaign.sensors.items()}
    every = [n for n, own in made.items() if not used.not_used[n] and own <= failed(used, n, unless_mended=True)]
    absent = {n: set().union(*made.values()) - own - {*used.not_used[n]} for n, own in made.items()}
    some = {
        "runs_used_though_failed": {str(number): sorted(made[number]) for number in every},
        "runs_without_rows": {str(number): sorted(lacks) for number, lacks in absent.items() if lacks},
        "taken_as_zero": list(campaign.taken_as_zero),
    }
    return {
        "missing": list(campaign.missing),
        "runs_not_used": {str(number): list(runs) for number, runs in used.not_used.items() if runs},
        "runs_not_settled": [
            {"sensor": number, "runs": [run for run, of in soaks.items() if of == why], "why": why}
            for number, soaks in not_settled(used).items()
            for why in dict.fromkeys(soaks.values())
        ],
        **{name: of for name, of in some.items() if of},
    }


def in_words(wrong: Mapping[str, Any], *, searched: bool = False) -> list[str]:
    """Say of each entry of the keys that `what_is_wrong` returns what is done and why; `searched`: by the search."""
    more = "" if searched else "; hil reconcile weighs it against everything else, and may leave it out"
    runs_by_words: dict[tuple[str, int, str], list[int]] = {}
    for each in wrong.get("rows", ()):
        why = each["why"].removeprefix(f"sensor {each['sensor']}: ")
        runs_by_words.setdefault((each["done"], each["sensor"], why), []).append(each["run"])
    soaks: dict[tuple[str, str], list[int]] = {}  # of what every sensor's thermometer shows once
    for each in wrong.get("runs_not_settled", ()):
        soaks.setdefault((numbered("run", each["runs"]), each["why"]), []).append(each["sensor"])
    rows = [
        f"{done}: sensor {number}, {of_runs(runs, why)}{more * (done == USED)}"
        for (done, number, why), runs in runs_by_words.items()
    ]
    return (
        [f"missing: {each}" for each in wrong.get("missing", ())]
        + [f"{listed(names)}: {AS_ZERO}" for names in [wrong.get("taken_as_zero")] if names]
        + rows
        + [
            f"sensor {number}: {said.format(numbered('run', runs))}"
            for key, said in _OF_RUNS.items()
            for number, runs in wrong.get(key, {}).items()
        ]
        + [f"{numbered('sensor', sensors)}, {runs}: {why}" for (runs, why), sensors in soaks.items()]
        + [
            f"sensor {number}: among so few runs a collect that is off by less than {significant(size)} deg/hr may not "
            "be seen here, nor another bias of a whole run; hil reconcile looks closer"
            for number, size in wrong.get("rows_seen_from", {}).items()
        ]
    )


def of_runs(runs: Collection[int], why: str) -> str:
    """Say something of runs, their numbers once."""
    which = numbered("run", runs)
    return f"{which}: {why.removeprefix(f'{which} ')}"


def not_settled(campaign: Campaign) -> dict[int, dict[int, str]]:
    """Return by sensor the runs, of those that are in means, in which the unit had not settled, and why."""
    every, used = campaign.sensors, pooled(campaign).sensors
    told = {number: unsettled(every[number].conditions) for number in used}
    return {n: {run: of for run, of in told[n].items() if run in rows.conditions.run} for n, rows in used.items()}


def otherwise(campaign: Campaign, rows: Sequence[Mapping[str, Any]], taken_off: Campaign) -> list[str]:
    """Say where the search's `rows` are not what the quick form, which numbers are made from, does or doubts.

    What it doubts no more with what is known and was found `taken_off` the rates has its explanation.
    """

    def rates(of: Sequence[Mapping[str, Any]]) -> set[tuple[int, str, int]]:
        return {
            (int(row["sensor"]), channel, collect)
            for row in of
            for collect, channel in product(row["collects"], row["channels"])
        }

    asked = what_is_wrong(campaign)["rows"]
    search, quick = (rates([row for row in of if row["done"] != USED]) for of in (rows, asked))
    known = rates(rows)
    still = rates([row for row in what_is_wrong(taken_off)["rows"] if row["done"] == USED])
    used = (row for row in asked if row["done"] == USED and rates([row]) & still)
    doubted = [row for row in used if not rates([row]) & known]
    here = "by hil solve, report, budget, thermal and visibility, which look less closely"
    unsaid = "hil solve doubts, and no row is called wrong here"
    differ: dict[tuple[str, int, tuple[int, ...]], list[str]] = {}
    for odd, what in ((search - quick, "used as measured"), (quick - search, "left out or mended")):
        for sensor, channel in sorted({(s, c) for s, c, _ in odd}):
            collects = sorted(n for *of, n in odd if of == [sensor, channel])
            differ.setdefault((what, sensor, tuple(collects)), []).append(channel)
    told = [
        f"sensor {sensor}, {listed(channels)}: {numbered('collect', collects)}: {what} {here}"
        for (what, sensor, collects), channels in differ.items()
    ]
    return told + [f"{unsaid}: {each}" for each in in_words({"rows": doubted}, searched=True)]
