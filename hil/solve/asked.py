"""What is wrong with runs: everything that may be, weighed by what it leaves of the rates."""

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Self

import numpy as np
from scipy.special import logsumexp

from hil.campaign import FloatArray, IntArray
from hil.model.effects.data import of_a_run, put_right
from hil.model.effects.prior import COMMON, log_sum
from hil.solve.causes import ODDS, OWN, TOLD, WIDE, Cause, Runs, Tried, Ways, explained, made_again, off_along, some_of
from hil.solve.temperatures import runs_by_temperature, visits
from hil.solve.whitened import Whitened

DOUBTED = 0.5
"""Probability of nothing being wrong, below which something may be."""
_HARDLY_ANY = 4.0  # logs: of many runs those are not asked about that the data make no likelier than that less
_SOME = 0.01  # probability of what says at which temperatures rates may be noisier
_TOGETHER = 72  # of what runs have of their own are asked in pairs: of a life all would fill the memory
_GROWN = 8  # likeliest of what several runs have of their own that are asked for more
_FIRST = 3  # runs of which it is asked what else is wrong beside what is likeliest of them
_LEAST_RUNS = 2  # of so few both are all
_AT_ONCE = 4000  # ways of which it is asked how probable they are: of a life all of them would fill the memory
_NEXT_TO_NONE = 1e-3  # probability of all ways together that do not even decide between two
_TIMES = np.geomspace(0.05, 500.0, 93)  # that standard errors are too small by
_RIGHT, _NEARLY = 0.7, 0.15  # probability that they are as stated, within
_OTHERWISE = 0.7  # and else the usual size of the logarithm of how many times they are not
Found = list[tuple[tuple[Cause, ...], float]]
"""What may be wrong, one or two at once, each with its probability."""


@dataclass(frozen=True)
class OtherSensor:
    """What another sensor shows in the same collects: its `rates` (n, c), NaN where it took none.

    `labels` says of a run how much likelier they are, in logs, with two of its places exchanged; `instead` how much
    with the rates that this sensor shows in it.
    """

    rates: FloatArray
    labels: Callable[[int], Mapping[tuple[int, ...], float]]
    instead: Callable[[int], float]


