"""The evidence of sets of terms in one sensor: the one function that everything else calls, and what it proposes.

search = SensorSearch(blocks, noises, terms)
search.evidence((3, 17))       # log evidence of terms 3 and 17 together, by kind of scatter and block
search.likely_sets()           # the sets that are worth anything
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.evidence import (
    HOLDS,
    LEAST,
    UNKNOWN,
    Beside,
    Group,
    decoupled,
    explained,
    log_factors,
    log_sum,
)
from hil.reconcile.search.noise import Noise, Points, joined_points
from hil.reconcile.search.terms import Term
from hil.solve.rows import Block

POINTS = 32
"""Points of the noise that a block is weighed at: what the data leave probable under any of the leading sets."""
SCANNED = 10
"""And of these, at which every term is tried: a scan proposes, and what it proposes is weighed at all."""
DEPTH = 9.0
"""Noise this much (in log probability) below the best is left out: one part in eight thousand."""
LEADING = 6
"""Terms beside which the noise is looked at anew."""
ROUNDS = 4
"""At most, in which the sizes of a set are improved: two are enough unless columns are nearly the same."""
Set = tuple[int, ...]


@dataclass
class BlockSearch:
    """One block: its rows, its noise, and the points at which it is weighed."""

    block: Block
    noise: Noise
    every: Points
    points: Points
    scales: Sequence[tuple[float, float, float]]
    y: FloatArray
    unit: float
    beside: Beside
    scanned: IntArray

    @classmethod
    def of(cls, block: Block, noise: Noise) -> BlockSearch:
        """Lay out the noise: ordinary first, then every scatter beside what of the ordinary may be."""
        unit = float(np.sqrt(noise.unit))
        y = block.y / unit
        scales = HOLDS if block.sigma_stated else UNKNOWN
        ordinary = noise.ordinary()
        beside = Beside.of(ordinary, scales, y, block.base)
        log_null = ordinary.log_prior + beside.log_null()
        good = log_null > log_null.max() - 2.0 * DEPTH
        levels, wide = np.unique(ordinary.level[good]), np.unique(ordinary.calibration[good])
        every = (
            joined_points(ordinary, noise.scattering(levels.tolist(), wide.tolist(), ordinary))
            if noise.kinds
            else ordinary
        )
        out = cls(block, noise, every, every, scales, y, unit, beside, np.zeros(0, dtype=np.int64))
        out.choose([np.zeros((len(y), 0))])
        return out

    def choose(self, extras: Sequence[FloatArray]) -> None:
        """Keep the points that are probable with one of several further columns (N, q) in the base."""
        log_null = [self._log_posterior(self.y, np.hstack([self.block.base, extra])) for extra in extras]
        self._keep(np.max([own - own.max() for own in log_null], axis=0))

    def choose_for(self, units: Sequence[FloatArray]) -> None:
        """Keep the points that are probable for one of several units, whose rates are (N,) deg/hr each."""
        log_null = [self._log_posterior(y / self.unit, self.block.base) for y in units]
        self._keep(np.max([own - own.max() for own in log_null], axis=0))

    def _log_posterior(self, y: FloatArray, base: FloatArray) -> FloatArray:
        return self.every.log_prior + Beside.of(self.every, self.scales, y, base).log_null()

    def _keep(self, best: FloatArray) -> None:
        """Keep the best points, and the quiet ones, whatever the base alone says of them."""
        quiet = (self.every.kind < 0) & (self.every.level == self.every.level.max()) & (self.every.offset < 1.0)
        quiet &= self.every.calibration == self.every.calibration[int(np.argmax(best))]
        order = np.argsort(-best)[:POINTS]
        kept = np.unique(np.concatenate([order[best[order] > -DEPTH], np.flatnonzero(quiet)]))
        self.points = self.every.take(kept)
        self.beside = Beside.of(self.points, self.scales, self.y, self.block.base)
        self.scanned = np.argsort(-best[kept])[:SCANNED]


@dataclass
class SensorSearch:
    """One sensor: what may be in it, and how probable any set of that is."""

    blocks: Sequence[BlockSearch]
    terms: list[Term]
    _known: dict[Set, list[FloatArray]] = field(default_factory=dict)
    _weighed: dict[tuple[Set, int], SetInBlock] = field(default_factory=dict)
    _laid: list[list[tuple[Group, FloatArray]]] = field(default_factory=list)

    def leading(self) -> list[int]:
        """Return the places of the terms that explain most, one of each name."""
        first: dict[str, int] = {}
        for j in np.argsort(-(self.scan(()) + self.log_odds)).tolist():
            first.setdefault(self.terms[j].name, j)
        return list(first.values())[:LEADING]

    def refine(self) -> None:
        """Choose the points of the noise anew, so that they serve the leading terms as well as the base alone."""
        leading = self.leading()
        for b, block in enumerate(self.blocks):
            parts = [self.terms[j].parts[b] for j in leading]
            block.choose([np.zeros((len(block.y), 0)), *(p.columns for p in parts if p is not None)])
        self.forget()

    def forget(self) -> None:
        """Compute everything anew from now on: the terms or the points of the noise are others."""
        self._laid, self._known, self._weighed = [], {}, {}

    @property
    def log_odds(self) -> FloatArray:
        """Log prior odds of every term, (j,)."""
        return np.array([term.log_odds for term in self.terms])

    def _groups(self) -> list[list[tuple[Group, FloatArray]]]:
        if not self._laid:
            for b, search in enumerate(self.blocks):
                factor, empty = search.points.factor[search.scanned], np.zeros((len(search.y), 0))
                columns = [empty if (p := t.parts[b]) is None else p.columns / search.unit for t in self.terms]
                groups = Group.several(columns, [t.amplitudes[b] for t in self.terms])
                self._laid.append([(group, factor @ group.columns) for group in groups])
        return self._laid

    def scan(self, given: Set) -> FloatArray:
        """Log Bayes factor of every further term beside a set, whose own amplitudes are then free, (j,)."""
        total = np.zeros(len(self.terms))
        for b, (search, groups) in enumerate(zip(self.blocks, self._groups(), strict=True)):
            points = search.points.take(search.scanned)
            own = [part.columns for j in given if (part := self.terms[j].parts[b]) is not None]
            beside = Beside.of(points, search.scales, search.y, np.hstack([search.block.base, *own]))
            by_point = log_factors(beside, groups, len(self.terms)) + points.log_prior[:, None]
            total += log_sum(by_point) - log_sum(beside.log_null() + points.log_prior)
        return total

    def evidence(self, chosen: Set) -> list[FloatArray]:
        """Log evidence of a set by block: (kinds + 1,) each, ordinary noise first, without the kinds' own odds."""
        if chosen not in self._known:
            self._known[chosen] = self._evidence(chosen)
        return self._known[chosen]

    def in_block(self, chosen: Set, b: int) -> SetInBlock:
        """Return a set weighed in one block."""
        if (chosen, b) not in self._weighed:
            self._weighed[chosen, b] = SetInBlock.of(self.blocks[b], [(j, self.terms[j]) for j in chosen], b)
        return self._weighed[chosen, b]

    def _evidence(self, chosen: Set) -> list[FloatArray]:
        out, ties = [], any(self.terms[j].ties for j in chosen)
        at: list[AtBest] = []
        for b, search in enumerate(self.blocks):
            weighed = self.in_block(chosen, b)
            out.append(weighed.by_kind(len(search.noise.kinds)))
            if ties:
                at.append(weighed.at_best())
        if ties:
            out[0] = out[0] + tied_gain(at, [j for j in chosen if self.terms[j].ties])
        return out


