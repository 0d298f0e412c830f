"""Waiting for evidence that the unit is in thermal equilibrium. Time alone is not evidence, and air is not the unit.

The criteria are the scheduled time, the chamber's band and slope, and the span and slope of the unit's own sensors;
all at once, held over the whole window. Leaving the band restarts the window; leaving it for longer than the excursion
time restarts the soak too, because the unit has then begun to follow. A ceiling ends the wait whatever the evidence.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import InitVar, dataclass, field
from typing import Any

import numpy as np

from procedures.quality import slope_per_min
from procedures.settings import Restabilisation
from procedures.unit_watch import labelled
from procedures.verdict import Verdict
from procedures.watch import Looks, Watch

Sensor = int | str
"""A thermometer, by its sensor's number, behind that of its unit where there are several: 0042.2."""

_EVALUATIONS = 20  # of the evidence, per window
_EPSILON_S = 1e-6


@dataclass(frozen=True)
class Decision:
    """What the evidence says at one instant. `since_s` says since when each met criterion has been met."""

    since_s: Mapping[str, float | None]
    evidence: Mapping[str, Any] = field(default_factory=dict)

    @property
    def met(self) -> bool:
        """True where every criterion is met."""
        return all(since is not None for since in self.since_s.values())

    @property
    def waiting_for(self) -> tuple[str, ...]:
        """The criteria that are not met."""
        return tuple(name for name, since in self.since_s.items() if since is None)

    @property
    def decided_by(self) -> str:
        """The criterion that was met last: what the wait was for in the end."""
        return max(self.since_s, key=lambda name: self.since_s[name] or 0.0)


@dataclass(eq=False)
class RestabilisationGate:
    """Judges looks at chamber and unit, in order of time. Pure: it neither waits nor reads."""

    settings: Restabilisation
    thermometers: InitVar[Collection[Sensor]]
    decision: Decision = field(default=Decision({"time": None}), init=False)
    soak_restarts = 0
    window_restarts = 0
    # When the present soak and the present stay in the band began, when that was left, and the last look was; or never.
    _soak_s = _band_s = _left_s = _last_s = math.inf
    _judged_s = -math.inf
    _judged_state = (False, False)

    def __post_init__(self, thermometers: Collection[Sensor]) -> None:
        self._air: list[tuple[float, float]] = []  # the window's looks: time, °C
        self._unit: dict[Sensor, list[tuple[float, float]]] = {sensor: [] for sensor in sorted(thermometers)}

    def forget(self, thermometers: Collection[Sensor]) -> None:
        """Judge these no more: their unit was set aside."""
        self._unit = {sensor: looks for sensor, looks in self._unit.items() if sensor not in thermometers}

    def look(self, time_s: float, air_degC: float, setpoint_degC: float, unit_degC: Mapping[Sensor, float]) -> Decision:
        """Take one look in and return the decision."""
        longest_s = max(self.settings.excursion_s, self.settings.window_s / 4.0)
        if self._left_s == math.inf and time_s - self._last_s > longest_s:
            self._leave(self._last_s)  # nobody knows what the air did meanwhile
        self._last_s = time_s
        # Written so that a reading which is not a number lies outside.
        if abs(air_degC - setpoint_degC) <= self.settings.band_degC:
            if time_s - self._left_s > self.settings.excursion_s and self._soak_s < math.inf:
                self._soak_s = math.inf
                self.soak_restarts += 1
            self._left_s = math.inf
            self._soak_s, self._band_s = min(self._soak_s, time_s), min(self._band_s, time_s)
            self._air.append((time_s, air_degC))
        elif self._left_s == math.inf:
            self._leave(time_s)
        for sensor in self._unit.keys() & unit_degC.keys():
            self._unit[sensor].append((time_s, unit_degC[sensor]))
        self._judge(time_s)
        return self.decision

    def _leave(self, time_s: float) -> None:
        """Forget what leaving the band makes worthless."""
        self.window_restarts += self._band_s < math.inf
        self._left_s, self._band_s = time_s, math.inf

    def _judge(self, time_s: float) -> None:
        """Judge the criteria: a few times per window, when the schedule is up, and at once where the band was left."""
        soaked = time_s - self._soak_s >= self.settings.at_least_s - _EPSILON_S
        due = time_s - self._judged_s >= self.settings.window_s / _EVALUATIONS - _EPSILON_S
        state = (soaked, self._band_s < math.inf)
        if not due and state == self._judged_state:
            return
        self._judged_s, self._judged_state = time_s, state
        begins_s = time_s - self.settings.window_s
        self._air = _recent(self._air, begins_s)
        self._unit = {sensor: _recent(looks, begins_s) for sensor, looks in self._unit.items()}
        held = self._band_s <= begins_s + _EPSILON_S
        air, unit = _evidence(self._air), {str(sensor): _evidence(looks) for sensor, looks in self._unit.items()}
        calm = held and _within(air, "slope_degC_per_min", self.settings.slope_degC_per_min)
        criteria = {"time": soaked, "band": held, "slope": calm}
        for sensor, looks in self._unit.items():
            pace_s = looks[1][0] - looks[0][0] if len(looks) > 1 else 0.0
            whole = bool(looks) and looks[0][0] <= begins_s + self.settings.window_s / _EVALUATIONS + pace_s
            steady = _within(unit[str(sensor)], "slope_degC_per_min", self.settings.unit_slope_degC_per_min)
            narrow = _within(unit[str(sensor)], "span_degC", self.settings.unit_band_degC)
            criteria[f"unit band (sensor {sensor})"] = whole and narrow
            criteria[f"unit slope (sensor {sensor})"] = whole and steady
        before = self.decision.since_s
        since_s = {
            name: (time_s if before.get(name) is None else before[name]) if met else None
            for name, met in criteria.items()
        }
        self.decision = Decision(since_s, {"chamber": air, "unit": unit})


