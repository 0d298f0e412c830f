"""A campaign as it would have been without what a model knows: which runs do not agree even so."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hil.campaign import Campaign, Collects, FloatArray
from hil.model.effects.base import Scatter
from hil.model.forms import default_form
from hil.reconcile.outcome.scatter import FoundScatter
from hil.reconcile.outcome.values import Values, least_squares, left_by
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.problem import Problem, SensorProblem
from hil.solve.identifiability import orthonormal, project_out


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
        collects = _less(sensor, [each for each in terms if each[0].sensor == number])
        parts = [*problem.model.stated_scatter(collects.conditions)]
        for found in (each for each in scatter if each.sensor == number):
            of_unit_size = found.effect.scatter(collects.conditions, found.shape)
            parts += [replace(part, columns=part.columns * found.value) for part in of_unit_size]
        laid[number] = replace(collects, rates_se_deg_per_hr=_with_scatter(collects, parts)) if parts else collects
    return replace(problem.campaign, sensors=laid, exchanged={})


def _less(sensor: SensorProblem, terms: Sequence[tuple[Candidate, Values]]) -> Collects:
    columns, left, made = left_by(sensor, terms)
    own = len(sensor.form.names)
    made += columns[:, :, own:] @ least_squares(columns, left)[own:]
    return replace(sensor.collects, rates_deg_per_hr=sensor.collects.rates_deg_per_hr - made)


def _with_scatter(collects: Collects, parts: Sequence[Scatter]) -> FloatArray:
    """Return standard errors (n, c) with what scatters inside a run: what a run's own values take is none of it."""
    conditions, stated = collects.conditions, collects.rates_se_deg_per_hr
    variance = stated**2
    for rows in conditions.of_each_run.values():
        own = conditions.rows(rows)
        values = default_form(own).columns(own)
        basis = orthonormal(values.reshape(-1, values.shape[-1]), 1e-6)
        for part in parts:
            there = part if part.group is None else replace(part, group=part.group[rows])
            covariance = replace(there, columns=part.columns[rows]).covariance(own)
            left = project_out(basis, project_out(basis, covariance).T)
            variance[rows] += np.diag(left).reshape(variance[rows].shape)
    return np.where(stated > 0.0, np.sqrt(variance), stated)
