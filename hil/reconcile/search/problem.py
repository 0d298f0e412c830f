"""From a campaign and a model to what the search works on: blocks, the fitted base, and the candidates.

A built-in model has no values: its six (or four, or two) parameters are one set for the whole campaign, constant with
temperature, because that is what its form says; `matrix-6-thermal` says that they are quadratics. So on an
eight-temperature campaign a bias that follows temperature is a disagreement with `matrix-6`, and none with
`matrix-6-thermal`. Terms that a model already has are refitted with the base: what the model knows cannot be found
again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType

import numpy as np

from hil.campaign import Campaign, Collects, Conditions, FloatArray
from hil.campaign.data import known_mean
from hil.campaign.stand_ins import OWN, own_degC, with_stand_ins
from hil.model import Model
from hil.model.curve import Polynomial
from hil.model.effects.base import Base, Effect, effect_columns
from hil.model.effects.prior import UNSEEN
from hil.model.equation import pickoff_rates
from hil.model.forms import LinearForm
from hil.reconcile.search.candidates import Candidate, catalogue_candidates, second_tier
from hil.solve.beside_terms import with_white_noise_of
from hil.solve.identifiability import kept_shares, orthonormal, smallest_fit
from hil.solve.precision import with_every_error
from hil.solve.rows import Block, sensor_blocks
from hil.solve.temperatures import NOT_SETTLED, fitted_form, same_temperature, unsettled, why_unsettled
from hil.solve.wrong_rows import wrong_rows
from procedures.words import counted

LEAST_FREEDOM = 1  # rows of a block beyond the values of its base, from which on anything can be tested
LARGE = 250_000  # bytes: columns of a life, of which some hundred candidates would fill a third of the memory
_BEYOND_DOUBT = 12.0  # log likelihood


@dataclass(frozen=True)
class SensorProblem:
    """One sensor: its collects, the form that is fitted, the fitted values (p,), and the base at each row.

    Base and values are those of `right` (n, c), rates as far as they are where they belong, less what the model's terms
    make of them as they are `stated` (n, c); in a search they are of any size, by `term_columns`. `given` is the model
    whose own values follow temperature: they stand, and what is fitted is a correction to them.
    """

    number: int
    collects: Collects
    right: FloatArray
    form: LinearForm
    values: FloatArray
    base: Base
    term_columns: FloatArray
    stated: FloatArray
    given: Model | None = None

    def base_on(self, conditions: Conditions, values: FloatArray | None = None) -> Base:
        """Return the base on other rows of this sensor, or with other values (p,) than those that were fitted."""
        return _base(self.form, conditions, self.values if values is None else values, self.given)

    def predicted_from(self, rates: FloatArray) -> FloatArray:
        """Return what the form makes of other rates (n, c) than were filed, at every row."""
        conditions = self.collects.conditions
        values = fit_to(rates - self.known_rates(), self.form.columns(conditions), self.collects.rates_se_deg_per_hr)
        return self.base_on(conditions, values).rates

    def base_beside(self, effect: Effect, shape: Mapping[str, float]) -> Base:
        """Return the base as it is if `effect` acts too: what scales or turns the base has changed the fitted one.

        Base and effect are fitted together, but only where the effect shows beyond doubt: columns that follow every
        noise would find it more often than stated.
        """
        if not effect.needs_base:
            return self.base
        conditions = self.collects.conditions
        plain = np.concatenate([self.form.columns(conditions), self.term_columns], axis=2)
        rates, stated = self.right - self.known_rates(), self.collects.rates_se_deg_per_hr
        alone = _misfit(plain, rates, fit_to(rates, plain, stated))
        columns, measured = effect_columns(effect, conditions, self.base, shape), np.isfinite(rates)
        kept = kept_shares(orthonormal(plain[measured]), columns[measured]) > UNSEEN  # the rest is the base's to do
        both = np.concatenate([plain, columns[:, :, kept]], axis=2)
        if alone - _misfit(both, rates, fit_to(rates, both, stated)) < _BEYOND_DOUBT:
            return self.base
        beside = np.concatenate([self.form.columns(conditions), columns[:, :, kept]], axis=2)
        return self.base_on(conditions, fit_to(rates - self.stated, beside, stated)[: len(self.form.names)])

    def known_rates(self) -> FloatArray:
        """Return what is not fitted at each row, (n, c): the earth rate, and the values that stand."""
        conditions = self.collects.conditions
        earth = conditions.w_channels_deg_per_hr
        return earth if self.given is None else self.given.base_for(conditions).rates


@dataclass(frozen=True)
class Problem:
    """Everything that is known before the search begins."""

    campaign: Campaign
    model: Model
    sensors: Mapping[int, SensorProblem]
    blocks: Sequence[Block]
    candidates: Sequence[Candidate]
    notes: Sequence[str] = field(default_factory=tuple)


def as_thermometers_may_be(campaign: Campaign) -> list[Campaign]:
    """Return a campaign as recorded; where a thermometer may be off in a run, as if it is, and as if it is right.

    If it is off it shows what it shows in others at the setpoint; if not, the run is one of another setpoint. Both say
    so in their warnings.
    """
    off: dict[tuple[int, int], float] = {}  # °C, by sensor and run
    for number, collects in campaign.sensors.items():
        conditions, late = collects.conditions, unsettled(collects.conditions)
        for run in (run for run, why in late.items() if why_unsettled([why]) != NOT_SETTLED):
            setpoint, own, rows = conditions.columns["setpoint_degC"], own_degC(conditions), conditions.run == run
            others = np.isin(setpoint, setpoint[rows]) & ~np.isin(conditions.run, [*late])
            if np.isfinite(by := known_mean(own[rows]) - known_mean(own[others])):
                off[number, run] = by
    is_off = _moved(campaign, OWN, {at: -by for at, by in off.items()}, "off by {:+.1f} °C")
    return [is_off, _moved(campaign, "setpoint_degC", off, f"right: {NOT_SETTLED}")] if off else [campaign]


def _moved(campaign: Campaign, name: str, by_degC: Mapping[tuple[int, int], float], how: str) -> Campaign:
    """Return a campaign with a temperature moved in runs, by sensor and run, and of their thermometers said how."""
    sensors, said = dict(campaign.sensors), []
    for (number, run), by in by_degC.items():
        conditions = sensors[number].conditions
        rows = conditions.run == run
        shown = known_mean(own_degC(campaign.sensors[number].conditions)[rows])
        columns = {**conditions.columns, name: conditions.columns[name] + by * rows}
        sensors[number] = replace(sensors[number], conditions=replace(conditions, columns=columns))
        its = f"its thermometer, at {shown:z.1f} °C, is {how.format(-by)}"
        said.append(f"sensor {number}, run {run}: rates are likelier if {its}")
    return replace(campaign, sensors=sensors, warnings=[*campaign.warnings, *said])


def pose(campaign: Campaign, model: Model, catalogue: Sequence[Effect]) -> Problem:
    """Fit the model's form to every sensor, cut the rows into blocks, and list the candidates.

    Raises `InputError` where the form does not fit a sensor, needs a column that the campaign lacks, or values that
    follow temperature in a way that these temperatures do not tell.
    """
    blocks: list[Block] = []
    candidates: list[Candidate] = []
    notes: list[str] = []
    # What acts on the base acts on that of rates which are where they belong.
    right = {number: of.likeliest.rates_deg_per_hr for number, of in wrong_rows(campaign).items()}
    sensors = fitted_sensors(campaign, model, right)
    for number, sensor in sensors.items():
        columns = np.concatenate([sensor.form.columns(sensor.collects.conditions), sensor.term_columns], axis=2)
        blocks += sensor_blocks(number, sensor.collects, sensor.known_rates(), columns)
    bears = [block for block in blocks if len(block.y) - block.base.shape[1] >= LEAST_FREEDOM]
    if bears:
        starved = [block for block in blocks if 0 < len(block.y) < block.base.shape[1] + LEAST_FREEDOM]
        notes, blocks = [_starved(block, sensors[block.sensor].collects) for block in starved], bears
    for number in sorted({block.sensor for block in blocks}):
        collects, sensor, form = campaign.sensors[number], sensors[number], sensors[number].form
        own = collects.conditions.sensor
        asked = [effect for effect in catalogue if effect.beside_form(form.names, own)]
        for each in catalogue_candidates(collects.conditions, sensor.base_beside, asked):
            many = isinstance(each.laid, np.ndarray) and each.laid.nbytes > LARGE  # made where they are asked for
            made = partial(_made, replace(each, laid=np.zeros(0)), sensor)
            candidates.append(replace(each, laid=made) if many else each)
        candidates += list(second_tier(number, collects.conditions))
    return Problem(campaign, model, sensors, blocks, candidates, tuple(notes))


def _made(candidate: Candidate, sensor: SensorProblem) -> FloatArray:
    base = sensor.base if candidate.effect is None else sensor.base_beside(candidate.effect, candidate.shape)
    return candidate.rebuilt(sensor.collects.conditions, base)


def fitted_sensors(
    campaign: Campaign, model: Model, right: Mapping[int, FloatArray] = MappingProxyType({})
) -> dict[int, SensorProblem]:
    """Fit the model's form to every sensor, or its own to one of another kind; raises `InputError` if none fits.

    To the rates (n, c) that are `right`, where these are not as filed.
    """
    every = {
        number: with_white_noise_of(model, with_every_error(rows), rows.conditions)
        for number, rows in with_stand_ins(campaign).sensors.items()
    }
    return {
        n: _sensor(collects, right.get(n, collects.rates_deg_per_hr), model, fitted_form(model, collects.conditions))
        for n, collects in every.items()
    }


def _starved(block: Block, collects: Collects) -> str:
    channels = list(collects.conditions.sensor.channels)
    names = " and ".join(channels[c] for c in np.unique(block.channel))
    return (
        f"sensor {block.sensor}, {names}: {counted(len(block.y), 'rate')} for {counted(block.base.shape[1], 'value')} "
        "of the model: too few to test anything by, so the search is about the others"
    )


def _sensor(collects: Collects, right: FloatArray, model: Model, form: LinearForm) -> SensorProblem:
    conditions, number = collects.conditions, collects.conditions.sensor.number
    temperature, curves = conditions.columns.get("temperature_degC"), model.sensors.get(number, {}).values()
    known = temperature is not None and bool(np.all(np.isfinite(temperature)))
    # Values that follow temperature in a way that the form does not refit stand.
    stand = known and form.reference_degC is None and any(curve.depends_on_temperature for curve in curves)
    given = model if stand else None
    columns = form.columns(conditions)
    fixed = conditions.w_channels_deg_per_hr if given is None else given.base_for(conditions).rates
    rates = right - fixed
    stated = np.zeros_like(rates)
    for _ in range(2):  # terms are what they are beside the base, and the base is what it is beside them
        values = fit_to(rates - stated, columns, collects.rates_se_deg_per_hr)
        base = _base(form, conditions, values, given)
        terms, stated = _of_terms(model, conditions, base)
    return SensorProblem(number, collects, right, form, values, base, terms, stated, given)


def _base(form: LinearForm, conditions: Conditions, values: FloatArray, given: Model | None) -> Base:
    """Return the base with fitted values (p,), which are a correction where a model's own stand."""
    correction = base_at(form, conditions, values)
    if given is None:
        return correction
    own = given.base_for(conditions)
    both = Base(**{name: value + getattr(own, name) for name, value in vars(correction).items()})
    # The earth turns once: rates do not add up.
    return replace(both, rates=pickoff_rates(both.bias, both.k, conditions.f_g, conditions.w_channels_deg_per_hr))


