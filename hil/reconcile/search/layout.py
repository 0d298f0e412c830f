"""From a problem to what is searched: per sensor its blocks with their noise, and all that may be beside the base."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from hil.model.effects.base import Effect, VarianceEffect, effect_columns
from hil.model.effects.data import Mislabelled
from hil.model.effects.prior import MANY
from hil.reconcile.search.block_search import BlockSearch
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.mistakes import AsSolved, as_told, exchanges, may_be_wrong
from hil.reconcile.search.noise import Noise
from hil.reconcile.search.posterior import Found, Posterior, shared_evidence
from hil.reconcile.search.problem import LEAST_FREEDOM, Problem, SensorProblem
from hil.reconcile.search.sets import SensorSearch
from hil.reconcile.search.terms import Term, terms

BETWEEN = (0.25, 0.5, 0.75)
"""Where, in logarithms, a shape is tried between two points of its grid: a time constant is then right to a tenth."""
BEYOND = 1.6  # by this factor a shape may lie outside its grid


def searches(
    problem: Problem,
    mislabelled: Sequence[Effect],
    scatter: Sequence[VarianceEffect],
    stand: Mapping[int, SensorSearch] = MappingProxyType({}),
) -> Mapping[int, SensorSearch]:
    """Return the search of every sensor, as it is `coarse` and then `refined`."""
    return refined(problem, coarse(problem, mislabelled, scatter, stand))


def coarse(
    problem: Problem,
    mislabelled: Sequence[Effect],
    scatter: Sequence[VarianceEffect],
    stand: Mapping[int, SensorSearch] = MappingProxyType({}),
) -> Mapping[int, SensorSearch]:
    """Return the search of every sensor at the noise that the base leaves probable, at the shapes of the grid.

    Beside the searches with values that `stand`, the base has values of its own at each temperature.
    """
    out: dict[int, SensorSearch] = {}
    for number in sorted({block.sensor for block in problem.blocks}):
        sensor, blocks = problem.sensors[number], [block for block in problem.blocks if block.sensor == number]
        conditions = sensor.collects.conditions
        stated = problem.model.stated_scatter(conditions)
        testable = min(len(block.y) - block.base.shape[1] for block in blocks) >= LEAST_FREEDOM
        if testable and number in stand:
            noises = [own.noise.at_each_temperature() for own in stand[number].blocks]
        else:
            noises = [Noise(block, conditions, scatter if testable else (), stated) for block in blocks]
        laid = [BlockSearch.of(block, own) for block, own in zip(blocks, noises, strict=True)]
        out[number] = SensorSearch(laid, [])
        if not testable:
            continue
        candidates = [c for c in problem.candidates if c.sensor == number]
        solved = AsSolved.of(problem.campaign, number)
        candidates += may_be_wrong(number, blocks, conditions, solved)
        if any(isinstance(effect, Mislabelled) for effect in mislabelled):
            candidates += exchanges(sensor, blocks, solved)
        found = _terms(problem, number, candidates, laid)
        told = as_told(found, solved, problem.campaign.exchanged.get(number, ()))
        out[number] = SensorSearch(laid, told, solved.among(told))
    return out


def refined(problem: Problem, found: Mapping[int, SensorSearch]) -> Mapping[int, SensorSearch]:
    """Choose the points of the noise anew beside leading terms, and try these at shapes between those of the grid."""
    for number, search in found.items():
        if search.terms:
            search.refine()
            parents = [term for j in search.leading() if (term := search.terms[j]).tier == 1]
            finer = [(parent, list(_between(problem.sensors[number], parent.candidate))) for parent in parents]
            log_odds = {id(c): parent.log_odds - float(np.log(len(own) + 1.0)) for parent, own in finer for c in own}
            between = _terms(problem, number, [c for _, own in finer for c in own], search.blocks)
            search.terms += [replace(t, log_odds=log_odds[id(t.candidate)]) for t in between]
    return found


def _terms(
    problem: Problem, number: int, candidates: Sequence[Candidate], laid: Sequence[BlockSearch]
) -> Sequence[Term]:
    conditions, site = problem.sensors[number].collects.conditions, problem.campaign.site
    known = {c.name: c.effect.known_amplitudes(conditions, site) for c in candidates if c.effect is not None and c.tier}
    noise, own_values = float(np.sqrt(np.mean([b.noise.unit for b in laid]))), all(b.noise.calibrated for b in laid)
    return terms(candidates, [b.block for b in laid], conditions, noise, known, calibrated=own_values)


def may_be_calibrated(problem: Problem) -> bool:
    """Whether the base may have values at each temperature: no values that stand say anything of it."""
    says = any(sensor.given for sensor in problem.sensors.values())
    several = any(len(np.unique(block.station)) > 1 for block in problem.blocks)
    return several and not says and not problem.model.terms


def values_follow(problem: Problem, posterior: Posterior, found: Found) -> bool:
    """Whether values that follow temperature make a sensor's rows likelier, alone or beside a set that was found.

    In ordinary noise, or with what was found to scatter: what else wanders may follow temperature itself.
    """
    effects = [effect for name, effect in posterior.scatter.items() if name in found.scatter]
    sorts = [frozenset[str](), found.scatter]
    for number, search in posterior.searches.items():
        conditions = problem.sensors[number].collects.conditions
        stated = problem.model.stated_scatter(conditions)
        noises = [Noise(own.block, conditions, effects, stated).at_each_temperature() for own in search.blocks]
        other = SensorSearch([BlockSearch.of(noise.block, noise) for noise in noises], search.terms)
        follow, stand = (shared_evidence(of, [(), found.terms[number]], sorts) for of in (other, search))
        if np.any(follow > stand):
            return True
    return False


def _between(sensor: SensorProblem, candidate: Candidate) -> Iterator[Candidate]:
    """Yield a candidate at shapes between the point of the grid that fits best and the next that was tried."""
    effect, conditions = candidate.effect, sensor.collects.conditions
    if effect is None or candidate.form != "constant":
        return
    every = list(effect.shape_grid(conditions))
    step, place = 1 + len(every) // MANY, every.index(candidate.shape)
    values = [*every[max(place - step + 1, 0) : place], *every[place + 1 : place + step]]
    for shape in [each for each in effect.shapes if each.continuous][:1]:
        here = candidate.shape[shape.name]
        grid = (here / BEYOND, *shape.grid, here * BEYOND)
        place = grid.index(here, 1)
        for other in (grid[place - 1], grid[place + 1]):
            values += [{**candidate.shape, shape.name: here * (other / here) ** part} for part in BETWEEN]
    for value in values:
        columns = effect_columns(effect, conditions, sensor.base_beside(effect, value), value)
        yield replace(candidate, shape=value, laid=columns)
