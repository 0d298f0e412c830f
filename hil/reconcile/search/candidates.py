"""What may be missing: the catalogue's effects, and behind them a second tier of terms that have no name.

A candidate is a set of columns with a name. One name has several candidates: one per value of its shape parameters
(time constant, hysteresis width) and per form in temperature (constant, straight line, a value at each setpoint). The
second tier is every base parameter times every driver that the campaign knows: without it, something that is not in the
catalogue would get the catalogue's nearest name.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.campaign.plausibility import accelerometer_columns
from hil.model.effects.base import Base, Effect, Parameter, effect_columns
from hil.model.effects.catalogue import named
from hil.model.effects.followed import driver_values, expressible, position_is
from hil.model.effects.prior import BaseBeside, shapes_tried
from hil.model.forms import PER_G, RATE
from hil.solve.temperatures import same_temperature, told_parameters

POWERS: Mapping[str, int] = {"line": 2, "quadratic": 3, "cubic": 4}
"""How many values a form in powers of temperature has."""
MANY = 80
"""Places of one sort that are asked about: every row of a night, and of a year of nights those that are odd."""
_FEWEST_VALUES = 6
_CURVE_ORDER = 3


@dataclass(frozen=True)
class Candidate:
    """Columns of one name at one shape on one sensor, shape (n, c, p) over all its collects.

    `tier` is 1 for the catalogue, 2 for parameter × driver terms. `form` is the dependence on temperature of the values
    ("constant", "line", …, "table"), `stations_degC` the setpoints of a table. `parameters` has one entry per column.
    Of the second tier `changes` are the base parameters that follow the `driver`, one per channel.
    """

    name: str
    tier: int
    sensor: int
    laid: FloatArray | Callable[[], FloatArray]
    parameters: tuple[Parameter, ...]
    shape: Mapping[str, float] = field(default_factory=dict)
    form: str = "constant"
    reference_degC: float | None = None
    stations_degC: tuple[float, ...] = ()
    title: str = ""
    equation: str = ""
    effect: Effect | None = None
    driver: str = ""
    changes: Sequence[str] = ()
    kept: tuple[int, ...] = ()

    @classmethod
    def of(
        cls, effect: Effect, tier: int, conditions: Conditions, columns: FloatArray, shape: Mapping[str, float]
    ) -> "Candidate":
        """Return an effect by the name that it is known under, with all its parameters: its columns are (n, c, p)."""
        called, number, parameters = named(effect), conditions.sensor.number, effect.parameters_for(conditions)
        of = cls(called.id, tier, number, columns, parameters, shape, title=called.title, effect=effect)
        return replace(of, equation=called.equation)

    @property
    def columns(self) -> FloatArray:
        """The columns, (n, c, p); what is soon made of a few numbers is made anew, and takes no memory."""
        return self.laid() if callable(self.laid) else self.laid

    def rebuilt(self, conditions: Conditions, base: Base) -> FloatArray:
        """Return the columns of the same effect, shape and form on other rows, shape (n, c, p).

        Raises `ValueError` where it is a term of the second tier, which is no effect.
        """
        if self.effect is None:
            raise ValueError(f"{self.name} has no effect to be rebuilt from")
        columns = effect_columns(self.effect, conditions, base, self.shape)
        columns = columns[:, :, list(self.kept)] if self.kept else columns
        return in_form(columns, conditions, self.form, self.reference_degC, self.stations_degC)

    def only(self, places: Sequence[int]) -> "Candidate":
        """Return it with the parameters at some places, and no others; it itself where those are all, or none."""
        if len(places) in (0, len(self.parameters)):
            return self
        every, parameters = self.kept or range(len(self.parameters)), tuple(self.parameters[k] for k in places)
        kept = tuple(every[k] for k in places)
        return replace(self, laid=self.columns[:, :, list(places)], parameters=parameters, kept=kept)


def catalogue_candidates(
    conditions: Conditions, base_beside: BaseBeside, catalogue: Sequence[Effect]
) -> Iterator[Candidate]:
    """Yield the candidates of every catalogue effect that can be asked about on this sensor.

    `base_beside` gives the base as it is if an effect of a shape acts beside it.
    """
    temperature = conditions.columns.get("temperature_degC", np.full(1, np.nan))
    numbers = same_temperature(conditions) if np.all(np.isfinite(temperature)) else np.zeros(0, dtype=np.int64)
    centres = tuple(float(np.mean(temperature[numbers == k])) for k in range(numbers.max(initial=-1) + 1))
    for effect in catalogue:
        if not effect.searched or not effect.applies_to(conditions.sensor) or effect.missing(conditions):
            continue
        told = told_parameters(effect, conditions)
        for shape, columns in shapes_tried(effect, conditions, base_beside):
            plain = Candidate.of(effect, 1, conditions, columns, shape)
            if not effect.in_every_model:
                yield plain.only(told)
            if effect.may_follow_temperature and len(centres) > 1:
                kept = effect.kept_over_temperature(plain.parameters, conditions.sensor)
                yield from _over_temperature(plain.only(kept), conditions, centres)


def _over_temperature(plain: Candidate, conditions: Conditions, centres: tuple[float, ...]) -> Iterator[Candidate]:
    """Yield the candidate with values that follow temperature: a straight line, and one value per setpoint."""
    reference = float(np.round(np.mean(conditions.columns["temperature_degC"])))
    cubic = plain.effect is not None and plain.effect.series_in_temperature
    forms: list[tuple[str, float | None, tuple[float, ...]]] = [
        (form, reference, ())
        for form, values in POWERS.items()
        if (cubic or form != "cubic") and len(centres) >= values + (form == "cubic")
    ]
    forms += [("table", None, centres)] * (len(centres) > 3)
    for form, about, stations in forms:
        columns = in_form(plain.columns, conditions, form, about, stations)
        parameters = plain.parameters * (columns.shape[2] // len(plain.parameters))
        laid = replace(plain, laid=columns, parameters=parameters, form=form)
        yield replace(laid, reference_degC=about, stations_degC=stations)


def in_form(
    columns: FloatArray, conditions: Conditions, form: str, reference_degC: float | None, centres: Sequence[float]
) -> FloatArray:
    """Give columns (n, c, p) values that follow temperature: in its powers, or one per setpoint (p by p)."""
    if form == "constant":
        return columns
    temperature = conditions.columns["temperature_degC"]
    if form == "table":
        nearest = np.argmin(np.abs(temperature[:, None] - np.asarray(centres)), axis=1)
        factors = (nearest[:, None] == np.arange(len(centres))).astype(np.float64)
    else:
        delta = temperature - (reference_degC or 0.0)
        factors = np.stack([delta**power for power in range(POWERS[form])], axis=1)
    return np.concatenate([columns * factors[:, k, None, None] for k in range(factors.shape[1])], axis=2)


@dataclass(frozen=True)
class Driver:
    """Something that a coefficient might follow: a name for people and its value at each row, shape (n,)."""

    name: str
    values: FloatArray
    kind: str


def drivers(conditions: Conditions) -> list[Driver]:
    """Return everything the campaign knows that a coefficient might follow, named by its expression.

    Conditions as they were measured (but accelerations, which show the pose), temperature and time as powers, setpoints
    and zones one by one, and steps from one run to the next.
    """
    expressions: list[tuple[str, str]] = []
    temperature = conditions.columns.get("temperature_degC")
    known = {"n_samples", *accelerometer_columns(conditions.sensor)}
    for name, values in conditions.columns.items():
        varies = np.all(np.isfinite(values)) and np.ptp(values) > 1e-9 * max(1.0, float(np.abs(values).max()))
        a_temperature = name in {"setpoint_degC", "chamber_degC", "case_degC"} and temperature is not None
        if varies and not a_temperature and name not in known and expressible(name):
            expressions.append((name, "condition"))
    if temperature is not None and np.all(np.isfinite(temperature)) and np.ptp(temperature) > 8.0:
        expressions += [(f"temperature_degC^{power}", "condition") for power in (2, 3, 4)]
        numbers = same_temperature(conditions)
        low = [float(temperature[numbers == k].min()) for k in range(numbers.max() + 1)]
        high = [float(temperature[numbers == k].max()) for k in range(numbers.max() + 1)]
        if len(low) > 2:
            expressions += [
                (f"temperature_degC[{a - 1:.1f}..{b + 1:.1f}]", "setpoint") for a, b in zip(low, high, strict=True)
            ]
            expressions += [
                (f"temperature_degC>{0.5 * (a + b):.1f}", "zone") for a, b in zip(low[1:], high, strict=False)
            ]
    expressions += [(f"{name}^2", kind) for name, kind in expressions if name == "dTdt_degC_per_min"]
    expressions += [("start_s", "time"), ("start_s^2", "time")]
    runs = list(dict.fromkeys(conditions.run.tolist()))
    if len(runs) > 5:
        expressions += [(f"run>{run}", "step") for run in runs[1 : -2 : 1 + len(runs) // MANY]]
    return [Driver(text, driver_values(text, conditions), kind) for text, kind in expressions]


def second_tier(number: int, conditions: Conditions) -> Iterator[Candidate]:
    """Yield parameter × driver terms: one column per channel, each with an amplitude of its own."""
    plain = drivers(conditions)
    targets = list(_targets(conditions))
    temperature, curves = conditions.columns.get("temperature_degC", np.full(1, np.nan)), list[tuple[str, int]]()
    if np.all(np.isfinite(temperature)) and len(np.unique(same_temperature(conditions))) > 5:
        curves.append(("temperature_degC", 5))
    curves += [("start_s", 5)] * (len(np.unique(conditions.run)) > 7)
    known = [of for of in plain if of.kind == "condition" and "^" not in of.name and of.name != "temperature_degC"]
    # What else was recorded bears a curve of the bias where it takes enough values.
    bear = [(of.name, _CURVE_ORDER) for of in known if len(np.unique(np.round(of.values, 9))) >= _FEWEST_VALUES]
    for target in targets:
        for driver in plain:
            yield _nameless(number, conditions, target, driver.name, target.columns * driver.values[:, None])
        for over, order in [*curves, *bear * (target.name == "B")]:
            curve = np.stack([driver_values(f"{over}^{power}", conditions) for power in range(1, order + 1)], axis=1)
            yield _nameless(number, conditions, target, over, target.columns[:, :, None] * curve[:, None, :])
    labels, counts = np.unique(conditions.position, return_counts=True)
    for label in labels[counts > 1].tolist() if len(labels) <= 12 else ():
        both = [place := position_is(label)]
        for zone in [driver.name for driver in plain if driver.kind == "zone"]:
            both += [f"{place}&{zone}", f"{place}&{zone.replace('>', '<')}"]
        for text in both:
            yield _nameless(number, conditions, targets[0], text, driver_values(text, conditions)[:, None])


class _Target(NamedTuple):
    """What a driver may act on: its column per channel, (n, c) or (n, 1), and the base parameter of each channel."""

    name: str
    unit: str
    columns: FloatArray
    changes: Sequence[str]


def _targets(conditions: Conditions) -> Iterator[_Target]:
    """Yield what a driver may act on, the bias first. The earth rate is known, and what scales it scales all rates."""
    sensor, axes = conditions.sensor, list(conditions.sensor.channels.values())
    biases = [f"B{axis}" for axis in axes]
    yield _Target("B", RATE, np.ones((len(conditions), 1)), biases)
    for k, axis in enumerate(sensor.axes):
        if np.std(conditions.f_g[:, k]) > 0.05:
            name, changes = f"g along {axis}", [f"G{of}{axis}" for of in axes] if sensor.is_triad else biases
            if sensor.is_rotor:
                name, changes = (("GS", ["GSA", "GSB"]), (name, ["GSB", "GSA"]), ("MU", ["MUB", "MUA"]))[k]
            yield _Target(name, PER_G, conditions.f_g[:, k : k + 1], changes)


def _nameless(number: int, conditions: Conditions, target: _Target, driver: str, values: FloatArray) -> Candidate:
    """A target that follows a driver by `values` (n, c or 1), or a curve over it, (n, c or 1, k), in each channel."""
    curve, channels = values.ndim > 2, len(conditions.sensor.channels)
    values = values.reshape(*values.shape[:2], -1)
    order, how = values.shape[2], f"{'curve over ' * curve}{driver}"
    changes = [Parameter(f"{name} × {driver}", target.unit, (0.0, np.inf)) for name in target.changes]
    return Candidate(
        name=f"{target.name} × {how}",
        tier=2,
        sensor=number,
        laid=partial(_each_channel, values, channels),
        parameters=tuple(each for each in changes for _ in range(order)),
        title=f"{target.name} follows {driver}{' in a way that no effect of the catalogue describes' * curve}",
        equation=f"rate += amplitude × {target.name} × {how}",
        driver=driver,
        changes=target.changes,
    )


def _each_channel(values: FloatArray, channels: int) -> FloatArray:
    """Return values (n, c or 1, k) of every channel by itself, (n, c, c·k)."""
    each = np.broadcast_to(values, (len(values), channels, values.shape[2]))[:, :, None, :]
    return np.asarray((each * np.eye(channels)[:, :, None]).reshape(len(values), channels, -1))
