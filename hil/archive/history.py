"""A unit's life from the archive: each parameter over calendar time, its drift, its jumps, its own limits, what is due.

What all temperatures have in common is looked at first: a calibration's shift against the others, with the same offset
of each temperature in all of them. That tells a drift from a jump (`hil.archive.trend`). Values are brought to the
temperature at which the unit usually was, by its own dependence on it, so that a chamber that stood half a degree
elsewhere is no jump; and where a jump differs between temperatures, it is said that the dependence has changed.
A mean with a run that is INCONCLUSIVE or FAIL tells nothing of the unit; a calibration with no other is only listed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.archive import trend as trends
from hil.archive.index import ArchivedMean, Entry, Index, calibrations
from hil.campaign import BoolArray, FloatArray
from hil.errors import InputError
from hil.files.document import picked, plain
from hil.files.strict import near
from hil.solve.temperatures import ELSEWHERE_DEGC
from hil.solve.uncertain import Uncertain
from procedures.verdict import NOT_GOOD
from procedures.words import listed

if TYPE_CHECKING:  # where no limits are known, nothing that reads them is loaded
    from hil.config.limits import Limits, ParameterLimits

_MONTH_S = 365.25 / 12.0 * 86400.0
_BY_MEANS = "of the unit what its means without such runs do"
_SIGMAS = 3.0  # chance passes control limits as rarely
_AHEAD_MONTHS = np.linspace(0.0, 120.0, 1201)


def history(index: Index, serial: str, model: str | None = None, limits: Limits | None = None) -> dict[str, Any]:
    """Say what the archive knows of a unit, of a `model` where two share a serial number; else `InputError`."""
    every, behind = index.entries(serial), index.behind(serial)
    if not every:
        there = sorted({each.serial for each in index.entries()})
        raise InputError(f"{serial}: the archive has no such unit{near(serial, there)}")
    gone = set(index.gone(serial))
    said = [*behind, *(f"{each.name}: cannot be read: {each.trouble}" for each in every if each.trouble)]
    good = [each for each in every if not each.trouble and each.name not in gone]
    kinds = {(each.model, each.simulated) for each in good if model in (None, each.model)}
    if len(kinds) > 1:
        models = sorted({of for of, _ in kinds})
        if len(models) > 1:
            raise InputError(
                f"{serial}: two units have this serial number: {', '.join(models)}; --unit-model says which"
            )
        good = [each for each in good if not each.simulated]
        said.append(f"{serial}: its simulated campaigns are left out: a simulated unit is another one")
    good = [each for each in good if (each.model, each.simulated) in kinds]
    if not good:
        raise InputError(f"{serial}: nothing of it can be read: {'; '.join(said)}")
    said += _told(good)
    good = calibrations(good)
    used = [each for each in good if each.good]
    said += [
        f"{each.name}: is {each.verdict} and tells {_BY_MEANS if each.good else 'nothing of the unit'}: {each.reason}"
        for each in good
        if each.verdict in NOT_GOOD
    ]
    settings = index.settings([each.settings for each in good])
    if limits is None and good:
        text = settings.get(good[-1].settings, {}).get("limits")
        if text is not None:
            from hil.config.limits import Limits

            limits = Limits.parse(text, good[-1].name)
    names = {each.name for each in used}
    every_mean = [each for each in index.means(serial) if each.entry in names]
    elsewhere = _elsewhere(every_mean)
    means = [each for each in every_mean if each not in elsewhere]
    found = list(_parameters(means, {each.name: each.began_utc for each in used}, limits))
    parameters, kind, changes = [document for document, _ in found], good[-1], _changes(good, settings)
    said += _not_judged(limits, kind.model, parameters)
    days = {each.name: each.began_utc[:10] for each in used}
    said += [*_not_compared(parameters, days), *_off(elsewhere, days)]
    day, why = _next(parameters, limits, used[-1].began_utc if used else "", judged=any(told for _, told in found))
    return {
        "schema": "hil.history/1",
        "serial": serial,
        "model": kind.model,
        "simulated": bool(kind.simulated),
        "campaigns": [
            {
                **picked(each, "entry=name began_utc title verdict reason from=whence"),
                "used": each in used,
                "changed_since_the_last": list(changes.get(each.name, ())),
            }
            for each in good
        ],
        "parameters": parameters,
        "limits": None if limits is None else limits.title,
        "next_calibration": {"due": day, "why": why},
        "said": said,
    }


def _next(
    parameters: Sequence[Mapping[str, Any]], limits: Limits | None, newest_utc: str, *, judged: bool
) -> tuple[str | None, str]:
    """Return the day on which the next calibration is due by drift and limits, and why."""
    if limits is None:
        return None, "no limits are known: --limits names them"
    found = [(of["due_in_months"], p, of) for p in parameters for of in p["temperatures"]]
    due = [each for each in found if each[0] is not None]
    if not due:
        none = "no parameter reaches a limit within ten years"
        return None, none if judged else "it takes three calibrations that tell something"
    out = [each for each in due if each[2]["beyond_limit"]]  # what surely is comes before what may be
    months, parameter, of = min(out or due, key=lambda each: each[0])
    day = (datetime.fromisoformat(newest_utc) + timedelta(seconds=months * _MONTH_S)).date().isoformat()
    at = "" if of["temperature_degC"] is None else f" at {of['temperature_degC']:z.1f} °C"
    why = "may be beyond its limit by then" if months else "is not certainly within its limits even now"
    why = "is beyond its limit now" if out else why
    more = f", and {len(out) - 1} more are" if len(out) > 1 else ""
    return day, f"sensor {parameter['sensor']}, {parameter['parameter']}{at} {why}{more}"


def _told(good: Sequence[Entry]) -> Iterator[str]:
    """Yield what is odd about a unit's entries: two nights at one time, nights that are not where they were."""
    for one, other in pairwise(good):
        if one.night and other.night and one.night != other.night and other.began_utc < one.ended_utc:
            why = "two units with one serial number, or one clock is wrong"
            why = "clocks of simulated nights begin alike, and nothing is told by time" if one.simulated else why
            yield f"{one.name} and {other.name} were measured at the same time: {why}"
    yield from (
        f"{each.name}: what it was taken up from is not at {each.whence} any more; what was averaged of it is here"
        for each in good
        if each.night and not Path(each.whence).exists()
    )


