"""A set of terms in one block of rows: how probable the rows are with it, whatever sizes its amplitudes may have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.evidence import LEAST, Beside, Options, decoupled, explained, log_sum
from hil.reconcile.search.noise import Points
from hil.reconcile.search.terms import Part
from hil.reconcile.search.tied import AtBest

ROUNDS = 8
"""At most, in which the sizes of a set are improved: two are enough unless columns are nearly the same."""


@dataclass
class SetInBlock:
    """A set of terms in one block: inner products (t, k, k) and (t, k), log evidence (t,), the sizes that are best."""

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
        out = cls(beside, points, gram, score, owner, options, places, [j for j, *_ in members], np.zeros(0), [], [])
        out._weigh()
        return out

    def _weigh(self) -> None:
        """Sum over sizes about the best of each term: they are nearly independent given the data, and of the noise."""
        if not self.options:
            self.terms_log = self.beside.log_null()
            return
        # A large effect in quiet noise and a small one in noise that is large may both be summits: climb the higher.
        starts = [self._best_sizes(int(np.argmax(log + self.points.log_prior))) for log in self._with_and_without()]
        heights = self._at(starts)
        first = int(np.argmax((heights + self.points.log_prior).max(axis=1)))
        self.best, self.terms_log = starts[first], heights[first]
        for _ in range(ROUNDS):
            t = np.array([int(np.argmax(self.terms_log + self.points.log_prior))])
            tried = [(e, o) for e in self._all() for o in range(len(self.options[e]))]
            found = self._at([self._with(e, o) for e, o in tried], t)[:, 0].tolist()
            most = [max((f, o) for (i, o), f in zip(tried, found, strict=True) if i == e)[1] for e in self._all()]
            leaps = [most, self._with(*tried[int(np.argmax(found))])]
            if leaps[1] == self.best:
                break
            heights = self._at(leaps)
            better = int(np.argmax((heights + self.points.log_prior).max(axis=1)))
            self.best, self.terms_log = leaps[better], heights[better]
        tried = [(e, o) for e in self._all() for o in self._near(e)]
        found = self._at([self._with(e, o) for e, o in tried])
        of = np.array([e for e, _ in tried])
        self.slack = [log_sum(found[of == e]) - self.terms_log for e in self._all()]
        self.terms_log = self.terms_log + np.sum(self.slack, axis=0)

    def _all(self) -> range:
        return range(len(self.options))

    def _near(self, e: int) -> range:
        return range(max(0, self.best[e] - 2), min(len(self.options[e]), self.best[e] + 3))

    def _with(self, e: int, option: int) -> list[int]:
        return [*self.best[:e], option, *self.best[e + 1 :]]

    def _with_and_without(self) -> tuple[FloatArray, FloatArray]:
        """Log evidence (t,) of the base alone, and, roughly, with amplitudes that are free."""
        values, z = decoupled(self.gram, self.score)
        left = np.maximum(self.beside.rss - explained(values, z), LEAST)
        terms = [self.beside.student(left, np.zeros(len(left)), k) for k in range(len(self.beside.scales))]
        return self.beside.log_null(), log_sum(np.array(terms))

    def _best_sizes(self, t: int) -> list[int]:
        """Return the sizes that a free fit at one point of the noise makes most probable."""
        inverse = np.linalg.pinv(self.gram[t], rcond=1e-8, hermitian=True)
        fit = inverse @ self.score[t]
        freedom = max(self.beside.freedom - len(fit), 1)
        values = np.diag(inverse) * max((self.beside.rss[t] - fit @ self.score[t]) / freedom, 1e-9)
        best = []
        for own, places in zip(self.options, self.places, strict=True):
            variance = own.deviation**2 + values[places]
            misfit = np.sum((fit[places] - own.mean) ** 2 / variance + np.log(variance), axis=1)
            best.append(int(np.argmax(own.log_weights - 0.5 * misfit)))
        return best

    def prior_at(self, chosen: Sequence[int]) -> tuple[float, FloatArray, FloatArray]:
        """Return log weight, mean (k,) and deviation (k,) of a choice of sizes."""
        pairs = list(zip(self.options, chosen, strict=True))
        mean = np.concatenate([np.zeros(0), *(own.mean[o] for own, o in pairs)])
        deviation = np.concatenate([np.zeros(0), *(own.deviation[o] for own, o in pairs)])
        return float(sum(own.log_weights[o] for own, o in pairs)), mean, deviation

    def _at(self, choices: Sequence[Sequence[int]], at: IntArray | slice = slice(None)) -> FloatArray:
        """Log evidence (o, t) of several choices of sizes, at some points."""
        priors = [self.prior_at(chosen) for chosen in choices]
        mean, deviation = (np.array([p[i] for p in priors])[:, None, :] for i in (1, 2))
        gram, score, beside = self.gram[at], self.score[at], self.beside.at(at)
        rss = beside.rss
        if np.any(mean):
            pull = np.einsum("tpq,oxq->otp", gram, mean)
            rss, score = rss + np.sum((pull - 2.0 * score) * mean, axis=-1), score - pull
        scaled = gram * (deviation[..., :, None] * deviation[..., None, :])
        values, z = decoupled(scaled, score * deviation)
        least = np.maximum(rss - explained(values, z), LEAST)
        terms = []
        for k in range(len(beside.scales)):
            variance = beside.scale_left(least, k)[..., None]
            shrunk = 1.0 + values / variance
            left = np.maximum(rss - np.sum(z**2 / (variance * shrunk), axis=-1), LEAST)
            terms.append(beside.student(left.T, 0.5 * np.sum(np.log(shrunk), axis=-1).T, k).T)
        return np.asarray(np.array([p[0] for p in priors])[:, None] + log_sum(np.array(terms)))

    def by_kind(self, kinds: int) -> FloatArray:
        """Log evidence by kind of scatter, (v,), ordinary noise first."""
        total = self.terms_log + self.points.log_prior
        out = np.full(kinds + 1, -np.inf)
        np.logaddexp.at(out, self.points.kind + 1, total)
        return out

    def left_at(self, t: int) -> tuple[float, float]:
        """Return what a free fit leaves at one point, and the scale s² that it most probably means."""
        inverse = np.linalg.pinv(self.gram[t], rcond=1e-8, hermitian=True)
        left = max(float(self.beside.rss[t] - self.score[t] @ inverse @ self.score[t]), LEAST)
        scales = range(len(self.beside.scales))
        best = max(
            scales, key=lambda k: float(self.beside.student(np.full(len(self.beside.rss), left), np.zeros(1), k)[t])
        )
        return left, float(self.beside.scale_left(np.array(left), best))

    def at_best(self) -> AtBest:
        """Return what the set says at its most probable point, in units of the noise there."""
        t = int(np.argmax(self.terms_log + self.points.log_prior))
        inverse = np.linalg.pinv(self.gram[t], rcond=1e-8, hermitian=True)
        left = max(float(self.beside.rss[t] - self.score[t] @ inverse @ self.score[t]), LEAST)
        variance = left / max(self.beside.freedom - len(self.owner), 1)
        slack = {j: float(own[t]) for j, own in zip(self.members, self.slack, strict=True)}
        scaled = (self.gram[t] / variance, self.score[t] / variance)
        return AtBest(*scaled, self.owner, self.members, self.options, self.best, slack)