def _recent(looks: list[tuple[float, float]], begins_s: float) -> list[tuple[float, float]]:
    """Return the looks of the window (the first may be a hair older, so that the window is covered)."""
    return [look for look in looks if look[0] >= begins_s - _EPSILON_S]


def _within(evidence: Mapping[str, float | None], what: str, most: float) -> bool:
    value = evidence[what]
    return value is not None and abs(value) <= most


def _evidence(looks: list[tuple[float, float]]) -> dict[str, float | None]:
    if not looks:
        return {"temperature_degC": None, "slope_degC_per_min": None, "span_degC": None}
    time_s, values = np.array(looks).T
    slope = slope_per_min(time_s, values)
    known = slope if slope is not None and np.isfinite(slope) else None
    return {"temperature_degC": looks[-1][1], "slope_degC_per_min": known, "span_degC": float(np.ptp(values))}


def restabilise(watch: Watch, settings: Restabilisation) -> Mapping[str, Any]:
    """Wait for the evidence of every unit, never longer than the ceiling; return everything that decided.

    `waiting_for` is empty where the evidence was there. Raises what a poll raises.

    Every sensor that has a temperature of its own is judged, and a silent one is no evidence; one of a unit that is set
    aside meanwhile is waited for no more. Where there are none, the result says that only chamber and time were judged.
    """
    thermometers = _thermometers(watch)
    gate = RestabilisationGate(settings, thermometers)
    began_s = watch.now_s
    _take_in(gate, watch, watch.poll())  # the soak begins with the step, also where no reading of the chamber is due
    for looks in watch.wait(began_s + settings.ceiling_s):
        gate.forget(thermometers - _thermometers(watch))
        if not next(iter(looks.values())).chamber_fresh or watch.commanded_degC is None:
            continue
        _take_in(gate, watch, looks)
        watch.note = "waiting for " + ", ".join(gate.decision.waiting_for)
        if gate.decision.met:
            break
    return _result(gate, watch.now_s - began_s, watch)


def _thermometers(watch: Watch) -> set[Sensor]:
    return {_sensor(name, number) for name, unit in watch.units.items() for number in unit.temperature_fields}


def _sensor(unit: str, number: int) -> Sensor:
    return labelled(unit, number) if unit else number


def _take_in(gate: RestabilisationGate, watch: Watch, looks: Looks) -> None:
    """Judge against what was commanded, not against what the chamber believes it was told."""
    look = next(iter(looks.values()))
    if look.chamber is None or watch.commanded_degC is None:
        return
    shown = {_sensor(unit, number): t for unit, each in looks.items() for number, t in each.unit_degC.items()}
    gate.look(look.time_s, look.chamber.temperature_degC, watch.commanded_degC, shown)


def _result(gate: RestabilisationGate, waited_s: float, watch: Watch) -> Mapping[str, Any]:
    """Return the result in words and numbers: of all, and where units are listed of each, which the others are not."""
    decision, thermometers = gate.decision, _thermometers(watch)
    waiting = decision.waiting_for
    verdict, reason = _judged(decision, waiting, waited_s, thermometers)
    told = {"verdict": verdict.value, "reason": reason, "waited_s": waited_s}
    by = {"decided_by": decision.decided_by if decision.met else None, "waiting_for": list(waiting)}
    restarts = {"soak_restarts": gate.soak_restarts, "window_restarts": gate.window_restarts}
    each = {}
    for unit in filter(None, watch.units):
        others = [str(sensor) for sensor in thermometers if not str(sensor).startswith(f"{unit}.")]
        own = [name for name in waiting if not name.endswith(tuple(f"(sensor {sensor})" for sensor in others))]
        its, why = _judged(decision, own, waited_s, thermometers)
        each[unit] = {"verdict": its.value, "reason": why, "waiting_for": own}
    units = {"units": each} if each else {}
    return {**told, **by, **restarts, **decision.evidence, **units}


def _judged(
    decision: Decision, waiting: Sequence[str], waited_s: float, thermometers: Collection[Sensor]
) -> tuple[Verdict, str]:
    minutes = waited_s / 60.0
    if decision.met:
        reason = f"restabilised after {minutes:.1f} min, decided by {decision.decided_by}"
    elif waiting:
        reason = f"not restabilised within {minutes:.0f} min, as long as the sweep lets it: {', '.join(waiting)}"
    else:
        reason = f"restabilised within {minutes:.0f} min; other units were not"
    if not thermometers:
        reason += "; the unit has no temperature sensor, so only chamber and time were judged"
    return Verdict.INCONCLUSIVE if waiting else Verdict.PASS, reason
