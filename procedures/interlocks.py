"""What must not be: evaluated at every poll, in every step.

Each interlock says in one sentence what is wrong at this look, or nothing. `Interlocks` adds persistence: the first
sight is an event and holds the sweep (no step begins while something is suspected); a condition that clears is an
event and costs nothing; one that lasts its grace, and was seen at least twice, trips. One glitch does not end a night.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from drivers.chambers import ChamberLimits, ChamberReading
from drivers.frames.counts import StreamCounts
from drivers.imu import SampleBlock
from procedures.settings import InterlockSettings

_EXPECTED_FRAMES = 5.0  # an empty drain says nothing before so many frames should have come …
_SLOWEST_S = 2.0  # … and one of a unit that is set to another rate
_WINDOW_S = 120.0  # over which a rate is judged: long enough for a thermometer's resolution not to matter


@dataclass(frozen=True)
class Look:
    """One look at a unit and its chamber. `chamber` is the latest good reading, and news only where `chamber_fresh`."""

    time_s: float  # the clock's
    stream_span_s: float  # since the last good frame before this look
    samples: int
    counts: StreamCounts
    sample_rate_hz: float
    chamber: ChamberReading | None = None
    chamber_fresh: bool = False
    chamber_error: str = ""
    stream_error: str = ""
    unit_degC: Mapping[int, float] = field(default_factory=dict)  # by sensor, mean of what was drained
    commanded_degC: float | None = None
    frozen_s: Mapping[str, float] = field(default_factory=dict)  # "2.RA" → for how long it has not changed
    disk_free_mb: float | None = None
    resting: bool = False  # somebody has paused the sweep
    arrived: bool = False  # the air has reached the commanded setpoint since it was commanded
    unit: str = ""  # whose stream it is
    block: SampleBlock = field(default_factory=lambda: SampleBlock(np.empty(0), {}))  # what was drained


@dataclass(frozen=True)
class Interlock:
    """One thing that must not be; `problem` says what is wrong, "" for nothing, None where a look tells nothing."""

    name: str
    grace_s: float
    problem: Callable[[Look], str | None]
    of_unit: bool = False  # it ends the night of that unit alone


class InterlockTripped(Exception):
    """An interlock lasted its grace: the sweep ends in the safe state, or where it is a unit's, goes on without it."""

    def __init__(self, name: str, reason: str, *, of_unit: bool = False) -> None:
        super().__init__(f"{name}: {reason}")
        self.name = name
        self.reason = reason
        self.of_unit = of_unit


def standard_interlocks(settings: InterlockSettings, limits: ChamberLimits) -> Sequence[Interlock]:
    """Return the interlocks of every bench, with its limits; those on how fast temperatures move have a memory."""
    s = settings
    return (
        Interlock("chamber-lost", s.chamber_loss_s, _chamber_lost),
        Interlock("chamber-alarm", s.alarm_grace_s, _on_news(_chamber_alarm)),
        Interlock("chamber-limits", s.chamber_limit_grace_s, _on_news(partial(_chamber_limits, s, limits))),
        Interlock("chamber-stopped", s.setpoint_grace_s, _on_news(_chamber_stopped)),
        Interlock("setpoint-changed", s.setpoint_grace_s, _on_news(partial(_setpoint_changed, s))),
        Interlock("setpoint-not-followed", s.follow_grace_s, _on_news(partial(_setpoint_not_followed, s))),
        Interlock("unit-limits", s.unit_limit_grace_s, partial(_unit_limits, s), of_unit=True),
        Interlock("stream-lost", s.stream_loss_s, _stream_lost, of_unit=True),
        Interlock("stream-frozen", 0.5 * s.frozen_s, partial(_stream_frozen, s), of_unit=True),
        Interlock("disk-low", s.disk_grace_s, partial(_disk_low, s)),
        Interlock("chamber-rate", s.rate_grace_s, _Rates(s.chamber_rate_degC_per_min, _chamber_air).problem),
        Interlock("unit-rate", s.rate_grace_s, _Rates(s.unit_rate_degC_per_min, _unit_sensors).problem, of_unit=True),
    )


