"""Effects of the electronics and its surroundings: quadrature, supply voltage, magnetic field."""

from collections.abc import Mapping, Sequence

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import OUTSIDE, Base, Effect, Parameter, ShapeParameter
from hil.model.effects.columns import REFERENCE_DEGC, channel_labels, column, median_of, per_channel
from hil.model.effects.geometry import local_frame

EARTH_FIELD_G = 0.5
DIP = np.deg2rad(62.0)
"""Size and dip of the earth's field at mid northern latitudes; sensitivities scale with the true field."""


class QuadratureLeakage(Effect):
    """Quadrature leaks into the rate by the demodulator's phase, which follows the electronics' temperature."""

    id = "demod"
    follows = "temperature"
    title = "Quadrature leakage"
    equation = "B += Q dphi/dT (T_case - 25 degC)"
    per_channel = True
    parameters = (Parameter("q", "deg/hr/degC", (0.05, 1.0)),)
    needs = frozenset({"case_degC"})
    signature = "As a bias that follows the case (electronics) rather than the sensor."
    confusable_with = ("bias_T", "bias_grad")
    experiment = "Step the demodulation phase."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return per_channel(column(conditions, "case_degC") - REFERENCE_DEGC, conditions.sensor)


class SupplyVoltage(Effect):
    """Bias that follows the supply or reference voltage."""

    id = "supply"
    follows = "supply"
    title = "Supply voltage"
    equation = "B += K_V 100 (V/nominal - 1)"
    per_channel = True
    parameters = (Parameter("K_V", "deg/hr/%", (0.1, 2.0), {"MEMS": (0.1, 5.0)}),)
    needs = frozenset({"supply_V"})
    common_to_sensors = True
    signature = "All positions, all channels and both sensors in step with the supply."
    confusable_with = ("bias_T", "spin", "ageing")
    experiment = "Step the supply and log the voltage at the unit's terminals."

    def shapes_for(self, conditions: Conditions) -> tuple[ShapeParameter, ...]:
        return (ShapeParameter("nominal_V", "V", (median_of(conditions, "supply_V"),)),)

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        deviation = 100.0 * (column(conditions, "supply_V") / shape["nominal_V"] - 1.0)
        return per_channel(deviation, conditions.sensor)


class MagneticSensitivity(Effect):
    """The rates follow the magnetic field along the sensor's axes; the earth's is mostly vertical."""

    id = "mag"
    follows = "heading"
    title = "Magnetic sensitivity"
    equation = "R += K_m b, b = the earth's field along the sensor's axes"
    parameters = (Parameter("m", "deg/hr/G", (0.1, 5.0), {"RLG": (0.01, 1.0), "FOG": (0.01, 1.0)}),)
    accepted = r"m..+"
    signature = (
        "Turns with the sensor, so it looks like GS and MU; parts from them only by the field's level component."
    )
    confusable_with = ("GS", "MU_real", "g_sensitivity", "earth")
    odds = OUTSIDE
    incidental = True
    experiment = "Change the heading; a Helmholtz coil; the chamber's heater off during collects."

    def labels_for(self, conditions: Conditions) -> Sequence[str]:
        """Return one sensitivity per channel and axis: mAA, mAB, mAS, mBA, …."""
        return [row + axis for row in channel_labels(conditions.sensor) for axis in conditions.sensor.axes]

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        """Return the field along the sensor's axes for each channel, (n, c, 3c); no level part where w is 0."""
        frame = local_frame(conditions)
        field = EARTH_FIELD_G * (np.cos(DIP) * frame.north - np.sin(DIP) * frame.up)
        channels = len(conditions.sensor.channels)
        columns = np.einsum("cd,na->ncda", np.eye(channels), field)
        return np.asarray(columns.reshape(len(conditions), channels, 3 * channels))
