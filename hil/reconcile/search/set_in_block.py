"""Sets of terms in one block of rows: how probable the rows are with each, whatever sizes its amplitudes may have.

Inner products of all columns that are asked about are taken once. A set is a choice of columns, and sets are weighed
side by side: one of fewer columns than another is filled up with a column of zeros, which changes nothing.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from types import MappingProxyType

import numpy as np

from hil.campaign import BoolArray, FloatArray, IntArray
from hil.model.effects.prior import log_sum
from hil.reconcile.search.evidence import LEAST, Beside, Inner, Member, Options, bordered, eliminated, student, swept
from hil.reconcile.search.likely_noise import DEPTH
from hil.reconcile.search.noise import LARGEST
from hil.reconcile.search.points import Points

CLOSE = 0.01
"""What makes the rows less more probable than this (log) is not climbed to."""
ABOUT = np.arange(-2, 3)  # steps of a size about the best that are summed over
_FREE = 1e6  # times what makes a column as large as the noise: as good as free, and no combination of columns is none
_ALIKE = 4  # columns by which sets that are weighed side by side may differ


@dataclass(frozen=True)
class SetInBlock:
    """A set of terms, by place, in one block: inner products (t, k, k) and (t, k), log evidence (t,), the best sizes.

    `left` (t,) is what a free fit leaves, `slack` (t,) by member what its other sizes add.
    """

    beside: Beside
    points: Points
    members: tuple[int, ...]
    owner: list[tuple[int, int]]
    options: list[Options]
    gram: FloatArray
    score: FloatArray
    left: FloatArray
    terms_log: FloatArray
    best: list[int]
    slack: Sequence[FloatArray]

    def prior(self, instead: Mapping[int, int] = MappingProxyType({})) -> tuple[FloatArray, FloatArray]:
        """Return the means (k,) and deviations (k,) of the amplitudes at the best sizes, or others of some members."""
        at = [(own, instead.get(j, o)) for j, own, o in zip(self.members, self.options, self.best, strict=True)]
        none = np.zeros(0)
        mean, deviation = ([none, *(getattr(own, of)[o] for own, o in at)] for of in ("mean", "deviation"))
        return np.concatenate(mean), np.concatenate(deviation)

    def by_sort(self, sorts: int) -> FloatArray:
        """Log evidence by what scatters, (u,), ordinary noise first."""
        total = self.terms_log + self.points.log_prior
        out = np.full(sorts, -np.inf)
        np.logaddexp.at(out, self.points.sort, total)
        return out

    @cached_property
    def scales_left(self) -> FloatArray:
        """The scale s² that what a free fit leaves most probably means, at every point, (t,)."""
        likeliest = np.argmax(self.beside.student(self.left[None]), axis=0)
        return np.asarray(np.take_along_axis(self.beside.scale_left(self.left), likeliest[None], axis=0)[0])

    def noise_where(self, left: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how probable rows are of which `left` (m, t) is left (log), and how far each point counts, (m, t).

        That is how probable the point then is, over the scale s² that it then has.
        """
        beside = self.beside
        log = student(left[None], beside.log_base, beside.scales, beside.freedom) + self.points.log_prior
        whole = log_sum(np.moveaxis(log, 2, 1).reshape(-1, len(left)))
        return whole, np.sum(np.exp(log - whole[:, None]) / beside.scale_left(left), axis=0)

    @property
    def slack_at_best(self) -> list[float]:
        """What other sizes of each member add at the most probable point."""
        t = int(np.argmax(self.terms_log + self.points.log_prior))
        return [float(own[t]) for own in self.slack]


