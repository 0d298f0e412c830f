"""The chamber's air together with what the chamber was told, for effects that depend on the last change of setpoint."""

import numpy as np

from drivers.simulators.chambers.plant import ChamberPlant, FloatArray


class LoggedPlant(ChamberPlant):
    """A `ChamberPlant` that remembers its commands. It is the air and the setpoints of the simulated unit."""

    def __init__(self, **settings: float) -> None:
        super().__init__(**settings)
        self._commanded_s: list[float] = []
        self._setpoints: list[float] = []

    def command(self, setpoint_degC: float | None, at_s: float) -> None:
        """Condition to `setpoint_degC`, or stop conditioning (None), from `at_s` on, and remember it."""
        if setpoint_degC is not None and (not self._setpoints or self._setpoints[-1] != setpoint_degC):
            self._commanded_s.append(at_s)
            self._setpoints.append(setpoint_degC)
        super().command(setpoint_degC, at_s)

    def setpoint_at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the setpoint in force at each time and for how long, °C and s, (n,) each; NaN before the first."""
        last = np.searchsorted(self._commanded_s, times_s, side="right")
        return np.array([np.nan, *self._setpoints])[last], times_s - np.array([np.nan, *self._commanded_s])[last]