def fit_to(rates: FloatArray, columns: FloatArray, stated: FloatArray | None = None) -> FloatArray:
    """Return what fits rates (n, c) by columns (n, c, p) best, (p,), the smallest where they leave a combination open.

    Where errors (n, c) of all rates are `stated`, they weigh them.
    """
    measured = np.isfinite(rates)
    weight = np.ones(measured.sum())
    if stated is not None and measured.any() and np.all(stated[measured] > 0.0):
        weight = 1.0 / np.hypot(stated[measured], 0.3 * np.median(stated[measured]))
    return smallest_fit(columns[measured] * weight[:, None], rates[measured] * weight, 1e-3)


def _misfit(columns: FloatArray, rates: FloatArray, values: FloatArray) -> float:
    """Return minus the log likelihood of a fit at the scatter that it leaves, up to a constant."""
    measured = np.isfinite(rates)
    left = (rates - columns @ values)[measured]
    return 0.5 * float(measured.sum()) * float(np.log(max(float(left @ left), 1e-300)))


def base_at(form: LinearForm, conditions: Conditions, values: FloatArray) -> Base:
    """Return bias, K, rates and their slopes by temperature at each row, from the fitted values (p,)."""
    bias, k = form.terms(conditions, values)
    rates = pickoff_rates(bias, k, conditions.f_g, conditions.w_channels_deg_per_hr)
    temperature = conditions.columns.get("temperature_degC")
    if temperature is None:
        return Base(bias, k, rates, np.zeros_like(bias), np.zeros_like(k))
    at = ({**conditions.columns, "temperature_degC": temperature + off} for off in (0.5, -0.5))
    (bias_up, k_up), (bias_down, k_down) = (form.terms(replace(conditions, columns=each), values) for each in at)
    return Base(bias, k, rates, bias_up - bias_down, k_up - k_down)


