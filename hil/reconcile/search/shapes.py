"""Shape parameters between the points of their grid: a time constant or a width as the data have it.

The grid is what is searched, because it can be laid out once. But an effect that shows strongly leaves a remainder
beside the nearest point of the grid: its size would be off, and the remainder would be given a name of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from hil.campaign import FloatArray
from hil.model.effects.base import ShapeParameter
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.fit import Added, BlockNoise
from hil.reconcile.search.hypotheses import Hypothesis, units_of
from hil.reconcile.search.problem import Problem
from hil.solve.identifiability import orthonormal, project_out, unit_columns
from hil.solve.rows import Block

_BEYOND = 1.6  # by this factor a shape may lie outside its grid
_WORTH = 1.5  # log likelihood, from which on the point between is kept


def between_the_grid(
    added: Added, problem: Problem, blocks: Sequence[Block], noise: Sequence[BlockNoise]
) -> Hypothesis | None:
    """Return the hypothesis of `added` at the shape that fits best; None where the grid serves as well."""
    candidate = added.hypothesis.candidate
    shape = _continuous(candidate)
    if shape is None:
        return None
    at = candidate.shape[shape.name]
    place = int(np.argmin(np.abs(np.array(shape.grid) - at)))
    low = shape.grid[place - 1] if place else shape.grid[0] / _BEYOND
    high = shape.grid[place + 1] if place + 1 < len(shape.grid) else shape.grid[-1] * _BEYOND
    touched = {b for unit in added.units for b in unit.blocks}

    def explained(log_value: float) -> float:
        found = _at(added.hypothesis, shape, float(np.exp(log_value)), problem, blocks)
        return _explained(Added(found, found.units).columns(len(blocks)), blocks, noise, touched)

    best = minimize_scalar(
        lambda v: -explained(v), bounds=(np.log(low), np.log(high)), method="bounded", options={"xatol": 0.02}
    )
    if -float(best.fun) - explained(float(np.log(at))) < 2.0 * _WORTH:
        return None
    return _at(added.hypothesis, shape, float(np.exp(best.x)), problem, blocks)


def _continuous(candidate: Candidate) -> ShapeParameter | None:
    """The shape parameter that has values between the points of its grid."""
    if candidate.effect is None:
        return None
    return next((shape for shape in candidate.effect.shapes if shape.continuous), None)


def _at(
    hypothesis: Hypothesis, shape: ShapeParameter, value: float, problem: Problem, blocks: Sequence[Block]
) -> Hypothesis:
    """The hypothesis with another value of one shape parameter, on all its sensors."""
    units = []
    for candidate in {unit.candidate.sensor: unit.candidate for unit in hypothesis.units}.values():
        sensor = problem.sensors[candidate.sensor]
        moved = replace(candidate, shape={**candidate.shape, shape.name: value})
        columns = moved.rebuilt(sensor.collects.conditions, sensor.base)
        units += units_of(replace(moved, columns=columns), blocks)
    return replace(hypothesis, units=tuple(units))


def _explained(
    columns: Sequence[FloatArray | None], blocks: Sequence[Block], noise: Sequence[BlockNoise], touched: set[int]
) -> float:
    """What columns beside the base explain of the touched blocks, in squares of the noise."""
    total = 0.0
    for b in touched:
        own = columns[b]
        if own is None:
            continue
        white = noise[b].whitening
        rest = project_out(orthonormal(white @ blocks[b].base), unit_columns(white @ own))
        total += float(np.sum((orthonormal(rest, scale=1.0).T @ (white @ blocks[b].y)) ** 2))
    return total
