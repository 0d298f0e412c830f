"""The air in a chamber under the chamber's own controller: ramp limit, overshoot, ripple, ambient when off.

Every command begins a segment, and within a segment the temperature is a closed formula, so a night costs next to
nothing and any moment of it can be asked for, in any order. While it ramps the air approaches the ramp limit s from
the rate v0 at which it was,

    T(u) = T0 + s u - (s - v0) a (1 - exp(-u / a)),

and once it reaches the setpoint, at rate v, it settles as a critically damped loop does,

    T(u) = setpoint + v u exp(-u / b) + ripple,

which overshoots by v b / e: 1.1 °C for 3 °C/min and b = 60 s (b is less for a small step, which overshoots by at most
0.3 of itself). Without conditioning it leaks towards ambient.
The slope never exceeds the ramp limit. The form is a simulator's convenience, not any maker's control law.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from drivers.frames.wire import FloatArray

_OVERSHOOT_OF_A_STEP = 0.3
_FASTEST_SETTLING_S = 5.0
_RIPPLE_PERIOD_S = 180.0
_THERE_DEGC = 1e-9


@dataclass(frozen=True)
class _Segment:
    """A stretch of the history, u s from its beginning: level + slope u + (off + pace u) exp(-u / fade) + ripple."""

    fade_s: float
    level_degC: float
    off_degC: float = 0.0
    slope_per_s: float = 0.0
    pace_per_s: float = 0.0
    ripple_degC: float = 0.0

    def at(self, elapsed_s: FloatArray | float) -> FloatArray:
        fade = np.exp(-elapsed_s / self.fade_s)
        ripple = self.ripple_degC * (1.0 - fade) * np.sin(2.0 * np.pi * elapsed_s / _RIPPLE_PERIOD_S)
        off = (self.off_degC + self.pace_per_s * elapsed_s) * fade
        return np.asarray(self.level_degC + self.slope_per_s * elapsed_s + off + ripple, dtype=np.float64)

    def rate_per_s(self, elapsed_s: float) -> float:
        """Return how fast it moves, but for the ripple."""
        off = self.off_degC + self.pace_per_s * elapsed_s
        return self.slope_per_s + (self.pace_per_s - off / self.fade_s) * math.exp(-elapsed_s / self.fade_s)


def _reached_s(ramp: _Segment, begins_degC: float, target_degC: float) -> float:
    """Return when a ramp is at its target (the last time, where the air still moves the other way at first)."""
    from scipy.optimize import brentq  # imported late: it is slow, and only a simulated chamber needs it

    distance = abs(target_degC - begins_degC)
    if distance < _THERE_DEGC:
        return 0.0
    # The air is at most (s - v0) a behind a ramp that began at full rate.
    behind_s = (1.0 + abs(ramp.rate_per_s(0.0) / ramp.slope_per_s)) * ramp.fade_s
    latest_s = distance / abs(ramp.slope_per_s) + behind_s + 1.0
    sign = math.copysign(1.0, ramp.slope_per_s)
    return float(brentq(lambda u: sign * (ramp.at(u) - target_degC), 0.0, latest_s, xtol=1e-9))


@dataclass(eq=False, kw_only=True)
class ChamberPlant:
    """The air, °C, from `begins_s` on, at ambient. Rates are °C/min, positive (else `ValueError`); times in s."""

    ambient_degC: float = 22.0
    heating_degC_per_min: float = 3.0
    cooling_degC_per_min: float = 2.0
    response_s: float = 20.0
    settling_s: float = 60.0
    ripple_degC: float = 0.05
    leak_s: float = 3600.0
    begins_s: float = 0.0
    # The controller's own ramp up and down, from the next command on; 0 for no bound.
    ramp_degC_per_min: tuple[float, ...] = field(default=(0.0, 0.0), init=False)
    # None while unconditioned; a dead plant does not follow it.
    commanded_degC: float | None = field(default=None, init=False)
    _dead = False
    _astray_degC = 0.0

    def __post_init__(self) -> None:
        if self.heating_degC_per_min <= 0 or self.cooling_degC_per_min <= 0:
            raise ValueError("heating and cooling rates are given as positive numbers, °C/min")
        self._told: list[tuple[float, float]] = []  # when, and which setpoint: every one that is not the last again
        self._now_s = self.begins_s
        self._begins = [self.begins_s]
        self._segments = [_Segment(self.leak_s, self.ambient_degC)]

    def command(self, setpoint_degC: float | None, at_s: float) -> None:
        """Condition to `setpoint_degC`, or stop (None), from `at_s` on: not before the latest time asked for."""
        if setpoint_degC is not None and (not self._told or self._told[-1][1] != setpoint_degC):
            self._told.append((at_s, setpoint_degC))
        if setpoint_degC == self.commanded_degC:
            return
        self.commanded_degC = setpoint_degC
        self._restart(at_s)

    def setpoint_at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the setpoint in force at each time and for how long, °C and s, (n,) each; NaN before the first."""
        at_s, setpoint = np.array([(np.nan, np.nan), *self._told]).T
        last = np.searchsorted(at_s[1:], times_s, side="right")
        return setpoint[last], times_s - at_s[last]

    def fail(self, *, dead: bool, at_s: float) -> None:
        """Let compressor and heater fail: setpoints are taken and not followed; or let them work again."""
        self._dead = dead
        self._restart(at_s)

    def go_astray(self, by_degC: float, at_s: float) -> None:
        """Let the control loop drive the air this far beyond its setpoint (0 for no longer), while it conditions."""
        self._astray_degC = by_degC
        self._restart(at_s)

    def advance(self, to_s: float) -> float:
        """Move the present to `to_s` and return the air temperature there, °C."""
        self._now_s = max(self._now_s, to_s)
        number = max(bisect_right(self._begins, to_s) - 1, 0)
        return float(self._segments[number].at(max(to_s - self._begins[number], 0.0)))

    def air_degC(self, times_s: FloatArray) -> FloatArray:
        """Return the air temperature at `times_s`, any shape, °C: the whole history can be asked for again."""
        times = np.asarray(times_s, dtype=np.float64)
        if times.size == 0:
            return np.empty(times.shape)
        self._now_s = max(self._now_s, float(times.max()))
        owner = np.maximum(np.searchsorted(self._begins, times, side="right") - 1, 0)
        air = np.empty(times.shape)
        for number in range(int(owner.min()), int(owner.max()) + 1):
            mine = owner == number
            air[mine] = self._segments[number].at(np.maximum(times[mine] - self._begins[number], 0.0))
        return air

    def _restart(self, at_s: float) -> None:
        at_s = max(at_s, self._now_s)
        while len(self._begins) > 1 and self._begins[-1] > at_s:  # the settling that a new command overtakes
            self._begins.pop()
            self._segments.pop()
        air = self.advance(at_s)
        rate = self._segments[-1].rate_per_s(max(at_s - self._begins[-1], 0.0))
        self._begins.append(at_s)
        if self.commanded_degC is None or self._dead:
            self._segments.append(_Segment(self.leak_s, self.ambient_degC, air - self.ambient_degC))
            return
        target = self.commanded_degC + self._astray_degC
        up, down = (each or math.inf for each in self.ramp_degC_per_min)
        limit = min(self.heating_degC_per_min, up) if target > air else -min(self.cooling_degC_per_min, down)
        limit /= 60.0
        lag = (limit - rate) * self.response_s
        ramp = _Segment(self.response_s, air - lag, lag, limit)
        duration_s = _reached_s(ramp, air, target)
        arrives, settling_s = ramp.rate_per_s(duration_s), self.settling_s
        if arrives != 0.0:  # a small step overshoots by at most a share of itself
            allowed_s = _OVERSHOOT_OF_A_STEP * abs(target - air) * math.e / abs(arrives)
            settling_s = min(settling_s, max(allowed_s, _FASTEST_SETTLING_S))
        self._begins.append(at_s + duration_s)
        self._segments += [ramp, _Segment(settling_s, target, pace_per_s=arrives, ripple_degC=self.ripple_degC)]
