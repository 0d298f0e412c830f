"""Thermal effects: bias against temperature, its rate, gradients, lag, hysteresis, soak, warm-up, gas."""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.campaign.stand_ins import OWN, temperature_of
from hil.errors import InputError
from hil.model.effects.base import Base, Effect, Parameter, ShapeParameter, required_base
from hil.model.effects.columns import above_reference, column, per_channel
from hil.model.effects.history import averaged_decay, loop_side, setpoint_step
from hil.model.equation import pickoff_rates
from hil.model.forms import mu_columns

_SOAK_TAU = ShapeParameter("tau_min", "min", (5.0, 8.0, 12.0, 18.0, 25.0, 40.0, 70.0), continuous=True)
_LINE_TYPICAL = {"RLG": (0.005, 0.05), "FOG": (0.02, 0.2), "DTG": (0.05, 0.5), "MEMS": (1.0, 30.0)}
_BEND_TYPICAL = {"RLG": (0.0001, 0.001), "FOG": (0.0004, 0.004), "DTG": (0.001, 0.01), "MEMS": (0.02, 0.6)}
_UNUSUAL = 0.1  # odds, before the data, of what would have to be of an unusual kind or size to stand in


def _of_its_own_temperature(_: Effect, conditions: Conditions) -> Mapping[str, float]:
    """Return the bias that follows temperature where another stands in for the unit's, which decays unrecorded."""
    return {"bias_T": 1.0} if temperature_of(conditions) != OWN else {}


class BiasTemperature(Effect):
    """Bias that follows the sensor's temperature, to second order about 25 °C."""

    id = "bias_T"
    follows = "temperature"
    title = "Bias temperature coefficient"
    equation = "B += b1 (T - 25 degC) + b2 (T - 25 degC)^2"
    per_channel = True
    parameters = (
        Parameter("b1", "deg/hr/degC", (0.2, 2.0), _LINE_TYPICAL, power=1),
        Parameter("b2", "deg/hr/degC^2", (0.004, 0.04), _BEND_TYPICAL, power=2),
    )
    needs = frozenset({"temperature_degC"})
    signature = (
        "All positions move together and smoothly with temperature, the same heating and cooling; MU and GS stay."
    )
    confusable_with = ("turnon", "ageing", "demod", "supply", "T_lag")
    plain_form = "line"
    series_in_temperature = True
    odds = 3.0
    kin = MappingProxyType({"demod": _UNUSUAL, "warmup": _UNUSUAL})
    experiment = "Revisit every temperature from both directions and on another day."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        delta = above_reference(conditions)
        return per_channel(np.stack([delta, delta**2], -1), conditions.sensor)


class TemperatureRateBias(Effect):
    """Bias proportional to how fast the sensor's temperature changes."""

    id = "bias_Tdot"
    follows = "temperature_rate"
    title = "Temperature-rate bias"
    equation = "B += K_Tdot dT/dt"
    per_channel = True
    parameters = (Parameter("K_Tdot", "deg/hr per degC/min", (2.0, 30.0), {"FOG": (1.0, 10.0), "MEMS": (1.0, 20.0)}),)
    needs = frozenset({"dTdt_degC_per_min"})
    signature = "Opposite sign heating and cooling, dies away while soaking, largest in the first run after a setpoint."
    confusable_with = ("hyst", "bias_grad", "soak_insufficient", "T_lag", "drift")
    incidental = True
    idealises = "It takes dT/dt as recorded, of which the thermometer's steps of 0.01 °C leave 0.01 °C/min uncertain."
    kin = MappingProxyType({"bias_grad": 1.0})
    experiment = "Two ramp rates and a long soak; order 1-3-2, in which MU is immune to it."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return per_channel(column(conditions, "dTdt_degC_per_min"), conditions.sensor)


class GradientBias(Effect):
    """Bias proportional to the temperature difference between case and rotor."""

    id = "bias_grad"
    follows = "temperature_rate"
    title = "Case-to-rotor gradient bias"
    equation = "B += K_g (T_case - T)"
    per_channel = True
    parameters = (Parameter("K_g", "deg/hr/degC", (0.5, 5.0), {"FOG": (0.1, 1.0)}),)
    needs = frozenset({"case_degC", "temperature_degC"})
    signature = "As the temperature-rate bias, with a constant part from self-heating; follows motor power too."
    confusable_with = ("bias_Tdot", "warmup", "soak_insufficient")
    incidental = True
    kin = MappingProxyType({"bias_Tdot": 1.0})
    experiment = "Step the motor or heater power at constant chamber temperature."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        difference = column(conditions, "case_degC") - column(conditions, "temperature_degC")
        return per_channel(difference, conditions.sensor)


