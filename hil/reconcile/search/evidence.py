"""How probable a block of rows is with a set of effects beside the base: one closed form, for one set or for many.

With whitened rows, the base's columns projected out, and amplitudes a ~ N(m, S) of the columns X, the rates are normal
with covariance s² (1 + X S X'/s²). The scale s² has an inverse-gamma prior; S is measured by the scale that this very
set leaves, so that what is integrated is a Student t (Box & Tiao 1973, 2.7). Everything is averaged over the points of
the noise, over the sizes that an amplitude may have, and over how strongly the stated errors hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.noise import Points
from hil.solve.identifiability import independent_columns

HOLDS = ((18.0, 18.0, 0.6), (0.3, 0.3, 0.4))
"""Inverse-gamma (a, b) of s² in stated variances, and weight: errors are right to 17 %, or nobody knows how wrong."""
UNKNOWN = ((0.3, 0.3, 1.0),)
"""Of s² in the variance that a rough fit leaves, where no errors are stated."""
SEEN = 1e-6
"""A direction of which less is left beside the base is the base's."""
LEAST = 1e-12
"""Sum of squares below which nothing but rounding is left."""


@dataclass(frozen=True)
class Amplitude:
    """What is known of amplitudes (p,) before the data: normal about `mean`, of `deviation` times one of the `sizes`.

    `deviation` and `mean` are (p,), `sizes` and their `log_weights` (u,): one size is right for all p.
    """

    deviation: FloatArray
    sizes: FloatArray
    log_weights: FloatArray
    mean: FloatArray


