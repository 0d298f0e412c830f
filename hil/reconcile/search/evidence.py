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

    `basis` (t, N, p) spans the base, `residual` (t, N) is what it leaves, `rss` (t,) its square, `log_base` (t,) the log
    determinants.
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
        rss = np.maximum(np.einsum("tn,tn->t", left, left), 1e-12)
        return cls(points, scales, own, left, rss, log_base - points.half_log_det, len(y) - base.shape[1])

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
        return np.logaddexp.reduce([self.student(self.rss, zero, k) for k in range(len(self.scales))], axis=0)


def columns_by_size(columns: Sequence[FloatArray]) -> list[tuple[IntArray, FloatArray]]:
    """Return columns (N, q) of many candidates grouped by q: their places (j,) and the columns side by side."""
    sizes = np.array([c.shape[1] for c in columns], dtype=np.int64)
    groups = []
    for size in sorted(set(sizes.tolist()) - {0}):
        places = np.flatnonzero(sizes == size)
        groups.append((places, np.concatenate([columns[int(j)] for j in places], axis=1)))
    return groups


def log_factors(
    beside: Beside,
    groups: Sequence[tuple[IntArray, FloatArray]],
    amplitudes: Sequence[Sequence[Amplitude]],
    count: int,
) -> FloatArray:
    """Log evidence of each of `count` candidates at every point, (t, count), the point's prior apart.

    `groups` are the whitened columns (t, N, j·q) of candidates of one size, `amplitudes` the prior of every candidate.
    """
    out = np.repeat(beside.log_null()[:, None], count, axis=1)
    for places, white in groups:
        size = white.shape[2] // len(places)
        gram, score = _within(beside, white, size)
        owners = np.array([j for j, place in enumerate(places) for _ in amplitudes[place]])
        terms = _weighed(beside, gram[:, owners], score[:, owners], [p for place in places for p in amplitudes[place]])
        for j in range(len(places)) if len(owners) > len(places) else ():
            terms[:, np.flatnonzero(owners == j)[0]] = np.logaddexp.reduce(terms[:, owners == j], axis=1)
        out[:, places] = terms[:, np.searchsorted(owners, np.arange(len(places)))]
    return out


def _within(beside: Beside, white: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Inner products within each candidate (t, j, q, q) beside the base, and scores (t, j, q)."""
    points, rows, wide = white.shape
    left = white - beside.basis @ (np.swapaxes(beside.basis, 1, 2) @ white)
    apart = left.reshape(points, rows, wide // size, size)
    score = np.einsum("tnk,tn->tk", white, beside.residual).reshape(points, -1, size)
    if size == 1:
        return np.einsum("tnjq,tnjq->tjq", apart, apart)[..., None], score
    apart = np.ascontiguousarray(apart.transpose(0, 2, 1, 3))
    return np.swapaxes(apart, 2, 3) @ apart, score


def _weighed(beside: Beside, gram: FloatArray, score: FloatArray, priors: Sequence[Amplitude]) -> FloatArray:
    """Log evidence (t, j) of columns given their Gram (t, j, q, q), score (t, j, q) and prior."""
    mean, deviation = np.array([p.mean for p in priors]), np.array([p.deviation for p in priors])
    pull = np.einsum("tjpq,jq->tjp", gram, mean)
    rss = beside.rss[:, None] - 2.0 * np.einsum("tjq,jq->tj", score, mean) + np.einsum("tjq,jq->tj", pull, mean)
    scaled = gram * (deviation[:, :, None] * deviation[:, None, :])
    turned = (score - pull) * deviation
    if scaled.shape[-1] == 1:
        values, z = np.maximum(scaled[..., 0], 0.0), turned
    else:
        values, vectors = np.linalg.eigh(scaled)
        values, z = np.maximum(values, 0.0), np.einsum("tjqk,tjq->tjk", vectors, turned)
    usable = values > 1e-10 * np.maximum(values.max(axis=-1, keepdims=True), 1e-300)
    fitted = np.sum(np.where(usable, z**2 / np.where(usable, values, 1.0), 0.0), axis=-1)
    least = np.maximum(rss - fitted, 1e-12)
    most = max(len(p.sizes) for p in priors)
    sizes = np.array([np.pad(p.sizes, (0, most - len(p.sizes))) for p in priors])
    weights = np.array([np.pad(p.log_weights, (0, most - len(p.sizes)), constant_values=-np.inf) for p in priors])
    terms = []
    for k in range(len(beside.scales)):
        variance = beside.scale_left(least, k)[..., None]
        for u in range(most):
            ratio = sizes[:, u, None] ** 2 / variance
            shrunk = 1.0 + values * ratio
            left = np.maximum(rss - np.sum(z**2 * ratio / shrunk, axis=-1), 1e-12)
            terms.append(weights[:, u] + beside.student(left, 0.5 * np.sum(np.log(shrunk), axis=-1), k))
    return np.asarray(np.logaddexp.reduce(terms, axis=0))
