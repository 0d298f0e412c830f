"""How probable a block of rows is under models of its means: restricted likelihood over a grid of noise models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.solve.identifiability import (
    combinations_beside,
    independent_columns,
    orthonormal_of_independent,
    project_out,
    unit_columns,
)
from hil.solve.noise_grid import NoiseGrid, noise_grid, whiteners
from hil.solve.rows import Block

_STATED_DOF = 3.0  # how strongly stated standard errors hold the scale
_TRUSTED_DOF = 12.0  # and where they are all there is to judge by
_LEAST_FREEDOM = 4
_DEPENDENT = 1e-6


@dataclass(frozen=True)
class NoiseTable:
    """A block's noise models: whitening matrices W (t, N, N) and half log determinants (t,), made once.

    `known` is what the block's data say of them under rich models of the means, where that has been asked.
    """

    grid: NoiseGrid
    whitening: FloatArray
    half_log_det: FloatArray
    known: list[RichMeans] = field(default_factory=list, repr=False, compare=False)

    @classmethod
    def of(cls, block: Block) -> NoiseTable:
        """Compute the table of a block's layout."""
        return cls.on(block, noise_grid(block))

    @classmethod
    def on(cls, block: Block, grid: NoiseGrid) -> NoiseTable:
        """Compute the table of a block's layout on a given grid."""
        whitening, half_log_det = whiteners(block, grid)
        return cls(grid, whitening, half_log_det)

    def take(self, index: IntArray) -> NoiseTable:
        """Return the table at some grid points."""
        return NoiseTable(self.grid.take(index), self.whitening[index], self.half_log_det[index])