def weigh_in_block(
    beside: Beside, points: Points, terms: Mapping[int, Member], sets: Sequence[tuple[int, ...]]
) -> Iterator[SetInBlock]:
    """Yield sets of some of the terms weighed in one block."""
    inner = Inner.of(beside, terms)

    def size(chosen: tuple[int, ...]) -> int:
        return -(-sum(len(inner.places[j]) for j in chosen) // _ALIKE)

    for wide, alike in groupby(sorted(sets, key=size), size):
        own = list(alike)
        most = max(1, int(LARGEST / (len(points) * (_ALIKE * wide + 1) ** 2 * 2 * max(1, *map(len, own)))))
        for first in range(0, len(own), most):
            yield from Sets(beside, points, terms, own[first : first + most], inner).weighed()


class Sets:
    """Sets (m,) of e members and k columns at most, side by side, in one block."""

    def __init__(
        self,
        beside: Beside,
        points: Points,
        terms: Mapping[int, Member],
        sets: Sequence[tuple[int, ...]],
        inner: Inner,
    ) -> None:
        self.beside, self.points, self.terms, self.sets = beside, points, terms, sets
        gram, score, places = inner.gram, inner.score, inner.places
        columns = [np.concatenate([np.zeros(0, dtype=np.int64), *(places[j] for j in s)]) for s in sets]
        members, wide = max(1, *(len(s) for s in sets)), max(1, *(len(c) for c in columns))
        used = list(dict.fromkeys(j for s in sets for j in s))
        none, zeros = len(used), score.shape[1] - 1
        of = np.array([[*(used.index(j) for j in s), *[none] * (members - len(s))] for s in sets], dtype=np.int64)
        filled = np.array([[*c, *[zeros] * (wide - len(c))] for c in columns], dtype=np.int64)
        # Of every size of every term, and of one more that has no columns: log weight, means and deviations.
        most = max((len(terms[j].options) for j in used), default=1)
        log_weights = np.full((none + 1, most), -np.inf)
        mean, deviation = np.zeros((2, none + 1, most, zeros + 1))
        log_weights[none, 0] = 0.0
        for i, j in enumerate(used):
            own = terms[j].options
            log_weights[i, : len(own)] = own.log_weights
            mean[i, : len(own), places[j]] = own.mean.T
            # None is nothing: what others leave of an amplitude is told in units of it.
            largest = np.max(own.deviation + np.abs(own.mean), axis=0)
            deviation[i, : len(own), places[j]] = np.maximum(own.deviation, LEAST * largest).T
        at = of[:, :, None], slice(None), filled[:, None, :]
        self.log_weights, self.known = log_weights[of], np.isfinite(log_weights[of])  # (m, e, o)
        self.mean, self.deviation = (np.moveaxis(own[at], 3, 2) for own in (mean, deviation))  # (m, e, o, k)
        self.has_means = bool(np.any(self.mean))
        # How many columns each member has, (m, e), and the first of them.
        self.width = np.array([*(len(places[j]) for j in used), 0])[of]
        self.first = np.cumsum(self.width, axis=1) - self.width
        self.gram = np.ascontiguousarray(np.moveaxis(gram, 0, 2)[filled.T[:, None], filled.T])  # (k, k, m, t)
        self.score = np.ascontiguousarray(np.moveaxis(score, 0, 1)[filled.T])
        self.unit = np.sqrt(np.maximum(np.einsum("kkmt->kmt", self.gram), LEAST))
        far = _FREE / self.unit
        left, _ = eliminated(bordered(self.gram * (far[:, None] * far), self.score * far, beside.rss))
        self.left = np.maximum(left, LEAST)
        self.variance = beside.scale_left(self.left)
        self.each = np.arange(len(sets))
        shape = (wide + 1, *self.variance.shape)
        self.held, self.less, self.half_log_det = np.empty((wide + 1, *shape)), np.empty(shape), np.empty(shape[1:])

    def weighed(self) -> Iterator[SetInBlock]:
        """Sum over sizes about the best of each term: they are nearly independent given the data, and of the noise."""
        best, heights, near, found = self._climbed()
        total = heights + self.points.log_prior
        likely, first = total > total.max(axis=1, keepdims=True) - DEPTH, np.argmax(total, axis=1)
        gain = found - heights[:, None, None, :]
        # At points that are next to impossible with these sizes, others add what they add at the likeliest.
        usual = gain[self.each, :, :, first][..., None]
        gain = np.where(likely[:, None, None, :] | ~near[..., None], gain, usual)
        slack = log_sum(np.moveaxis(gain, 2, 0))
        for m, chosen in enumerate(self.sets):
            own = [self.terms[j] for j in chosen]
            owner = [(j, int(k)) for j, term in zip(chosen, own, strict=True) for k in term.parameters]
            k, e = len(owner), len(chosen)
            inner = np.moveaxis(self.gram[:k, :k, m], 2, 0), self.score[:k, m].T, self.left[m]
            log = heights[m] + np.sum(slack[m, :e], axis=0), best[m, :e].tolist(), list(slack[m, :e])
            yield SetInBlock(self.beside, self.points, chosen, owner, [term.options for term in own], *inner, *log)

    def _climbed(self) -> tuple[IntArray, FloatArray, BoolArray, FloatArray]:
        """Return the best sizes (m, e), the log evidence with these (m, t), and what is about them."""
        prior, climbing = self.points.log_prior, self.each
        free = np.argmax(log_sum(self._student(self.left[None])) + prior, axis=1)
        best = self.best_sizes(free)
        heights = self.hold(self.each, best)
        near, about = self._about(self.each, best, heights)
        still = climbing[:0]
        while len(
            some := climbing if len(climbing) else still
        ):  # every round makes the rows likelier, and sizes are few
            least = (heights[some] + prior).max(axis=1) + CLOSE
            if len(climbing):
                highest = (about[some] + prior).max(axis=3)
                (e, step), top = _most(highest), highest.max(axis=(1, 2))
                size, still = best[some, e] + ABOUT[step], np.append(still, some[top <= least])
            else:  # what is best at the point that was likeliest may not be so at another, which is likelier with it
                (e, size, top), still = self._farther(some, best, (np.argmax(heights + prior, axis=1), free)), still[:0]
            climbing, e, size = (each[top > least] for each in (some, e, size))
            best[climbing, e] = size
            if len(climbing):
                heights[climbing] = self.hold(climbing, best[climbing])
                near[climbing], about[climbing] = self._about(climbing, best, heights)
        return best, heights, near, about

    def _farther(self, some: IntArray, best: IntArray, at: Iterable[IntArray]) -> tuple[IntArray, IntArray, FloatArray]:
        """Return which member of some sets is best at which of all its sizes, `at` points (m,), and how, (s,) each."""
        _, i, e = (part.ravel() for part in np.indices((2, *best[some].shape)))
        sets, t = some[i], np.concatenate([of[some[i[: len(i) // 2]]] for of in at])
        every = np.repeat(np.arange(self.known.shape[2])[:, None], len(i), axis=1)
        each = self.instead(sets, e, best, every, t) + self.points.log_prior[t]
        found = np.moveaxis(each.reshape(len(every), 2, *best[some].shape).max(axis=1), 0, 2)
        return *_most(found), found.max(axis=(1, 2))

    def _about(self, sets: IntArray, best: IntArray, heights: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Return which sizes about the best there are in some sets, (s, e, a), and the log evidence with each in turn.

        That is (s, e, a, t), at points that are likely with the best; elsewhere minus infinity.
        """
        sizes = best[sets][:, :, None] + ABOUT
        inside = (sizes >= 0) & (sizes < self.known.shape[2])
        sizes = np.where(inside, sizes, 0)
        near = inside & np.take_along_axis(self.known[sets], sizes, axis=2)
        total = heights[sets] + self.points.log_prior
        likely = total > total.max(axis=1, keepdims=True) - DEPTH
        i, e, t = np.nonzero(likely[:, None] & near.any(axis=2)[..., None])
        found = np.full((*near.shape, len(self.points)), -np.inf)
        found[i, e, :, t] = np.where(near[i, e], self.instead(sets[i], e, best, sizes[i, e].T, t).T, -np.inf)
        return near, found

    def _student(self, left: FloatArray, at: IntArray | slice = slice(None)) -> FloatArray:
        return student(left, self.beside.log_base[at], self.beside.scales, self.beside.freedom)

    def best_sizes(self, t: IntArray) -> IntArray:
        """Return the sizes (m, e) that a free fit at one point of the noise (m,) makes most probable."""
        unit = self.unit[:, self.each, t].T
        both, here = unit[:, :, None] * unit[:, None], np.moveaxis(self.gram[:, :, self.each, t], 2, 0)
        inverse = np.linalg.pinv(here / both, rcond=1e-9, hermitian=True) / both
        fit = np.einsum("mkl,lm->mk", inverse, self.score[:, self.each, t])
        left = self.left[self.each, t] / np.maximum(self.beside.freedom - self.width.sum(axis=1), 1)
        values = np.einsum("mkk->mk", inverse) * np.maximum(left, 1e-9)[:, None]
        variance = self.deviation**2 + values[:, None, None]
        own = np.any(self.deviation > 0.0, axis=2, keepdims=True)
        variance = np.where(own, variance, 1.0)
        misfit = np.where(own, (fit[:, None, None, :] - self.mean) ** 2, 0.0) / variance + np.log(variance)
        return np.asarray(np.argmax(self.log_weights - 0.5 * np.sum(misfit, axis=3), axis=2))

    def hold(self, sets: IntArray, choices: IntArray) -> FloatArray:
        """Return the log evidence (s, t) of some sets (s,) with choices of sizes (s, e), and keep what others cost."""
        member = sets[:, None], np.arange(choices.shape[1]), choices
        deviation, mean = (own[member].sum(axis=1).T for own in (self.deviation, self.mean))
        gram, score, rss = self.gram[:, :, sets], self.score[:, sets], self.beside.rss
        if self.has_means:
            pull = np.sum(gram * mean[..., None], axis=1)
            rss, score = rss + np.sum((pull - 2.0 * score) * mean[..., None], axis=0), score - pull
        root = deviation[:, None, :, None] / np.sqrt(self.variance[:, sets])
        held = bordered(gram[:, :, None] * (root[:, None] * root), score[:, None] * root, rss)
        less = np.concatenate([np.einsum("kkst->kst", gram)[:, None] * root**2, held[-1:, -1]])
        half_log_det = swept(held, less, len(root))
        self.held[:, :, :, sets], self.less[:, :, sets], self.half_log_det[:, sets] = held, less, half_log_det
        log = log_sum(self._student(held[-1, -1]) - half_log_det)
        return np.asarray(self.log_weights[member].sum(axis=1)[:, None] + log)

    def instead(self, sets: IntArray, e: IntArray, best: IntArray, sizes: IntArray, t: IntArray) -> FloatArray:
        """Return the log evidence (a, n) of sets (n,), each at a point (n,), with other sizes (a, n) of a member (n,).

        All others have the best sizes (m, e), as they are held: what these leave is a matrix of the size of a member.
        """
        out, (m, j), wide = np.empty(sizes.shape), (sets, e), self.width[sets, e]
        here = np.take_along_axis(self.log_weights, best[..., None], axis=2)[..., 0]
        others = here.sum(axis=1)[m] - here[m, j] + self.log_weights[m, j, sizes]
        for size in np.unique(wide).tolist():
            n = np.flatnonzero(wide == size)
            (m, j), at, own = (sets[n], e[n]), t[n], self.first[sets[n], e[n]] + np.arange(size)[:, None]
            both, scale = np.vstack([own, np.full(len(n), -1)]), np.arange(len(self.variance))[:, None]
            inner = self.held[both[:, None, None], both[:, None], scale, m, at]
            less = self.less[both[:, None], scale, m, at]
            half_log_det = self.half_log_det[:, m, at] + swept(inner, less, size)
            inner[range(size), range(size)] = less[:size]
            gram, score, rss = inner[:size, :size, :, None], -inner[:size, -1, :, None], inner[-1, -1, :, None]
            was, now = self.deviation[m, j, best[m, j], own], self.deviation[m, j, sizes[:, n], own[:, None]]
            root = (now / was[:, None])[:, None]
            if self.has_means:
                mean = self.mean[m, j, sizes[:, n], own[:, None]] - self.mean[m, j, best[m, j], own][:, None]
                mean = (mean / was[:, None])[:, None] * np.sqrt(self.variance[:, m, at])[:, None]
                pull = np.sum(gram * mean, axis=1)
                rss, score = rss + np.sum((pull - 2.0 * score) * mean, axis=0), score - pull
            left, more = eliminated(bordered(gram * (root[:, None] * root), score * root, rss))
            out[:, n] = log_sum(self._student(left, at) - half_log_det[:, None] - more)
        return np.asarray(out + others)


def _most(found: FloatArray) -> tuple[IntArray, IntArray]:
    """Return in which member (m,), and at which of its sizes (m,), each of (m, e, o) is highest."""
    sets, members, sizes = found.shape
    highest = np.argmax(found.reshape(sets, members * sizes), axis=1)
    member, size = np.divmod(highest, sizes)
    return np.asarray(member), np.asarray(size)
