"""What may be missing: the catalogue's effects, and behind them a second tier of terms that have no name.

A candidate is a set of columns with a name. One name has several candidates: one per value of its shape parameters
(time constant, hysteresis width) and per form in temperature (constant, straight line, a value at each setpoint). The
second tier is every base parameter times every driver that the campaign knows: without it, something that is not in the
catalogue would get the catalogue's nearest name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import ROOM_DEGC, Base, Effect, Parameter
from hil.model.effects.catalogue import named
from hil.model.effects.followed import driver_values, expressible, position_is
from hil.model.effects.history import joined
from hil.model.forms import RATE
from hil.solve.temperatures import same_temperature

POWERS: Mapping[str, int] = {"line": 2, "quadratic": 3, "cubic": 4}
"""How many values a form in powers of temperature has."""
_SLOPE = "dTdt_degC_per_min"
_NOTHING = 1e-4  # deg/hr: what an effect of the largest typical size does not reach is not measured by any bench
_FEWEST_VALUES = 6
_CURVE_ORDER = 3


BaseBeside = Callable[[Effect, Mapping[str, float]], Base]


@dataclass(frozen=True)
class Candidate:
    """Columns of one name at one shape on one sensor, shape (n, c, p) over all its collects.

    `tier` is 1 for the catalogue, 2 for parameter × driver terms. `form` is the dependence on temperature of the values
    ("constant", "line", …, "table"), `stations_degC` the setpoints of a table. `parameters` has one entry per column.
    `searched` are the shape parameters with more than one value to search: a reference is each sensor's own.
    """

    name: str
    tier: int
    sensor: int
    columns: FloatArray
    parameters: tuple[Parameter, ...]
    shape: Mapping[str, float] = field(default_factory=dict)
    form: str = "constant"
    reference_degC: float | None = None
    stations_degC: tuple[float, ...] = ()
    title: str = ""
    equation: str = ""
    effect: Effect | None = None
    driver: str = ""
    target: str = ""
    sensor_axes: tuple[str, ...] = ()
    kept: tuple[int, ...] = ()
    before_degC: float = ROOM_DEGC
    searched: tuple[tuple[str, float], ...] = ()

    @property
    def size(self) -> int:
        """Number of columns."""
        return int(self.columns.shape[2])

    def rebuilt(self, conditions: Conditions, base: Base) -> FloatArray:
        """Return the columns of the same effect, shape and form on other rows, shape (n, c, p).

        Raises `ValueError` where it is a term of the second tier, which is no effect.
        """
        if self.effect is None:
            raise ValueError(f"{self.name} has no effect to be rebuilt from")
        columns = effect_columns(self.effect, conditions, base, self.shape, self.before_degC)
        columns = columns[:, :, list(self.kept)] if self.kept else columns
        return in_form(columns, conditions, self.form, self.reference_degC, self.stations_degC)


def catalogue_candidates(
    number: int, conditions: Conditions, base_beside: BaseBeside, catalogue: Sequence[Effect]
) -> Iterator[Candidate]:
    """Yield the candidates of every catalogue effect that can be asked about on this sensor.

    `base_beside` gives the base as it is if an effect of a shape acts beside it.
    """
    for effect in catalogue:
        if not effect.searched or not effect.applies_to(conditions.sensor) or effect.missing(conditions):
            continue
        for shape in effect.shape_grid(conditions):
            yield from _of_shape(number, conditions, base_beside(effect, shape), effect, shape)


def _of_shape(
    number: int, conditions: Conditions, base: Base, effect: Effect, shape: Mapping[str, float]
) -> Iterator[Candidate]:
    """Yield the candidates of one effect at one shape: one per history it may have had, in every form."""
    tried: list[FloatArray] = []
    searched = tuple((item.name, shape[item.name]) for item in effect.shapes_for(conditions) if len(item.grid) > 1)
    for before_degC in effect.came_from_degC or (ROOM_DEGC,):
        columns = effect_columns(effect, conditions, base, shape, before_degC)
        parameters = effect.parameters_for(conditions)
        high = np.array([item.typical[1] if 0 < item.typical[1] < np.inf else 1.0 for item in parameters])
        if float(np.abs(columns * high).max(initial=0.0)) < _NOTHING or any(np.allclose(columns, o) for o in tried):
            continue
        tried.append(columns)
        plain = Candidate(
            name=named(effect).id,
            tier=1,
            sensor=number,
            columns=columns,
            parameters=parameters,
            shape=shape,
            title=effect.followed_title or effect.title,
            equation=effect.equation,
            effect=effect,
            sensor_axes=conditions.sensor.axes,
            before_degC=before_degC,
            searched=searched,
        )
        if not effect.followed_title:
            yield plain
        if effect.may_follow_temperature:
            yield from _over_temperature(plain, conditions)


def effect_columns(
    effect: Effect, conditions: Conditions, base: Base, shape: Mapping[str, float], before_degC: float = ROOM_DEGC
) -> FloatArray:
    """Return an effect's columns, zero where it is not asked about, shape (n, c, p).

    What remembers temperature (hysteresis, the step before a plateau) is given the room that the unit came from: the
    first plateau was reached from somewhere too.
    """
    if not effect.came_from_degC or not {"temperature_degC", "setpoint_degC"} & set(conditions.columns):
        return np.nan_to_num(np.asarray(effect.columns(conditions, base, shape), dtype=np.float64))
    rows = joined(_before(conditions, before_degC), conditions)
    return np.nan_to_num(np.asarray(effect.columns(rows, None, shape), dtype=np.float64))[1:]


def _before(conditions: Conditions, temperature_degC: float) -> Conditions:
    """One row before the campaign: the same orientation at another temperature, the room's as a rule."""
    row = conditions.rows(np.array([int(np.argmin(conditions.start_s))]))
    columns = {name: np.full(1, np.nan) for name in row.columns}
    for name in ("temperature_degC", "setpoint_degC"):
        if name in columns:
            columns[name] = np.full(1, temperature_degC)
    return replace(row, run=row.run - 1, collect=row.collect - 1, start_s=row.start_s - 7200.0, columns=columns)


