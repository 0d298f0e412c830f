"""The unit's temperatures: two lags in cascade behind the chamber's air, and the rotors' own heat after spin-on.

    d case / dt  = (air - case) / tau_case
    d rotor / dt = (case - rotor) / tau_rotor

A new setpoint reaches the rotor as the classical two-lag response: 45 minutes after the air began to move by 15.3 °C at
3 °C/min, 1.6 °C are still missing with 12 and 10 minutes. The time constants are assumed; the report has only the 45.

A spinning rotor is warmer than its case. The report's tables, and so the model file, are in terms of the temperature
of a soaked, spinning unit; the rotor temperature here is in the same terms. A unit that has just spun up therefore
reads `self_heating` too low, and gains it with the time constant `self_heating_lag`.

The state is advanced on a fixed grid and extrapolated along its slope in between, never from what has not happened
yet: whoever asks, however often, finds the same temperatures.
"""

import math
from collections.abc import Callable

import numpy as np

from hil.campaign import FloatArray
from hil.config.simulation import ThermalSection

GRID_S = 5.0
"""Spacing of the grid. Within it a rotor that follows a ramp of 3 °C/min departs from its slope by less than 1 m°C."""


Air = Callable[[FloatArray], FloatArray]
"""What a unit lies in, a simulated chamber's air or a planned one: its temperature, °C, at rising times, (n,) each."""


class ThermalUnit:
    """Case and rotor temperatures of a unit in `air`, shape (n,), that was at `start_degC` throughout at `begins_s`."""

    def __init__(
        self, settings: ThermalSection, air: Air, *, start_degC: float, begins_s: float, powered_for_s: float
    ) -> None:
        self._settings = settings
        self._air = air
        self._begins_s = begins_s
        self._spin_on_s = begins_s - powered_for_s
        self._case_gain = _ramp_response(settings.case_lag)
        self._rotor_gain = _ramp_response(settings.rotor_lag)
        self._last_air = start_degC
        self._case = start_degC
        self._rotor = start_degC
        self._nodes = 0

    def advance(self, to_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return new grid points to `to_s`: times (m,), air, case, rotor (m, 3), °C, slopes of the two (m, 2), °C/s."""
        last = math.floor((to_s - self._begins_s) / GRID_S) if to_s >= self._begins_s else -1
        numbers = np.arange(self._nodes, max(last + 1, self._nodes))
        times_s = np.asarray(self._begins_s + GRID_S * numbers, dtype=np.float64)
        air = self._air(times_s) if len(times_s) else np.empty(0)
        lagged = np.empty((len(times_s), 3))
        for row, air_degC in enumerate(air.tolist()):
            if self._nodes + row > 0:  # exact for an input that moves in a straight line between grid points
                (keep, old, new), (slowly, before, now) = self._case_gain, self._rotor_gain
                case = keep * self._case + old * self._last_air + new * air_degC
                self._rotor, self._case = slowly * self._rotor + before * self._case + now * case, case
            lagged[row] = air_degC, self._case, self._rotor
            self._last_air = air_degC
        self._nodes += len(times_s)
        settings = self._settings
        lacking = settings.self_heating * np.exp(-(times_s - self._spin_on_s) / settings.self_heating_lag)
        slopes = np.empty((len(times_s), 2))
        slopes[:, 0] = (lagged[:, 0] - lagged[:, 1]) / settings.case_lag
        slopes[:, 1] = (lagged[:, 1] - lagged[:, 2]) / settings.rotor_lag + lacking / settings.self_heating_lag
        lagged[:, 2] -= lacking
        return times_s, lagged, slopes


def _ramp_response(lag_s: float) -> tuple[float, float, float]:
    """Return the weights of the state, the former input and the present input over one grid step (first-order hold)."""
    keep = math.exp(-GRID_S / lag_s)
    new = 1.0 - (1.0 - keep) * lag_s / GRID_S
    return keep, 1.0 - keep - new, new
