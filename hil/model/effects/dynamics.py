"""Effects of motion: settling after an index move, and the rotor's speed."""

from collections.abc import Mapping

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import Base, Effect, Parameter, ShapeParameter, required_base
from hil.model.effects.columns import column, median_of, per_channel
from hil.model.effects.history import averaged_decay, slew_since_previous
from hil.model.effects.pickoff import turned_pair


class IndexSettling(Effect):
    """A remainder of the index move's disturbance is inside the collect; larger after a larger slew."""

    id = "settle"
    title = "Settling after index"
    equation = "R += S (slew/90 deg) exp(-t_index/tau)"
    per_channel = True
    parameters = (Parameter("S", "deg/hr", (5.0, 100.0)),)
    shapes = (ShapeParameter("tau_s", "s", (2.0, 5.0, 10.0, 20.0, 30.0, 60.0), continuous=True),)
    needs = frozenset({"time_since_index_s"})
    signature = "Exponential at the beginning of every collect; collect 2, after 180 deg, differs from 1 and 3."
    confusable_with = ("MU_real", "drift", "convection")
    incidental = True
    idealises = (
        "It is as exact as the recorded time since the index, of which the controller hears tenths of a second late: "
        "1 % at 20 s. Whence the first collect was reached is not recorded: it gets the mean slew of the others."
    )
    experiment = "Discard the head of each collect, and compare its first half with its second."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        left = averaged_decay(column(conditions, "time_since_index_s"), conditions.duration_s, shape["tau_s"])
        return per_channel(slew_since_previous(conditions) * left, conditions.sensor)


class SpinSpeed(Effect):
    """The rotor turns at another speed: the gain of the rate signal and its phase follow."""

    id = "spin"
    follows = "spin_period_us"
    title = "Spin-speed error"
    equation = "R += gain (dN/N) R + turn (dN/N) (-RB, RA); dN/N = nominal/period - 1"
    parameters = (Parameter("gain", "1", (0.5, 3.0)), Parameter("turn", "rad", (0.1, 10.0)))
    needs = frozenset({"spin_period_us"})
    rotor_only = True
    needs_base = True
    common_to_sensors = True
    signature = "Scale and phase together, in step with the logged spin period."
    confusable_with = ("scale", "phase", "supply")
    experiment = "Log the spin period and step the speed."

    def shapes_for(self, conditions: Conditions) -> tuple[ShapeParameter, ...]:
        return (ShapeParameter("nominal_us", "us", (median_of(conditions, "spin_period_us"),)),)

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        rates = required_base(self, base).rates
        error = np.nan_to_num(shape["nominal_us"] / conditions.columns["spin_period_us"] - 1.0)[:, None]
        return np.stack([error * rates, error * turned_pair(rates)], -1)
