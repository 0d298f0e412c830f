"""Effects of the surroundings that scatter averages: condensation, noise at one setpoint, and a base that moves."""

from collections.abc import Mapping

import numpy as np

from hil.campaign import Conditions
from hil.model.effects.base import Parameter, ShapeParameter, VarianceEffect
from hil.model.effects.columns import HOUR_S, LEVEL, column, per_channel
from hil.model.effects.geometry import local_frame
from hil.model.effects.scatter import Scatter, averaged_s, white

_TAU_S = 1800.0
"""Correlation time of pier and floor motion (heating, ventilation, people)."""
_APART_DEGC = 3.0  # nearer ones are one temperature
_LEVELS = 16  # more are no steps


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


class NoiseAtTemperature(VarianceEffect):
    """White noise of one temperature alone: a chamber's fan, compressor or valve that hunts there, or a resonance."""

    id = "noise_T"
    follows = "temperature"
    title = "Noise of one temperature"
    equation = "sigma = N_T / sqrt(duration) at one setpoint"
    parameters = (Parameter("N_T", "deg/sqrt(hr)", (0.1, 1.0), {"RLG": (0.001, 0.1), "MEMS": (0.05, 1.0)}),)
    needs = frozenset({LEVEL})
    signature = (
        "Only the variance rises, at one temperature, from collect to collect; its neighbours are as quiet as all."
    )
    confusable_with = ("hash", "frost", "arw")
    experiment = "That temperature again with the chamber's fan and compressor off; samples of the averages there."

    def shapes_for(self, conditions: Conditions) -> tuple[ShapeParameter, ...]:
        """Return the temperatures, °C, of which it may be one; none where there are not several, or no steps."""
        level = np.sort(column(conditions, LEVEL)[np.isfinite(column(conditions, LEVEL))])
        steps = np.split(level, 1 + np.flatnonzero(np.diff(level) > _APART_DEGC)) if len(level) else []
        levels = tuple(round(float(np.mean(each)), 1) for each in steps)
        return (ShapeParameter("at_degC", "degC", levels if 1 < len(levels) <= _LEVELS else ()),)

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        """Return one over the root of the duration, in hr, of each row at the temperature."""
        here = np.abs(column(conditions, LEVEL) - shape["at_degC"]) < _APART_DEGC
        return white(np.where(here, np.sqrt(HOUR_S / averaged_s(conditions)), 0.0), conditions)


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
