"""Refit everything at once: base and added effects by generalised least squares, with covariance and predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import BoolArray, FloatArray
from hil.reconcile.search.hypotheses import Hypothesis, Unit
from hil.solve.identifiability import orthonormal, project_out, smallest_fit
from hil.solve.likelihood import NoiseTable, ScalePrior, restricted_likelihood
from hil.solve.noise_grid import covariances
from hil.solve.rows import Block

UNSEEN = 0.02  # a column of which less than this is left beside the base has no value of its own


@dataclass(frozen=True)
class Added:
    """A hypothesis that was added, and the units of it that the data touch."""

    hypothesis: Hypothesis
    units: tuple[Unit, ...]

    def columns(self, n_blocks: int) -> list[FloatArray | None]:
        """Return the columns it adds to each block, (N, p); None where it does not act."""
        out: list[FloatArray | None] = [None] * n_blocks
        for unit in self.units:
            for block, columns in zip(unit.blocks, unit.columns, strict=True):
                present = out[block]
                out[block] = columns if present is None else np.hstack([present, columns])
        return out


def chosen_units(hypothesis: Hypothesis, log_factors: FloatArray) -> Added:
    """Keep the units that the data speak for, by their log factors (units,); at least the strongest."""
    strongest = int(np.argmax(log_factors))
    kept = [unit for k, unit in enumerate(hypothesis.units) if log_factors[k] > 0 or k == strongest]
    return Added(hypothesis, tuple(kept))


@dataclass(frozen=True)
class BlockNoise:
    """The noise of one block as finally estimated: covariance (N, N) in (deg/hr)² and its whitening."""

    covariance: FloatArray
    whitening: FloatArray

    def take(self, keep: BoolArray) -> BlockNoise:
        """Return the noise of the rows where `keep` is true."""
        return BlockNoise.of(self.covariance[np.ix_(keep, keep)])

    def beside(self, base: FloatArray, columns: FloatArray) -> FloatArray:
        """Return columns (N,) or (N, p), whitened, less their part in what the base (N, b) spans."""
        return project_out(orthonormal(self.whitening @ base), self.whitening @ columns)

    def projector(self, base: FloatArray) -> FloatArray:
        """Return the matrix P (N, N) with y'Py the weighted sum of squares that the base (N, b) leaves."""
        maker = self.beside(base, np.eye(len(base)))
        return np.asarray(maker.T @ maker)

    @classmethod
    def of(cls, covariance: FloatArray) -> BlockNoise:
        """Factor a covariance."""
        return cls(covariance, np.linalg.inv(np.linalg.cholesky(covariance)))


def estimate_noise(block: Block, table: NoiseTable) -> BlockNoise:
    """Return the most probable noise of a block given its present base, with the scale estimated."""
    prior = ScalePrior.of(block)
    (log_null, rss), *_ = restricted_likelihood(table, [block.base], block.y, prior)
    point = np.array([int(np.argmax(log_null))])
    freedom = len(block.y) - block.base.shape[1]
    scale = (prior.b + 0.5 * rss[point[0]]) / max(prior.a + 0.5 * freedom, 0.5)
    return BlockNoise.of(scale * covariances(block, table.grid.take(point))[0])


@dataclass(frozen=True)
class Fit:
    """Values (p,) and covariance (p, p) of the added parameters, and what base and effects make of every block.

    `owner` says for each value which added effect, unit and column it belongs to. `predicted[b]` (N,) is base and
    effects, `residual[b]` what they leave, `effect[b]` the added part alone.
    """

    values: FloatArray
    covariance: FloatArray
    owner: Sequence[tuple[int, int, int]]
    base_values: Sequence[FloatArray]
    predicted: Sequence[FloatArray]
    residual: Sequence[FloatArray]
    effect: Sequence[FloatArray]


def refit(
    blocks: Sequence[Block],
    noise: Sequence[BlockNoise],
    added: Sequence[Added],
    rows: Sequence[BoolArray] | None = None,
) -> Fit:
    """Fit the base of every block and all added effects together, on the rows where `rows[b]` is true (all, if None).

    `rows[b]` is (N,), `noise[b]` that of these rows; predictions and residuals are for every row. Directions that the
    rows cannot support get the smallest solution.
    """
    keep = [np.ones(len(b.y), dtype=bool) for b in blocks] if rows is None else list(rows)
    owner = [
        (i, u, k)
        for i, a in enumerate(added)
        for u, unit in enumerate(a.units)
        for k in range(unit.columns[0].shape[1])
    ]
    base_sizes = [block.base.shape[1] for block in blocks]
    total = sum(base_sizes) + len(owner)
    typical = np.array([np.nan] * sum(base_sizes) + [_typical(added[i].units[u], k) for i, u, k in owner])
    designs, targets, full = [], [], []
    for b, block in enumerate(blocks):
        design = np.zeros((len(block.y), total))
        start = sum(base_sizes[:b])
        design[:, start : start + base_sizes[b]] = block.base
        for place, (i, u, k) in enumerate(owner):
            unit = added[i].units[u]
            if b in unit.blocks:
                design[:, sum(base_sizes) + place] = unit.columns[unit.blocks.index(b)][:, k]
        full.append(design)
        designs.append(noise[b].whitening @ design[keep[b]])
        targets.append(noise[b].whitening @ block.y[keep[b]])
    cut = sum(base_sizes)
    solution, covariance = _least_squares(np.vstack(designs), np.concatenate(targets), typical, cut)
    predicted = [design @ solution for design in full]
    effect = [design[:, cut:] @ solution[cut:] for design in full]
    residual = [block.y - p for block, p in zip(blocks, predicted, strict=True)]
    starts = np.cumsum([0, *base_sizes])
    base_values = [solution[starts[b] : starts[b + 1]] for b in range(len(blocks))]
    return Fit(solution[cut:], covariance, owner, base_values, predicted, residual, effect)


def _typical(unit: Unit, column: int) -> float:
    """The largest typical size of a column's parameter; NaN where the catalogue states none."""
    largest = unit.candidate.parameters[unit.parameters[column]].typical[1]
    return float(largest) if unit.candidate.form in {"constant", "table"} and 0 < largest < np.inf else np.nan


def _least_squares(
    design: FloatArray, target: FloatArray, typical: FloatArray, cut: int
) -> tuple[FloatArray, FloatArray]:
    """Least squares with the covariance for unit noise; the first `cut` columns are the base.

    What of the added columns the base can imitate is the base's. Where the rows leave a combination of them open, the
    solution is the one with the smallest sizes in units of what is typical. The covariance is of the added values.
    """
    base, added = design[:, :cut], design[:, cut:]
    rest = project_out(orthonormal(base), added)
    norm = np.linalg.norm(added, axis=0)
    rest[:, np.linalg.norm(rest, axis=0) < UNSEEN * norm] = 0.0
    scale = np.where(
        np.isfinite(typical[cut:]),
        1.0 / np.where(np.isfinite(typical[cut:]), typical[cut:], 1.0),
        np.where(norm > 0, norm, 1.0),
    )
    u, values, v = np.linalg.svd(rest / scale, full_matrices=False)
    usable = values > 1e-4 * values.max(initial=0.0)
    inverse = np.where(usable, 1.0 / np.where(usable, values, 1.0), 0.0)
    effect = (v.T * inverse) @ (u.T @ target) / scale
    covariance = (v.T * inverse**2) @ v / np.outer(scale, scale)
    basic = smallest_fit(base, target - added @ effect, 1e-7) if cut else np.zeros(0)
    return np.concatenate([basic, effect]), covariance