@dataclass
class SetInBlock:
    """A set of terms in one block: inner products at every point, and which sizes its amplitudes probably have."""

    beside: Beside
    points: Points
    gram: FloatArray
    score: FloatArray
    owner: list[tuple[int, int]]
    options: list[list[tuple[float, FloatArray, FloatArray]]]
    places: list[IntArray]
    members: list[int]
    terms_log: FloatArray
    best: list[int]
    slack: Sequence[FloatArray]

    @classmethod
    def of(cls, search: BlockSearch, members: Sequence[tuple[int, Term]], b: int) -> SetInBlock:
        """Weigh the members' parts in block `b` together."""
        columns: list[FloatArray] = []
        owner: list[tuple[int, int]] = []
        options, places, present = [], [], []
        for j, term in members:
            part = term.parts[b]
            if part is None:
                continue
            first = len(owner)
            columns.append(part.columns)
            owner += [(j, int(k)) for k in part.parameters]
            places.append(np.arange(first, len(owner)))
            present.append(j)
            options.append(
                [
                    (float(a.log_weights[u]), a.mean, a.deviation * a.sizes[u])
                    for a in term.amplitudes[b]
                    for u in range(len(a.sizes))
                ]
            )
        stacked = np.hstack([np.zeros((len(search.y), 0)), *columns])
        gram, score = search.beside.products(search.points.factor @ (stacked / search.unit))
        out = cls(search.beside, search.points, gram, score, owner, options, places, present, np.zeros(0), [], [])
        out._weigh()
        return out

    def _weigh(self) -> None:
        """Sum over sizes about the best of each term: they are nearly independent given the data."""
        if not self.options:
            self.terms_log = self.beside.log_null()
            return
        # A large effect in quiet noise and a small one in noise that is large may both be summits: climb the higher.
        starts = [self._best_sizes(int(np.argmax(log + self.points.log_prior))) for log in self._with_and_without()]
        heights = self._at(starts) + self.points.log_prior
        self.best = starts[int(np.argmax(heights.max(axis=1)))]
        for _ in range(ROUNDS):
            t = np.array([int(np.argmax(self._at([self.best])[0] + self.points.log_prior))])
            before = self.best
            for e in range(len(self.options)):
                near = self._near(e)
                self.best = self._with(e, near[int(np.argmax(self._at([self._with(e, o) for o in near], t)[:, 0]))])
            if self.best == before:
                break
        base = self._at([self.best])[0]
        self.slack = [
            log_sum(self._at([self._with(e, o) for o in self._near(e)])) - base for e in range(len(self.best))
        ]
        self.terms_log = base + np.sum(self.slack, axis=0)

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
        for options, places in zip(self.options, self.places, strict=True):
            logs = []
            for log_weight, mean, deviation in options:
                variance = deviation**2 + values[places]
                logs.append(log_weight - 0.5 * float(np.sum((fit[places] - mean) ** 2 / variance + np.log(variance))))
            best.append(int(np.argmax(logs)))
        return best

    def prior_at(self, chosen: Sequence[int]) -> tuple[float, FloatArray, FloatArray]:
        """Return log weight, mean (k,) and deviation (k,) of a choice of sizes."""
        picked = [options[o] for options, o in zip(self.options, chosen, strict=True)]
        mean, deviation = (np.concatenate([p[i] for p in picked]) for i in (1, 2))
        return sum(p[0] for p in picked), mean, deviation

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
        """Log evidence by kind of scatter, (kinds + 1,), ordinary noise first."""
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


