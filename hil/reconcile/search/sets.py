"""The evidence of sets of terms in one sensor: the one function that everything else calls, and what it proposes.

search = SensorSearch(blocks, noises, terms)
search.evidence((3, 17))       # log evidence of terms 3 and 17 together, by kind of scatter and block
search.likely_sets()           # the sets that are worth anything
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.evidence import (
    HOLDS,
    UNKNOWN,
    Beside,
    Group,
    log_factors,
    log_sum,
)
from hil.reconcile.search.noise import Noise, Points, joined_points
from hil.reconcile.search.set_in_block import SetInBlock
from hil.reconcile.search.terms import Term
from hil.reconcile.search.tied import AtBest, tied_gain
from hil.solve.rows import Block

POINTS = 32
"""Points of the noise that a block is weighed at: what the data leave probable under any of the leading sets."""
SCANNED = 10
"""And of these, at which every term is tried: a scan proposes, and what it proposes is weighed at all."""
DEPTH = 9.0
"""Noise this much (in log probability) below the best is left out: one part in eight thousand."""
LEADING = 6
"""Terms beside which the noise is looked at anew."""
Set = tuple[int, ...]


@dataclass
class BlockSearch:
    """One block: its rows `y` (N,) in units of its noise, the points at which it is weighed, those scanned (t,)."""

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
        some = ordinary.take(np.flatnonzero(good))
        every = joined_points(ordinary, noise.scattering(some)) if noise.kinds else ordinary
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
        """Log evidence of a set by block: (v,) each, ordinary noise first, without the kinds' own odds."""
        if chosen not in self._known:
            self._known[chosen] = self._evidence(chosen)
        return self._known[chosen]

    def in_block(self, chosen: Set, b: int) -> SetInBlock:
        """Return a set weighed in one block."""
        own = self.blocks[b]
        if (chosen, b) not in self._weighed:
            self._weighed[chosen, b] = SetInBlock.of(
                own.beside, own.points, own.unit, [(j, self.terms[j]) for j in chosen], b
            )
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
