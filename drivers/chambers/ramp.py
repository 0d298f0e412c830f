"""Ramps: by the controller where it can, otherwise by stepping its setpoint from here, no more often than needed.

    chamber = RampedChamber(chamber, clock, degC_per_min=1.0)
    chamber.prepare()
    chamber.set_temperature(60.0)       # the first step; every later reading moves it on

Many controllers keep their setpoint in memory that wears out, so a step is at least 0.5 °C and 30 s from the last one,
and nothing is written where nothing changes. If the program dies, the chamber holds the last step.
"""

import math
from dataclasses import KW_ONLY, dataclass, field, replace

from drivers.chambers.chamber import ChamberIdentity, ChamberReading, SafeState
from drivers.chambers.setpoints import clamped
from drivers.chambers.supervised import SupervisedChamber
from drivers.clock import Clock

_LEAST_STEP_DEGC = 0.5
_LEAST_INTERVAL_S = 30.0
_SAME_DEGC = 0.06  # within half of the coarsest step that a controller here holds


def steps_of_a_ramp(span_degC: float, degC_per_min: float) -> int:
    """Return how often the setpoint is written, at most, to move it by `span_degC` from here."""
    per_step_degC = max(_LEAST_STEP_DEGC, degC_per_min / 60.0 * _LEAST_INTERVAL_S)
    return max(1, math.ceil(abs(span_degC) / per_step_degC) + 1)


@dataclass(eq=False)
class RampedChamber:
    """A `Chamber` whose setpoint moves no faster than `degC_per_min`.

    While a ramp runs its readings give the setpoint it leads to, as long as the controller holds the present step; any
    other setpoint (somebody at the panel) is given as it is. Raises `ValueError` for a rate that is not positive.
    """

    chamber: SupervisedChamber
    clock: Clock
    _: KW_ONLY
    degC_per_min: float
    _target: float | None = field(default=None, init=False)
    native = False  # whether the controller ramps by itself; known once it is prepared
    _begins_degC = _began_s = _step = _stepped_s = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.degC_per_min < math.inf:
            raise ValueError(f"a ramp rate is a positive number of °C/min, not {self.degC_per_min:g}")
        self.limits = self.chamber.limits

    @property
    def ramping(self) -> bool:
        """Whether steps are still to be made from here."""
        return self._target is not None and self._step != self._target

    @property
    def wear_warning(self) -> str | None:
        return self.chamber.wear_warning

    def identify(self) -> ChamberIdentity:
        return self.chamber.identify()

    def prepare(self) -> None:
        self._target = None
        self.chamber.prepare()
        self.native = self.chamber.set_ramp_rate(self.degC_per_min)

    def read(self) -> ChamberReading:
        """Read, and move a running ramp on where a step is due."""
        reading = self.chamber.read()
        if self._target is None:
            return reading
        if abs(reading.setpoint_degC - self._step) > _SAME_DEGC:
            return reading  # not ours any more: nothing is written over somebody else's setpoint
        now_s = self.clock.now()
        if self._step != self._target and now_s - self._stepped_s >= _LEAST_INTERVAL_S:
            # Counted from the ramp's beginning, so that what a write takes is not lost each time.
            step = _towards(self._begins_degC, self._target, self.degC_per_min / 60.0 * (now_s - self._began_s))
            if abs(step - self._step) >= _LEAST_STEP_DEGC or step == self._target:
                self._write(step)
        return replace(reading, setpoint_degC=self._target)

    def set_temperature(self, setpoint_degC: float) -> None:
        """Begin a ramp from the air's temperature, with its first step; `SetpointOutOfLimits` before that is sent."""
        self._target = None
        if self.native or clamped(setpoint_degC, self.limits) != setpoint_degC:
            self.chamber.set_temperature(setpoint_degC)
            return
        self._begins_degC = clamped(self.chamber.read().temperature_degC, self.limits)
        self._began_s = self.clock.now()
        self._write(_towards(self._begins_degC, setpoint_degC, _LEAST_STEP_DEGC))
        self._target = setpoint_degC

    def safe_state(self) -> SafeState:
        self._target = None
        return self.chamber.safe_state()

    def close(self) -> None:
        self.chamber.close()

    def _write(self, step_degC: float) -> None:
        self._stepped_s = self.clock.now()
        self.chamber.set_temperature(step_degC)
        self._step = step_degC


def _towards(here: float, there: float, most: float) -> float:
    return there if abs(there - here) <= most else here + math.copysign(most, there - here)