@dataclass(frozen=True)
class AtBest:
    """A set in one block at one point of the noise: Gram (k, k), score (k,), owners, and the sizes that are best."""

    gram: FloatArray
    score: FloatArray
    owner: Sequence[tuple[int, int]]
    members: Sequence[int]
    options: Sequence[Sequence[tuple[float, FloatArray, FloatArray]]]
    best: Sequence[int]
    slack: Mapping[int, float]

    def prior(self, instead: Mapping[int, int]) -> tuple[dict[int, float], FloatArray, FloatArray]:
        """Return log weight by member, mean (k,) and deviation (k,), with other sizes for some of the members."""
        picked = [
            (j, options[instead.get(j, o)]) for j, options, o in zip(self.members, self.options, self.best, strict=True)
        ]
        mean, deviation = (np.concatenate([np.zeros(0), *(p[i] for _, p in picked)]) for i in (1, 2))
        return {j: p[0] for j, p in picked}, mean, deviation


def tied_gain(blocks: Sequence[AtBest], tied: Sequence[int]) -> float:
    """How much more probable the data are if tied parameters are one number in all blocks, not one in each (log)."""
    apart = 0.0
    for block in blocks:
        weights, mean, deviation = block.prior({})
        apart += _gaussian(block.gram, block.score - block.gram @ mean, deviation)
        apart += sum(weights.get(j, 0.0) + block.slack.get(j, 0.0) for j in tied)
    apart -= sum(max(block.slack.get(j, 0.0) for block in blocks) for j in tied)
    tried = [sorted({b.best[b.members.index(j)] for b in blocks if j in b.members}) for j in tied]
    return max(_one_number(blocks, dict(zip(tied, sizes, strict=True))) for sizes in itertools.product(*tried)) - apart


def _one_number(blocks: Sequence[AtBest], sizes: Mapping[int, int]) -> float:
    keys: dict[tuple[int, ...], int] = {}
    for b, block in enumerate(blocks):
        for j, k in block.owner:
            keys.setdefault((j, k) if j in sizes else (j, k, b), len(keys))
    gram, score, deviation = np.zeros((len(keys), len(keys))), np.zeros(len(keys)), np.zeros(len(keys))
    weight: dict[int, float] = {}
    for b, block in enumerate(blocks):
        weights, mean, own = block.prior(sizes)
        index = np.array([keys[(j, k) if j in sizes else (j, k, b)] for j, k in block.owner], dtype=np.int64)
        if len(index):
            gram[np.ix_(index, index)] += block.gram
            score[index] += block.score - block.gram @ mean
            deviation[index] = own
        weight |= {j: weights[j] for j in sizes if j in weights}
    return _gaussian(gram, score, deviation) + sum(weight.values())


def _gaussian(gram: FloatArray, score: FloatArray, deviation: FloatArray) -> float:
    """Log Bayes factor of amplitudes N(0, deviation²) against none, in units of the noise."""
    if not len(score):
        return 0.0
    scaled = np.eye(len(score)) + gram * np.multiply.outer(deviation, deviation)
    factor = np.linalg.cholesky(scaled)
    z = np.linalg.solve(factor, score * deviation)
    return float(0.5 * z @ z - np.sum(np.log(np.diag(factor))))