def _over_temperature(plain: Candidate, conditions: Conditions) -> Iterator[Candidate]:
    """Yield the candidate with values that follow temperature: a straight line, and one value per setpoint."""
    temperature = conditions.columns.get("temperature_degC")
    if temperature is None or not np.all(np.isfinite(temperature)):
        return
    plain = _apart_from_bias(plain)
    numbers = same_temperature(conditions)
    centres = tuple(float(np.mean(temperature[numbers == k])) for k in range(numbers.max() + 1))
    if len(centres) < 2:
        return
    reference = float(np.round(np.mean(temperature)))
    for form, values in POWERS.items():
        asked = form != "cubic" or plain.name == "bias_T"  # a bias follows temperature as a series in its powers
        if asked and len(centres) >= values + (form == "cubic"):
            yield _replaced(plain, in_form(plain.columns, conditions, form, reference, ()), form, reference, ())
    if len(centres) > 3:
        yield _replaced(plain, in_form(plain.columns, conditions, "table", None, centres), "table", None, centres)


def _apart_from_bias(plain: Candidate) -> Candidate:
    """Leave out of a g-squared effect what, following temperature, would be a bias: kAA with kSS is one.

    What is left is the square along the last axis, the spin axis of a rotor.
    """
    if plain.name != "k2" or plain.effect is None:
        return plain
    axis = plain.sensor_axes[-1]
    kept = [k for k, parameter in enumerate(plain.parameters) if parameter.name.startswith(f"k{axis}{axis}")]
    return replace(
        plain, columns=plain.columns[:, :, kept], parameters=tuple(plain.parameters[k] for k in kept), kept=tuple(kept)
    )


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


def _replaced(
    plain: Candidate, columns: FloatArray, form: str, reference: float | None, centres: tuple[float, ...]
) -> Candidate:
    repeats = columns.shape[2] // plain.size
    values = {**plain.__dict__, "columns": columns, "parameters": plain.parameters * repeats, "form": form}
    return Candidate(**{**values, "reference_degC": reference, "stations_degC": centres})


@dataclass(frozen=True)
class Driver:
    """Something that a coefficient might follow: a name for people and its value at each row, shape (n,)."""

    name: str
    values: FloatArray
    kind: str


def drivers(conditions: Conditions) -> list[Driver]:
    """Return everything the campaign knows that a coefficient might follow, named by its expression.

    Conditions as they were measured, temperature and time as powers, setpoints and zones one by one, and steps from one
    run to the next.
    """
    expressions: list[tuple[str, str]] = []
    temperature = conditions.columns.get("temperature_degC")
    for name, values in conditions.columns.items():
        varies = np.all(np.isfinite(values)) and np.ptp(values) > 1e-9 * max(1.0, float(np.abs(values).max()))
        a_temperature = name in {"setpoint_degC", "chamber_degC", "case_degC"} and temperature is not None
        if varies and not a_temperature and name != "n_samples" and expressible(name):
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
    if any(name == _SLOPE for name, _ in expressions):
        expressions.append((f"{_SLOPE}^2", "condition"))
    expressions += [("start_s", "time"), ("start_s^2", "time")]
    runs = list(dict.fromkeys(conditions.run.tolist()))
    if len(runs) > 5:
        expressions += [(f"run>{run}", "step") for run in runs[1:-2]]
    return [Driver(text, driver_values(text, conditions), kind) for text, kind in expressions]


def position_drivers(conditions: Conditions) -> list[Driver]:
    """Return one indicator per position that is visited more than once."""
    labels, counts = np.unique(conditions.position, return_counts=True)
    if len(labels) > 12:
        return []
    texts = [position_is(str(label)) for label, count in zip(labels, counts, strict=True) if count > 1]
    return [Driver(text, driver_values(text, conditions), "position") for text in texts]


