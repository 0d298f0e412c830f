"""What an effect is: one small class that everything else uses.

The twin simulates with it, the solver solves for it, reconcile searches over it, the report prints it. A model is a sum
of effects. Adding one is a class with a docstring in the file of its family; `hil.model.effects.catalogue` finds it.

    effect = effect_by_id("bias_Tdot")
    effect.missing(conditions)                   # () or ("dTdt_degC_per_min",): it cannot be asked about this data
    [p.name for p in effect.parameters_for(conditions)]          # ["K_Tdot_A", "K_Tdot_B"]
    effect.columns(conditions, base=None, shape={})              # dR/dK, shape (n, c, p)

There are three kinds. An `Effect` moves the averages of collects: it gives columns. A `VarianceEffect` only scatters
them: it gives the coefficients that scatter, and so covariance and draws. A `SeriesEffect` shows inside a collect: it
tests the series of samples.
"""

from __future__ import annotations

import itertools
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from hil.campaign import Conditions, FloatArray, Sensor
from hil.errors import InputError
from hil.model.effects.columns import channel_labels
from hil.model.effects.scatter import Scatter

Amplitudes = Sequence[tuple[float, FloatArray, FloatArray]]
OUTSIDE = 1.0 / 3.0
"""Odds of a cause outside the sensor element, which a bench is built to exclude."""


@dataclass(frozen=True)
class Parameter:
    """A linear parameter: its name, unit, and the range of sizes that is physically typical (absolute values).

    `typical` is the range for the report's rotor sensor; `typical_other` the ranges of other technologies (RLG, FOG,
    DTG, MEMS, gas …) where they differ. All are order-of-magnitude engineering values. `power` is that of temperature
    by which it multiplies what it acts on: one of two and more is asked about only where temperatures tell it.
    """

    name: str
    unit: str
    typical: tuple[float, float]
    typical_other: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    power: int = 0

    @property
    def size(self) -> float:
        """The geometric middle of the typical range (a third of its top where it begins at zero)."""
        low, high = self.typical
        return math.sqrt(low * high) if low > 0.0 else high / 3.0

    def log_density(self, size: float) -> float:
        """Return the log prior density of a size, per unit of its logarithm.

        Every order of magnitude within the typical range is as probable. Ten times the largest typical is thirty
        times less so, a hundredth of the smallest ten times; sizes that nobody has seen are improbable, not impossible.
        """
        low, high = self.bounds
        beyond = 1.5 * np.log(high / size) if size > high else 0.5 * np.log(size / low) if size < low else 0.0
        return float(beyond - np.log(np.log(high / low) + 8.0 / 3.0))

    @property
    def largest(self) -> float:
        """The largest size that is searched for, a thousand times the largest typical: what needs more is not seen."""
        return self.typical[1] * 1e3

    @property
    def bounds(self) -> tuple[float, float]:
        """The typical range, of which a bottom of zero is a hundredth of the top."""
        low, high = self.typical
        return low if low > 0.0 else 0.01 * high, high

    def for_sensor(self, sensor: Sensor) -> Parameter:
        """Return this parameter with `typical` as it is for a sensor.

        Of the sensor's technology that is its own range. A rotor sensor whose technology nobody stated keeps the
        rotor's, and any other gets the span of all that are listed.
        """
        if sensor.technology in self.typical_other:
            return replace(self, typical=self.typical_other[sensor.technology])
        if sensor.is_rotor or not self.typical_other:
            return self
        ranges = list(self.typical_other.values())
        return replace(self, typical=(min(low for low, _ in ranges), max(high for _, high in ranges)))


@dataclass(frozen=True)
class ShapeParameter:
    """A parameter that enters non-linearly (time constant, hysteresis width, lag) with the grid that is searched.

    A grid of one value is a reference that must be stored with a fitted term (nominal supply voltage), not searched.
    A continuous one is searched on the grid first, then between its points. `default` is what a term means that has
    no value for it, as files that are older; without one a term must have a value.
    """

    name: str
    unit: str
    grid: tuple[float, ...]
    continuous: bool = False
    default: float | None = None


@dataclass(frozen=True)
class Base:
    """The fitted base model at each row: what effects that scale, rotate or tilt the existing terms need.

    `bias` (n, c) deg/hr, `k` (n, c, 3) deg/hr/g, `rates` (n, c) deg/hr including earth rate. The slopes by temperature,
    per °C, have the shapes of `bias` and `k`; None where the base does not know them.
    """

    bias: FloatArray
    k: FloatArray
    rates: FloatArray
    bias_slope: FloatArray | None = None
    k_slope: FloatArray | None = None


