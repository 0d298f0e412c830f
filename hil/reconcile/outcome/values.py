"""What a unit's parameters are without what was found and with it, and its campaign as it would be without it."""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import replace
from typing import Any

import numpy as np

from hil.campaign import BoolArray, Campaign, Conditions, FloatArray
from hil.campaign.data import known_mean
from hil.campaign.stand_ins import OWN, temperature_of
from hil.model import Model
from hil.model.effects.base import Effect
from hil.model.effects.catalogue import entries, over_temperature
from hil.model.effects.catalogue import named as known_as
from hil.model.forms import default_form
from hil.reconcile.outcome.improve import base_curves, left_by
from hil.reconcile.outcome.scatter import FoundScatter
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.fitted import Values
from hil.reconcile.search.problem import Problem, SensorProblem
from hil.solve import solve
from hil.solve.beside_terms import with_scatter
from hil.solve.runs import OBSERVABLE
from hil.solve.temperatures import at_no_temperature, same_temperature, told_by

_CHANGED = 0.1  # of what changes most, of one unit
_SLIGHTLY = 0.03  # of what changes most of all: less is what a temperature that is not quite one makes
_DIGITS = 9
_FROM = "from_run"  # of the shape of what steps


def before_and_after(
    before: Model,
    after: Model,
    sensors: Mapping[int, SensorProblem],
    terms: Sequence[tuple[Candidate, Values]],
    calibrated: frozenset[int],
    alike: Mapping[str, Sequence[Effect]],
) -> list[dict[str, Any]]:
    """Return what each parameter that the terms change is in a model before and after: key `values`.

    That is at three temperatures of the thermometer that curves are of and, of what lasts from a time on, in the first
    and the last run there, and in a run from which on, or in which alone, it acts, at its temperature. What parameters
    do with temperature and time is theirs, by whichever of effects that look the same (`alike`, by the id of a term's);
    what else was found stands beside them. A model is told by the parameters that its rates would be solved for,
    whatever its own are.
    """
    # Of an effect of a caller's own nobody else knows what it makes of a rate.
    strange = {c.effect.id for c, _ in terms if c.effect is not None} - {entry.id for entry in entries()}
    out = []
    for number in sorted({candidate.sensor for candidate, _ in terms}):
        sensor, conditions = sensors[number], _steady(sensors[number].collects.conditions)
        form, rates, acting, parted = default_form(conditions), list[FloatArray](), set[Effect](), set[int]()
        by_itself = list[FloatArray]()
        changed = set[int]()
        for model, found in ((before, ()), (after, terms)):
            curves = base_curves(sensor, found, number in calibrated)
            known = tuple(term for term in model.terms if term.effect not in strange)
            acts = model.model_copy(update={"terms": known}).terms_for(conditions.sensor)
            may = [(term, [effect, *alike.get(effect.id, ())]) for term, effect in acts]
            # What parameters are at a temperature or from a time on, whatever else a collect has: bias_T, GS.
            theirs = (
                any(e.lasts or over_temperature(known_as(e)).follows == "temperature" for e in of) for _, of in may
            )
            own = [
                each for each, is_so in zip(may, theirs, strict=True) if is_so and not each[1][0].missing(conditions)
            ]
            acting |= {effect for _, of in own for effect in of}
            parted |= {run for term, (effect, *_) in own for run in effect.begins_within(term.shape)}
            changed |= {int(term.shape[_FROM]) for term, _ in own if _FROM in term.shape}
            changes = {"form": sensor.form.name, "sensors": {number: curves}}
            alone, *with_one, whole = (
                model.model_copy(update={**changes, "terms": some}).rates(conditions) - conditions.w_channels_deg_per_hr
                for some in ((), *((term,) for term, _ in own), tuple(term for term, _ in own))
            )
            rates.append(whole)
            by_itself = [each - alone for each in with_one]
        rows, made = [], []
        for degC, run, here in _places(conditions, parted, changed, runs=any(effect.lasts for effect in acting)):
            of_all = form.columns(conditions.rows(here)).reshape(-1, len(form.names))
            every = (*rates, *by_itself)
            told = [solve(of_all, of[here].reshape(-1), 1.0, rank_tolerance=OBSERVABLE).values for of in every]
            was, now = (values.round(_DIGITS) + 0.0 for values in told[:2])
            rows.append((degC, run, was, now))
            made.append([now - was, *told[2:]])
        change = np.max(np.nan_to_num(np.abs(made)), axis=0, initial=0.0)  # by all together, and by each term
        units = np.array(form.units)
        most = np.array([np.max(change[:, units == unit], axis=1) for unit in units]).T
        told_of = (change > _CHANGED * most) & (change > _SLIGHTLY * np.max(change, axis=1, keepdims=True))
        for p in np.flatnonzero(told_of.any(axis=0)):
            said = {(degC, float(was[p]), float(now[p])): run for degC, run, was, now in rows}
            same = len({(was, now) for _, was, now in said}) == 1
            stays = len(said) == len({degC for degC, *_ in said})
            out += [
                {
                    "sensor": number,
                    "name": form.names[p],
                    "unit": form.units[p],
                    "temperature_degC": None if same else degC,
                    "temperature_of": told_by(conditions) and temperature_of(sensor.collects.conditions),
                    "run": None if stays else run,
                    "before": was,
                    "after": now,
                }
                for (degC, was, now), run in (list(said.items())[:1] if same else said.items())
                if np.isfinite(was + now)
            ]
    return out


def _steady(conditions: Conditions) -> Conditions:
    """Return collects of known temperature as if the unit had been at the mean through all of what is one."""
    elsewhere = np.isin(conditions.run, at_no_temperature(conditions))
    known = conditions.rows((same_temperature(conditions) >= 0) & ~elsewhere)
    station, own = same_temperature(known), known.columns.get(OWN, np.full(len(known), np.nan)).copy()
    for k in np.unique(station):
        own[station == k] = known_mean(own[station == k])
    return replace(known, columns={**known.columns, OWN: own})


def _places(
    conditions: Conditions, parted: Set[int], changed: Set[int], *, runs: bool
) -> Iterator[tuple[float | None, int | None, BoolArray]]:
    """Yield the coldest, middle and warmest temperature and its rows (n,), or those of its first and last whole run.

    That is but for runs that are `parted`, where there are others; and those of runs in which something `changed`.
    """
    station, odd = same_temperature(conditions), np.isin(conditions.run, [*changed])
    known = np.unique(station)
    for k in np.union1d(known[[0, len(known) // 2, -1]], station[odd]).tolist() if len(known) else ():
        degC = known_mean(conditions.columns[OWN][station == k])
        made, collects = np.unique(conditions.run[station == k], return_counts=True)
        whole = made[collects == collects.max()]
        whole = whole[~np.isin(whole, [*parted])] if {*whole.tolist()} - parted else whole
        told = {*whole[[0, -1]].tolist()} | changed & {*whole.tolist()}
        for run in sorted(told) if runs else (None,):
            here = (station == k) & (True if run is None else conditions.run == run)
            yield degC if np.isfinite(degC) else None, run, here


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
        *_, made = left_by(sensor, terms)
        collects = replace(sensor.collects, rates_deg_per_hr=sensor.collects.rates_deg_per_hr - made)
        parts = [*problem.model.stated_scatter(collects.conditions)]
        for found in (each for each in scatter if each.sensor == number):
            parts += found.parts(collects.conditions)
        laid[number] = with_scatter(collects, parts)
    return replace(problem.campaign, sensors=laid, exchanged={})