def _of_terms(model: Model, conditions: Conditions, base: Base) -> tuple[FloatArray, FloatArray]:
    """Return columns (n, c, p) of the terms that the model has, in each power of temperature that their values have.

    One for each temperature where these are a table; and what their values make of the rates, (n, c).
    """
    count, numbers = len(conditions), same_temperature(conditions)
    temperature = conditions.columns.get("temperature_degC", np.full(count, np.nan))
    stated = np.zeros((count, len(conditions.sensor.channels)))
    out = [stated[..., None][..., :0]]
    for term, effect in model.terms_for(conditions.sensor):
        if effect.missing(conditions):
            continue
        shape = {**{s.name: s.grid[0] for s in effect.shapes_for(conditions) if len(s.grid) == 1}, **term.shape}
        columns = effect_columns(effect, conditions, base, shape)
        names = [parameter.name for parameter in effect.parameters_for(conditions)]
        stated += np.einsum("ncp,np->nc", columns, np.nan_to_num(term.values_at(names, temperature)))
        for place, curve in enumerate(map(term.parameters.get, names)):
            if curve is None:
                continue
            by = np.ones((count, 1))
            if isinstance(curve, Polynomial):
                powers = [k for k, value in enumerate(curve.polynomial) if value]
                by = np.nan_to_num(temperature[:, None] - curve.reference_degC) ** powers
            elif curve.depends_on_temperature:
                by = np.equal.outer(numbers, np.unique(numbers[numbers >= 0])).astype(np.float64)
            out.append(columns[:, :, [place]] * by[:, None])
    return np.concatenate(out, axis=2), stated