class Described(ABC):
    """What every entry of the catalogue says about itself, whatever it acts on."""

    id: ClassVar[str]
    family: ClassVar[str]  # by default as the file is called in which the class stands
    title: ClassVar[str]
    equation: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    shapes: ClassVar[tuple[ShapeParameter, ...]] = ()
    per_channel: ClassVar[bool] = False  # every parameter exists once per channel, named after the channel's axis
    rotor_only: ClassVar[bool] = False  # exists only in a two-channel rotor sensor
    triad_only: ClassVar[bool] = False  # only in a triad
    named_by_data: ClassVar[bool] = False  # which parameters there are depends on positions or power cycles
    accepted: ClassVar[str] = ""  # how names of parameters look where positions or axes make them: a regular expression
    needs: ClassVar[frozenset[str]] = frozenset()  # condition columns; "a|b" is satisfied by either
    common_to_sensors: ClassVar[bool] = False  # one cause moves both sensors: a finding in one alone speaks against it
    follows: ClassVar[str] = "pose"
    """What it follows: time, run, temperature, temperature_rate, temperature_history, pose, supply … or a column."""
    signature: ClassVar[str] = ""
    confusable_with: ClassVar[tuple[str, ...]] = ()
    experiment: ClassVar[str] = ""
    asks_for: ClassVar[str] = "more runs or positions"
    """What rows lack in which none of its shapes shows."""

    idealises: ClassVar[str] = ""
    """By what its column in recorded conditions differs from what a unit does by more than 1 %; empty where nothing."""

    odds: ClassVar[float] = 1.0
    """How many times as probable as any other name it is before the data.

    Terms of the standard gyro models (IEEE 813, 952) have 3 to 5: a rotor without mass unbalance is rarer than a triad
    without sensitivity to acceleration.
    """

    kin: ClassVar[Mapping[str, float]] = MappingProxyType({})
    """Names of the same history in time, that only a further condition tells apart, with their weight against its 1."""

    incidental: ClassVar[bool] = False
    """Whether it imitates others only by the order, the timing or the one heading of collects.

    Where it is improbable it stays in the list of rivals, but does not withhold another name."""

    def __init_subclass__(cls) -> None:
        if "family" not in vars(cls):
            cls.family = cls.__module__.rpartition(".")[2].replace("_", "-")

    @property
    def moves_inside(self) -> bool:
        """Whether a rate goes on changing by it while a collect lasts, beyond white noise."""
        stands = self.follows in ("pose", "run", "heading", "duration_s")
        return not stands or "time_since_index_s" in self.needs

    def applies_to(self, sensor: Sensor) -> bool:
        """Whether the effect can exist in a sensor of this layout."""
        return (sensor.is_rotor or not self.rotor_only) and (sensor.is_triad or not self.triad_only)

    def missing(self, conditions: Conditions) -> tuple[str, ...]:
        """Return the condition columns that the data lacks (absent or all empty), without which it cannot be asked."""
        return tuple(
            need
            for need in sorted(self.needs)
            if not any(np.any(np.isfinite(conditions.columns.get(name, np.nan))) for name in need.split("|"))
        )

    def odds_for(self, conditions: Conditions) -> float:
        """Return its `odds`, or what these rows make of them before any rate is seen."""
        return self.odds

    def parameters_for(self, conditions: Conditions) -> tuple[Parameter, ...]:
        """Return the parameters as they are for these rows, one per column of `columns`, in that order."""
        declared, labels = [each.for_sensor(conditions.sensor) for each in self.parameters], self.labels_for(conditions)
        return tuple(replace(each, name=f"{each.name}{label}") for each in declared for label in labels)

    def labels_for(self, conditions: Conditions) -> Sequence[str]:
        """Return what follows the name of each parameter that is declared, once for each that there is of it."""
        return [f"_{label}" for label in channel_labels(conditions.sensor)] if self.per_channel else [""]

    def known_amplitudes(self, conditions: Conditions, site: Mapping[str, float]) -> Amplitudes:
        """Return what physics fixes of the amplitudes: probability, values (p,) and their deviations (p,) each.

        `site` holds what the campaign says of where it was measured (`latitude_deg`); empty where nothing is fixed.
        """
        return ()

    def shapes_for(self, conditions: Conditions) -> tuple[ShapeParameter, ...]:
        """Return the shape parameters with their grids for these rows (a changepoint's grid is the runs)."""
        return self.shapes

    def shape_grid(self, conditions: Conditions) -> Sequence[Mapping[str, float]]:
        """Return every combination of the shape parameters; `[{}]` where there are none."""
        shapes = self.shapes_for(conditions)
        return [
            dict(zip((shape.name for shape in shapes), values, strict=True))
            for values in itertools.product(*(shape.grid for shape in shapes))
        ]

    def accepts(self, parameter: str) -> bool:
        """Whether a model file may give a value for a parameter of this name."""
        if self.accepted:
            return re.fullmatch(self.accepted, parameter, re.DOTALL) is not None
        declared = [declared.name for declared in self.parameters]
        if self.per_channel:
            return any(parameter.startswith(f"{name}_") for name in declared)
        return parameter in declared


