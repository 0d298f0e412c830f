"""Effects of the pickoff: phase of the spin reference, scale factor, misaligned input axes."""

from collections.abc import Mapping, Sequence

import numpy as np

from hil.campaign import Conditions, FloatArray, Sensor
from hil.model.effects.base import OUTSIDE, Amplitudes, Base, Effect, Parameter, required_base
from hil.model.effects.columns import above_reference, channel_labels

_SCALE_TYPICAL = {"RLG": (1.0, 5.0), "FOG": (50.0, 500.0), "DTG": (100.0, 500.0), "MEMS": (500.0, 5000.0)}
_SLOPE_TYPICAL = {"FOG": (5.0, 50.0), "DTG": (10.0, 100.0), "MEMS": (10.0, 300.0)}
MILLI = 1e-3
PPM = 1e-6
TURNED = 0.02
"""Probability that a channel whose scale is off has its sign turned."""


def turned_pair(rates: FloatArray) -> FloatArray:
    """Return the change of (RA, RB), (n, 2), per radian of phase error: (−RB, RA)."""
    return np.stack([-rates[:, 1], rates[:, 0]], -1)


class PhaseError(Effect):
    """The spin-phase reference is off by psi: every (A, B) pair turns by the same angle."""

    id = "phase"
    title = "Pickoff phase error"
    equation = "RA -= psi RB; RB += psi RA; psi = psi0 + dpsi_dT (T - 25 degC)"
    parameters = (
        Parameter("psi", "mrad", (1.0, 20.0), {"CVG": (2.0, 90.0)}),
        Parameter("dpsi_dT", "mrad/degC", (0.05, 0.3)),
    )
    rotor_only = True  # whose axes come from one signal by phase
    needs_base = True
    signature = "GS, MU and B + w all turn by one common angle; their moduli stay."
    confusable_with = ("GS_T", "demod", "spin")
    experiment = "Rate about A alone on a turntable, seen in B; |GS| and |MU| constant while the angle moves."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        turned = MILLI * turned_pair(required_base(self, base).rates)
        return np.stack([turned, turned * np.nan_to_num(above_reference(conditions))[:, None]], -1)


class ScaleFactor(Effect):
    """The rate is read too large by a fraction: common to a rotor's channels, of each channel's own in a triad."""

    id = "scale"
    title = "Scale-factor error"
    equation = "R += (e + de_dT (T - 25 degC)) R"
    parameters = (
        Parameter("e", "ppm", (1000.0, 5000.0), _SCALE_TYPICAL),
        Parameter("de_dT", "ppm/degC", (100.0, 500.0), _SLOPE_TYPICAL),
    )
    needs_base = True
    accepted = r"(e|de_dT)(_.*)?"
    signature = (
        "GS, MU and bias grow in proportion, and earth rate with them: a few hundredths of a deg/hr. Where no "
        "temperature was recorded, what de_dT does shows in no column."
    )
    confusable_with = ("earth", "GS_T", "misalign")
    experiment = "Two headings, or a rate table."

    def labels_for(self, conditions: Conditions) -> Sequence[str]:
        sensor = conditions.sensor
        return [""] if sensor.is_rotor else [f"_{label}" for label in channel_labels(sensor)]

    def known_amplitudes(self, conditions: Conditions, site: Mapping[str, float]) -> Amplitudes:
        """Return a sign that is turned, of each channel that has a scale of its own: minus two million ppm."""
        own = len(self.parameters_for(conditions)) // 2
        usual = np.repeat([parameter.typical[1] for parameter in self.parameters], own)
        turned = [-2.0 / PPM * (np.arange(2 * own) == channel) for channel in range(own if own > 1 else 0)]
        return tuple((TURNED, mean, usual) for mean in turned)

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        rates = PPM * required_base(self, base).rates
        warmed = rates * np.nan_to_num(above_reference(conditions))[:, None]
        if conditions.sensor.is_rotor:
            return np.stack([rates, warmed], -1)
        own = np.eye(rates.shape[1])
        return np.concatenate([rates[:, :, None] * own, warmed[:, :, None] * own], -1)


class Misalignment(Effect):
    """Each input axis leans toward the two others and sees their part of the earth rate."""

    id = "misalign"
    title = "Input-axis misalignment"
    equation = "RA += mAB wB + mAS wS; RB += mBA wA + mBS wS"
    parameters = (Parameter("m", "mrad", (1.0, 5.0), {"RLG": (0.05, 1.0), "FOG": (0.05, 1.0), "MEMS": (1.0, 20.0)}),)
    accepted = r"m..+"
    signature = "Bias, GS and MU move by 0.01 to 0.06 deg/hr; no temperature, no order."
    confusable_with = ("earth", "scale", "g_sensitivity")
    odds = OUTSIDE
    experiment = "Change the heading: G stays, W turns. A rate table settles it."

    def labels_for(self, conditions: Conditions) -> Sequence[str]:
        """Return AB, AS, BA, BS (for a triad XY, XZ, …): channel's axis, then the axis it leans toward."""
        return [label + axis for _, label, _, axis in _leanings(conditions.sensor)]

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        leanings = _leanings(conditions.sensor)
        columns = np.zeros((len(conditions), len(conditions.sensor.channels), len(leanings)))
        for index, (channel, _, axis, _) in enumerate(leanings):
            columns[:, channel, index] = MILLI * np.nan_to_num(conditions.w_deg_per_hr[:, axis])
        return columns


def _leanings(sensor: Sensor) -> list[tuple[int, str, int, str]]:
    """Return (channel, its label, axis, its name) for every axis that a channel should not see."""
    return [
        (channel, label, axis, name)
        for channel, (label, own) in enumerate(zip(channel_labels(sensor), sensor.channel_axes, strict=True))
        for axis, name in enumerate(sensor.axes)
        if axis != own
    ]