@dataclass(frozen=True)
class Beside:
    """Rows whitened at every point, (t, N), with a base projected out, and what is left of the data there.

    `basis` (t, N, p) spans the base, `residual` (t, N) is what it leaves, `rss` (t,) its square, `log_base` (t,) the
    log determinants.
    """

    points: Points
    scales: Sequence[tuple[float, float, float]]
    basis: FloatArray
    residual: FloatArray
    rss: FloatArray
    log_base: FloatArray
    freedom: int

    @classmethod
    def of(
        cls, points: Points, scales: Sequence[tuple[float, float, float]], y: FloatArray, base: FloatArray
    ) -> Beside:
        """Project a base (N, p), made independent, out of data y (N,)."""
        base = independent_columns(base, SEEN)
        white = points.factor @ np.column_stack([base, y])
        if base.shape[1]:
            own, triangle = np.linalg.qr(white[:, :, :-1])
            log_base = -np.sum(np.log(np.abs(np.diagonal(triangle, axis1=1, axis2=2))), axis=1)
        else:
            own, log_base = white[:, :, :0], np.zeros(len(points))
        left = white[:, :, -1]
        left = left - (own @ (np.swapaxes(own, 1, 2) @ left[..., None]))[..., 0]
        rss = np.maximum(np.einsum("tn,tn->t", left, left), LEAST)
        return cls(points, scales, own, left, rss, log_base - points.half_log_det, len(y) - base.shape[1])

    def at(self, index: IntArray | slice) -> Beside:
        """Return some of the points."""
        if isinstance(index, slice):
            return self
        values = (self.basis[index], self.residual[index], self.rss[index], self.log_base[index])
        return Beside(self.points, self.scales, *values, self.freedom)

    def products(self, white: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return inner products (t, k, k) of whitened columns (t, N, k) beside the base, and with the data (t, k)."""
        across = np.swapaxes(self.basis, 1, 2) @ white
        gram = np.swapaxes(white, 1, 2) @ white - np.swapaxes(across, 1, 2) @ across
        return gram, np.einsum("tnk,tn->tk", white, self.residual)

    def student(self, left: FloatArray, half_log_det: FloatArray, scale: int) -> FloatArray:
        """Log evidence for a quadratic form `left` (t, …) under one of the scales' priors, prior of the point apart."""
        a, b, weight = self.scales[scale]
        power = a + 0.5 * self.freedom
        constant = a * np.log(b) - gammaln(a) + gammaln(power) + np.log(weight)
        shape = (len(self.rss),) + (1,) * (left.ndim - 1)
        log_point = self.log_base.reshape(shape)
        return np.asarray(constant + log_point - power * np.log(b + 0.5 * left) - half_log_det)

    def scale_left(self, left: FloatArray, scale: int) -> FloatArray:
        """Return what s² most probably is where a fit leaves `left`."""
        a, b, _ = self.scales[scale]
        return np.asarray((b + 0.5 * left) / (a + 0.5 * self.freedom))

    def log_null(self) -> FloatArray:
        """Log evidence of the base alone at every point, (t,), the point's prior apart."""
        zero = np.zeros(len(self.rss))
        return log_sum(np.array([self.student(self.rss, zero, k) for k in range(len(self.scales))]))


@dataclass(frozen=True)
class Group:
    """Candidates with q columns each: their places (j,), columns (N, j·q), and their priors, one or several of each.

    `owner` (p,) is the candidate of a prior, `mean` and `deviation` are (p, q), `sizes` and `log_weights` (p, u).
    """

    places: IntArray
    columns: FloatArray
    owner: IntArray
    mean: FloatArray
    deviation: FloatArray
    sizes: FloatArray
    log_weights: FloatArray

    @classmethod
    def several(cls, columns: Sequence[FloatArray], amplitudes: Sequence[Sequence[Amplitude]]) -> list[Group]:
        """Group candidates, by columns (N, q) and priors, by q; those without columns are in no group."""
        sizes = np.array([c.shape[1] for c in columns], dtype=np.int64)
        out = []
        for q in sorted(set(sizes.tolist()) - {0}):
            places = np.flatnonzero(sizes == q)
            priors = [(j, prior) for j, place in enumerate(places.tolist()) for prior in amplitudes[place]]
            most = max(len(prior.sizes) for _, prior in priors)
            tried, weights = np.zeros((len(priors), most)), np.full((len(priors), most), -np.inf)
            for i, (_, prior) in enumerate(priors):
                tried[i, : len(prior.sizes)], weights[i, : len(prior.sizes)] = prior.sizes, prior.log_weights
            out.append(
                cls(
                    places,
                    np.concatenate([columns[place] for place in places.tolist()], axis=1),
                    np.array([j for j, _ in priors]),
                    np.array([prior.mean for _, prior in priors]),
                    np.array([prior.deviation for _, prior in priors]),
                    tried,
                    weights,
                )
            )
        return out


def log_factors(beside: Beside, groups: Sequence[tuple[Group, FloatArray]], count: int) -> FloatArray:
    """Log evidence of each of `count` candidates at every point, (t, count), the point's prior apart.

    `groups` come with their whitened columns (t, N, j·q).
    """
    out = np.repeat(beside.log_null()[:, None], count, axis=1)
    for group, white in groups:
        gram, score = _within(beside, white, len(group.places))
        terms = _weighed(beside, gram[:, group.owner], score[:, group.owner], group)
        if len(group.owner) > len(group.places):
            terms = np.stack(
                [np.logaddexp.reduce(terms[:, group.owner == j], axis=1) for j in range(len(group.places))], 1
            )
        out[:, group.places] = terms
    return out


def _within(beside: Beside, white: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Inner products within each of `count` candidates (t, j, q, q) beside the base, and scores (t, j, q)."""
    points, _, wide = white.shape
    size = wide // count
    across = np.swapaxes(beside.basis, 1, 2) @ white
    score = np.einsum("tnk,tn->tk", white, beside.residual).reshape(points, count, size)
    if size == 1:
        gram = np.einsum("tnk,tnk->tk", white, white) - np.einsum("tpk,tpk->tk", across, across)
        return gram[..., None, None], score
    return _grams(white, size) - _grams(across, size), score


def _grams(columns: FloatArray, size: int) -> FloatArray:
    points, rows, wide = columns.shape
    apart = np.ascontiguousarray(columns.reshape(points, rows, wide // size, size).transpose(0, 2, 1, 3))
    return np.asarray(np.swapaxes(apart, 2, 3) @ apart)


def _weighed(beside: Beside, gram: FloatArray, score: FloatArray, group: Group) -> FloatArray:
    """Log evidence (t, p) of columns given their Gram (t, p, q, q) and score (t, p, q), for each prior of the group."""
    mean, deviation = group.mean, group.deviation
    if np.any(mean):
        pull = np.einsum("tjpq,jq->tjp", gram, mean)
        rss = beside.rss[:, None] + np.einsum("tjq,jq->tj", pull - 2.0 * score, mean)
        score = score - pull
    else:
        rss = beside.rss[:, None]
    values, z = decoupled(gram * (deviation[:, :, None] * deviation[:, None, :]), score * deviation)
    least = np.maximum(rss - explained(values, z), LEAST)
    terms = []
    for k in range(len(beside.scales)):
        variance = beside.scale_left(least, k)[..., None]
        for u in range(group.sizes.shape[1]):
            ratio = group.sizes[:, u, None] ** 2 / variance
            shrunk = 1.0 + values * ratio
            left = np.maximum(rss - np.sum(z**2 * ratio / shrunk, axis=-1), LEAST)
            terms.append(group.log_weights[:, u] + beside.student(left, 0.5 * np.sum(np.log(shrunk), axis=-1), k))
    return log_sum(np.array(terms))


def decoupled(gram: FloatArray, score: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues (…, q) of Gram matrices and scores (…, q) turned into their axes."""
    if gram.shape[-1] == 1:
        return np.maximum(gram[..., 0], 0.0), score
    values, vectors = np.linalg.eigh(gram)
    return np.maximum(values, 0.0), np.einsum("...qk,...q->...k", vectors, score)


def explained(values: FloatArray, z: FloatArray) -> FloatArray:
    """Return how much of the squared residuals free amplitudes explain, (…,)."""
    usable = values > 1e-10 * np.maximum(values.max(axis=-1, keepdims=True), 1e-300)
    return np.asarray(np.sum(np.where(usable, z**2 / np.where(usable, values, 1.0), 0.0), axis=-1))


def log_sum(values: FloatArray) -> FloatArray:
    """Log of the sum of exponentials along the first axis, (m,) of (k, m); quicker than logaddexp.reduce."""
    peak = values.max(axis=0)
    peak = np.where(np.isfinite(peak), peak, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(peak + np.log(np.sum(np.exp(values - peak), axis=0)))
