"""Thermal effects: bias against temperature, its rate, gradients, lag, hysteresis, soak, warm-up, gas."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.effects.base import Base, Effect, Parameter


class TemperatureRateBias(Effect):
    """Bias proportional to how fast the sensor's temperature changes."""

    id = "bias_Tdot"
    family = "thermal"
    title = "Temperature-rate bias"
    equation = "B += K_Tdot dT/dt"
    per_channel = True
    parameters = (Parameter("K_Tdot", "deg/hr per degC/min", (2.0, 30.0)),)
    needs = frozenset({"dTdt_degC_per_min"})

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:  # noqa: ARG002
        """Return dT/dt in each channel's own column, shape (n, c, c)."""
        rate = np.nan_to_num(conditions.columns["dTdt_degC_per_min"])
        return np.asarray(rate[:, None, None] * np.eye(len(conditions.sensor.channels)))
