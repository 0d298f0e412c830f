"""A unit's life from the archive: each parameter over calendar time, its drift, its jumps, its own limits, what is due.

    found = history(index, "0042", limits=load_limits("mfs"))
    found.document()       # hil.history/1

What all temperatures have in common is looked at first: a calibration's shift against the others, with the same offset
of each temperature in all of them. That tells a drift from a jump (`hil.archive.trend`). Values are brought to the
temperature at which the unit usually was, by its own dependence on it, so that a chamber that stood half a degree
elsewhere is no jump; and where a jump differs between temperatures, it is said that the dependence has changed.
A calibration that is INCONCLUSIVE or FAIL tells nothing of the unit, as everywhere, and is only listed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.archive.index import ArchivedMean, Entry, Index
from hil.archive.trend import (
    Trend,
    at_one_temperature,
    at_usual_temperatures,
    control_half_width,
    control_limits,
    differs,
    predicted,
    shifts_of,
    stations_of,
    trend,
)
from hil.campaign import FloatArray
from hil.errors import InputError
from hil.files.document import picked
from hil.files.strict import near
from hil.solve.repeats import Uncertain
from hil.solve.runs import finite

if TYPE_CHECKING:  # where no limits are known, nothing that reads them is loaded
    from hil.config.limits import Limits, ParameterLimits

_MONTH_S = 365.25 / 12.0 * 86400.0
_AHEAD_MONTHS = np.linspace(0.0, 120.0, 1201)


@dataclass(frozen=True)
class Station:
    """A parameter at one temperature: its means (n,) in the order of time, the trend, and its control limits.

    `control` is where the newest should be by the earlier ones; `due` when its interval reaches a limit, in months
    after the newest, None where it does not within ten years, or nobody can tell.
    """

    temperature_degC: float | None
    means: Sequence[ArchivedMean]
    months: FloatArray
    trend: Trend
    control: Uncertain | None
    due: float | None

    @property
    def outside(self) -> bool:
        """Whether the newest is outside its control limits."""
        newest = self.means[-1].value.value
        return self.control is not None and abs(newest - self.control.value) > control_half_width(self.control)


@dataclass(frozen=True)
class Parameter:
    """One parameter of a sensor: what all its temperatures did together over `months` (n,), and each of them.

    `differs` says that a jump is not the same at all of them.
    """

    sensor: int
    name: str
    unit: str
    months: FloatArray
    entries: Sequence[str]
    together: Trend
    differs: bool
    stations: Sequence[Station]


@dataclass(frozen=True)
class History:
    """What the archive says of one unit. `used` are the entries that tell something of it; `said` is what to know."""

    serial: str
    model: str
    simulated: bool
    entries: Sequence[Entry]
    used: Sequence[Entry]
    changes: Mapping[str, Sequence[str]]
    parameters: Sequence[Parameter]
    limits: Limits | None
    said: Sequence[str]

    def due(self) -> tuple[str | None, str]:
        """Return the day on which the next calibration is due by drift and limits, and why."""
        if self.limits is None:
            return None, "no limits are known: --limits names them"
        found = [(of.due, p, of) for p in self.parameters for of in p.stations if of.due is not None]
        if not found:
            judged = any(of.trend.fit is not None for p in self.parameters for of in p.stations)
            return None, "no parameter reaches a limit within ten years" if judged else "it takes three calibrations"
        months, parameter, of = min(found, key=lambda each: each[0])
        newest = datetime.fromisoformat(self.used[-1].began_utc)
        day = (newest + timedelta(seconds=months * _MONTH_S)).date().isoformat()
        at = "" if of.temperature_degC is None else f" at {of.temperature_degC:.1f} °C"
        why = "may be beyond its limit by then" if months else "is not certainly within its limits even now"
        return day, f"sensor {parameter.sensor}, {parameter.name}{at} {why}"

    def document(self) -> dict[str, Any]:
        """Return the document hil.history/1."""
        day, why = self.due()
        days = {each.name: each.began_utc[:10] for each in self.entries}
        return {
            "schema": "hil.history/1",
            "serial": self.serial,
            "model": self.model,
            "simulated": bool(self.simulated),
            "campaigns": [
                {
                    **picked(each, "entry=name began_utc title verdict reason from=whence"),
                    "used": each in self.used,
                    "changed_since_the_last": list(self.changes.get(each.name, ())),
                }
                for each in self.entries
            ],
            "parameters": [_parameter(each, days) for each in self.parameters],
            "limits": None if self.limits is None else self.limits.title,
            "next_calibration": {"due": day, "why": why},
            "said": list(self.said),
        }


def history(index: Index, serial: str, model: str | None = None, limits: Limits | None = None) -> History:
    """Say what the archive knows of a unit; `model` tells two units with one serial number apart.

    Without `limits` the newest calibration's own. Raises `InputError` where there is no such unit, or there are two.
    """
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
    newest = {each.night or each.name: each for each in good}  # of a night that was carried on, what has most
    good = [each for each in good if newest[each.night or each.name] is each]
    used = [each for each in good if each.good]
    said += [
        f"{each.name}: is {each.verdict} and tells nothing of the unit: {each.reason}"
        for each in good
        if each not in used
    ]
    settings = index.settings([each.settings for each in good])
    if limits is None and good:
        text = settings.get(good[-1].settings, {}).get("limits")
        if text is not None:
            from hil.config.limits import Limits

            limits = Limits.parse(text, good[-1].name)
    names = {each.name for each in used}
    means = [each for each in index.means(serial) if each.entry in names]
    began = {each.name: datetime.fromisoformat(each.began_utc).timestamp() / _MONTH_S for each in used}
    parameters, kind = list(_parameters(means, began, limits)), good[-1]
    said += _not_judged(limits, kind.model, parameters)
    return History(serial, kind.model, kind.simulated, good, used, _changes(good, settings), parameters, limits, said)


def _told(good: Sequence[Entry]) -> Iterator[str]:
    """Yield what is odd about a unit's entries: two nights at one time, nights that are not where they were."""
    for one, other in pairwise(good):
        if one.night and other.night and one.night != other.night and other.began_utc < one.ended_utc:
            yield (
                f"{one.name} and {other.name} were measured at the same time: two units with one serial number, or one "
                "clock is wrong"
            )
    yield from (
        f"{each.name}: its night is not at {each.whence} any more; what was averaged of it is here"
        for each in good
        if each.night and not Path(each.whence).exists()
    )


