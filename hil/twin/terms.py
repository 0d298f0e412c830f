"""A simulated sensor whose model has named terms: the rates come from the model itself, terms included.

The terms may depend on anything that a campaign knows and on the past (hysteresis, a setpoint's step), so they are
evaluated in groups of grid points, five minutes each, with a history of one row for every group before. Each grid point
stands for the mean over its 5 s.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hil.campaign import Conditions, FloatArray
from hil.model.effects.history import joined
from hil.twin.grid import CASE, ROTOR, SlowGrid
from hil.twin.motion import Leg
from hil.twin.sensor import SimulatedSensor
from hil.twin.thermal import GRID_S

_GROUP = 60  # grid points per evaluation: five minutes


class Setpoints(Protocol):
    """Whatever knows what the chamber was told."""

    def setpoint_at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the setpoint in force at each time and for how long, °C and s, (n,) each; NaN before the first."""


class TermRates:
    """Rates of one sensor at its orientation, from `Model.rates`."""

    def __init__(self, sensor: SimulatedSensor, grid: SlowGrid, spun_up_s: float, setpoints: Setpoints | None) -> None:
        self._sensor, self._grid, self._spun_up_s, self._setpoints = sensor, grid, spun_up_s, setpoints
        self._history: Conditions | None = None  # the first grid point of every group that is over

    def rates(self, leg: Leg, f_g: FloatArray, w_deg_per_hr: FloatArray, first: int, last: int) -> FloatArray:
        """Return the mean rates over grid points `first` to `last` (inclusive) while resting, shape (m, c), deg/hr."""
        parts = []
        known = 0 if self._history is None else len(self._history)
        for group in range(known, last // _GROUP):
            row = self._conditions(leg, f_g, w_deg_per_hr, np.array([group * _GROUP]))
            self._history = row if self._history is None else joined(self._history, row)
        for group in range(first // _GROUP, last // _GROUP + 1):
            begin, end = group * _GROUP, min(last, group * _GROUP + _GROUP - 1)
            # From the group's beginning even where only its end is asked for: an effect that remembers must meet the
            # same past however often it is asked.
            rows = self._conditions(leg, f_g, w_deg_per_hr, np.arange(begin, end + 1))
            past = self._history.rows(np.arange(group)) if self._history is not None and group > 0 else None
            parts.append(self._sensor.model.rates(rows, past)[max(first - begin, 0) :])
        return np.concatenate(parts)

    def _conditions(self, leg: Leg, f_g: FloatArray, w_deg_per_hr: FloatArray, nodes: NDArray[np.int64]) -> Conditions:
        begins_s = self._grid.time_of(nodes)
        state, slopes = self._grid.state[nodes], self._grid.state_slope[nodes]
        half, known = 0.5 * GRID_S, bool(np.isfinite(leg.ends_s))
        columns = {
            "temperature_degC": state[:, ROTOR] + half * slopes[:, 1],
            "case_degC": state[:, CASE] + half * slopes[:, 0],
            "chamber_degC": state[:, 0],
            "dTdt_degC_per_min": 60.0 * slopes[:, 1],
            "time_since_power_on_s": begins_s - self._spun_up_s,
            "time_since_index_s": np.maximum(begins_s - leg.ends_s, 0.0) if known else np.full(len(nodes), np.nan),
            **self._grid.conditions(self._sensor.sensor.number, nodes),
        }
        if self._setpoints is not None:
            columns["setpoint_degC"], columns["time_since_setpoint_s"] = self._setpoints.setpoint_at(begins_s)
        n = len(nodes)
        return Conditions(
            self._sensor.sensor,
            collect=nodes,
            run=np.full(n, leg.run),
            position=np.full(n, leg.position),
            start_s=begins_s,
            duration_s=np.full(n, GRID_S),
            f_g=np.tile(f_g, (n, 1)),
            w_deg_per_hr=np.tile(w_deg_per_hr, (n, 1)),
            columns=columns,
        )
