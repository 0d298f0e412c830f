"""What a unit's parameters are without what was found and with it, and its campaign as it would be without it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hil.campaign import Campaign, Collects, FloatArray
from hil.model.effects.catalogue import named as known_as
from hil.model.effects.catalogue import over_temperature
from hil.model.effects.followed import driver_of
from hil.model.forms import default_form
from hil.reconcile.outcome.scatter import FoundScatter
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.fitted import Values
from hil.reconcile.search.problem import Problem, SensorProblem, fit_to
from hil.solve import solve
from hil.solve.beside_terms import with_scatter
from hil.solve.runs import OBSERVABLE
from hil.solve.temperatures import level_degC, same_temperature, told_by

_CHANGED = 0.1  # of what changes most
_DIGITS = 9


def before_and_after(
    sensors: Mapping[int, SensorProblem], terms: Sequence[tuple[Candidate, Values]], calibrated: frozenset[int]
) -> list[dict[str, Any]]:
    """Return what each parameter that the terms change is at three temperatures, without and with them: key `values`.

    As the improved model has them: what parameters do with temperature is theirs, and what else was found stands beside
    them. A model is told by the parameters that its rates would be solved for, whatever its own are.
    """
    out = []
    for number in sorted({candidate.sensor for candidate, _ in terms}):
        sensor = sensors[number]
        conditions = sensor.collects.conditions
        form, station, level = default_form(conditions), same_temperature(conditions), level_degC(conditions)
        columns, known = form.columns(conditions), sensor.known_rates() - conditions.w_channels_deg_per_hr
        own = left_by(sensor, [each for each in terms if _is_of_parameters(each[0])])[2]
        places = np.unique(station[station >= 0])
        rows: list[tuple[float | None, FloatArray, FloatArray]] = []
        for k in np.unique(places[[0, len(places) // 2, -1]]) if len(places) else ():
            here = station == k
            is_ = []
            for chosen, made in (((), np.zeros_like(own)), (terms, own)):
                base, left, _ = left_by(sensor, chosen)
                fitted = here if number in calibrated else np.isfinite(left).any(axis=1)
                fit = fit_to(left[fitted], base[fitted], sensor.collects.rates_se_deg_per_hr[fitted])
                rates = known[here] + made[here] + base[here] @ fit
                of_all = columns[here].reshape(-1, len(form.names))
                is_.append(solve(of_all, rates.reshape(-1), 1.0, rank_tolerance=OBSERVABLE).values.round(_DIGITS) + 0.0)
            rows.append((None if level is None else float(np.nanmean(level[here])), is_[0], is_[1]))
        change = np.max([np.nan_to_num(np.abs(now - was)) for _, was, now in rows], axis=0, initial=0.0)
        alike = [len({(was[p], now[p]) for _, was, now in rows}) == 1 for p in range(len(form.names))]
        changed = np.flatnonzero(change > _CHANGED * np.max(change))
        out += [
            {
                "sensor": number,
                "name": form.names[p],
                "unit": form.units[p],
                "temperature_degC": None if alike[p] else at,
                "temperature_of": told_by(conditions),
                "before": float(was[p]),
                "after": float(now[p]),
            }
            for p in changed
            for at, was, now in (rows[:1] if alike[p] else rows)
            if np.isfinite(was[p] + now[p])
        ]
    return out


def _is_of_parameters(candidate: Candidate) -> bool:
    """Whether a term is what parameters are at a temperature, whatever else a collect has: bias_T, MU_real, GS_T."""
    effect = candidate.effect
    follows = driver_of(candidate.driver) if effect is None else over_temperature(known_as(effect)).follows
    return follows == "temperature"


def left_by(
    sensor: SensorProblem, terms: Sequence[tuple[Candidate, Values]]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the base's columns (n, c, p), what its terms leave of the rates, and what they make, (n, c) each."""
    collects = sensor.collects
    columns = np.concatenate([sensor.form.columns(collects.conditions), sensor.term_columns], axis=2)
    made = np.zeros_like(collects.rates_deg_per_hr)
    for candidate, values in (each for each in terms if each[0].sensor == sensor.number):
        for column, (value, _) in values.items():
            made += candidate.columns[:, :, column] * value
    return columns, collects.rates_deg_per_hr - sensor.known_rates() - made, made


def taken_out(
    problem: Problem,
    sensors: Mapping[int, SensorProblem],
    terms: Sequence[tuple[Candidate, Values]],
    scatter: Sequence[FoundScatter],
) -> Campaign:
    """Return the problem's campaign less what the model's terms and those that were found make of the rates.

    What is stated or was found of their scatter is in the standard errors. Labels are as they are in `sensors`.
    """
    laid = {}
    for number, sensor in sensors.items():
        collects = _less(sensor, terms)
        parts = [*problem.model.stated_scatter(collects.conditions)]
        for found in (each for each in scatter if each.sensor == number):
            of_unit_size = found.effect.scatter(collects.conditions, found.shape)
            parts += [replace(part, columns=part.columns * found.value) for part in of_unit_size]
        laid[number] = with_scatter(collects, parts)
    return replace(problem.campaign, sensors=laid, exchanged={})


def _less(sensor: SensorProblem, terms: Sequence[tuple[Candidate, Values]]) -> Collects:
    columns, left, made = left_by(sensor, terms)
    own = len(sensor.form.names)
    made += columns[:, :, own:] @ fit_to(left, columns, sensor.collects.rates_se_deg_per_hr)[own:]
    return replace(sensor.collects, rates_deg_per_hr=sensor.collects.rates_deg_per_hr - made)