@dataclass(frozen=True)
class Projection:
    """Rows whitened with the base projected out: whitening (t, N, N), base's span (t, N, p), log weights (t,)."""

    whitening: FloatArray
    basis: FloatArray
    log_weight: FloatArray
    freedom: int

    @classmethod
    def of(cls, noise: NoiseTable, base: FloatArray) -> Projection:
        """Project `base` (N, p) out at every noise point."""
        log_weight = noise.grid.log_prior - noise.half_log_det
        if base.shape[1] == 0:
            return cls(noise.whitening, np.zeros((len(log_weight), base.shape[0], 0)), log_weight, base.shape[0])
        span, r = np.linalg.qr(base)
        white = noise.whitening @ span
        factor = np.linalg.cholesky(np.swapaxes(white, 1, 2) @ white)
        log_weight = log_weight - np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
        log_weight = log_weight - np.sum(np.log(np.abs(np.diagonal(r))))
        basis = white @ np.swapaxes(np.linalg.inv(factor), 1, 2)
        return cls(noise.whitening, basis, log_weight, base.shape[0] - base.shape[1])

    def beside(self, white: FloatArray) -> FloatArray:
        """Return whitened columns (t, N, k) less their part in the base."""
        return project_out(self.basis, white)

    def log_null(self, y: FloatArray, prior: ScalePrior) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return residuals (t, N, m), RSS (t, m) and the log marginal likelihood of the base alone (t, m)."""
        residual = self.beside(self.whitening @ y)
        rss = np.sum(residual**2, axis=1)
        power = prior.a + 0.5 * self.freedom
        return residual, rss, self.log_weight[:, None] - power * np.log(prior.b + 0.5 * rss)

    def log_null_with(self, white: FloatArray, residual: FloatArray, rss: FloatArray, prior: ScalePrior) -> FloatArray:
        """Log marginal likelihood (t,), up to a constant, with further whitened columns (t, N, k) in the base.

        For one data set: `residual` (t, N) is what the base leaves of it, `rss` (t,) its square.
        """
        log_weight, left = self.log_weight, rss
        if white.shape[2]:
            own = self.beside(white)
            factor = np.linalg.cholesky(np.swapaxes(own, 1, 2) @ own)
            score = np.linalg.solve(factor, np.einsum("tnk,tn->tk", own, residual)[..., None])[..., 0]
            log_weight = log_weight - np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
            left = np.maximum(rss - np.sum(score**2, axis=1), 1e-12 * rss)
        power = prior.a + 0.5 * (self.freedom - white.shape[2])
        return np.asarray(log_weight - power * np.log(prior.b + 0.5 * left))


@dataclass(frozen=True)
class ScalePrior:
    """Inverse-gamma prior of the scale s²: flat where nothing is stated, weakly held by stated standard errors."""

    a: float
    b: float

    @classmethod
    def of(cls, block: Block) -> ScalePrior:
        """Return the prior of a block."""
        if not block.sigma_stated:
            return cls(0.0, 1e-12)
        strength = _TRUSTED_DOF if block.sigma_trusted else _STATED_DOF
        return cls(0.5 * strength, 0.5 * strength * float(np.mean(block.sigma**2)))


def restricted_likelihood(
    noise: NoiseTable, bases: Sequence[FloatArray], y: FloatArray, prior: ScalePrior
) -> list[tuple[FloatArray, FloatArray]]:
    """For each of several bases (N, p): log marginal likelihood (t,) up to a constant, and RSS (t,), at every point.

    The same as `Projection.log_null`, for one data set `y` (N,) and without what only candidates need.
    """
    spans = [orthonormal_of_independent(base) for base in bases]
    white = noise.whitening @ np.column_stack([*spans, y])
    out, start = [], 0
    target = white[:, :, -1]
    whole = np.einsum("tn,tn->t", target, target)
    for span in spans:
        p = span.shape[1]
        own = white[:, :, start : start + p]
        start += p
        log_weight, rss = noise.grid.log_prior - noise.half_log_det, whole
        if p:
            factor = np.linalg.cholesky(np.swapaxes(own, 1, 2) @ own)
            score = np.linalg.solve(factor, np.einsum("tnp,tn->tp", own, target)[..., None])[..., 0]
            log_weight = log_weight - np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
            rss = np.maximum(whole - np.sum(score**2, axis=1), 1e-12 * whole)
        power = prior.a + 0.5 * (len(y) - p)
        out.append((log_weight - power * np.log(prior.b + 0.5 * rss), rss))
    return out


def bases_of(block: Block, rich: Sequence[FloatArray]) -> list[FloatArray]:
    """The base alone, and with each rich model of the means that leaves some freedom, (N, p) each."""
    bases = []
    for extra in ([np.zeros((len(block.y), 0))], *[[columns] for columns in rich]):
        base = independent_columns(np.hstack([block.base, *extra]), 1e-6)
        if len(base) - base.shape[1] >= _LEAST_FREEDOM or not extra[0].shape[1]:
            bases.append(base)
    return bases


@dataclass(frozen=True)
class RichMeans:
    """A block with its base, alone and within each rich model of its means, projected out at every noise point.

    Kept, because a base that has grown by a few columns then needs these few only. `spans` (N, p) are orthonormal,
    `residuals` (t, N) what each projection leaves of the data, `squares` (t,) their sums of squares.
    """

    block: Block
    rich: Sequence[FloatArray]
    whitening: FloatArray
    spans: Sequence[FloatArray]
    projections: Sequence[Projection]
    residuals: Sequence[FloatArray]
    squares: Sequence[FloatArray]

    @classmethod
    def of(cls, block: Block, noise: NoiseTable, rich: Sequence[FloatArray]) -> RichMeans:
        """Project the base out, alone and with each of the rich models."""
        spans = [orthonormal_of_independent(base) for base in bases_of(block, rich)]
        projections = [Projection.of(noise, span) for span in spans]
        white = noise.whitening @ block.y[:, None]
        residuals = [projection.beside(white)[:, :, 0] for projection in projections]
        squares = [np.sum(residual**2, axis=1) for residual in residuals]
        return cls(block, tuple(rich), noise.whitening, spans, projections, residuals, squares)

    def serves(self, block: Block, rich: Sequence[FloatArray]) -> bool:
        """Whether it is about these data and rich models, and a base that only has further columns."""
        known = self.block.base
        same = len(rich) == len(self.rich) and all(a is b for a, b in zip(rich, self.rich, strict=True))
        same = same and ScalePrior.of(block) == ScalePrior.of(self.block)
        pairs = ((block.y, self.block.y), (block.base[:, : known.shape[1]], known))
        return same and all(np.array_equal(a, b) for a, b in pairs)

    def best_of_any(self, base: FloatArray) -> FloatArray:
        """Log probability of each noise point below the best, under whichever model suits it most, (t,)."""
        prior, further = ScalePrior.of(self.block), base[:, self.block.base.shape[1] :]
        further = unit_columns(further)
        white = self.whitening @ further
        out = []
        for k, (span, projection) in enumerate(zip(self.spans, self.projections, strict=True)):
            new = white @ combinations_beside(span, further, _DEPENDENT)
            if k == 0 or len(span) - span.shape[1] - new.shape[2] >= _LEAST_FREEDOM:
                log_null = projection.log_null_with(new, self.residuals[k], self.squares[k], prior)
                out.append(log_null - log_null.max())
        return np.asarray(np.max(out, axis=0))


def log_sum(values: FloatArray) -> FloatArray:
    """Log of the sum of exponentials along the first axis, (m,) from (k, m); five times as quick as scipy's."""
    peak = values.max(axis=0)
    return np.asarray(peak + np.log(np.sum(np.exp(values - peak), axis=0)))