class Asked:
    """What may be wrong with whitened rates, each with its log odds before the data and the squares that it leaves.

    `beside` is what another sensor shows in the same collects; runs that are `apart` have a bias, B, or MU of
    their own.
    """

    def __init__(
        self, rates: Whitened, apart: Collection[tuple[int, str]] = (), beside: OtherSensor | None = None
    ) -> None:
        self.rates, self._apart, self._beside = rates, apart, beside

    @property
    def times(self) -> float:
        """How many times as far from each other as their standard errors say rates are."""
        return float(np.sqrt(max(self.rates.squares, 0.0) / max(self.rates.freedom, 1.0)))

    @property
    def as_filed(self) -> float:
        """Log probability of the rates if nothing is wrong with them."""
        return float(self._evidence(np.array([self.rates.squares]))[0])

    def weighed(self, run: int | None = None) -> tuple[float, Found]:
        """Return how probable it is that nothing is wrong, and causes with their probability, the likeliest first.

        One, or two in two runs, which hide behind each other; whatever the noise is at one temperature, where something
        may be wrong. Of one `run` alone, if asked for.
        """
        log_whole, nothing, found = self._weighed(run, DOUBTED)
        if nothing > DOUBTED:
            return nothing, found
        told, runs = [(log_whole, nothing, found)], {cause.run for causes, p in found if p > _SOME for cause in causes}
        for log_odds, rates in self.rates.louder(runs):
            log_whole, nothing, found = Asked(rates, self._apart, self._beside)._weighed(run)
            told.append((log_odds + log_whole, nothing, found))
        whole = logsumexp([log for log, *_ in told])
        weighed = [(float(np.exp(log - whole)), nothing, found) for log, nothing, found in told]
        every: dict[frozenset[object], list[tuple[float, tuple[Cause, ...]]]] = {}
        for weight, _, found in weighed:
            for causes, p in found:
                same = frozenset((each.what, each.run, each.rows, each.channels) for each in causes)
                every.setdefault(same, []).append((weight * p, causes))
        likely = [(max(of, key=lambda each: each[0])[1], sum(p for p, _ in of)) for of in every.values()]
        nothing = sum(weight * own for weight, own, _ in weighed)
        return nothing, sorted(likely, key=lambda each: -each[1])

    def _weighed(self, run: int | None, most: float = 1.0) -> tuple[float, float, Found]:
        if self.rates.freedom < 1.0:
            return 0.0, 1.0, []
        singly = [some_of(each, np.isin(each.runs, each.runs if run is None else run)) for each in self._tried()]
        ways = [*(each.ways() for each in singly), *self._twice(singly), *self._alike(singly), *self._again(singly)]
        found = self._posterior(ways, most)
        return self._posterior([*ways, *self._another(singly)]) if found[1] < DOUBTED and run is None else found

    def _posterior(self, ways: Sequence[Ways], most: float = 1.0) -> tuple[float, float, Found]:
        """Return the log probability of the rates whatever is wrong, and with that what `weighed` does.

        No causes where nothing is wrong with a probability of more than `most`.
        """
        weights = np.concatenate([np.zeros(1), *(log_odds for log_odds, *_ in ways)])
        weights += self._evidence(np.concatenate([np.array([self.rates.squares]), *(left for _, left, _ in ways)]))
        log_whole = float(logsumexp(weights))
        weights = np.exp(weights - log_whole)
        if weights[0] > most:
            return log_whole, float(weights[0]), []
        ends = np.cumsum([1, *(len(left) for _, left, _ in ways)])
        order = 1 + np.argsort(-weights[1:])
        told = order[np.cumsum(weights[order]) - weights[order] < 1.0 - weights[0] - _NEXT_TO_NONE]
        of = np.searchsorted(ends, told, side="right") - 1
        found = [(ways[w][2](k), float(weights[i])) for i, w, k in zip(told, of, told - ends[of], strict=True)]
        once: dict[frozenset[Cause], tuple[tuple[Cause, ...], float]] = {}  # two are met from either
        for causes, p in sorted(found, key=lambda each: -each[1]):
            once.setdefault(frozenset(causes), (causes, p))
        whole = float(weights[0]) + sum(p for _, p in once.values())
        return log_whole, float(weights[0]) / whole, [(causes, p / whole) for causes, p in once.values()]

    def _another(self, singly: Sequence[Tried]) -> Iterator[Ways]:
        """Yield what leaves least of a run whose rates it tells, of a few, with all that may be in others."""
        first: dict[int, tuple[Tried, int]] = {}
        telling = [each for each in singly if each.moved is not None]
        for _, k, i in sorted((left, k, i) for k, each in enumerate(telling) for i, left in enumerate(each.left)):
            first.setdefault(int(telling[k].runs[i]), (telling[k], i))
        for one, i in [*first.values()][:_FIRST]:
            known, moved = one.one(i), np.zeros(0) if one.moved is None else one.moved[i]
            rates = self.rates.moved(known.run, moved, float(one.left[i]))
            for other in Asked(rates, self._apart, self._beside)._tried():
                yield some_of(other, other.runs != known.run).ways((known,), float(one.log_odds[i]))

    def _twice(self, singly: Sequence[Tried]) -> Iterator[Ways]:
        """Yield the same mistake in two of several runs, with its log odds and what it leaves: less than either alone.

        What all runs would share is none of theirs, and whose rates are another sensor's that one tells.
        """
        alike: dict[tuple[object, ...], list[tuple[Tried, FloatArray]]] = {}
        runs = len(self.rates.collects.conditions.of_each_run)
        for each in singly:
            if each.moved is not None and each.instead is None and runs > _LEAST_RUNS:
                moved = zip(each.runs.tolist(), each.moved, strict=True)
                shown = np.array([self.rates.shown(run) @ by for run, by in moved])
                places, which = np.unique(each.place, axis=0, return_inverse=True)
                for k, place in enumerate(places.tolist()):
                    own = np.flatnonzero(which.reshape(-1) == k)
                    of = alike.setdefault((each.what, *place, each.channels), [])
                    of.append((some_of(each, own), shown[own]))
        for several in alike.values():
            shown, alone = np.vstack([by for _, by in several]), np.concatenate([each.left for each, _ in several])
            log_odds = np.concatenate([each.log_odds for each, _ in several])
            reach = np.linalg.norm(shown, axis=1)  # what has too little in common with any is in no pair
            near = np.flatnonzero(alone - self.rates.squares < 2.0 * reach * reach.max(initial=0.0))
            every = [(each, k) for each, _ in several for k in range(len(each.left))]
            left = alone[near, None] + alone[near] - self.rates.squares - 2.0 * shown[near] @ shown[near].T
            i, j = np.nonzero(np.triu(left < np.minimum(alone[near, None], alone[near]), 1))
            both = partial(_both, every, near[i], near[j], None)
            yield log_odds[near[i]] + made_again(2, runs), left[i, j], both

    def _alike(self, singly: Sequence[Tried]) -> Iterator[Ways]:
        """Yield rates of one place, off by the same in two of several runs of a temperature: each hides the other."""
        places: dict[tuple[int, ...], list[tuple[Tried, int]]] = {}
        for each in singly:
            if each.what == "rate" and len(each.left):
                places.setdefault(each.values, []).extend((each, k) for k in range(len(each.left)))
        conditions = self.rates.collects.conditions
        groups = [of for _, of in runs_by_temperature(conditions) if len(of) > _LEAST_RUNS]
        at = {run: k for k, of in enumerate(groups) for run in of}
        for of in places.values() if at else ():
            every = sorted(of, key=lambda one: one[0].left[one[1]])[:_TOGETHER]
            several, log_odds = _Several.of(self.rates, every), np.array([each.log_odds[k] for each, k in every])
            size, product, shown = several.squares[:, 0], several.products, several.shown[..., 0]
            group = np.array([at.get(int(each.runs[k]), -1 - i) for i, (each, k) in enumerate(every)])
            i, j = np.nonzero(np.triu((several.visit[:, None] != several.visit) & (group[:, None] == group), 1))
            both = size[i] + size[j] - 2.0 * np.sum(shown[i] * shown[j], axis=1, keepdims=True)
            off = (product[i] + product[j]) / np.maximum(both, TOLD)
            less, paid = explained(np.where(both > TOLD, both, 0.0), off)
            alone, had = explained(size, product / size)
            better = np.flatnonzero(less > np.maximum(alone[i], alone[j]))
            odds, left = (log_odds + had)[i] + (log_odds + had)[j] - paid, self.rates.squares - less
            yield odds[better], left[better], partial(_both, every, i[better], j[better], off[better])

    def _again(self, singly: Sequence[Tried]) -> Iterator[Ways]:
        """Yield what several runs have of their own: alone, each is hidden by what the others make of the noise.

        All twos, and as many more beside the likeliest of each number as that is worth.
        """
        alike: dict[str, list[tuple[Tried, int]]] = {}
        for each in singly:
            if each.what in OWN and len(each.left):
                alike.setdefault(each.what, []).extend((each, k) for k in range(len(each.left)))
        runs = len(self.rates.collects.conditions.of_each_run)
        for of in alike.values():
            every = sorted(of, key=lambda one: one[0].left[one[1]])[:_TOGETHER]
            several, kinds = _Several.of(self.rates, every), len({each.values for each, _ in of})
            log_odds, left = (np.array([getattr(each, of)[k] for each, k in every]) for of in ("log_odds", "left"))
            places, best = np.arange(len(every))[:, None], -np.inf
            before = self._known(OWN[every[0][0].what])
            for times in range(2, 1 + runs // 2 - before):
                odds = log_odds + made_again(before + times, runs) - float(np.log(kinds))
                places, log_odds, left = several.further(places, odds, left)
                if not len(places):
                    break
                worth = log_odds + self._evidence(left)
                if worth.max() < best - _HARDLY_ANY:
                    break
                yield log_odds, left, _Grown(several, places).causes
                best, first = max(best, float(worth.max())), np.argsort(-worth)[:_GROWN]
                places, log_odds, left = places[first], log_odds[first], left[first]

    def _known(self, kind: str) -> int:
        """Return of how many runs it is known that they have a kind of their own."""
        return len({run for run, own in self._apart if own == kind})

    def _evidence(self, squares: FloatArray) -> FloatArray:
        """Log probability of residual squares (h,), whatever the size of the noise."""
        size = np.log(_TIMES)
        prior = np.full(len(size), 1.0 / len(size))
        if self.rates.stated:
            right, otherwise = np.exp(-0.5 * (size / _NEARLY) ** 2), np.exp(-np.abs(size) / _OTHERWISE)
            prior = _RIGHT * right / right.sum() + (1.0 - _RIGHT) * otherwise / otherwise.sum()
        by_size, out = np.log(prior) - self.rates.freedom * size, np.empty(len(squares))
        for few in np.array_split(np.arange(len(squares)), 1 + len(squares) // _AT_ONCE):
            left = by_size - 0.5 * np.maximum(squares[few], 0.0)[:, None] / _TIMES**2
            out[few] = log_sum(left, 1)
        return out

    def labels(self, run: int) -> dict[tuple[int, ...], float]:
        """Return how much likelier, in logs, these rates are with each two places in a run exchanged."""
        (own,) = (each for runs in Runs.of(self.rates, [run]) for each in runs.exchanged())
        likelier = (self._evidence(own.left) - self.as_filed).tolist()
        return dict(zip(map(tuple, own.place.tolist()), likelier, strict=True))

    def with_others(self, run: int, rates: FloatArray) -> float:
        """Return how much likelier, in logs, these rates are with others (k, c) in a run: not at all if one lacks."""
        (own,) = (each for runs in Runs.of(self.rates, [run]) for each in runs.otherwise("sensors", rates[None]))
        return float(self._evidence(own.left)[0]) - self.as_filed if len(own.left) else -np.inf

    def seen_from(self) -> FloatArray:
        """Return how far off each rate must be to be doubted, deg/hr, (n, c); infinite where nothing tells."""
        rates, size = self.rates, np.geomspace(1.0, 1e6, 300)
        apart = np.zeros(rates.known.shape)
        for run, rows in rates.collects.conditions.of_each_run.items():
            apart[rows] = np.diag(rates.of(run)[0]).reshape(len(rows), -1)
        told = rates.known & (apart > TOLD)
        against = np.log(DOUBTED) + np.log(ODDS["rate"] / apart.size) - 0.5 * np.log1p(WIDE**2 * apart[told])
        nothing, wrong = self._evidence(rates.freedom + size), self._evidence(np.array([rates.freedom]))
        squares = size[np.minimum(np.searchsorted(wrong - nothing, -against), len(size) - 1)]
        out = np.full(apart.shape, np.inf)
        out[told] = np.sqrt(squares / apart[told]) / rates.weight[told]
        return out

    def _tried(self) -> Iterator[Tried]:
        """Yield each cause with its log odds, less what it pays for being anywhere, and the squares that it leaves."""
        (n, channels), every = self.rates.known.shape, self.rates.collects.conditions.of_each_run
        runs, many = [*Runs.of(self.rates, every)], len(every)
        of = {"rate": n * channels, "collect": n, "exchanged": max(sum(int(each.may_be.sum()) for each in runs), 1)}
        of |= {what: many * count for what, count in Counter(what for what, _ in of_a_run(channels)).items()}
        of |= {"sensors": many, "run": many, **dict.fromkeys(OWN, many * (channels + (channels > 1)))}
        log_odds = {what: float(np.log(ODDS[what] / places)) for what, places in of.items()}
        for what, kind in OWN.items():
            if 0 < (before := self._known(kind)) < many:
                again = made_again(before + 1, many) - float(np.log(of[what] / many))
                log_odds[what] = max(log_odds[what], again)
        for each in runs:
            likelier = self._evidence(self.rates.squares - each.most) - self.as_filed
            for tried in self._of(some_of(each, likelier >= np.log(many) - _HARDLY_ANY), many, log_odds["exchanged"]):
                yield replace(tried, log_odds=tried.log_odds + log_odds[tried.what])

    def _of(self, runs: Runs, many: int, exchanged: float) -> Iterator[Tried]:
        """Yield what may be wrong with some of so many runs; labels are `exchanged` with these log odds alone."""
        beside = self._beside
        yield from runs.rows_off()
        for tried in runs.exchanged():
            at = zip(tried.runs.tolist(), map(tuple, tried.place.tolist()), strict=True)
            theirs = [_in_common(exchanged, beside.labels(run).get(place)) if beside else 0.0 for run, place in at]
            yield replace(tried, log_odds=np.array(theirs))
        if runs.rows.shape[1] < 2:
            return
        for what, some in of_a_run(runs.known.shape[2]):
            told = some_of(runs, runs.known[..., some].sum(axis=(1, 2)) > 1)
            yield from told.otherwise(what, put_right(told.measured, what, some), some)
        if many > 1:
            for tried in runs.of_its_own():
                known = [(run, OWN[tried.what]) in self._apart for run in tried.runs.tolist()]
                yield some_of(tried, ~np.array(known, dtype=np.bool_))
            yield from runs.anywhere("run", np.eye(runs.free.shape[1]))
        if beside is not None:
            for tried in runs.otherwise("sensors", beside.rates[runs.rows]):
                # What is no longer this sensor's is the other's, which must not agree less with it for that.
                theirs = [min(beside.instead(run), 0.0) for run in tried.runs.tolist()]
                yield replace(tried, log_odds=np.array(theirs), instead=beside.rates[tried.rows])


@dataclass(frozen=True)
class _Several:
    """What `every` of n causes in `runs` (n,) does: squares (n, q, q), products (n, q), and `shown` (n, p, q) by all.

    Runs of one `visit` (n,) to a temperature that was gone to again have one number: what they share is the visit's.
    What has fewer values than q has some that do nothing.
    """

    every: Sequence[tuple[Tried, int]]
    visit: IntArray
    squares: FloatArray
    products: FloatArray
    shown: FloatArray

    @classmethod
    def of(cls, rates: Whitened, every: Sequence[tuple[Tried, int]]) -> Self:
        """Return what some causes do to rates."""
        most = max(len(each.values) for each, _ in every)
        runs = np.array([each.runs[k] for each, k in every])
        own = [np.zeros((0, 0)) if each.along is None else each.along[k] for each, k in every]
        own = [np.pad(of, ((0, 0), (0, most - of.shape[1]))) for of in own]
        changed = {run: (*rates.of(run), rates.shown(run)) for run in dict.fromkeys(runs.tolist())}
        laid = [(of, *changed[run]) for of, run in zip(own, runs.tolist(), strict=True)]
        gone_to = visits(rates.collects.conditions)
        again = Counter(degC for degC, _ in gone_to)
        visit = {run: of[0] if again[degC] > 1 else run for degC, of in gone_to for run in of}
        does = ((of.T @ free @ of, of.T @ apart, shows @ of) for of, free, apart, shows in laid)
        return cls(every, np.array([visit[run] for run in runs.tolist()]), *map(np.array, zip(*does, strict=True)))

    def together(self, places: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what some (g, k), as one, do: shown (g, p, k·q), the inverse of squares, and how far off, (g, k·q).

        What does nothing is off by nothing.
        """
        (several, k), q = places.shape, self.products.shape[1]
        shown = np.moveaxis(self.shown[places], 1, 2).reshape(several, -1, k * q)
        squares = -np.swapaxes(shown, 1, 2) @ shown
        for i in range(k):
            squares[:, i * q : (i + 1) * q, i * q : (i + 1) * q] = self.squares[places[:, i]]
        inverse = np.asarray(np.linalg.pinv(squares, hermitian=True), dtype=np.float64)
        return shown, inverse, (inverse @ self.products[places].reshape(several, -1, 1))[..., 0]

    def further(
        self, places: IntArray, log_odds: FloatArray, left: FloatArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return some (g, k) with each in another run that leaves less beside them: places, log odds and left.

        Less what each pays for being off by anything; of two either may be the first.
        """
        shown, inverse, off = self.together(places)
        common = -np.einsum("npq,gpk->gnqk", self.shown, shown, optimize=True)
        own = self.squares - common @ inverse[:, None] @ np.swapaxes(common, 2, 3)
        products = self.products - (common @ off[:, None, :, None])[..., 0]
        several, n, q = products.shape
        size, by, _ = off_along(own.reshape(-1, q, q), products.reshape(-1, q))
        less, paid = (of.reshape(several, n) for of in explained(size, by))
        other = (self.visit != self.visit[places][..., None]).all(axis=1)
        if places.shape[1] == 1:
            other &= np.arange(n) > places
        g, j = np.nonzero((less > 0.0) & other)
        sets, first = np.unique(np.sort(np.column_stack([places[g], j])), axis=0, return_index=True)  # met from several
        return sets, (log_odds[g] - paid[g, j])[first], (left[g] - less[g, j])[first]


@dataclass(frozen=True)
class _Grown:
    """Sets (g, k) of several causes, by their places."""

    several: _Several
    places: IntArray

    @cached_property
    def _off(self) -> FloatArray:
        """How far off each is beside the others of its set, (g, k, q)."""
        return self.several.together(self.places)[2].reshape(*self.places.shape, -1)

    def causes(self, i: int) -> tuple[Cause, ...]:
        """Return the causes of one of the sets."""
        every = (self.several.every[j] for j in self.places[i].tolist())
        return tuple(each.one(k, by[: len(each.values)]) for (each, k), by in zip(every, self._off[i], strict=True))


def _in_common(log_odds: float, elsewhere: float | None) -> float:
    """Return by how much another sensor's rates, so many logs likelier with labels exchanged, move those log odds.

    A label is a collect's, which all sensors have in common: nearly always it is exchanged for all, or for none.
    """
    if elsewhere is None:
        return 0.0
    alone = float(np.log1p(-COMMON))
    both = float(np.logaddexp(np.log(COMMON) + elsewhere, alone))
    return both - float(np.logaddexp(0.0, log_odds + alone + elsewhere))


def _both(
    every: Sequence[tuple[Tried, int]], i: IntArray, j: IntArray, off: FloatArray | None, k: int
) -> tuple[Cause, Cause]:
    (first, one), (second, other), by = every[i[k]], every[j[k]], None if off is None else off[k]
    return first.one(one, by), second.one(other, by)
