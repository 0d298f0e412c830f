"""Fit every parameter of every sensor of a campaign against temperature.

First the parameters are free at every temperature; from that each gets its form (`choice`). Then all visits are fitted
once more along the chosen forms, at the temperature that each really had.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc, ndtr, stdtr

from hil.analysis.thermal.choice import FALSE_ALARM, MONOTONE, Choice, Improvement, monotone, nested_errors
from hil.analysis.thermal.estimate import Estimates, Layout, Visits, layout_of
from hil.campaign import Campaign, Collects, FloatArray
from hil.campaign.stand_ins import with_stand_ins
from hil.errors import InputError
from hil.files.strict import near
from hil.model import Model
from hil.model.curve import Constant, Curve, Polynomial, Table, TableRows
from hil.model.forms import MODEL_NAMES, named_form
from hil.model.model_file import SCHEMA as MODEL_SCHEMA
from hil.solve import Solution, repeats, solve, solve_campaign
from hil.solve.repeats import SensorRepeats
from hil.solve.wrong_rows import treated

HIGHEST_ORDER = 5
_QUESTIONS = 3
"""Asked of each parameter, and one answer is enough: do values change, does a line, does a form foretell better."""

DESCRIBES = 0.01
"""A form describes the values where noise would leave a larger misfit in at least this share of campaigns."""


class ParameterFit:
    """One parameter against temperature.

    `values` are the free estimates at each temperature; `coefficients` those of the chosen form (powers of T - T0, the
    lowest first, for a polynomial; values at the temperatures for a table). `p_value` is the chance that of as many
    parameters as the sensor has (`together`) noise alone would make one as unlike a constant, by its values, their
    straight line or what predicts them; `changes` says that it is less than `FALSE_ALARM`. `chance_constant` and
    `chance_form` are the chances of a misfit to noise as large as that of the constant and of the chosen form (None:
    nothing is left over). `largest_change` bounds the change over the range of a straight line, where no dependence was
    found, and `sigmas` is that line's change in its standard errors, where only `repeats` are too few to call that more
    than chance, else 0; `repeated` says that it was told more than once at some temperature; `hysteresis` (1,) is the
    value reached from below less that reached from above, whatever the form.
    """

    def __init__(
        self,
        seen: Visits,
        place: int,
        choice: Choice,
        p_value: float,
        values: Estimates,
        line: Estimates,
        errors: FloatArray,
    ) -> None:
        layout, order = seen.layout, choice.form.order
        self.name, self.unit = layout.form.names[place], layout.form.units[place]
        self.choice, self.values = choice, values
        coefficients = seen.along(place, order)[0]
        self.hysteresis = seen.along(place, None)[1]  # beside a form that does not describe it, it would take its place
        if order is not None:
            by = layout.half_degC ** -np.arange(order + 1.0)
            scaled = coefficients.covariance * np.outer(by, by)
            coefficients = replace(coefficients, values=coefficients.values * by, covariance=scaled)
        elif choice.form.name == MONOTONE:
            coefficients = replace(coefficients, values=monotone(coefficients.values, choice.weight))
        ratio, chance = (1.0, None) if order is None else _misfit(layout, values, order)
        self.chance_form: float | None = chance
        if chance is not None and chance < DESCRIBES:
            # What the form does not describe stands in the errors of its coefficients.
            coefficients = replace(coefficients, covariance=coefficients.covariance * ratio)
        self.coefficients, self.curve = coefficients, _curve(layout, self.unit, order, coefficients)
        told = seen.of_each[np.isfinite(seen.values[:, place]), place]
        self.repeatability = float(np.nanmedian(told))  # one that is huge says nothing of the others
        self.together = len(layout.form.names)
        self.repeats = int(seen.spread.degrees[place])
        self.repeated = bool(self.repeats)
        self.p_value, self.changes = p_value, p_value < FALSE_ALARM
        self.chance_constant = _misfit(layout, values, 0)[1]
        self.largest_change = 2.0 * float(abs(line.values[1]) + line.half_width[1])
        sigmas = float(abs(line.values[1]) / line.se[1])
        of_known_noise = 2.0 * _QUESTIONS * self.together * float(ndtr(-sigmas))
        self.sigmas = sigmas if self.repeated and not self.changes and of_known_noise < FALSE_ALARM else 0.0
        self.improvement = Improvement(choice.held_out_constant, errors, choice.weight)

    @property
    def form(self) -> str:
        """The name of the chosen form."""
        return self.choice.form.name

    @property
    def is_confirmed(self) -> bool:
        """Whether a form that depends on temperature also wins where it is chosen anew without what it predicts."""
        return self.finding == "modelled" and self.improvement.chosen_anew and self.improvement.is_certain

    @property
    def finding(self) -> str:
        """modelled, constant (no dependence found), or undescribed (it depends, and no form predicts it)."""
        if self.choice.form.order != 0:
            return "modelled"
        return "undescribed" if self.changes else "constant"


class SensorFit:
    """One sensor, `shown` by its repeats: its temperatures, its parameters, and what modelling does for its rates.

    See `fit_thermal`, also for where it raises `InputError`.
    """

    def __init__(
        self,
        collects: Collects,
        shown: SensorRepeats,
        model: str | None,
        order: int,
        apart_degC: float | None,
        as_zero: Sequence[str],
    ) -> None:
        number = collects.conditions.sensor.number
        if not shown.stated and np.isfinite(shown.left.deg_per_hr).all():
            collects = replace(collects, rates_se_deg_per_hr=shown.noise(collects.rates_se_deg_per_hr))
        of_errors = shown.spread.factor, shown.spread.residuals, shown.spread.common
        known = np.stack(np.broadcast_arrays(*of_errors), axis=1)
        factor_of = dict(zip(shown.names, known.tolist(), strict=True))
        layout, notes = layout_of(number, collects, model, apart_degC, factor_of, as_zero, shown.between.alone)
        seen = Visits(layout)
        free, centre_degC = [seen.free(place) for place in range(len(layout.form.names))], layout.stations.centre_degC
        compared = [
            Choice(centre_degC, each.values, each.covariance, highest_order=order, seed=place)
            for place, each in enumerate(free)
        ]
        scatters = bool(np.any(seen.spread.degrees)) or shown.of_means or bool(shown.by_model)
        told, least = scatters and seen.known, float(seen.known)
        lines = [_line(layout, each, None if told else least) for each in free]
        # How often noise alone would change the straight line, or, where it is told, any of the free values.
        slopes = [2.0 * float(stdtr(line.freedom, -abs(line.values[1]) / line.se[1])) for line in lines]
        of_values = [min(_misfit(layout, v, 0)[1], p) if told else p for v, p in zip(free, slopes, strict=True)]
        chances = _together(
            [_QUESTIONS * min(of, c.chance_of_constant) for of, c in zip(of_values, compared, strict=True)]
        )
        choices = [c if p < FALSE_ALARM else c.flat() for c, p in zip(compared, chances, strict=True)]
        if not told:
            without = "no temperature was measured twice" if seen.known else "neither repeats nor standard errors"
            notes.append(f"sensor {number}: {without}: what the curves leave is taken for noise")
            left = [_misfit(layout, v, c.form.order or 0)[0] for v, c in zip(free, choices, strict=True)]
            seen.sd = seen.sd * np.sqrt(np.maximum(left, least))
            if not seen.known:
                seen.of_each = np.hypot(seen.sd, seen.common)
            free = [seen.free(place) for place in range(len(free))]
        errors = [nested_errors(centre_degC, each, c, order) for each, c in zip(free, choices, strict=True)]
        self.parameters = {
            name: ParameterFit(seen, place, choices[place], chances[place], free[place], lines[place], errors[place])
            for place, name in enumerate(layout.form.names)
        }
        if layout.hysteresis:
            notes.append(f"sensor {number}: a drift through the campaign, if any, is part of what stands as hysteresis")
        else:
            notes.append(
                f"sensor {number}: no temperature was reached from both sides: hysteresis and a drift through the "
                "campaign are in the curves"
            )
        notes += [f"sensor {number}: {said}" for said in (*shown.between.in_words, *shown.uneven_in_words)]
        self.number, self.layout, self.notes = number, layout, notes
        self.improvement = _rate_improvement(layout, choices, errors)
        # Less what the two directions differ by, which is no noise.
        beyond = np.sqrt(np.maximum(shown.by_noise.beyond**2 - shown.spread.beyond**2 + seen.spread.beyond**2, 0.0))
        shown = replace(shown, by_noise=replace(shown.by_noise, beyond=beyond))
        of_a_collect = shown.of_a_collect(layout.collects.rates_se_deg_per_hr, layout.columns)
        self.rate_noise_deg_per_hr = of_a_collect if seen.known else None

    @property
    def curves(self) -> dict[str, Curve]:
        """The curve of every parameter of the form, 0 of what the campaign has taken as zero."""
        form = named_form(self.layout.form.name, self.layout.collects.conditions)
        found = {name: each.curve for name, each in self.parameters.items()}
        return {n: found.get(n, Constant(unit=u, value=0.0)) for n, u in zip(form.names, form.units, strict=True)}


@dataclass(frozen=True)
class ThermalFit:
    """The fits of a campaign's sensors; `not_fitted` says of the others why they have none."""

    campaign: Campaign
    sensors: Mapping[int, SensorFit]
    not_fitted: Mapping[int, str]

    def of(self, number: int) -> SensorFit:
        """Return the fit of a sensor; raise `InputError` saying why where there is none."""
        if number not in self.sensors:
            raise InputError(self.not_fitted[number])
        return self.sensors[number]

    def model(self) -> Model:
        """Return the curves as a model file's content; raise `InputError` where sensors have different forms."""
        forms = {each.layout.form.name for each in self.sensors.values()}
        if len(forms) > 1:
            raise InputError(f"the sensors have different forms ({', '.join(sorted(forms))}); fit them one by one")
        curves = {n: each.curves for n, each in self.sensors.items()}
        title = f"{self.campaign.title}, against temperature"
        source = f"hil thermal on {self.campaign.title}" + (" (SIMULATED)" if self.campaign.simulated else "")
        return Model(schema=MODEL_SCHEMA, title=title, form=forms.pop(), source=source, sensors=curves)


