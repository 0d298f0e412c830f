"""How strongly the data of one block speak for each candidate, whatever the noise is.

For every point of the noise grid the rows are whitened and the base model is projected out. What is left of a candidate
explains a part S of what is left of the data, and the ratio of the two marginal likelihoods is, with amplitudes drawn
from N(0, g s² (Z'Z)^-1) and the scale s² integrated out,

    BF = (1 + g)^(-q/2) [ (b + RSS/2) / (b + (RSS - S g/(1+g))/2) ]^(a + nu/2)

averaged over g (how large effects are, in units of the noise) and over the noise grid, each point with its restricted
likelihood. A candidate that noise could imitate does not win by being tested at a noise level of its own choosing.
Everything is an array over (noise, candidates, data sets), so that a thousand simulated nights cost as much as one
loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.blocks import Block, independent_columns
from hil.reconcile.noise import NoiseGrid, covariances, noise_grid, whiteners
from hil.reconcile.whitened import Whitened

_G = (8.0, 64.0, 512.0, 4096.0)
_STATED_DOF = 3.0  # how strongly stated standard errors hold the scale
_TRUSTED_DOF = 12.0  # and where they are all there is to judge by
_INVISIBLE = 0.04  # directions of which less than this is left beside the base are not counted
_DEPTH = 9.0  # noise points this much (in log probability) below the best are left out
_MOST_POINTS = 36
_OUT_OF_THE_QUESTION = 15.0
_MOST_KEPT = 160
_LEAST_FREEDOM = 4
_DEPENDENT = 1e-6
_AT_ONCE = 32  # data sets weighed together: as many as stay close to the processor

State = tuple[FloatArray, FloatArray, FloatArray]


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
        return np.asarray(white - self.basis @ (np.swapaxes(self.basis, 1, 2) @ white))

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
    spans = [np.linalg.qr(base)[0] if base.shape[1] else base for base in bases]
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


class BlockEvidence:
    """Evidence for many candidates in one block, at the noise points that matter for its data."""

    def __init__(
        self,
        block: Block,
        noise: NoiseTable,
        columns: Sequence[FloatArray] | Whitened,
        rich: Sequence[FloatArray] = (),
        *,
        keep_all: bool = False,
    ) -> None:
        """`columns` (N, q) of every candidate; where they are whitened already, every point of `noise` is kept."""
        self.block = block
        self.prior = ScalePrior.of(block)
        all_points = keep_all or isinstance(columns, Whitened)
        self.noise = noise if all_points else noise.take(relevant_points(block, noise, rich))
        self.projection = Projection.of(self.noise, block.base)
        self.white = columns if isinstance(columns, Whitened) else Whitened.of(self.noise.whitening, columns)
        self.rank = np.zeros((len(self.noise.grid), self.white.count))
        self._inverse = []
        for group in self.white.groups:
            inverse, self.rank[:, group.members] = _pseudo_inverse(group.beside(self.projection.basis))
            self._inverse.append(inverse)

    def state(self, y: FloatArray) -> State:
        """What the base leaves of data sets `y` (N, m): residuals (t, N, m), RSS (t, m), log likelihood (t, m)."""
        return self.projection.log_null(y, self.prior)

    def log_factors(self, y: FloatArray) -> FloatArray:
        """Log Bayes factor of every candidate against the base alone, for data sets `y` (N, m), shape (j, m)."""
        return self.log_factors_of(self.state(y))

    def log_factors_of(self, state: State) -> FloatArray:
        """Log Bayes factors (j, m) of data sets of which the base has been taken off."""
        starts = range(0, state[1].shape[1], _AT_ONCE)
        parts = [self._log_factors(*(values[..., i : i + _AT_ONCE] for values in state)) for i in starts]
        return np.concatenate(parts, axis=1)

    def _log_factors(self, residual: FloatArray, rss: FloatArray, log_null: FloatArray) -> FloatArray:
        power = self.prior.a + 0.5 * self.projection.freedom
        weight = np.exp(log_null - _log_sum(log_null))
        share = np.zeros((len(rss), self.white.count, rss.shape[1]))
        for group, inverse in zip(self.white.groups, self._inverse, strict=True):
            share[:, group.members] = _explained(group.scores(residual), inverse)
        share *= (0.5 / (self.prior.b + 0.5 * rss))[:, None, :]
        np.clip(share, 0.0, 1.0 - 1e-12, out=share)
        terms = [
            -0.5 * self.rank[:, :, None] * np.log1p(g) - power * np.log1p(-share * (g / (1.0 + g))) - np.log(len(_G))
            for g in _G
        ]
        peak = np.max([term.max(axis=0) for term in terms], axis=0)
        total = sum(np.einsum("tm,tjm->jm", weight, np.exp(term - peak)) for term in terms)
        visible = self.rank.max(axis=0) > 0
        return np.where(visible[:, None], peak + np.log(np.maximum(total, 1e-300)), 0.0)

    def simulate(self, y: FloatArray, draws: int, rng: np.random.Generator) -> FloatArray:
        """Draw data sets (N, draws) without a missing effect, from the noise that this block's own data suggest.

        Each has a noise of its own, drawn with its scale from what these data leave possible: a data set without an
        effect would not know its noise better.
        """
        _, rss, log_null = self.projection.log_null(y[:, None], self.prior)
        weight = np.exp(log_null[:, 0] - _log_sum(log_null)[0])
        chosen = rng.choice(len(weight), size=draws, p=weight / weight.sum())
        out = np.empty((len(self.block.y), draws))
        points = np.unique(chosen)
        for point, covariance in zip(points, covariances(self.block, self.noise.grid.take(points)), strict=True):
            where = np.flatnonzero(chosen == point)
            power, offset = self.prior.a + 0.5 * self.projection.freedom, self.prior.b + 0.5 * rss[point, 0]
            scale = offset / rng.gamma(max(power, 0.5), size=len(where))
            scale = self.prior.b / self.prior.a if self.block.sigma_trusted and self.block.sigma_stated else scale
            factor = np.linalg.cholesky(covariance)
            out[:, where] = np.sqrt(scale) * (factor @ rng.standard_normal((out.shape[0], len(where))))
        return out


def _pseudo_inverse(gram: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverse (t, j, q, q) in the directions of which something is left, and how many these are, (t, j)."""
    if gram.shape[-1] == 1:
        usable = gram > _INVISIBLE**2
        return np.where(usable, 1.0 / np.where(usable, gram, 1.0), 0.0), usable[:, :, 0, 0].astype(np.float64)
    values, vectors = np.linalg.eigh(gram)
    usable = values > _INVISIBLE**2
    weights = np.where(usable, 1.0 / np.where(usable, values, 1.0), 0.0)
    inverse = (vectors * weights[:, :, None, :]) @ np.swapaxes(vectors, 2, 3)
    return inverse, usable.sum(axis=2).astype(np.float64)


