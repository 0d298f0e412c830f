"""Whether a chamber's readings can be true, judged over time: a jump that no air makes, a value that never changes.

One glitch is asked again by the driver. A jump that stays is a sensor, a changed unit or another channel; the watch
keeps saying so until the reading comes back to where it was, or somebody has prepared the chamber anew.
"""

from dataclasses import dataclass, field

from drivers.chambers.setpoints import check_plausible
from drivers.errors import SensorFault

# What a chamber's air can do. The fastest test chambers reach 15 °C/min.
_STEP_DEGC = 5.0  # what a reading may change at once
_SLEW_DEGC_PER_MIN = 15.0
_FROZEN_AFTER_S = 900.0  # the very same reading for so long …
_FROZEN_DISTANCE_DEGC = 2.0  # … this far from a setpoint that is being driven to


@dataclass(eq=False)
class ReadingWatch:
    """The readings of one sensor, in the order they were taken. `device` begins every message."""

    device: str
    _last: tuple[float, float] | None = field(default=None, init=False)  # time, °C
    _jumped_at_s: float | None = field(default=None, init=False)
    _same_since_s = 0.0

    def forget(self) -> None:
        """Begin anew: somebody has looked at the chamber."""
        self._last = self._jumped_at_s = None

    def accept(self, now_s: float, reading_degC: float, *, driven_to_degC: float | None) -> None:
        """Raise `SensorFault` for what cannot be true; `driven_to_degC` is the setpoint, where it is conditioned to."""
        check_plausible(reading_degC, self.device)
        if self._last is not None:
            self._refuse_jump(now_s, reading_degC, *self._last)
        if self._last is None or reading_degC != self._last[1]:
            self._same_since_s = now_s
        self._last = (now_s, reading_degC)
        self._refuse_frozen(now_s, reading_degC, driven_to_degC)

    def _refuse_jump(self, now_s: float, reading_degC: float, before_s: float, before_degC: float) -> None:
        # From the first sight of a jump on, time no longer widens what is allowed: a wrong unit never becomes right.
        until_s = now_s if self._jumped_at_s is None else self._jumped_at_s
        allowed_degC = _STEP_DEGC + _SLEW_DEGC_PER_MIN * max(until_s - before_s, 0.0) / 60.0
        if abs(reading_degC - before_degC) <= allowed_degC:
            self._jumped_at_s = None
            return
        self._jumped_at_s = until_s
        raise SensorFault(
            f"{self.device} reads {reading_degC:g} °C where it read {before_degC:g} °C {until_s - before_s:.0f} s "
            "before, which no chamber's air does; check its sensor, and that its panel still shows °C"
        )

    def _refuse_frozen(self, now_s: float, reading_degC: float, driven_to_degC: float | None) -> None:
        if driven_to_degC is None or abs(reading_degC - driven_to_degC) <= _FROZEN_DISTANCE_DEGC:
            self._same_since_s = now_s
        elif now_s - self._same_since_s >= _FROZEN_AFTER_S:
            raise SensorFault(
                f"{self.device} has read {reading_degC:g} °C without any change for "
                f"{(now_s - self._same_since_s) / 60.0:.0f} min on its way to {driven_to_degC:g} °C; its sensor is "
                "frozen, or it neither heats nor cools"
            )
