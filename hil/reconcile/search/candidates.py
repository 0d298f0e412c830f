"""What may be missing: the catalogue's effects, and behind them a second tier of terms that have no name.

A candidate is a set of columns with a name. One name has several candidates: one per value of its shape parameters
(time constant, hysteresis width) and per form in temperature (constant, straight line, a value at each setpoint). The
second tier is every base parameter times every driver that the campaign knows: without it, something that is not in the
catalogue would get the catalogue's nearest name.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import Base, Effect, Parameter
from hil.model.effects.catalogue import named
from hil.model.effects.prior import shapes_tried
from hil.solve.temperatures import same_temperature

POWERS: Mapping[str, int] = {"line": 2, "quadratic": 3, "cubic": 4}
"""How many values a form in powers of temperature has."""
_NOTHING = 1e-4  # deg/hr: what an effect of the largest typical size does not reach is not measured by any bench


BaseBeside = Callable[[Effect, Mapping[str, float]], Base]


@dataclass(frozen=True)
class Candidate:
    """Columns of one name at one shape on one sensor, shape (n, c, p) over all its collects.

    `tier` is 1 for the catalogue, 2 for parameter × driver terms. `form` is the dependence on temperature of the values
    ("constant", "line", …, "table"), `stations_degC` the setpoints of a table. `parameters` has one entry per column.
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
        columns = effect_columns(self.effect, conditions, base, self.shape)
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
        tried = set[bytes]()
        for shape in shapes_tried(effect, conditions):
            columns = effect_columns(effect, conditions, base_beside(effect, shape), shape)
            parameters = effect.parameters_for(conditions)
            high = np.array([item.typical[1] if 0 < item.typical[1] < np.inf else 1.0 for item in parameters])
            same = (columns.round(9) + 0.0).tobytes()  # as where nothing tells one room before the night from another
            if float(np.abs(columns * high).max(initial=0.0)) < _NOTHING or same in tried:
                continue
            tried.add(same)
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
            )
            if not effect.followed_title:
                yield plain
            if effect.may_follow_temperature:
                yield from _over_temperature(plain, conditions)


def effect_columns(effect: Effect, conditions: Conditions, base: Base, shape: Mapping[str, float]) -> FloatArray:
    """Return an effect's columns, zero where it is not asked about, shape (n, c, p)."""
    return np.nan_to_num(np.asarray(effect.columns(conditions, base, shape), dtype=np.float64))


def _over_temperature(plain: Candidate, conditions: Conditions) -> Iterator[Candidate]:
    """Yield the candidate with values that follow temperature: a straight line, and one value per setpoint."""
    temperature = conditions.columns.get("temperature_degC")
    if temperature is None or not np.all(np.isfinite(temperature)):
        return
    kept = () if plain.effect is None else plain.effect.kept_over_temperature(plain.parameters, conditions.sensor)
    if 0 < len(kept) < plain.size:
        parameters = tuple(plain.parameters[k] for k in kept)
        plain = replace(plain, columns=plain.columns[:, :, list(kept)], parameters=parameters, kept=kept)
    numbers = same_temperature(conditions)
    centres = tuple(float(np.mean(temperature[numbers == k])) for k in range(numbers.max() + 1))
    if len(centres) < 2:
        return
    reference = float(np.round(np.mean(temperature)))
    for form, values in POWERS.items():
        asked = form != "cubic" or (plain.effect is not None and plain.effect.series_in_temperature)
        if asked and len(centres) >= values + (form == "cubic"):
            yield _replaced(plain, in_form(plain.columns, conditions, form, reference, ()), form, reference, ())
    if len(centres) > 3:
        yield _replaced(plain, in_form(plain.columns, conditions, "table", None, centres), "table", None, centres)


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
    parameters = plain.parameters * (columns.shape[2] // plain.size)
    plain = replace(plain, reference_degC=reference, stations_degC=centres)
    return replace(plain, columns=columns, parameters=parameters, form=form)