def _not_judged(limits: Limits | None, model: str, parameters: Sequence[Parameter]) -> Iterator[str]:
    """Yield of which limits the unit has no parameter; raise `InputError` for limits of another model."""
    if limits is None:
        return
    if limits.unit and model and limits.unit != model:
        raise InputError(f"{limits.source}: unit: these are limits of {limits.unit}, and the unit is {model}")
    there = {(each.sensor, each.name) for each in parameters}
    for sensor, of in limits.sensors.items():
        if lacking := [name for name in of if (sensor, name) not in there]:
            yield f"{limits.source}: sensor {sensor}: no calibration tells {', '.join(lacking)}: not judged"


def _changes(good: Sequence[Entry], settings: Mapping[str, Mapping[str, Any]]) -> dict[str, list[str]]:
    """Return what changed in bench, sweep and software since the entry before, where both were recorded by hil."""
    found = {}
    for before, now in pairwise(each for each in good if len(settings.get(each.settings, {})) > 0):
        old, new = settings[before.settings], settings[now.settings]
        keys = [key for key in dict.fromkeys([*old, *new]) if key != "limits" and old.get(key) != new.get(key)]
        found[now.name] = [f"{key}: {old.get(key, 'nothing')} → {new.get(key, 'nothing')}" for key in keys]
    return found


def _parameters(
    means: Sequence[ArchivedMean], began: Mapping[str, float], limits: Limits | None
) -> Iterator[Parameter]:
    by_parameter: dict[tuple[int, str], list[ArchivedMean]] = {}
    for each in means:
        by_parameter.setdefault((each.sensor, each.parameter), []).append(each)
    for (sensor, name), own in by_parameter.items():
        stations = stations_of(own)
        values = at_usual_temperatures(stations)
        names, shifts, errors, left = shifts_of(values)
        months = np.array([began[each] for each in names])
        together = trend(months, shifts, errors)
        k = 2.0 if limits is None else limits.k
        asked = None if limits is None else limits.sensors.get(sensor, {}).get(name)
        of_station = [_station(at, of, values[at], began, together, months, asked, k) for at, of in stations.items()]
        yield Parameter(
            sensor, name, own[0].value.unit, months, names, together, differs(left, names, together), of_station
        )


def _station(
    at: float | None,
    means: Sequence[ArchivedMean],
    values: Mapping[str, tuple[float, float]],
    began: Mapping[str, float],
    together: Trend,
    all_months: FloatArray,
    asked: ParameterLimits | None,
    k: float,
) -> Station:
    months = np.array([began[each.entry] for each in means])
    y, sd = np.array([values[each.entry] for each in means]).T
    since = float(all_months[together.step]) if together.step else -np.inf
    found = at_one_temperature(together, since, months, y, sd)
    before = months[:-1] >= since
    control = control_limits(y[:-1][before], sd[:-1][before])
    return Station(at, means, months, found, control, _due(found, months, asked, k))


def _due(found: Trend, months: FloatArray, asked: ParameterLimits | None, k: float) -> float | None:
    """Return in how many months after the newest its interval at `k` reaches a limit; None for not, or unknown."""
    if found.fit is None or asked is None or (asked.low is None and asked.high is None):
        return None
    value, wide = predicted(found.fit, months[-1] + _AHEAD_MONTHS, months, k)
    low, high = (-np.inf if asked.low is None else asked.low), (np.inf if asked.high is None else asked.high)
    beyond = (value - wide < low) | (value + wide > high)
    return float(_AHEAD_MONTHS[np.argmax(beyond)]) if beyond.any() else None


def _parameter(of: Parameter, days: Mapping[str, str]) -> dict[str, Any]:
    return {
        **picked(of, "sensor parameter=name unit"),
        **_trend(of.together, [days[name] for name in of.entries], of.unit),
        "differs_between_temperatures": of.differs,
        "temperatures": [
            {
                "temperature_degC": station.temperature_degC,
                **_trend(station.trend, [days[each.entry] for each in station.means], of.unit),
                "control": station.control
                and {
                    "centre": station.control.value,
                    **_ends(station.control.value, control_half_width(station.control)),
                    "outside": station.outside,
                },
                "due_in_months": station.due,
                "values": [
                    {"entry": each.entry, "day": days[each.entry], "own_degC": each.own_degC, **each.value.document()}
                    for each in station.means
                ],
            }
            for station in of.stations
        ],
    }


def _trend(found: Trend, days: Sequence[str], unit: str) -> dict[str, Any]:
    slope, jump = found.per_month, found.jump
    drift = slope and {"value": finite(slope.value), **_ends(slope.value, slope.half_width), "unit": f"{unit}/month"}
    between = {"between": [days[found.step - 1], days[found.step]]} if found.step else {}
    size = jump and {**between, "value": jump.value, **_ends(jump.value, jump.half_width), "unit": unit}
    return {"finding": found.word, "drift_per_month": drift, "jump": size}


def _ends(value: float, half_width: float) -> dict[str, float]:
    return {"low": value - half_width, "high": value + half_width}
