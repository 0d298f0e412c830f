"""Effects of second order in acceleration: anisoelastic compliance of rotor, bearing or proof mass."""

from collections.abc import Mapping, Sequence

import numpy as np

from hil.campaign import Conditions, FloatArray, Sensor
from hil.model.effects.base import Base, Effect, Parameter
from hil.model.effects.columns import channel_labels, per_channel

_OTHER = {"FOG": (0.0, 0.01), "DTG": (0.01, 0.1), "MEMS": (0.1, 1.0)}


class SquaredAcceleration(Effect):
    """Terms in the products of acceleration components: even, so turning the unit upside down leaves them."""

    id = "k2"
    title = "Anisoelastic (g squared) terms"
    equation = "R += kAA fA^2 + kSS fS^2 + kAS fA fS, per channel (all six products for a triad)"
    per_channel = True
    parameters = tuple(Parameter(name, "deg/hr/g^2", (0.1, 1.0), _OTHER) for name in ("kAA", "kSS", "kAS"))
    accepted = r"k.*_.*"
    signature = "Bias and MU move oppositely (+kAA, kSS - kAA), and a bias solved without MU hardly at all."
    confusable_with = ("MU_real", "bias")
    may_follow_temperature = True
    experiment = "Collect 4 gives the contrast kSS - kAA; the sum needs a centrifuge."

    def parameters_for(self, conditions: Conditions) -> tuple[Parameter, ...]:
        """Return one coefficient per channel and product of axes, named k, the two axes, and the channel's axis."""
        sensor = conditions.sensor
        unit = self.parameters[0].for_sensor(sensor)
        return tuple(
            Parameter(f"k{sensor.axes[i]}{sensor.axes[j]}_{label}", unit.unit, unit.typical)
            for i, j in _products(sensor)
            for label in channel_labels(sensor)
        )

    def kept_over_temperature(self, parameters: Sequence[Parameter], sensor: Sensor) -> tuple[int, ...]:
        """Return the square along the last axis: all squares together, following temperature, are a bias."""
        axis = sensor.axes[-1]
        return tuple(k for k, p in enumerate(parameters) if p.name.startswith(f"k{axis}{axis}"))

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        f = conditions.f_g
        return per_channel(
            np.stack([f[:, i] * f[:, j] for i, j in _products(conditions.sensor)], -1), conditions.sensor
        )


def _products(sensor: Sensor) -> tuple[tuple[int, int], ...]:
    if sensor.is_rotor:  # the B axis stays level: its products are never excited
        return ((0, 0), (2, 2), (0, 2))
    return ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
