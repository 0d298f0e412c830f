"""A set of terms in one block of rows: how probable the rows are with it, whatever sizes its amplitudes may have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.evidence import LEAST, Beside, Options, log_sum, shrunk
from hil.reconcile.search.likely_noise import DEPTH
from hil.reconcile.search.noise import Points
from hil.reconcile.search.terms import Part
from hil.reconcile.search.tied import AtBest

ROUNDS = 8
"""At most, in which the sizes of a set are improved: two are enough unless columns are nearly the same."""
CLOSE = 0.01
"""Sizes that make the rows less more probable than this (log) are not climbed to."""


@dataclass
class SetInBlock:
    """A set of terms in one block: inner products (t, k, k) and (t, k), log evidence (t,), the sizes that are best.

    `inverse` (t, k, k) turns scores into amplitudes that are free.
    """

    beside: Beside
    points: Points
    gram: FloatArray
    score: FloatArray
    owner: list[tuple[int, int]]
    options: list[Options]
    places: list[IntArray]
    members: list[int]
    terms_log: FloatArray
    best: list[int]
    slack: Sequence[FloatArray]
    variance: FloatArray
    inverse: FloatArray

    @classmethod
    def of(cls, beside: Beside, points: Points, members: Sequence[tuple[int, Part, Options, FloatArray]]) -> SetInBlock:
        """Weigh members together: their places, what they are here, their sizes, and projected columns (t, N, q)."""
        owner = [(j, int(k)) for j, part, _, _ in members for k in part.parameters]
        ends = np.cumsum([0, *(len(part.parameters) for _, part, _, _ in members)])
        columns = np.concatenate([np.zeros((*beside.residual.shape, 0)), *(own for *_, own in members)], axis=2)
        gram = np.swapaxes(columns, 1, 2) @ columns
        score = (beside.residual[:, None, :] @ columns)[:, 0]
        places = [np.arange(first, end) for first, end in pairwise(ends)]
        options = [own for _, _, own, _ in members]
        at = [j for j, *_ in members]
        unit = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), LEAST))
        both = unit[:, :, None] * unit[:, None, :]
        inverse = np.linalg.pinv(gram / both, rcond=1e-9, hermitian=True) / both
        out = cls(beside, points, gram, score, owner, options, places, at, np.zeros(0), [], [], np.zeros(0), inverse)
        out._weigh()
        return out

    def _weigh(self) -> None:
        """Sum over sizes about the best of each term: they are nearly independent given the data, and of the noise."""
        if not self.options:
            self.terms_log = self.beside.log_null()
            return
        # A large effect in quiet noise and a small one in noise that is large may both be summits: climb the higher.
        free = self._left()
        self.variance = self.beside.scale_left(free)
        with_all = log_sum(self.beside.student(free[None], np.zeros(1)))
        either = (self.beside.log_null(), with_all)
        starts = np.array([self._best_sizes(int(np.argmax(log + self.points.log_prior))) for log in either])
        heights = self._at(starts)
        first = int(np.argmax((heights + self.points.log_prior).max(axis=1)))
        self.best, self.terms_log = starts[first].tolist(), heights[first]
        every = np.array([(e, o) for e, own in enumerate(self.options) for o in range(len(own))])
        for _ in range(ROUNDS):
            t = np.array([int(np.argmax(self.terms_log + self.points.log_prior))])
            found = self._at(self._instead(every), t)[:, 0]
            of_each = [np.flatnonzero(every[:, 0] == e) for e in range(len(self.options))]
            most = np.concatenate([every[places[np.argmax(found[places])]][1:] for places in of_each])
            leaps = np.array([most, self._instead(every[[np.argmax(found)]])[0]])
            if leaps[1].tolist() == self.best:
                break
            heights = self._at(leaps)
            better = int(np.argmax((heights + self.points.log_prior).max(axis=1)))
            self.best, self.terms_log = leaps[better].tolist(), heights[better]
        while True:  # every round makes the rows likelier, and sizes are few
            near = every[np.abs(every[:, 1] - np.array(self.best)[every[:, 0]]) <= 2]
            total = self.terms_log + self.points.log_prior
            likely = np.flatnonzero(total > total.max() - DEPTH)
            found = self._at(self._instead(near), likely)
            # What is best at the point that was likeliest may not be so at another, which is likelier with it.
            heights = (found + self.points.log_prior[likely]).max(axis=1)
            if not heights.max() > total.max() + CLOSE:
                break
            choice = self._instead(near[[np.argmax(heights)]])
            self.best, (self.terms_log,) = choice[0].tolist(), self._at(choice)
        # At points that are next to impossible with these sizes, others add what they add at the likeliest.
        gain = np.tile(found[:, [np.argmax(total[likely])]] - self.terms_log[np.argmax(total)], len(self.points))
        gain[:, likely] = found - self.terms_log[likely]
        self.slack = [log_sum(gain[near[:, 0] == e]) for e in range(len(self.options))]
        self.terms_log = self.terms_log + np.sum(self.slack, axis=0)

    def _instead(self, changes: IntArray) -> IntArray:
        """Return the best sizes with one of them another, (m, e), for changes (m, 2) of a member's size."""
        out = np.tile(np.array(self.best), (len(changes), 1))
        out[np.arange(len(changes)), changes[:, 0]] = changes[:, 1]
        return out

    def _left(self) -> FloatArray:
        """Return what is left where all amplitudes are free, (t,)."""
        explained = np.einsum("tk,tkl,tl->t", self.score, self.inverse, self.score)
        return np.asarray(np.maximum(self.beside.rss - explained, LEAST))

    def _best_sizes(self, t: int) -> list[int]:
        """Return the sizes that a free fit at one point of the noise makes most probable."""
        inverse = self.inverse[t]
        fit = inverse @ self.score[t]
        freedom = max(self.beside.freedom - len(fit), 1)
        values = np.diag(inverse) * max((self.beside.rss[t] - fit @ self.score[t]) / freedom, 1e-9)
        best = []
        for own, places in zip(self.options, self.places, strict=True):
            variance = own.deviation**2 + values[places]
            misfit = np.sum((fit[places] - own.mean) ** 2 / variance + np.log(variance), axis=1)
            best.append(int(np.argmax(own.log_weights - 0.5 * misfit)))
        return best

    def prior_at(self, choices: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return log weights (o,), means (o, k) and deviations (o, k) of choices of sizes (o, e)."""
        each = list(zip(self.options, choices.T, strict=True))
        log_weights = np.sum([own.log_weights[o] for own, o in each], axis=0)
        return (
            log_weights,
            np.hstack([own.mean[o] for own, o in each]),
            np.hstack([own.deviation[o] for own, o in each]),
        )

    def _at(self, choices: IntArray, at: IntArray | slice = slice(None)) -> FloatArray:
        """Log evidence (o, t) of several choices of sizes (o, e), at some points."""
        log_weights, mean, deviation = self.prior_at(choices)
        mean, deviation = mean[:, None, :], deviation[:, None, :]
        gram, score, beside = self.gram[at], self.score[at], self.beside.at(at)
        rss = beside.rss
        if np.any(mean):
            pull = np.einsum("tpq,oxq->otp", gram, mean)
            rss, score = rss + np.sum((pull - 2.0 * score) * mean, axis=-1), score - pull
        root = deviation / np.sqrt(self.variance[:, None, at, None])
        left, half_log_det = shrunk(gram * (root[..., :, None] * root[..., None, :]), score * root, rss)
        by_point = beside.student(np.swapaxes(left, 1, 2), np.swapaxes(half_log_det, 1, 2))
        return np.asarray(log_weights[:, None] + log_sum(by_point).T)

    def by_kind(self, kinds: int) -> FloatArray:
        """Log evidence by kind of scatter, (v,), ordinary noise first."""
        total = self.terms_log + self.points.log_prior
        out = np.full(kinds + 1, -np.inf)
        np.logaddexp.at(out, self.points.kind + 1, total)
        return out

    def left_at(self, t: int) -> tuple[float, float]:
        """Return what a free fit leaves at one point, and the scale s² that it most probably means."""
        left = float(self._left()[t])
        best = int(np.argmax(self.beside.student(np.full((1, len(self.beside.rss)), left), np.zeros(1))[:, t]))
        return left, float(self.beside.scale_left(np.array(left))[best])

    def at_best(self) -> AtBest:
        """Return what the set says at its most probable point, in units of the noise there."""
        t = int(np.argmax(self.terms_log + self.points.log_prior))
        variance = float(self._left()[t]) / max(self.beside.freedom - len(self.owner), 1)
        slack = {j: float(own[t]) for j, own in zip(self.members, self.slack, strict=True)}
        scaled = (self.gram[t] / variance, self.score[t] / variance)
        return AtBest(*scaled, self.owner, self.members, self.options, self.best, slack)
