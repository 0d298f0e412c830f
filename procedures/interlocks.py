"""What must not be: evaluated at every poll, in every step.

Each interlock says in one sentence what is wrong at this look, or nothing. `Interlocks` adds persistence: the first
sight is an event and holds the sweep (no step begins while something is suspected); a condition that clears is an
event and costs nothing; one that lasts its grace, and was seen at least twice, trips. One glitch does not end a night.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from drivers.chambers import ChamberLimits, ChamberReading
from drivers.frames.counts import StreamCounts
from drivers.imu import SampleBlock
from procedures.settings import InterlockSettings

_EXPECTED_FRAMES = 5.0  # an empty drain says nothing before so many frames should have come …
_SLOWEST_S = 2.0  # … and one of a unit that is set to another rate
_WINDOW_S = 120.0  # over which a rate is judged: long enough for a thermometer's resolution not to matter
OF_A_UNIT = ("unit-limits", "stream-lost", "stream-frozen", "unit-rate")
Problems = Iterator[tuple[str, str | None]]


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


class InterlockTripped(Exception):
    """An interlock lasted its grace: the sweep ends in the safe state, or where it is a unit's, goes on without it."""

    def __init__(self, name: str, reason: str, *, of_unit: bool = False) -> None:
        super().__init__(f"{name}: {reason}")
        self.name = name
        self.reason = reason
        self.of_unit = of_unit


def _of_chamber(s: InterlockSettings, limits: ChamberLimits, look: Look) -> Problems:
    if look.chamber_error:
        yield "chamber-lost", f"the chamber does not answer: {look.chamber_error}"
    if not look.chamber_fresh or look.chamber is None:
        return
    if not look.chamber_error:
        yield "chamber-lost", ""
    chamber, commanded = look.chamber, look.commanded_degC
    yield "chamber-alarm", f"the chamber reports {', '.join(chamber.alarms)}" if chamber.alarms else ""
    low, high = limits.low_degC - s.chamber_margin_degC, limits.high_degC + s.chamber_margin_degC
    air, holds = chamber.temperature_degC, chamber.setpoint_degC
    # Written so that a reading which is not a number is a problem too.
    outside = f"the chamber is at {air:.1f} °C, outside {low:.1f} to {high:.1f} °C"
    yield "chamber-limits", "" if low <= air <= high else outside
    stopped = changed = left = ""
    if commanded is not None:
        # After a power failure a chamber comes back stopped, perhaps with the setpoint it had, in air that drifts.
        stopped = f"the chamber was told to hold {commanded:.1f} °C and is in mode {chamber.mode}"
        changed = f"the chamber holds {holds:.1f} °C, {commanded:.1f} °C was commanded"
        left = f"the chamber was at its setpoint of {commanded:.1f} °C and has left it: {air:.1f} °C"
        stopped = "" if chamber.mode == "CONSTANT" else stopped
        changed = "" if abs(holds - commanded) <= s.setpoint_tolerance_degC else changed
        left = "" if not look.arrived or abs(air - commanded) <= s.follow_tolerance_degC else left
    yield from (("chamber-stopped", stopped), ("setpoint-changed", changed), ("setpoint-not-followed", left))


def _of_unit(s: InterlockSettings, look: Look) -> Problems:
    if look.unit_degC:
        low, high = s.unit_low_degC, s.unit_high_degC
        outside = [f"sensor {n} at {value:.1f} °C" for n, value in look.unit_degC.items() if not low <= value <= high]
        said = f"the unit is outside {low:.0f} to {high:.0f} °C: {', '.join(outside)}"
        yield "unit-limits", said if outside else ""
    if look.resting:  # a pause is for cables; the unit is asked who it is afterwards
        yield from (("stream-lost", ""), ("stream-frozen", ""))
        return
    bad = look.counts.bad_checksum + look.counts.bad_delimiter
    if look.stream_error:
        yield "stream-lost", f"the unit's stream failed: {look.stream_error}"
    elif look.samples:
        said = f"{bad} of {bad + look.samples} frames of the unit are damaged"
        yield "stream-lost", said if bad > look.samples else ""
    elif look.stream_span_s >= max(_EXPECTED_FRAMES / look.sample_rate_hz, _SLOWEST_S):
        yield "stream-lost", f"no good frame from the unit for {look.stream_span_s:.1f} s ({bad} damaged)"
    if look.samples and look.frozen_s:
        # One that alone stands still fails its collects; here it is about a unit that sends but does not measure. Half
        # of the time is for the first sight: a coarse sensor may well show one value for a while.
        lasting_s = min(look.frozen_s.values())
        said = f"no rate of the unit has changed at all for {lasting_s:.0f} s: it sends, but does not measure"
        yield "stream-frozen", said if lasting_s >= 0.5 * s.frozen_s else ""