def _on_news(check: Callable[[Look, ChamberReading], str]) -> Callable[[Look], str | None]:
    return lambda look: check(look, look.chamber) if look.chamber_fresh and look.chamber is not None else None


def _chamber_lost(look: Look) -> str | None:
    if look.chamber_error:
        return f"the chamber does not answer: {look.chamber_error}"
    return "" if look.chamber_fresh else None


def _chamber_alarm(_: Look, chamber: ChamberReading) -> str:
    return f"the chamber reports {', '.join(chamber.alarms)}" if chamber.alarms else ""


def _chamber_limits(settings: InterlockSettings, limits: ChamberLimits, _: Look, chamber: ChamberReading) -> str:
    low, high = limits.low_degC - settings.chamber_margin_degC, limits.high_degC + settings.chamber_margin_degC
    air = chamber.temperature_degC
    # Written so that a reading which is not a number is a problem too.
    return "" if low <= air <= high else f"the chamber is at {air:.1f} °C, outside {low:.1f} to {high:.1f} °C"


def _chamber_stopped(look: Look, chamber: ChamberReading) -> str:
    """After a power failure a chamber comes back stopped, perhaps with the setpoint it had, in air that drifts."""
    if look.commanded_degC is None or chamber.mode == "CONSTANT":
        return ""
    return f"the chamber was told to hold {look.commanded_degC:.1f} °C and is in mode {chamber.mode}"


def _setpoint_changed(settings: InterlockSettings, look: Look, chamber: ChamberReading) -> str:
    holds, commanded = chamber.setpoint_degC, look.commanded_degC
    if commanded is None or abs(holds - commanded) <= settings.setpoint_tolerance_degC:
        return ""
    return f"the chamber holds {holds:.1f} °C, {commanded:.1f} °C was commanded"


def _setpoint_not_followed(settings: InterlockSettings, look: Look, chamber: ChamberReading) -> str:
    air, commanded = chamber.temperature_degC, look.commanded_degC
    if commanded is None or not look.arrived or abs(air - commanded) <= settings.follow_tolerance_degC:
        return ""
    return f"the chamber was at its setpoint of {commanded:.1f} °C and has left it: {air:.1f} °C"


def _unit_limits(settings: InterlockSettings, look: Look) -> str | None:
    if not look.unit_degC:
        return None
    low, high = settings.unit_low_degC, settings.unit_high_degC
    outside = [f"sensor {n} at {value:.1f} °C" for n, value in look.unit_degC.items() if not low <= value <= high]
    return f"the unit is outside {low:.0f} to {high:.0f} °C: {', '.join(outside)}" if outside else ""


def _stream_lost(look: Look) -> str | None:
    if look.resting:
        return ""  # a pause is for cables; the unit is asked who it is afterwards
    if look.stream_error:
        return f"the unit's stream failed: {look.stream_error}"
    bad = look.counts.bad_checksum + look.counts.bad_delimiter
    if look.samples:
        return f"{bad} of {bad + look.samples} frames of the unit are damaged" if bad > look.samples else ""
    if look.stream_span_s < max(_EXPECTED_FRAMES / look.sample_rate_hz, _SLOWEST_S):
        return None
    return f"no good frame from the unit for {look.stream_span_s:.1f} s ({bad} damaged)"


def _stream_frozen(settings: InterlockSettings, look: Look) -> str | None:
    if look.resting:
        return ""
    if not look.samples or not look.frozen_s:
        return None
    # One that alone stands still fails its collects; here it is about a unit that sends but does not measure. Half of
    # the time is for the first sight: a coarse sensor may well show one value for a while.
    lasting_s = min(look.frozen_s.values())
    if lasting_s < 0.5 * settings.frozen_s:
        return ""
    return f"no rate of the unit has changed at all for {lasting_s:.0f} s: it sends, but does not measure"


def _disk_low(settings: InterlockSettings, look: Look) -> str | None:
    if look.disk_free_mb is None:
        return None
    if look.disk_free_mb >= settings.disk_low_mb:
        return ""
    return f"the disk is nearly full, {look.disk_free_mb:.0f} MB are free: free some space, then carry on"