def second_tier(number: int, conditions: Conditions) -> Iterator[Candidate]:
    """Yield parameter × driver terms: one column per channel, each with an amplitude of its own."""
    ones = np.ones(len(conditions))
    plain = drivers(conditions)
    zones = [driver for driver in plain if driver.kind == "zone"]
    for target, unit, values in _targets(conditions):
        for driver in plain:
            if target != "earth rate" or driver.kind == "condition":
                yield _term(number, conditions, target, unit, driver, values * driver.values[:, None])
        if target != "earth rate":
            for power_name, curve in _smooth(conditions):
                yield _curve(number, conditions, target, unit, power_name, values[:, :, None] * curve[:, None, :])
        if target == "B":
            for driver in plain:
                if _bears_a_curve(driver):
                    curve = _powers(driver.name, conditions, _CURVE_ORDER)
                    yield _curve(number, conditions, target, unit, driver.name, values[:, :, None] * curve[:, None, :])
    for place in position_drivers(conditions):
        both = [place.name]
        for zone in zones:
            both += [f"{place.name}&{zone.name}", f"{place.name}&{zone.name.replace('>', '<')}"]
        for text in both:
            driver = Driver(text, driver_values(text, conditions), "position")
            yield _term(number, conditions, "B", RATE, driver, driver.values[:, None] * ones[:, None])


def _targets(conditions: Conditions) -> Iterator[tuple[str, str, FloatArray]]:
    """Yield what a driver may act on: name, unit and column per channel, shape (n, c) or (n, 1)."""
    sensor = conditions.sensor
    yield "B", RATE, np.ones((len(conditions), 1))
    for k, axis in enumerate(sensor.axes):
        if np.std(conditions.f_g[:, k]) > 0.05:
            name = {0: "GS", 2: "MU"}.get(k, f"g along {axis}") if sensor.is_rotor else f"g along {axis}"
            yield name, "deg/hr/g", conditions.f_g[:, k : k + 1]
    if np.any(conditions.w_deg_per_hr):
        yield "earth rate", "1", conditions.w_channels_deg_per_hr


def _smooth(conditions: Conditions) -> Iterator[tuple[str, FloatArray]]:
    """Yield smooth curves over temperature and time: powers one to five, shape (n, 5)."""
    temperature = conditions.columns.get("temperature_degC")
    known = temperature is not None and np.all(np.isfinite(temperature))
    if known and len(np.unique(same_temperature(conditions))) > 5:
        yield "temperature_degC", _powers("temperature_degC", conditions)
    if len(np.unique(conditions.run)) > 7:
        yield "start_s", _powers("start_s", conditions)


def _bears_a_curve(driver: Driver) -> bool:
    """Whether a recorded condition, temperature and time apart, takes enough values for a curve over it."""
    recorded = driver.kind == "condition" and "^" not in driver.name and driver.name != "temperature_degC"
    return recorded and len(np.unique(np.round(driver.values, 9))) >= _FEWEST_VALUES


def _powers(name: str, conditions: Conditions, order: int = 5) -> FloatArray:
    return np.stack([driver_values(f"{name}^{power}", conditions) for power in range(1, order + 1)], axis=1)


def _term(number: int, conditions: Conditions, target: str, unit: str, driver: Driver, values: FloatArray) -> Candidate:
    """One column per channel: `values`, shape (n, c) or (n, 1), in that channel only."""
    channels = len(conditions.sensor.channels)
    columns = np.broadcast_to(values, (len(conditions), channels))[:, :, None] * np.eye(channels)
    return Candidate(
        name=f"{target} × {driver.name}",
        tier=2,
        sensor=number,
        columns=columns,
        parameters=_amplitudes(conditions, unit, 1),
        title=f"{target} follows {driver.name}",
        equation=f"rate += amplitude × {target} × {driver.name}",
        driver=driver.name,
        target=target,
    )


def _curve(number: int, conditions: Conditions, target: str, unit: str, over: str, values: FloatArray) -> Candidate:
    """A smooth curve of no stated form: `values` (n, c or 1, k), each channel with amplitudes of its own."""
    channels, order = len(conditions.sensor.channels), values.shape[2]
    shaped = np.broadcast_to(values, (len(conditions), channels, order))
    columns = (shaped[:, :, None, :] * np.eye(channels)[:, :, None]).reshape(
        len(conditions), channels, channels * order
    )
    return Candidate(
        name=f"{target} × curve over {over}",
        tier=2,
        sensor=number,
        columns=columns,
        parameters=_amplitudes(conditions, unit, order),
        title=f"{target} follows {over} in a way that no effect of the catalogue describes",
        equation=f"rate += {target} × smooth curve over {over}",
        driver=over,
        target=target,
    )


def _amplitudes(conditions: Conditions, unit: str, order: int) -> tuple[Parameter, ...]:
    suffixes = [""] if order == 1 else [f"_{k}" for k in range(1, order + 1)]
    return tuple(
        Parameter(f"amplitude_{axis}{suffix}", unit, (0.0, np.inf))
        for axis in conditions.sensor.channels.values()
        for suffix in suffixes
    )
