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

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.whitened import Whitened
from hil.solve.likelihood import NoiseTable, Projection, RichMeans, ScalePrior, bases_of, log_sum, restricted_likelihood
from hil.solve.noise_grid import covariances
from hil.solve.rows import Block

ZELLNER_G = (8.0, 64.0, 512.0, 4096.0)
INVISIBLE = 0.04  # directions of which less than this is left beside the base are not counted
_DEPTH = 9.0  # noise points this much (in log probability) below the best are left out
_MOST_POINTS = 36
_OUT_OF_THE_QUESTION = 15.0
_MOST_KEPT = 160
_AT_ONCE = 32  # data sets weighed together: as many as stay close to the processor

State = tuple[FloatArray, FloatArray, FloatArray]


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
        weight = np.exp(log_null - log_sum(log_null))
        share = np.zeros((len(rss), self.white.count, rss.shape[1]))
        for group, inverse in zip(self.white.groups, self._inverse, strict=True):
            share[:, group.members] = _explained(group.scores(residual), inverse)
        share *= (0.5 / (self.prior.b + 0.5 * rss))[:, None, :]
        np.clip(share, 0.0, 1.0 - 1e-12, out=share)
        terms = [
            -0.5 * self.rank[:, :, None] * np.log1p(g)
            - power * np.log1p(-share * (g / (1.0 + g)))
            - np.log(len(ZELLNER_G))
            for g in ZELLNER_G
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
        weight = np.exp(log_null[:, 0] - log_sum(log_null)[0])
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
        usable = gram > INVISIBLE**2
        return np.where(usable, 1.0 / np.where(usable, gram, 1.0), 0.0), usable[:, :, 0, 0].astype(np.float64)
    values, vectors = np.linalg.eigh(gram)
    usable = values > INVISIBLE**2
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
    found = restricted_likelihood(noise, bases_of(block, rich), block.y, ScalePrior.of(block))
    return np.asarray(np.max([log_null - log_null.max() for log_null, _ in found], axis=0))