def fit_thermal(
    campaign: Campaign,
    model_name: str | None = None,
    *,
    highest_order: int = HIGHEST_ORDER,
    apart_degC: float | None = None,
) -> ThermalFit:
    """Fit each sensor of a campaign that can be; raise `InputError` where none can, as it takes three temperatures."""
    forms = [name for name in MODEL_NAMES if name != "matrix-6-thermal"]
    if model_name is not None and model_name not in forms:
        of = f"of a form without one{near(model_name, forms)}"
        raise InputError(f"model {model_name}: hil thermal finds the dependence itself, {of}")
    sensors, without = {}, {}
    for number, collects in with_stand_ins(treated(campaign)).sensors.items():
        try:
            shown = repeats(campaign, solve_campaign(campaign, model_name, number))[number]
            sensors[number] = SensorFit(collects, shown, model_name, highest_order, apart_degC, campaign.taken_as_zero)
        except InputError as error:
            without[number] = str(error)
    if not sensors:
        raise InputError("; ".join(without.values()) or "no collect was measured")
    return ThermalFit(campaign, sensors, without)


def _together(chances: Sequence[float]) -> list[float]:
    """Return, of chances of each parameter alone, those that one of so many is as improbable (Holm's)."""
    alone, count = np.array(chances), len(chances)
    order, together = np.argsort(alone), np.empty(count)
    together[order] = np.minimum(np.maximum.accumulate(np.arange(count, 0, -1) * alone[order]), 1.0)
    return together.tolist()


