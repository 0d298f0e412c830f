"""Effects of the surroundings that scatter averages: condensation, and a base that moves."""

from collections.abc import Mapping

import numpy as np

from hil.campaign import Conditions
from hil.model.effects.base import Parameter, VarianceEffect
from hil.model.effects.columns import column, per_channel
from hil.model.effects.geometry import local_frame
from hil.model.effects.scatter import Scatter

_TAU_S = 1800.0
"""Correlation time of pier and floor motion (heating, ventilation, people)."""


class Frost(VarianceEffect):
    """Condensation or ice near 0 °C: irregular offsets that last for a run."""

    id = "frost"
    follows = "temperature"
    title = "Condensation or ice around 0 °C"
    equation = "B of run k += N(0, s_f) exp(-(T - 0 degC)^2 / (2 (5 degC)^2))"
    parameters = (Parameter("s_f", "deg/hr", (1.0, 15.0)),)
    needs = frozenset({"temperature_degC"})
    common_to_sensors = True
    signature = "Irregular scatter from -12 to 7 °C, mostly when heating through 0 °C."
    confusable_with = ("jump", "turnon", "hash")
    experiment = "Purge with dry nitrogen; log the dew point."

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        near = np.nan_to_num(np.exp(-0.5 * (column(conditions, "temperature_degC") / 5.0) ** 2))
        return (Scatter(per_channel(near, conditions.sensor), group=conditions.run),)


class BaseMotion(VarianceEffect):
    """The pier turns slowly: real rates, the same in both sensors once turned into the room's axes."""

    id = "base"
    follows = "time"
    title = "Base motion"
    equation = "R += w_base(t) . channel axis"
    parameters = (Parameter("w_base", "deg/hr", (0.1, 2.0)),)
    common_to_sensors = True
    signature = "Noise with structure: common to both sensors, geometry-consistent, slow."
    confusable_with = ("arw", "drift", "flicker")
    experiment = "A reference gyro or tiltmeter; sensor 1 less sensor 2."

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        """Return a slow random rate about each of the room's axes, as the channels see it.

        Where north is not known, only rotation about the vertical can be followed from row to row.
        """
        frame = local_frame(conditions)
        directions = np.stack([frame.up, frame.north, frame.east], -1)[:, conditions.sensor.channel_axes, :]
        return (Scatter(directions, tau_s=_TAU_S),)