class _Rates:
    """How fast temperatures move from look to look: a runaway shows long before it reaches a limit."""

    def __init__(self, limit_degC_per_min: float) -> None:
        self._limit = limit_degC_per_min
        self._seen: dict[tuple[str, str], deque[tuple[float, float]]] = {}

    def problem(self, look: Look, values: Mapping[str, float]) -> str | None:
        """Return which of these values moves too fast, "" where none does, None where this look has no news."""
        said: list[str] = []
        news = False
        for what, value in values.items():
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


@dataclass(eq=False)
class Interlocks:
    """All interlocks of a bench with their memory; `record(kind, message)` receives what begins and what clears."""

    settings: InterlockSettings
    limits: ChamberLimits
    record: Callable[[str, str], None]
    # Since when and what, by interlock and unit:
    _suspicions: dict[tuple[str, str], tuple[float, str]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        s = self.settings
        self._air, self._sensors = _Rates(s.chamber_rate_degC_per_min), _Rates(s.unit_rate_degC_per_min)
        self._graces_s = {
            "chamber-lost": s.chamber_loss_s,
            "chamber-alarm": s.alarm_grace_s,
            "chamber-limits": s.chamber_limit_grace_s,
            "chamber-stopped": s.setpoint_grace_s,
            "setpoint-changed": s.setpoint_grace_s,
            "setpoint-not-followed": s.follow_grace_s,
            "unit-limits": s.unit_limit_grace_s,
            "stream-lost": s.stream_loss_s,
            "stream-frozen": 0.5 * s.frozen_s,
            "disk-low": s.disk_grace_s,
            "chamber-rate": s.rate_grace_s,
            "unit-rate": s.rate_grace_s,
        }

    def problems(self, look: Look, *, chamber: bool = True) -> Problems:
        """Yield by interlock what is wrong at a look, "" for nothing; of what it says nothing about None, or none."""
        if chamber:
            yield from _of_chamber(self.settings, self.limits, look)
        yield from _of_unit(self.settings, look)
        if chamber and (free_mb := look.disk_free_mb) is not None:
            said = f"the disk is nearly full, {free_mb:.0f} MB are free: free some space, then carry on"
            yield "disk-low", "" if free_mb >= self.settings.disk_low_mb else said
        if chamber and look.chamber_fresh and look.chamber is not None:
            yield "chamber-rate", self._air.problem(look, {"the chamber": look.chamber.temperature_degC})
        yield "unit-rate", self._sensors.problem(look, {f"sensor {n}": degC for n, degC in look.unit_degC.items()})

    @property
    def suspected(self) -> str:
        """What is suspected now, in words; empty where nothing is."""
        return "; ".join(f"{_named(*key)}: {reason}" for key, (_, reason) in self._suspicions.items())

    def countdown(self, time_s: float) -> str:
        """Say what is suspected and when it ends the sweep unless it clears; empty where nothing is."""
        left = [
            (max(self._graces_s[name] - (time_s - since_s), 0.0), unit, reason)
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
        for name, problem in self.problems(look, chamber=chamber):
            if problem is None:
                continue
            of_unit = name in OF_A_UNIT
            grace_s, key = self._graces_s[name], (name, look.unit if of_unit else "")
            since_s, _ = self._suspicions.get(key, (look.time_s, ""))
            if not problem:
                if self._suspicions.pop(key, None):
                    self.record("interlock-cleared", f"{_named(*key)} cleared after {look.time_s - since_s:.0f} s")
                continue
            if key not in self._suspicions:
                what = f"sets unit {key[1]} aside" if key[1] else "ends the sweep"
                self.record("interlock-suspected", f"{_named(*key)}: {problem} ({what} after {grace_s:g} s)")
            elif (lasted_s := look.time_s - since_s) >= grace_s:
                raise InterlockTripped(name, f"{problem}; it lasted {lasted_s:.0f} s", of_unit=of_unit)
            self._suspicions[key] = (since_s, problem)


def of_unit(unit: str) -> str:
    """Say whose something is, before it; nothing of the only unit of a bench that lists none."""
    return f"unit {unit}: " if unit else ""


def _named(interlock: str, unit: str) -> str:
    return f"{interlock} of unit {unit}" if unit else interlock