def _explained(score: FloatArray, inverse: FloatArray) -> FloatArray:
    """How much of the residuals candidates explain, (t, j, m), by scores (t, j, q, m) and inverses (t, j, q, q)."""
    if inverse.shape[-1] == 1:
        return np.asarray(score[:, :, 0] ** 2 * inverse[:, :, 0])
    return np.asarray(np.einsum("tjqm,tjqm->tjm", score, inverse @ score))


def relevant_points(block: Block, noise: NoiseTable, rich: Sequence[FloatArray]) -> IntArray:
    """Return the noise points that matter: probable under the base alone, or under some rich model of the means.

    They are returned as places in the grid, (k,); each rich model is (N, p).

    A missing effect looks like run-to-run noise to the base alone; a flexible model of the means shows how quiet the
    unit might really be. What lies between is judged by evidence.
    """
    if not (noise.known and noise.known[0].serves(block, rich)):
        noise.known[:] = [RichMeans.of(block, noise, rich)]
    best = noise.known[0].best_of_any(block.base)
    keep = np.zeros(len(noise.grid), dtype=bool)
    order = np.argsort(-best)
    keep[order[:_MOST_POINTS]] = True
    return np.flatnonzero(keep & (best > -_DEPTH))


def pruned(block: Block, noise: NoiseTable, rich: Sequence[FloatArray]) -> NoiseTable:
    """Return the table without noise points that are out of the question for these data; each rich model is (N, p)."""
    best = _best_of_any(block, noise, rich)
    likely = np.sort(np.argsort(-best)[:_MOST_KEPT])
    return noise.take(likely[best[likely] > -_OUT_OF_THE_QUESTION])


def _best_of_any(block: Block, noise: NoiseTable, rich: Sequence[FloatArray]) -> FloatArray:
    """Log probability of each noise point below the best, under whichever model of the means suits it most, (t,)."""
    found = restricted_likelihood(noise, _bases(block, rich), block.y, ScalePrior.of(block))
    return np.asarray(np.max([log_null - log_null.max() for log_null, _ in found], axis=0))


def _bases(block: Block, rich: Sequence[FloatArray]) -> list[FloatArray]:
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
        spans = [np.linalg.qr(base)[0] for base in _bases(block, rich)]
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
        further = further / np.maximum(np.linalg.norm(further, axis=0), 1e-300)
        white = self.whitening @ further
        out = []
        for k, (span, projection) in enumerate(zip(self.spans, self.projections, strict=True)):
            _, singular, v = np.linalg.svd(further - span @ (span.T @ further), full_matrices=False)
            seen = singular > _DEPENDENT
            new = white @ (v[seen].T / singular[seen])  # orthonormal beside the span, however alike the columns are
            if k == 0 or len(span) - span.shape[1] - new.shape[2] >= _LEAST_FREEDOM:
                log_null = projection.log_null_with(new, self.residuals[k], self.squares[k], prior)
                out.append(log_null - log_null.max())
        return np.asarray(np.max(out, axis=0))


def _log_sum(values: FloatArray) -> FloatArray:
    """Log of the sum of exponentials along the first axis."""
    peak = values.max(axis=0)
    return np.asarray(peak + np.log(np.sum(np.exp(values - peak), axis=0)))