def _not_judged(limits: Limits | None, model: str, parameters: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield of which limits the unit has no parameter; raise `InputError` for limits of another model."""
    if limits is None:
        return
    if limits.unit and model and limits.unit != model:
        raise InputError(f"{limits.source}: unit: these are limits of {limits.unit}, and the unit is {model}")
    there = {(each["sensor"], each["parameter"]) for each in parameters}
    for sensor, of in limits.sensors.items():
        if lacking := [name for name in of if (sensor, name) not in there]:
            yield f"{limits.source}: sensor {sensor}: no calibration tells {', '.join(lacking)}: not judged"


def _not_compared(parameters: Sequence[Mapping[str, Any]], days: Mapping[str, str]) -> Iterator[str]:
    """Yield of which calibrations the others tell nothing, and of which parameters."""
    of_each: dict[tuple[str, ...], list[str]] = {}
    for each in parameters:
        name = f"{each['parameter']} of sensor {each['sensor']}"
        of_each.setdefault(tuple(each["not_compared"]), []).append(name)
    for apart, names in of_each.items():
        if apart:
            which = "every parameter" if len(names) == len(parameters) else listed(names)
            share, one = ("shares", "it") if len(apart) == 1 else ("share", "them")
            yield (
                f"{listed(days[each] for each in apart)}: {share} no temperature with the other calibrations, and "
                f"nothing of {one} is compared with these: {which}"
            )


def _elsewhere(means: Sequence[ArchivedMean]) -> dict[ArchivedMean, float]:
    """Return the means at which the unit's thermometer showed another temperature than usual there, and by how much."""
    off = dict[ArchivedMean, float]()
    for at, of in trends.stations_of(means).items():
        for sensor in {each.sensor for each in of}:
            known = [(each, each.own_degC) for each in of if each.sensor == sensor and each.own_degC is not None]
            usual = float(np.median([degC for _, degC in known])) if known and at is not None else np.nan
            off |= {each: degC - usual for each, degC in known if abs(degC - usual) > ELSEWHERE_DEGC}
    return off


def _off(elsewhere: Mapping[ArchivedMean, float], days: Mapping[str, str]) -> Iterator[str]:
    """Yield of which calibrations means are compared with no other, as the thermometer showed another temperature."""
    by: dict[tuple[str, int], dict[float | None, float]] = {}
    for each, degC in elsewhere.items():
        by.setdefault((each.entry, each.sensor), {})[each.temperature_degC] = degC
    for (entry, sensor), at in sorted(by.items()):
        least, most = (f"{of(at.values()):+.1f}" for of in (min, max))
        levels = listed(f"{each:z.0f}" for each in at if each is not None)
        yield (
            f"{days[entry]}: sensor {sensor}'s own thermometer shows {least}{f' to {most}' * (least != most)} °C "
            f"beside what it usually does at {levels} °C: it is off, or the unit was elsewhere; none of these is "
            "compared, as hil report --against compares none"
        )


def _changes(good: Sequence[Entry], settings: Mapping[str, Mapping[str, Any]]) -> dict[str, list[str]]:
    """Return what changed in bench, sweep and software since the entry before, where both were recorded by hil."""
    found = {}
    for before, now in pairwise(each for each in good if len(settings.get(each.settings, {})) > 0):
        old, new = settings[before.settings], settings[now.settings]
        keys = [key for key in dict.fromkeys([*old, *new]) if key != "limits" and old.get(key) != new.get(key)]
        found[now.name] = [f"{key}: {old.get(key, 'nothing')} → {new.get(key, 'nothing')}" for key in keys]
    return found


def _parameters(
    means: Sequence[ArchivedMean], began_utc: Mapping[str, str], limits: Limits | None
) -> Iterator[tuple[dict[str, Any], bool]]:
    """Yield what all temperatures of each parameter did together, and each of them; and whether any has a trend."""
    began = {name: datetime.fromisoformat(utc).timestamp() / _MONTH_S for name, utc in began_utc.items()}
    days = {name: utc[:10] for name, utc in began_utc.items()}
    by_parameter: dict[tuple[int, str], list[ArchivedMean]] = {}
    for each in means:
        by_parameter.setdefault((each.sensor, each.parameter), []).append(each)
    for (sensor, name), own in by_parameter.items():
        stations, unit = trends.stations_of(own), own[0].value.unit
        values = trends.at_usual_temperatures(stations)
        k = 2.0 if limits is None else limits.k
        asked = None if limits is None else limits.sensors.get(sensor, {}).get(name)
        told, of_each, parts = False, [], []
        for part in trends.that_share(values):
            names, shifts, errors, left = trends.shifts_of(part)
            months = np.array([began[each] for each in names])
            together = trends.trend(months, shifts, errors)
            parts.append((names, together, left))
            since = float(months[together.step]) if together.step else -np.inf
            until = float(months[together.back]) if together.back else np.inf
            for at in part:
                of = stations[at]
                when = np.array([began[each.entry] for each in of])
                y, sd = np.array([values[at][each.entry] for each in of]).T
                found = trends.at_one_temperature(together, since, until, when, y, sd)
                told |= found.fit is not None
                known = min(each.value.freedom for each in of)
                near = (when < since) | (when >= until) if together.back else when >= since
                of_each.append(
                    {
                        "temperature_degC": at,
                        **_trend(found, [days[each.entry] for each in of], unit),
                        "control": _control(y, sd, near, known),
                        **_due(found, when, asked, k, of[-1].value),
                        "values": [
                            {"entry": m.entry, "day": days[m.entry], "own_degC": m.own_degC, **m.value.document()}
                            for m in of
                        ],
                    }
                )
        of_each.sort(key=lambda each: list(stations).index(each["temperature_degC"]))
        names, together, left = parts[0]
        document = {
            "sensor": sensor,
            "parameter": name,
            "unit": unit,
            **_trend(together, [days[each] for each in names], unit),
            "differs_between_temperatures": trends.differs(left, names, together),
            "not_compared": [each for apart, *_ in parts[1:] for each in apart],
            "temperatures": of_each,
        }
        yield document, told


def _control(y: FloatArray, sd: FloatArray, since: BoolArray, freedom: float) -> dict[str, Any] | None:
    """Return where the newest value (n,) should be by the earlier ones `since` a jump, and whether it is outside."""
    limits = trends.control_limits(y[:-1][since[:-1]], sd[:-1][since[:-1]], float(sd[-1]), freedom)
    if limits is None:
        return None
    half = limits.expanded(_SIGMAS)
    return {"centre": limits.value, **_ends(limits.value, half), "outside": bool(abs(y[-1] - limits.value) > half)}


def _due(
    found: trends.Trend, months: FloatArray, asked: ParameterLimits | None, k: float, newest: Uncertain
) -> dict[str, Any]:
    """Return in how many months its interval at `k` reaches a limit, and whether it is beyond one; None if never."""
    if found.fit is None or asked is None or (asked.low is None and asked.high is None):
        return {"due_in_months": None, "beyond_limit": None}
    value, wide = trends.predicted(found.fit, months[-1] + _AHEAD_MONTHS, months, k)
    low, high = (-np.inf if asked.low is None else asked.low), (np.inf if asked.high is None else asked.high)
    now = ((value[0], wide[0]), (newest.value, newest.expanded(k)))
    out = any(middle - half > high or middle + half < low for middle, half in now)
    beyond = (value - wide < low) | (value + wide > high)
    beyond[0] |= out
    due = float(_AHEAD_MONTHS[np.argmax(beyond)]) if beyond.any() else None
    return {"due_in_months": due, "beyond_limit": out}


def _trend(found: trends.Trend, days: Sequence[str], unit: str) -> dict[str, Any]:
    slope, jump = found.per_month, found.jump
    drift = slope and {"value": plain(slope.value), **_ends(slope.value, slope.half_width), "unit": f"{unit}/month"}
    between = {"between": [days[found.step - 1], days[found.step]]} if found.step else {}
    between |= {"back_between": [days[found.back - 1], days[found.back]]} if found.back else {}
    size = jump and {**between, "value": jump.value, **_ends(jump.value, jump.half_width), "unit": unit}
    return {"finding": found.word, "drift_per_month": drift, "jump": size}


def _ends(value: float, half_width: float) -> dict[str, float]:
    return {"low": value - half_width, "high": value + half_width}
