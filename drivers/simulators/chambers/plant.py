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
from dataclasses import dataclass

import numpy as np

from drivers.frames.wire import FloatArray

_OVERSHOOT_OF_A_STEP = 0.3
_FASTEST_SETTLING_S = 5.0


@dataclass(frozen=True)
class _Leak:
    """No conditioning: an exponential towards ambient."""

    begins_degC: float
    ambient_degC: float
    time_constant_s: float

    def at(self, elapsed_s: FloatArray | float) -> FloatArray:
        excess = self.begins_degC - self.ambient_degC
        return np.asarray(self.ambient_degC + excess * np.exp(-elapsed_s / self.time_constant_s), dtype=np.float64)

    def slope_per_s(self, elapsed_s: float) -> float:
        excess = self.begins_degC - self.ambient_degC
        return -excess / self.time_constant_s * math.exp(-elapsed_s / self.time_constant_s)


@dataclass(frozen=True)
class _Ramp:
    """Conditioning towards a setpoint, at most at the ramp limit."""

    begins_degC: float
    rate_per_s: float  # the limit, signed
    initial_per_s: float
    response_s: float

    def at(self, elapsed_s: FloatArray | float) -> FloatArray:
        lag = (self.rate_per_s - self.initial_per_s) * self.response_s
        gone = -np.expm1(-elapsed_s / self.response_s)
        return np.asarray(self.begins_degC + self.rate_per_s * elapsed_s - lag * gone, dtype=np.float64)

    def slope_per_s(self, elapsed_s: float) -> float:
        return self.rate_per_s + (self.initial_per_s - self.rate_per_s) * math.exp(-elapsed_s / self.response_s)

    def duration_to(self, setpoint_degC: float) -> float:
        """Return when the setpoint is reached (the last time, where the air still moves the other way at first)."""
        from scipy.optimize import brentq  # imported late: it is slow, and only a simulated chamber needs it

        distance = abs(setpoint_degC - self.begins_degC)
        if distance == 0.0:
            return 0.0
        # The air is at most (s - v0) a behind a ramp that began at full rate.
        behind_s = (1.0 + abs(self.initial_per_s / self.rate_per_s)) * self.response_s
        latest_s = distance / abs(self.rate_per_s) + behind_s + 1.0
        sign = math.copysign(1.0, self.rate_per_s)
        return float(brentq(lambda u: sign * (self.at(u) - setpoint_degC), 0.0, latest_s, xtol=1e-9))


@dataclass(frozen=True)
class _Settled:
    """At the setpoint: the overshoot dies away, a small ripple of the control loop remains."""

    setpoint_degC: float
    initial_per_s: float
    settling_s: float
    ripple_degC: float
    ripple_period_s: float

    def at(self, elapsed_s: FloatArray | float) -> FloatArray:
        fade = np.exp(-elapsed_s / self.settling_s)
        ripple = self.ripple_degC * (1.0 - fade) * np.sin(2.0 * np.pi * elapsed_s / self.ripple_period_s)
        return np.asarray(self.setpoint_degC + self.initial_per_s * elapsed_s * fade + ripple, dtype=np.float64)

    def slope_per_s(self, elapsed_s: float) -> float:
        return self.initial_per_s * (1.0 - elapsed_s / self.settling_s) * math.exp(-elapsed_s / self.settling_s)


_Segment = _Leak | _Ramp | _Settled  # a stretch of the history; `elapsed_s` counts from its beginning


class ChamberPlant:
    """The air, °C, from `begins_s` on, at ambient. Rates are °C/min, positive (else `ValueError`); times in s."""

    def __init__(
        self,
        *,
        ambient_degC: float = 22.0,
        heating_degC_per_min: float = 3.0,
        cooling_degC_per_min: float = 2.0,
        response_s: float = 20.0,
        settling_s: float = 60.0,
        ripple_degC: float = 0.05,
        ripple_period_s: float = 180.0,
        leak_s: float = 3600.0,
        begins_s: float = 0.0,
    ) -> None:
        if heating_degC_per_min <= 0 or cooling_degC_per_min <= 0:
            raise ValueError("heating and cooling rates are given as positive numbers, °C/min")
        self.ambient_degC = ambient_degC
        self._heating_per_s = heating_degC_per_min / 60.0
        self._cooling_per_s = cooling_degC_per_min / 60.0
        # The controller's own ramp up and down, from the next command on; 0 for no bound.
        self.ramp_degC_per_min: tuple[float, ...] = (0.0, 0.0)
        self._response_s = response_s
        self._settling_s = settling_s
        self._ripple = (ripple_degC, ripple_period_s)
        self._leak_s = leak_s
        self.commanded_degC: float | None = None  # None while unconditioned; a dead plant does not follow it
        self._told: list[tuple[float, float]] = []  # when, and which setpoint: every one that is not the last again
        self._dead = False
        self._astray_degC = 0.0
        self._now_s = begins_s
        self._begins: list[float] = [begins_s]
        self._segments: list[_Segment] = [_Leak(ambient_degC, ambient_degC, leak_s)]

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
        """Begin a new stretch of history from the present temperature and rate."""
        at_s = max(at_s, self._now_s)
        while len(self._begins) > 1 and self._begins[-1] > at_s:  # the settling that a new command overtakes
            self._begins.pop()
            self._segments.pop()
        air = self.advance(at_s)
        rate = self._segments[-1].slope_per_s(max(at_s - self._begins[-1], 0.0))
        self._begins.append(at_s)
        if self.commanded_degC is None or self._dead:
            self._segments.append(_Leak(air, self.ambient_degC, self._leak_s))
            return
        target = self.commanded_degC + self._astray_degC
        up_per_s, down_per_s = (each / 60.0 or math.inf for each in self.ramp_degC_per_min)
        limit = min(self._heating_per_s, up_per_s) if target > air else -min(self._cooling_per_s, down_per_s)
        ramp = _Ramp(air, limit, rate, self._response_s)
        duration_s = ramp.duration_to(target)
        arrives, settling_s = ramp.slope_per_s(duration_s), self._settling_s
        if arrives != 0.0:  # a small step overshoots by at most a share of itself
            allowed_s = _OVERSHOOT_OF_A_STEP * abs(target - air) * math.e / abs(arrives)
            settling_s = min(settling_s, max(allowed_s, _FASTEST_SETTLING_S))
        self._begins.append(at_s + duration_s)
        self._segments += [ramp, _Settled(target, arrives, settling_s, *self._ripple)]