class ThermometerLag(Effect):
    """The thermometer is late: the element is already at T + lag·dT/dt, and every term has its value there."""

    id = "T_lag"
    follows = "temperature_rate"
    title = "Thermometer lag"
    equation = "R += (dB/dT + k_share dK/dT f) dT/dt lag"
    parameters = (Parameter("lag", "min", (5.0, 25.0)),)
    shapes = (ShapeParameter("k_share", "1", (0.0, 1.0)),)
    needs = frozenset({"dTdt_degC_per_min"})
    needs_base = True
    needs_slopes = True
    signature = (
        "A loop of width 2 slope x lag against temperature, open where the terms are steep; closes after the ramp."
    )
    confusable_with = ("bias_Tdot", "hyst", "soak_insufficient")
    incidental = True
    idealises = "It takes dT/dt as recorded, of which the thermometer's steps of 0.01 °C leave 0.01 °C/min uncertain."
    experiment = "Loop area against ramp rate: a lag's grows with the rate, true hysteresis does not."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        """Return slope of the rate by temperature times dT/dt, shape (n, c, 1).

        `k_share` is how much of the acceleration terms lags too: all, where the thermometer is late (as without it);
        none, where the part is late that the bias alone follows. Raises `InputError` where `base` has no slopes.
        """
        base = required_base(self, base)
        if base.bias_slope is None or base.k_slope is None:
            raise InputError("effect T_lag needs a base model that depends on temperature (its slopes)")
        slope = pickoff_rates(base.bias_slope, shape.get("k_share", 1.0) * base.k_slope, conditions.f_g, 0.0)
        rate = np.nan_to_num(column(conditions, "dTdt_degC_per_min"))
        return np.asarray((slope * rate[:, None])[..., None])


class _Play(Effect):
    """What depends on the turning points of temperature, not on its rate: a play operator."""

    follows = "temperature_history"
    shapes = (
        ShapeParameter("half_width_degC", "degC", (1.0, 2.0, 5.0, 10.0, 14.0, 20.0), continuous=True),
        ShapeParameter("from_degC", "degC", (20.0, -80.0), default=np.nan),
    )
    needs = frozenset({"temperature_degC"})
    idealises = (
        "It knows the temperatures of collects and no others, so no overshoot between them, and begins relaxed: where "
        "the unit came from decides on which side of the loop it is, which a search tries as `from_degC`: a room, and "
        "as far below the first collect as the half width, for colder does no more. Nobody recorded either."
    )
    experiment = "Return to the same temperature from above and from below, each after a full soak."

    def shape_grid(self, conditions: Conditions) -> Sequence[Mapping[str, float]]:
        """Return every shape, the unit coming from no colder than puts the first collect on the heating branch."""
        temperature = column(conditions, "temperature_degC")[np.argsort(conditions.start_s, kind="stable")]
        first = next(iter(temperature[np.isfinite(temperature)].tolist()), 0.0)
        return [
            {**shape, "from_degC": max(shape["from_degC"], math.floor(first - shape["half_width_degC"]))}
            for shape in super().shape_grid(conditions)
        ]

    def side(self, conditions: Conditions, shape: Mapping[str, float]) -> FloatArray:
        """Return on which side of the loop each row is, -1 to 1, (n,)."""
        temperature, width = column(conditions, "temperature_degC"), shape["half_width_degC"]
        return loop_side(temperature, conditions.start_s, width, shape.get("from_degC", np.nan))


class Hysteresis(_Play):
    """Bias that depends on the turning points of temperature."""

    id = "hyst"
    title = "Rate-independent thermal hysteresis"
    equation = "B += h (T - play(T, half_width)) / half_width"
    per_channel = True
    parameters = (
        Parameter("h", "deg/hr", (1.0, 5.0), {"RLG": (0.005, 0.05), "FOG": (0.05, 0.5), "MEMS": (5.0, 50.0)}),
    )
    signature = "Opposite sign coming from below and from above, and it does not decay while soaking."
    confusable_with = ("T_lag", "bias_T", "ageing", "jump")
    kin = MappingProxyType({"soak_insufficient": 1.0, "bias_Tdot": 1.0, "bias_grad": 1.0})

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return per_channel(self.side(conditions, shape), conditions.sensor)


class AxialHysteresis(_Play):
    """MU that depends on the turning points of temperature: bearings that are loaded otherwise on the way back."""

    id = "MU_hyst"
    title = "Thermal hysteresis of MU"
    equation = "MU += h_MU (T - play(T, half_width)) / half_width"
    rotor_only = True
    parameters = tuple(Parameter(name, "deg/hr/g", (1.0, 5.0), {"DTG": (0.05, 0.5)}) for name in ("h_MUA", "h_MUB"))
    signature = "MU is another coming from below and from above, and the bias is not."
    confusable_with = ("MU_jump", "MU_T", "MU_rr")
    odds = 0.5  # the reference has one entry for both; that of the bias is the usual one
    kin = MappingProxyType({"MU_T": 1.0})

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return np.asarray(mu_columns(conditions) * self.side(conditions, shape)[:, None, None])


