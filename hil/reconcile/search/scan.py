"""How much more probable each of many candidates makes a block of rows: a scan, which proposes what is weighed."""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_array

from hil.campaign import FloatArray, IntArray
from hil.model.effects.prior import log_sum
from hil.reconcile.search.evidence import LEAST, Amplitude, Beside, student
from hil.reconcile.search.terms import Part

_NONE_LEFT = 1e-10  # of the squares of a column that nothing is beside
_AT_ONCE = 8_000  # numbers: of so few, arrays stay in the processor's own cache, and their memory with the process


@dataclass(frozen=True)
class Group:
    """Candidates with q columns each: their places (j,), and their priors, one or several of each.

    `columns` (N, j·q), in most of which most is zero, are as they were laid out; `gram` (t, j, q, q) has the products
    within each at some `points` of the noise, less what the base can do.
    `owner` (p,) is the candidate of a prior, `mean` and `deviation` are (p, q), `sizes` and `log_weights` (p, u).
    """

    places: IntArray
    columns: csc_array
    points: Sequence[Hashable]
    gram: FloatArray
    owner: IntArray
    mean: FloatArray
    deviation: FloatArray
    sizes: FloatArray
    log_weights: FloatArray

    def products(self, rows: FloatArray) -> FloatArray:
        """Return the products of rows (t, r, N) with the columns, (t, r, j·q)."""
        return np.asarray(rows.reshape(-1, rows.shape[2]) @ self.columns).reshape(*rows.shape[:2], -1)

    def at(
        self, points: Sequence[Hashable], project: Callable[[FloatArray, IntArray], FloatArray], at_once: int
    ) -> "Group":
        """Return the same at some points: what is known of them stays.

        `project` takes so many columns `at_once` to what they are at those of some places.
        """
        if points == self.points:
            return self
        gram, size = np.empty((len(points), *self.gram.shape[1:])), self.gram.shape[2]
        known = [place for place, point in enumerate(points) if point in self.points]
        gram[known] = self.gram[[self.points.index(points[place]) for place in known]]
        new, step = np.setdiff1d(np.arange(len(points)), known), max(1, at_once // size)
        for first in range(0, len(self.places) * bool(len(new)), step):
            few = self.columns[:, first * size : (first + step) * size].toarray()
            gram[new, first : first + step] = _grams(project(few, new), size)
        return replace(self, points=points, gram=gram)

    @classmethod
    def several(
        cls, parts: Sequence[Part | None], amplitudes: Sequence[Sequence[Amplitude]], first: int
    ) -> Iterator["Group"]:
        """Group candidates by how many columns they have in a block, at no points; those of none are in no group.

        `first` is the place of the first.
        """
        sizes = np.array([0 if part is None else len(part.parameters) for part in parts])
        for q in sorted(set(sizes.tolist()) - {0}):
            places = np.flatnonzero(sizes == q)
            priors = [(j, prior) for j, place in enumerate(places.tolist()) for prior in amplitudes[place]]
            most = max(len(prior.sizes) for _, prior in priors)
            tried, weights = np.zeros((len(priors), most)), np.full((len(priors), most), -np.inf)
            for i, (_, prior) in enumerate(priors):
                tried[i, : len(prior.sizes)], weights[i, : len(prior.sizes)] = prior.sizes, prior.log_weights
            own = [part for place in places.tolist() if (part := parts[place]) is not None]
            values = np.concatenate([part.values.T.ravel() for part in own])
            rows = np.concatenate([np.tile(part.rows, q) for part in own])
            ends = np.cumsum([0, *np.repeat([len(part.rows) for part in own], q)], dtype=np.int32)
            columns = csc_array((values, rows.astype(np.int32), ends), (own[0].many, len(ends) - 1))
            columns.eliminate_zeros()
            gram, owner = np.zeros((0, len(places), q, q)), np.array([j for j, _ in priors])
            mean, deviation = (np.array([getattr(prior, of) for _, prior in priors]) for of in ("mean", "deviation"))
            yield cls(places + first, columns, (), gram, owner, mean, deviation, tried, weights)


def log_factors(
    beside: Beside, groups: Sequence[Group], products: Sequence[tuple[FloatArray, FloatArray]], count: int
) -> FloatArray:
    """Log evidence of each of `count` candidates at every point in m data, (t, m, count), the point's prior apart.

    `products` are by group those of its columns with the residuals of the data, (t, m, j·q), of which the squares are
    (t, m), and with what `beside` has more than the base that candidates were laid out with, (t, a, j·q).
    """
    out = np.repeat(beside.log_null()[..., None], count, axis=-1)
    for own, (score, shared) in zip(groups, products, strict=True):
        size = own.gram.shape[2]
        score, gram = score.reshape(*beside.rss.shape, -1, size), own.gram - _grams(shared, size)
        terms = _weighed(beside, gram[:, None, own.owner], score[..., own.owner, :], own)
        if len(own.owner) > len(own.places):
            terms = np.stack(
                [np.logaddexp.reduce(terms[..., own.owner == j], axis=-1) for j in range(len(own.places))], -1
            )
        out[..., own.places] = terms
    return out


def _grams(columns: FloatArray, size: int) -> FloatArray:
    """Inner products within each of several candidates of `size` columns, (t, j, q, q) of (t, N, j·q)."""
    points, rows, wide = columns.shape
    if size == 1:
        return np.asarray(np.einsum("tnk,tnk->tk", columns, columns)[:, :, None, None])
    apart = np.ascontiguousarray(columns.reshape(points, rows, wide // size, size).transpose(0, 2, 1, 3))
    return np.asarray(np.swapaxes(apart, 2, 3) @ apart)


def _weighed(beside: Beside, gram: FloatArray, score: FloatArray, group: Group) -> FloatArray:
    """Log evidence (t, m, p) of columns given Gram (t, 1, p, q, q) and score (t, m, p, q), for each of p priors."""
    mean, deviation = group.mean, group.deviation
    pull = np.einsum("...jpq,jq->...jp", gram, mean)
    rss = beside.rss[..., None] + np.einsum("...jq,jq->...j", pull - 2.0 * score, mean)
    score = score - pull
    gram, z = gram * (deviation[:, :, None] * deviation[:, None, :]), score * deviation
    if gram.shape[-1] == 1:
        values = np.maximum(gram[..., 0], 0.0)
    else:
        values, axes = np.linalg.eigh(gram)
        values, z = np.maximum(values, 0.0), np.einsum("...qk,...q->...k", axes, z)
    # Axes first: a sum over few numbers that lie side by side takes many times as long as one of whole arrays.
    values, squares = (np.ascontiguousarray(np.moveaxis(own, -1, 0)) for own in (values, z**2))
    # Of a direction of which nothing is left beside what is given, only rounding is.
    whole = np.diagonal(group.gram, axis1=2, axis2=3)[:, group.owner] * deviation**2
    usable = values > _NONE_LEFT * whole.max(axis=2)[:, None]
    squares = np.where(usable, squares, 0.0)
    explained = np.sum(squares / np.where(usable, values, 1.0), axis=0)
    variance, terms = beside.scale_left(np.maximum(rss - explained, LEAST)), []
    step = max(1, _AT_ONCE // variance.size)
    for first in range(0, group.sizes.shape[1], step):
        size, log_weight = (own.T[first : first + step, None, None] for own in (group.sizes, group.log_weights))
        ratio, left, shrunk = size**2 / variance[:, None], rss, np.ones(1)
        for value, square in zip(values, squares, strict=True):  # (s, u, t, m, p) from now on
            own = 1.0 + value * ratio
            left, shrunk = left - square * ratio / own, shrunk * own
        log_base = beside.log_base[:, None, None] + log_weight - 0.5 * np.log(shrunk)
        by_size = student(np.maximum(left, LEAST), log_base, beside.scales, beside.freedom)
        terms.append(by_size.reshape(-1, *rss.shape))
    return log_sum(np.concatenate(terms))