class Effect(Described):
    """A named physical effect on the averages of collects. Subclasses are stateless; values live in a model.

    Rows whose needed cell is empty (NaN) get zeros: there the effect is not asked about. A parameter that the data
    cannot excite has a column of zeros.
    """

    needs_base: ClassVar[bool] = False  # `columns` refuses base=None
    needs_slopes: ClassVar[bool] = False  # … and a base without slopes by temperature
    in_models: ClassVar[bool] = True  # False for mistakes in a record: to be corrected there, not to be modelled

    searched: ClassVar[bool] = True
    """False where the search for what is missing comes upon it in another way than by its columns."""

    known_as: ClassVar[str] = ""
    """Id of the effect under whose name it is found, where both are one cause, at one and at several temperatures."""

    in_every_model: ClassVar[bool] = False
    """Whether a search looks for it only where it follows temperature: every model has the plain one."""

    may_follow_temperature: ClassVar[bool] = False
    """Whether its values may follow temperature: then powers of it and a value at each setpoint are tried as well."""

    plain_form: ClassVar[str] = "constant"
    """What its values most probably are over temperature: "line" where its name means that a term follows it."""

    series_in_temperature: ClassVar[bool] = False
    """Whether it follows temperature as a series in its powers, the third included."""

    lasts: ClassVar[bool] = False
    """Whether what it makes of a parameter is so from its time on, and nothing that begins anew or comes back."""

    @abstractmethod
    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        """Return the partial derivatives of the rates by the parameters, shape (n, c, p).

        `base` is needed by effects that act on the existing terms (scale factor, phase, tilt); `shape` gives a value
        for every shape parameter. For a collect it is the mean over [start, start + duration].
        """

    def untold_by(self, conditions: Conditions) -> str:
        """Return what these rows lack, so that nobody can say what it does in others; empty where nothing."""
        return ""

    def aliases_for(self, conditions: Conditions) -> Mapping[str, float]:
        """Return other names for the same columns in these rows, whatever is recorded, with weights against its 1."""
        return {}

    def beside_form(self, parameters: Sequence[str], sensor: Sensor) -> bool:
        """Whether it can be missing from a model whose form has these parameters."""
        return True

    def kept_over_temperature(self, parameters: Sequence[Parameter], sensor: Sensor) -> tuple[int, ...]:
        """Return the places of the parameters that, following temperature, are not another effect's."""
        return tuple(range(len(parameters)))

    def kin_for(self, conditions: Conditions, shape: Mapping[str, float]) -> Mapping[str, float]:
        """Return what of `kin`, and what else, has the history in time that it has at this shape."""
        return self.kin

    def happens(self, conditions: Conditions, shape: Mapping[str, float]) -> Hashable | None:
        """Return what happens at this shape, alike wherever it does and perhaps again; None of what always is."""
        return None

    def begins_within(self, shape: Mapping[str, float]) -> Sequence[int]:
        """Return the runs that it does not move as a whole: in them no parameter is one number."""
        return ()


class VarianceEffect(Described):
    """An effect that only scatters averages, without moving their mean. It has one parameter, its size."""

    @abstractmethod
    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        """Return the independent parts that add up to it, at unit size of the parameter, for n collects."""

    def covariance(self, conditions: Conditions, shape: Mapping[str, float] = MappingProxyType({})) -> FloatArray:
        """Return the covariance of the rates at unit size of the parameter, shape (n·c, n·c), rows (n, c) flattened."""
        return np.asarray(sum(part.covariance(conditions) for part in self.scatter(conditions, shape)))


def effect_columns(effect: Effect, conditions: Conditions, base: Base, shape: Mapping[str, float]) -> FloatArray:
    """Return an effect's columns, zero where it is not asked about, shape (n, c, p)."""
    return np.nan_to_num(np.asarray(effect.columns(conditions, base, shape), dtype=np.float64))


def required_base(effect: Effect, base: Base | None) -> Base:
    """Return `base`, or raise `InputError` where an effect that acts on the existing terms was asked without them."""
    if base is None:
        raise InputError(f"effect {effect.id} acts on the terms of the base model, and no base model was given")
    return base
