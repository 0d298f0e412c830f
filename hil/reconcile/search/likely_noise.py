"""Which noise a block of rows leaves probable: from every model of it to the few that are worth weighing sets at.

What the rows are to every model of the noise is said once, by inner products of a few columns; how the base's values
follow temperature then costs matrices of the size of a sweep, however many rows there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.evidence import LEAST, ROUNDING, SEEN, Scale, log_sum, student
from hil.reconcile.search.noise import Noise, Points
from hil.solve.identifiability import independent_columns

POINTS = 48
"""Points of the noise that a block is weighed at: what the data leave probable under any of the leading sets."""
DEPTH = 9.0
"""Noise this much (in log probability) below the best is left out: one part in eight thousand."""


@dataclass(frozen=True)
class _Rows:
    """Inner products (κ, m, m) of columns by temperature (r), base, further columns and data, at every noise."""

    noise: Noise
    grid: Points
    scales: Sequence[Scale]
    gram: FloatArray
    half_log_det: FloatArray
    variants: Sequence[IntArray]
    data: Sequence[int]

    def heights(self, at: IntArray, ways: IntArray) -> FloatArray:
        """Log evidence (v, k, f) of variants at some noises (k,) and ways to follow temperature (f,), with priors."""
        rest, half_log_det = self._without_values(at, ways)
        own = self.grid.log_prior[at][:, None] - np.log(len(self.noise.factors))
        return np.array(
            [self._alone(rest, half_log_det, v, y) + own for v, y in zip(self.variants, self.data, strict=True)]
        )

    def _without_values(self, at: IntArray, ways: IntArray) -> tuple[FloatArray, FloatArray]:
        """Integrate the values at each temperature out: inner products (k, f, m', m') and half log dets (k, f)."""
        values = self.noise.by_station.shape[1]
        gram, half_log_det = self.gram[at][:, None], self.half_log_det[at][:, None]
        factors = self.noise.factors[ways]
        factors = factors[:, :, np.any(factors, axis=(0, 1))]
        own = np.swapaxes(factors, 1, 2) @ gram[:, :, :values]
        triangle = np.linalg.cholesky(np.eye(factors.shape[2]) + own[..., :values] @ factors)
        seen = np.linalg.solve(triangle, own[..., values:])
        rest = gram[:, :, values:, values:] - np.swapaxes(seen, 2, 3) @ seen
        # Where values explain all but a part in 10^13, what is left is rounding, and may be less than nothing.
        np.einsum("kfii->kfi", rest)[:] += ROUNDING * np.einsum("kfii->kfi", gram[:, :, values:, values:])
        return rest, half_log_det + np.sum(np.log(np.diagonal(triangle, axis1=2, axis2=3)), axis=2)

    def _alone(self, rest: FloatArray, half_log_det: FloatArray, columns: IntArray, data: int) -> FloatArray:
        """Log evidence (k, f) of the data beside some columns that are free."""
        index = np.append(columns, data)
        own = rest[:, :, index[:, None], index]
        ridge = SEEN**2 * np.einsum("...ii->...i", own)
        triangle = np.diagonal(np.linalg.cholesky(own + ridge[..., None] * np.eye(len(index))), axis1=2, axis2=3)
        log_base = -np.sum(np.log(triangle[..., :-1]), axis=-1) - half_log_det
        rss = np.maximum(triangle[..., -1] ** 2, LEAST)
        freedom = len(self.noise.order) - len(columns)
        return log_sum(student(rss[None], log_base, self.scales, freedom))


def likely_points(
    noise: Noise, scales: Sequence[Scale], data: Sequence[FloatArray], base: FloatArray, extras: Sequence[FloatArray]
) -> tuple[Points, FloatArray]:
    """Return the points that are probable for some data (N,) beside the base with some further columns (N, q).

    With each how probable it is beside the best, log, (t,). Each of the data is weighed with each of the extras.
    """
    base = independent_columns(base, SEEN)
    free = [independent_columns(np.hstack([base, extra]), SEEN)[:, base.shape[1] :] for extra in extras]
    columns = np.column_stack([noise.by_station, *(own[noise.order] for own in (base, *free, *data))])
    first, ends = base.shape[1], np.cumsum([base.shape[1], *(own.shape[1] for own in free)])
    variants = [np.append(np.arange(first), np.arange(a, b)) for a, b in pairwise(ends)]
    grid = noise.grid()
    gram, half_log_det = noise.products(grid, columns)
    pairs = [(v, int(ends[-1]) + y) for v in variants for y in range(len(data))]
    rows = _Rows(noise, grid, scales, gram, half_log_det, [v for v, _ in pairs], [y for _, y in pairs])

    ordinary, every_way = np.flatnonzero(grid.kind < 0), np.arange(len(noise.factors))
    by_way = rows.heights(ordinary, every_way).max(axis=1)
    ways = np.flatnonzero(np.any(by_way > by_way.max(axis=1, keepdims=True) - DEPTH, axis=0))
    heights = rows.heights(np.arange(len(grid)), ways)
    best = np.max(heights - heights.max(axis=(1, 2), keepdims=True), axis=0)
    at, which = (part.ravel() for part in np.indices(best.shape))
    every = grid.take(at)
    return _kept(replace(every, profile=ways[which], log_prior=every.log_prior - np.log(len(every_way))), best.ravel())


def _kept(every: Points, best: FloatArray) -> tuple[Points, FloatArray]:
    """Keep the best points; the best of every kind, for what one block speaks against another may ask for; the quiet.

    Noise with next to no offset is kept whatever the base alone says: a term may explain what it takes for noise.
    """
    order = np.argsort(-best)
    kept = np.zeros(len(best), dtype=bool)
    kept[order[:POINTS]] = best[order[:POINTS]] > -DEPTH
    kept[order[np.unique(every.kind[order], return_index=True)[1]]] = True
    quiet = (every.kind < 0) & (every.level == every.level.max()) & (every.offset < 1.0)
    kept |= quiet & (every.profile == every.profile[order[0]])
    return every.take(np.flatnonzero(kept)), best[kept]