class _Rates:
    """How fast what `values` takes from every look moves: a runaway shows long before it reaches a limit."""

    def __init__(self, limit_degC_per_min: float, values: Callable[[Look], Mapping[str, float]]) -> None:
        self._limit, self._values = limit_degC_per_min, values
        self._seen: dict[tuple[str, str], deque[tuple[float, float]]] = {}

    def problem(self, look: Look) -> str | None:
        """Return what moves too fast, "" where nothing does, None where this look has no news."""
        said: list[str] = []
        news = False
        for what, value in self._values(look).items():
            seen = self._seen.setdefault((look.unit, what), deque())
            seen.append((look.time_s, value))
            while len(seen) > 2 and look.time_s - seen[0][0] > _WINDOW_S:
                seen.popleft()
            begin_s, begin = seen[0]
            if look.time_s - begin_s < _WINDOW_S / 4.0:
                continue
            news = True
            rate = 60.0 * (value - begin) / (look.time_s - begin_s)
            if abs(rate) > self._limit:
                said.append(f"{what} moves by {rate:+.1f} °C/min, {self._limit:g} are allowed")
        return ", ".join(said) if news else None


def _chamber_air(look: Look) -> Mapping[str, float]:
    return {"the chamber": look.chamber.temperature_degC} if look.chamber_fresh and look.chamber is not None else {}


def _unit_sensors(look: Look) -> Mapping[str, float]:
    return {f"sensor {number}": value for number, value in look.unit_degC.items()}


@dataclass(eq=False)
class Interlocks:
    """All interlocks of a bench with their memory. `record(kind, message)` receives what begins and what clears."""

    interlocks: Sequence[Interlock]
    record: Callable[[str, str], None]
    # Since when and what, by interlock and unit:
    _suspicions: dict[tuple[str, str], tuple[float, str]] = field(default_factory=dict, init=False)

    @property
    def suspected(self) -> str:
        """What is suspected now, in words; empty where nothing is."""
        return "; ".join(f"{_named(*key)}: {reason}" for key, (_, reason) in self._suspicions.items())

    def countdown(self, time_s: float) -> str:
        """Say what is suspected and when it ends the sweep unless it clears; empty where nothing is."""
        graces_s = {each.name: each.grace_s for each in self.interlocks}
        left = [
            (max(graces_s[name] - (time_s - since_s), 0.0), unit, reason)
            for (name, unit), (since_s, reason) in self._suspicions.items()
        ]
        return "; ".join(
            f"{of_unit(unit)}{reason}; {'set aside' if unit else 'safe state'} in {left_s:.0f} s unless it clears"
            for left_s, unit, reason in sorted(left, key=lambda each: each[0])
        )

    def forget(self, unit: str) -> None:
        """Suspect nothing of a unit any more: it has been set aside."""
        self._suspicions = {key: each for key, each in self._suspicions.items() if key[1] != unit}

    def evaluate(self, look: Look, *, chamber: bool = True) -> None:
        """Judge one look, and the `chamber` at one of units that share it; raise `InterlockTripped` after the grace."""
        for each in self.interlocks:
            problem = each.problem(look) if each.of_unit or chamber else None
            if problem is None:
                continue
            key = (each.name, look.unit if each.of_unit else "")
            since_s, _ = self._suspicions.get(key, (look.time_s, ""))
            if not problem:
                if self._suspicions.pop(key, None):
                    self.record("interlock-cleared", f"{_named(*key)} cleared after {look.time_s - since_s:.0f} s")
                continue
            if key not in self._suspicions:
                what = f"sets unit {key[1]} aside" if key[1] else "ends the sweep"
                self.record("interlock-suspected", f"{_named(*key)}: {problem} ({what} after {each.grace_s:g} s)")
            elif (lasted_s := look.time_s - since_s) >= each.grace_s:
                raise InterlockTripped(each.name, f"{problem}; it lasted {lasted_s:.0f} s", of_unit=each.of_unit)
            self._suspicions[key] = (since_s, problem)


def of_unit(unit: str) -> str:
    """Say whose something is, before it; nothing of the only unit of a bench that lists none."""
    return f"unit {unit}: " if unit else ""


def _named(interlock: str, unit: str) -> str:
    return f"{interlock} of unit {unit}" if unit else interlock
