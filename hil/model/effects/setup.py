"""Effects of the set-up: tilt, accelerometers, index positions, earth-rate knowledge."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.campaign.data import EARTH_RATE_DEG_PER_HR
from hil.model.effects.base import OUTSIDE, Amplitudes, Base, Effect, Parameter, required_base
from hil.model.effects.geometry import frame_by_heading, local_frame, turned_about_index_axis
from hil.model.equation import pickoff_rates

MILLI = 1e-3
LEFT_OUT = 0.9
"""Probability that, where a record has no earth rate and one is missing, it is the earth's whole."""


class Tilt(Effect):
    """The bench leans: gravity has components G2 and G3 that were taken as zero."""

    id = "tilt"
    needs_base = True
    rotor_only = True  # and indexed about its B axis; where a triad's fixture tilts, its own f shows it
    title = "Unmodelled tilt G2, G3"
    equation = "R += K df, df = (0, G2, G3), (0, G2, -G3), (G3, G2, 0) in collects 1, 2, 3"
    parameters = (Parameter("G2", "mg", (1.0, 20.0)), Parameter("G3", "mg", (5.0, 20.0)))
    signature = "MU follows GS by a constant factor: dMUB = GSA G3/G1, dMUA = GSB G3/G1."
    confusable_with: ClassVar[tuple[str, ...]] = ("MU_real", "MU_T", "accel", "index")
    odds = OUTSIDE
    experiment = "Use the measured G of every collect; shim the bench and repeat."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        f, k = conditions.f_g, required_base(self, base).k
        level = np.zeros_like(f)
        level[:, 1] = np.hypot(f[:, 0], f[:, 2])  # axis 2 is the sensor's B axis at every index position
        about_index_axis = turned_about_index_axis(f)
        return MILLI * np.stack([pickoff_rates(0.0, k, df, 0.0) for df in (level, about_index_axis)], -1)


class AccelerometerError(Tilt):
    """The accelerometers that measured G are off: the same columns as a tilt, of the other sign."""

    id = "accel"
    title = "Accelerometer error in measured G"
    equation = "R -= K df for an error (b2, b3) of the measured G2, G3"
    parameters = (Parameter("b2", "mg", (1.0, 10.0)), Parameter("b3", "mg", (1.0, 10.0)))
    signature = "As a tilt, with the accelerometer's own temperature dependence."
    confusable_with = ("tilt", "MU_real", "index")
    experiment = "A spirit level or inclinometer beside it; |G| = 1 in every collect."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return -super().columns(conditions, base, shape)


class IndexPositionError(Effect):
    """Index positions are not where they should be, each by its own angle about the index axis."""

    id = "index"
    needs_base = True
    rotor_only = True
    title = "Index position error"
    equation = "theta_i += d_i: RA += GSA d fS - MUB d fA + d wS; RB -= GSB d fS - MUA d fA"
    parameters = (Parameter("d", "mrad", (0.1, 2.0), {"table": (0.005, 0.05)}),)
    named_by_data = True
    accepted = r"d_.*"
    signature = "dMUB = (GSA + W1) d3 - (MUB + W3)(d1 - d2)/2; hundredths to tenths of a deg/hr per mrad."
    confusable_with = ("MU_rr", "tilt", "MU_real", "accel")
    odds = OUTSIDE
    experiment = "Measure the angle or G in every collect; approach each position from both sides."

    def labels_for(self, conditions: Conditions) -> Sequence[str]:
        """Return one angle per position of these rows: d_1, d_2, d_3."""
        return [f"_{label}" for label in np.unique(conditions.position)]

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        base = required_base(self, base)
        turned = turned_about_index_axis(np.nan_to_num(conditions.w_deg_per_hr))[:, conditions.sensor.channel_axes]
        change = pickoff_rates(0.0, base.k, turned_about_index_axis(conditions.f_g), turned)
        at = np.equal.outer(conditions.position, np.unique(conditions.position)).astype(np.float64)
        return np.asarray(MILLI * change[:, :, None] * at[:, None, :])


class EarthRateError(Effect):
    """The earth rate that was subtracted is wrong, or was left out: latitude, heading, a mount not where the map says.

    Where nothing tells north, and a unit was turned over in several ways, it has a level part in each position.
    """

    id = "earth"
    follows = "heading"
    title = "Earth-rate knowledge error"
    equation = "R -= dW . channel axis, dW = used - true, along up, north and east"
    parameters = tuple(Parameter(f"dW_{way}", "deg/hr", (0.02, 0.5)) for way in ("up", "north", "east"))
    named_by_data = True
    accepted = r"dW_(up|north|east|(level|across)_.*)"
    common_to_sensors = True
    signature = "dGSA = -dW1, dMUB = -dW3, dBB = -dW2; BA, GSB and MUA are immune. No temperature, no order."
    confusable_with = ("frame", "scale", "misalign", "g_sensitivity", "GS", "k2")
    odds = OUTSIDE
    experiment = "A second heading: gravity stays, earth rate turns. MUB shifts and MUA does not."

    def odds_for(self, conditions: Conditions) -> float:
        """Return those of a term of the standard models where some was left out: every gyro shows it."""
        return self.odds if np.any(local_frame(conditions).north) else 5.0

    def parameters_for(self, conditions: Conditions) -> tuple[Parameter, ...]:
        """Return one for up, and two that are level for all rows that have a heading in common."""
        up, *level = self.parameters
        ways = {
            of: ("level", "across") if of else ("north", "east") for of in np.unique(frame_by_heading(conditions)[1])
        }
        names = [f"dW_{way}" + f"_{of}" * bool(of) for of, both in ways.items() for way in both]
        return (up, *(replace(level[0], name=name) for name in names))

    def untold_by(self, conditions: Conditions) -> str:
        """Return the heading, where each position has its own."""
        return "w (latitude, and which way north lay) in each position" * any(frame_by_heading(conditions)[1])

    def known_amplitudes(self, conditions: Conditions, site: Mapping[str, float]) -> Amplitudes:
        """Return what was left out: of the level part all, of the vertical what latitude says, up to 15 deg/hr."""
        if np.any(local_frame(conditions).north):
            return ()
        subtracted = bool(np.any(np.nan_to_num(conditions.w_deg_per_hr)))
        mean = np.zeros(len(self.parameters_for(conditions)))
        deviation = np.full(len(mean), 0.5 * EARTH_RATE_DEG_PER_HR)
        if subtracted or "latitude_deg" in site:
            deviation[0] = 0.01 * EARTH_RATE_DEG_PER_HR
        if "latitude_deg" in site and not subtracted:
            mean[0] = -EARTH_RATE_DEG_PER_HR * np.sin(np.deg2rad(site["latitude_deg"]))
        return ((LEFT_OUT, mean, deviation),)

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        """Return the negative direction cosines of each channel's axis, (n, c, p), in the rows that a part is of."""
        frame, positions = frame_by_heading(conditions)
        at = np.equal.outer(positions, np.unique(positions)).astype(np.float64)
        level = np.stack([frame.north, frame.east], -1)[:, :, None, :] * at[:, None, :, None]
        directions = np.concatenate([frame.up[..., None], level.reshape(*frame.up.shape, -1)], -1)
        return -directions[:, conditions.sensor.channel_axes, :]
