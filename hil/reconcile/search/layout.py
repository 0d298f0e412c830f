"""From a problem to what is searched: per sensor its blocks with their noise, and all that may be beside the base."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from hil.model.effects.base import Effect, VarianceEffect
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.noise import Noise
from hil.reconcile.search.problem import TEMPERATURE_FREE, Problem, SensorProblem
from hil.reconcile.search.sets import BlockSearch, SensorSearch
from hil.reconcile.search.terms import terms, wrong_rows
from hil.solve.rows import Block


def searches(
    problem: Problem, mislabelled: Sequence[Effect], scatter: Sequence[VarianceEffect]
) -> Mapping[int, SensorSearch]:
    """Return the search of every sensor, with its points of the noise chosen."""
    out = {}
    for number in sorted({block.sensor for block in problem.blocks}):
        sensor = problem.sensors[number]
        blocks = [block for block in problem.blocks if block.sensor == number]
        out[number] = _search(problem, sensor, blocks, mislabelled, scatter)
    return out


def _search(
    problem: Problem,
    sensor: SensorProblem,
    blocks: Sequence[Block],
    mislabelled: Sequence[Effect],
    scatter: Sequence[VarianceEffect],
) -> SensorSearch:
    conditions = sensor.collects.conditions
    free = problem.model.form in TEMPERATURE_FREE and sensor.given is None
    stated = problem.model.stated_covariance(conditions)
    laid = []
    for block in blocks:
        place = block.rows * len(conditions.sensor.channels) + block.channel
        own = None if stated is None else stated[np.ix_(place, place)]
        laid.append(BlockSearch.of(block, Noise(block, conditions, scatter, calibrated=free, stated=own)))
    candidates = [c for c in problem.candidates if c.sensor == sensor.number]
    candidates += [*wrong_rows(sensor.number, blocks, conditions), *_exchanges(sensor, mislabelled)]
    site = problem.campaign.site
    known = {c.name: c.effect.known_amplitudes(conditions, site) for c in candidates if c.effect is not None and c.tier}
    noise = float(np.sqrt(np.mean([b.noise.unit for b in laid])))
    search = SensorSearch(laid, terms(candidates, blocks, noise, known))
    search.refine()
    return search


def _exchanges(sensor: SensorProblem, mislabelled: Sequence[Effect]) -> Iterator[Candidate]:
    """Yield one candidate per exchange of labels in one run: its columns are what the exchange would change."""
    conditions = sensor.collects.conditions
    for effect in (e for e in mislabelled if not e.in_models):
        if not effect.applies_to(conditions.sensor) or effect.missing(conditions):
            continue
        bases = {run: sensor.base_without(conditions.run == run) for run in np.unique(conditions.run).tolist()}
        for shape in (s for s in effect.shape_grid(conditions) if s.get("run") in bases):
            columns = np.nan_to_num(effect.columns(conditions, bases[int(shape["run"])], shape))
            if np.any(columns):
                parameters = effect.parameters_for(conditions)
                yield Candidate(
                    effect.id,
                    0,
                    sensor.number,
                    columns,
                    parameters,
                    shape=shape,
                    effect=effect,
                    title=effect.title,
                    equation=effect.equation,
                )
