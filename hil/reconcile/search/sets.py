"""The evidence of sets of terms in one sensor: the one function that everything else calls, and what it proposes."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, combinations, pairwise
from math import log

import numpy as np

from hil.campaign import FloatArray
from hil.model.effects.prior import log_sum
from hil.reconcile.search.block_search import BlockSearch
from hil.reconcile.search.evidence import LEAST, Beside, Member, Options
from hil.reconcile.search.noise import LARGEST
from hil.reconcile.search.scan import Group, log_factors
from hil.reconcile.search.set_in_block import SetInBlock, weigh_in_block
from hil.reconcile.search.terms import Term
from hil.reconcile.search.tied import tied_gains
from hil.solve.causes import made_again
from hil.solve.identifiability import orthonormal, project_out

LEADING = 18
"""Terms beside which the noise is looked at anew."""
Set = tuple[int, ...]


@dataclass
class SensorSearch:
    """One sensor: what may be in it, and how probable any set of that is. Sets grow from none, and from `starts`."""

    blocks: Sequence[BlockSearch]
    terms: list[Term]
    starts: Sequence[Set] = ()
    _known: dict[Set, list[FloatArray]] = field(default_factory=dict)
    _weighed: dict[tuple[Set, int], SetInBlock] = field(default_factory=dict)
    _laid: list[list[Group]] = field(default_factory=list)
    _scannable: int = 0
    _placed: int = 0
    _found: dict[object, list[int]] = field(default_factory=dict)
    _members: dict[tuple[int, int], Member] = field(default_factory=dict)
    _shown: dict[tuple[int | None, int], list[FloatArray]] = field(default_factory=dict)
    _scanned: dict[Set, FloatArray] = field(default_factory=dict)

    def leading(self, given: Set = ()) -> list[int]:
        """Return the places of the terms that explain most beside a set, one of each name."""
        first: dict[str, int] = {}
        for j in np.argsort(-(self.scan(given) + self.log_odds)).tolist():
            first.setdefault(self.terms[j].name, j)
        return list(first.values())[:LEADING]

    def refine(self) -> None:
        """Choose the points of the noise anew, so that they serve leading terms as well as the base alone.

        And the likeliest two together, because what a wrong row hides of the noise another term may hide as well.
        """
        asked: list[Set] = [(j,) for j in self.leading()]
        asked += [(*first, *self.leading(first)[:1]) for first in asked[:1]]
        asked += self.starts
        self._weigh_anew()
        for b, block in enumerate(self.blocks):
            beside = [self.columns(each, b) for each in asked]
            block.choose([self.columns((), b), *(own for own in beside if own.shape[1])])

    def serve(self, sets: Sequence[Set]) -> None:
        """Add the points of the noise that are probable beside some sets.

        And quieter ones: a further term may explain what is taken for noise beside the first.
        """
        self._weigh_anew()
        for b, block in enumerate(self.blocks):
            block.add([self.columns(each, b) for each in sets])

    def columns(self, chosen: Set, b: int) -> FloatArray:
        """Return the columns (N, q) of a set in a block."""
        own = [p.columns for j in chosen if (p := self.terms[j].parts[b])]
        return np.hstack([np.zeros((len(self.blocks[b].y), 0)), *own])

    def explained(self, places: Sequence[int], given: Set) -> FloatArray:
        """Return the squares that terms (t,) take of what the base and a set leave, in white noise, (t,)."""
        out = np.zeros(len(places))
        for b, search in enumerate(self.blocks):
            block, free = search.block, [search.block.base, self.columns(given, b)]
            free += [block.at_each_temperature(block.values)] * search.noise.calibrated
            basis = orthonormal(np.hstack(free))
            left = project_out(basis, block.y[:, None])[:, 0] / float(np.mean(block.sigma))
            parts = {t: part.columns for t, j in enumerate(places) if (part := self.terms[j].parts[b]) is not None}
            for wide in {own.shape[1] for own in parts.values()}:
                here = [t for t, own in parts.items() if own.shape[1] == wide]
                own = orthonormal(project_out(basis, np.array([parts[t] for t in here])))
                out[here] += np.sum((left @ own) ** 2, axis=1)
        return out

    def forget(self) -> None:
        """Compute everything anew from now on: the terms, the data or the points of the noise are others."""
        self._laid, self._scannable, self._placed, self._found = [], 0, 0, {}
        self._weigh_anew()

    def _weigh_anew(self) -> None:
        self._known, self._weighed, self._members, self._shown, self._scanned = {}, {}, {}, {}, {}

    @property
    def log_odds(self) -> FloatArray:
        """Log prior odds of every term, (j,)."""
        return np.array([term.log_odds for term in self.terms])

    def odds_beside(self, given: Set) -> FloatArray:
        """Log prior odds of every term, (j,), beside a set: what happened once happened again more probably."""
        out = self.log_odds
        for event, times in Counter(event for j in given if (event := self.terms[j].event) is not None).items():
            of = self.events[event]
            out[of] = np.maximum(out[of], self._again(event, times + 1))
        return out

    def priced(self, chosen: Set) -> list[float]:
        """Return the log prior odds of each term of a set, beside those before it."""
        out, before = [], Counter[object]()
        for term in (self.terms[j] for j in chosen):
            out.append(term.log_odds)
            if term.event is not None:
                before[term.event] += 1
                out[-1] = max(term.log_odds, self._again(term.event, before[term.event]))
        return out

    def _again(self, event: object, times: int) -> float:
        """Return the log odds that an event happened once more, the `times`-th time: never everywhere."""
        places = len(self.events[event])
        return made_again(times, places) if 1 < times < places else -np.inf

    @property
    def events(self) -> dict[object, list[int]]:
        """The places of the terms that are one event, by what it is: of those that came since, too."""
        for j in range(self._placed, len(self.terms)):
            if (event := self.terms[j].event) is not None:
                self._found.setdefault(event, []).append(j)
        self._placed = len(self.terms)
        return self._found

    def _groups(self) -> list[list[Group]]:
        """Return what is scanned, by block: what came since the last time is laid out beside what was."""
        self._laid = self._laid or [[] for _ in self.blocks]
        first, self._scannable = self._scannable, len(self.terms)
        new = self.terms[first:]
        for b, search in enumerate(self.blocks):
            parts, amplitudes = ([getattr(term, of)[b] for term in new] for of in ("parts", "amplitudes"))
            every = [*self._laid[b], *Group.several(parts, amplitudes, first)]
            points = search.points.take(search.scanned).told_by
            at_once = LARGEST // max(len(search.scanned) * len(search.y), 1)
            self._laid[b] = [group.at(points, search.scanned_columns, at_once) for group in every]
        return self._laid

    def _products(self, b: int, j: int | None) -> list[FloatArray]:
        """Return what a term (or the data) has in common with what is scanned in a block, by group, (t, q, j·q)."""
        search, known = self.blocks[b], self._shown.setdefault((j, b), [])
        if new := self._laid[b][len(known) :]:
            at = search.scanned
            own = search.beside.residual[at][:, None] if j is None else np.swapaxes(self.member(j, b).columns[at], 1, 2)
            pulled = search.pulled(own, at)
            known += [group.products(pulled) for group in new]
        return known

    def scan(self, given: Set) -> FloatArray:
        """Log Bayes factor of every further term beside a set, whose own amplitudes are then free, (j,)."""
        known = self._scanned.get(given)
        if known is not None and len(known) == len(self.terms):
            return known
        total = self._scanned[given] = np.zeros(len(self.terms))
        for b, (search, groups) in enumerate(zip(self.blocks, self._groups(), strict=True)):
            base, here = search.beside.at(search.scanned), [j for j in given if self.terms[j].parts[b]]
            products = [(score, score[:, :0]) for score in self._products(b, None)]
            beside = base
            if here:
                beside = base.beside(np.concatenate([self.member(j, b).columns[search.scanned] for j in here], axis=2))
                added = beside.basis[:, :, base.basis.shape[2] :]
                taken = base.residual[:, None] @ added
                of_members = zip(*(self._products(b, j) for j in here), strict=True)
                shared = [np.swapaxes(beside.turn, 1, 2) @ np.concatenate(own, axis=1) for own in of_members]
                products = [(score - taken @ own, own) for (score, _), own in zip(products, shared, strict=True)]
            total += self._factors(search, groups, beside, beside.rss[:, None], products)[0]
        return total

    def scan_many(self, data: Sequence[FloatArray], most: int | None = None) -> FloatArray:
        """Log Bayes factor of every term beside the base in other data: (j, m) of rates (N, m), deg/hr, by block.

        At the points that are scanned, or the first `most` of them.
        """
        total = np.zeros((data[0].shape[1], len(self.terms)))
        for search, groups, rates in zip(self.blocks, self._groups(), data, strict=True):
            at = search.scanned[:most]
            residual = np.ascontiguousarray(np.swapaxes(search.projected(rates, at), 1, 2))
            first, pulled = [replace(each, gram=each.gram[:most]) for each in groups], search.pulled(residual, at)
            products = [(score := each.products(pulled), score[:, :0]) for each in groups]
            squares = np.sum(residual**2, axis=2)
            total += self._factors(search, first, search.beside.at(at), squares, products)
        return total.T

    def _factors(
        self,
        search: BlockSearch,
        groups: Sequence[Group],
        beside: Beside,
        squares: FloatArray,
        products: Sequence[tuple[FloatArray, FloatArray]],
    ) -> FloatArray:
        """Log Bayes factor in one block, (m, j), of data of which the base and what is added leave `squares` (t, m)."""
        own = replace(beside, rss=np.maximum(squares, LEAST))
        log_prior = search.points.log_prior[search.scanned[: len(squares)]][:, None]
        found, null = log_factors(own, groups, products, len(self.terms)), own.log_null()
        absent = np.array([term.absent for term in self.terms])
        may = np.flatnonzero(absent)
        found[..., may] = np.logaddexp(
            np.log(1.0 - absent[may]) + found[..., may], np.log(absent[may]) + null[..., None]
        )
        return np.asarray(log_sum(found + log_prior[..., None]) - log_sum(null + log_prior)[:, None])

    def evidence(self, sets: Sequence[Set]) -> list[list[FloatArray]]:
        """Log evidence of sets by block: (u,) each, of what scatters, without the odds of that."""
        if new := [chosen for chosen in dict.fromkeys(sets) if chosen not in self._known]:
            self._known |= zip(new, self._evidence(new), strict=True)
        return [self._known[chosen] for chosen in sets]

    def weigh(self, sets: Iterable[Set]) -> None:
        """Weigh several sets in every block, all at once: what they are made of is laid out, and weighed, once."""
        sets = [each for own in sets for each in (self._untied(own), *(part for part, _ in self._in_part(own)))]
        for b, own in enumerate(self.blocks):
            new = dict.fromkeys(here for chosen in sets if ((here := self._here(chosen, b)), b) not in self._weighed)
            members = self._members_of({j for here in new for j in here}, b)
            for weighed in weigh_in_block(own.beside, own.points, members, list(new)) if new else ():
                self._weighed[weighed.members, b] = weighed

    def in_block(self, chosen: Set, b: int) -> SetInBlock:
        """Return a set weighed in one block."""
        here = self._here(chosen, b)
        if (here, b) not in self._weighed:
            self.weigh((chosen,))
        return self._weighed[here, b]

    def _untied(self, chosen: Set) -> Set:
        """Return what of a set no block has in common with another."""
        return tuple(j for j in chosen if not self.terms[j].ties)

    def _in_part(self, chosen: Set) -> list[tuple[Set, float]]:
        """Return all of a set that may be in one block, with how probable (log) it is that the rest is absent there."""
        may = {j: own for j in chosen if (own := self.terms[j].absent)}
        out = []
        for absent in chain.from_iterable(combinations(may, k) for k in range(len(may) + 1)):
            prior = sum(log(own if j in absent else 1.0 - own) for j, own in may.items())
            out.append((tuple(j for j in chosen if j not in absent), prior))
        return out

    def _here(self, chosen: Set, b: int) -> Set:
        """Return what of a set shows in a block."""
        return tuple(j for j in chosen if self.terms[j].parts[b] is not None)

    def member(self, j: int, b: int) -> Member:
        """Return what a term is in a block."""
        return self._members_of((j,), b)[j]

    def _members_of(self, places: Iterable[int], b: int) -> dict[int, Member]:
        """Lay out what several terms are in a block, all at once: a filter costs as much for one as for many."""
        asked = sorted(places)
        new = {j: part for j in asked if (j, b) not in self._members and (part := self.terms[j].parts[b])}
        ends = np.cumsum([0, *(part.columns.shape[1] for part in new.values())])
        laid = self.blocks[b].projected(np.hstack([part.columns for part in new.values()])) if new else np.zeros(0)
        for (j, part), (first, end) in zip(new.items(), pairwise(ends), strict=True):
            options = Options.of(self.terms[j].amplitudes[b])
            self._members[j, b] = Member(part.parameters, options, laid[:, :, first:end])
        return {j: self._members[j, b] for j in asked}

    def _evidence(self, sets: Sequence[Set]) -> list[list[FloatArray]]:
        def weighed(chosen: Set) -> list[SetInBlock]:
            return [self.in_block(chosen, b) for b in range(len(self.blocks))]

        self.weigh(sets)
        out = [[self._by_sort(chosen, b) for b in range(len(self.blocks))] for chosen in sets]
        tied = {m: others for m, s in enumerate(sets) if (others := self._untied(s)) != s}
        asked = [
            (weighed(sets[m]), weighed(own), [j for j in sets[m] if self.terms[j].ties]) for m, own in tied.items()
        ]
        for m, gain in zip(tied, tied_gains(asked), strict=True):
            out[m][0] = out[m][0] + gain
        return out

    def _by_sort(self, chosen: Set, b: int) -> FloatArray:
        """Log evidence (u,) of a set in one block by what scatters, whatever of it is in others alone."""
        sorts = len(self.blocks[b].noise.sorts)
        parts = self._in_part(self._here(chosen, b))
        return log_sum(np.array([self.in_block(part, b).by_sort(sorts) + prior for part, prior in parts]))