class InsufficientSoak(Effect):
    """The element has not reached the new temperature: a remainder of the setpoint's step is left in the bias."""

    id = "soak_insufficient"
    follows = "temperature_history"
    title = "Incomplete restabilisation"
    equation = "B += b step exp(-t_setpoint/tau)"
    per_channel = True
    parameters = (Parameter("b", "deg/hr/degC", (0.2, 2.0), {"FOG": (0.02, 0.2), "MEMS": (1.0, 30.0)}),)
    shapes = (_SOAK_TAU, ShapeParameter("from_degC", "degC", (20.0, 23.0, 26.0), default=np.nan))
    may_follow_temperature = True  # as dB/dT does, where the bias is no straight line
    needs = frozenset({"time_since_setpoint_s", "setpoint_degC|temperature_degC"})
    signature = "Follows sign and size of the temperature step; falls from run to run within a plateau."
    confusable_with = ("bias_Tdot", "bias_grad", "hyst", "T_lag")
    incidental = True
    idealises = (
        "Whence the first setpoint was reached is not recorded: its step counts as none without `from_degC`, which a "
        "search tries as laboratories are kept."
    )
    kin = MappingProxyType({"bias_Tdot": 1.0, "bias_grad": 1.0})
    experiment = "Five or more runs in one soak, or soaks of 45 and 120 min."

    aliases_for = _of_its_own_temperature  # where nobody recorded how that nears the chamber's

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        since = column(conditions, "time_since_setpoint_s")
        left = averaged_decay(since, conditions.duration_s, 60.0 * shape["tau_min"])
        return per_channel(setpoint_step(conditions, shape.get("from_degC", np.nan)) * left, conditions.sensor)


class WarmUp(Effect):
    """Bias that decays after power-on."""

    id = "warmup"
    follows = "time"
    title = "Warm-up since power-on"
    equation = "B += W exp(-t_on/tau)"
    per_channel = True
    parameters = (Parameter("W", "deg/hr", (5.0, 50.0), {"MEMS": (1.0, 20.0)}),)
    shapes = (ShapeParameter("tau_min", "min", (3.0, 5.0, 8.0, 12.0, 20.0, 40.0, 90.0), continuous=True),)
    needs = frozenset({"time_since_power_on_s"})
    common_to_sensors = True
    signature = "Tied to power-on, not to the chamber; the same sign always, both sensors if powered together."
    confusable_with = ("soak_insufficient", "drift", "ageing")
    incidental = True
    kin = MappingProxyType({"soak_insufficient": _UNUSUAL})
    experiment = "Switch power off and on at constant temperature, with the unit's own temperature recorded."

    aliases_for = _of_its_own_temperature  # where nobody recorded how it warms itself

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        since = column(conditions, "time_since_power_on_s")
        left = averaged_decay(since, conditions.duration_s, 60.0 * shape["tau_min"])
        return per_channel(left, conditions.sensor)


class GasConvection(Effect):
    """Gas moves in the cavity according to orientation: an acceleration sensitivity that builds up after each index."""

    id = "convection"
    follows = "temperature"
    title = "Orientation-dependent gas convection"
    equation = "R += (c1 fA + c3 fS) (298 K / T) (1 - exp(-t_index/tau))"
    rotor_only = True  # whose cavity is filled with gas
    per_channel = True
    parameters = (
        Parameter("c1", "deg/hr/g", (0.1, 2.0), {"gas": (0.01, 0.5)}),
        Parameter("c3", "deg/hr/g", (0.1, 2.0), {"gas": (0.01, 0.5)}),
    )
    shapes = (ShapeParameter("tau_min", "min", (1.0, 2.0, 5.0), continuous=True),)
    needs = frozenset({"time_since_index_s"})
    signature = "Looks like GS and MU, but approaches its value slowly after each index and thins out with heat."
    confusable_with = ("MU_real", "GS", "MU_T", "GS_T", "mag")
    incidental = True
    experiment = "Dwell ten minutes or more per position and look for a slow approach; change the self-heating."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        since = column(conditions, "time_since_index_s")
        left = averaged_decay(since, conditions.duration_s, 60.0 * shape["tau_min"])
        built = np.where(np.isfinite(since), 1.0 - left, 0.0)
        density = np.nan_to_num(298.15 / (column(conditions, "temperature_degC") + 273.15), nan=1.0)
        return per_channel(conditions.f_g[:, [0, 2]] * (built * density)[:, None], conditions.sensor)