def _misfit(layout: Layout, values: Estimates, order: int) -> tuple[float, float]:
    """Return how far a polynomial is from the free values: chi-square per degree of freedom, and the chance of more."""
    found = _polynomial(layout, values, order)
    left = int(found.degrees_of_freedom)
    if left == 0:
        return 1.0, 1.0
    ratio = float(found.chi_square) / left
    return ratio, float(fdtrc(left, min(values.freedom, 1e6), ratio))


def _polynomial(layout: Layout, values: Estimates, order: int) -> Solution:
    """Return powers of the scaled temperature through the free values, which share what they have in common."""
    whiten = np.linalg.inv(np.linalg.cholesky(values.covariance))
    return solve(whiten @ layout.powers(layout.stations.centre_degC, order), whiten @ values.values, 1.0)


def _line(layout: Layout, values: Estimates, least: float | None) -> Estimates:
    """Return level and slope of a line through the free values, scattered by what it leaves unless `least` is None."""
    found = _polynomial(layout, values, 1)
    if least is None:
        return Estimates(found.values, found.covariance, values.freedom)
    left = max(_misfit(layout, values, 1)[0], least)
    return Estimates(found.values, found.covariance * left, len(values.values) - 2.0)


def _curve(layout: Layout, unit: str, order: int | None, coefficients: Estimates) -> Curve:
    valid = layout.range_degC
    values, se = coefficients.values.tolist(), coefficients.se.tolist()
    if order == 0:
        return Constant(unit=unit, value=values[0], se=se[0], valid_degC=valid)
    if order is not None:
        middle = layout.middle_degC
        return Polynomial(unit=unit, polynomial=tuple(values), reference_degC=middle, se=tuple(se), valid_degC=valid)
    rows = TableRows(temperature_degC=tuple(layout.stations.centre_degC.tolist()), value=tuple(values), se=tuple(se))
    return Table(unit=unit, table=rows, valid_degC=valid)


def _rate_improvement(layout: Layout, choices: Sequence[Choice], errors: Sequence[FloatArray]) -> Improvement:
    number = layout.stations.number
    constant = np.stack([choice.held_out_constant[number] for choice in choices], -1)
    modelled = np.stack([each[number] for each in errors], -1)
    before = np.einsum("ncp,np->nc", layout.columns, constant)
    after = np.einsum("ncp,np->nc", layout.columns, modelled)
    counts = np.bincount(number).astype(np.float64)

    def per_station(rates: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(np.bincount(number, weights=np.mean(rates**2, axis=1)) / counts))

    return Improvement(per_station(before), per_station(after), counts / counts.sum())
