"""All that may be wrong with a run: how probable each is before the data, and what it leaves of the rates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self, TypeVar

import numpy as np
from scipy.special import logsumexp

from hil.campaign import BoolArray, FloatArray, IntArray
from hil.model.effects.data import of_a_run, put_right
from hil.model.effects.prior import COMMON
from hil.solve.whitened import Whitened

DOUBTED = 0.5
"""Probability of nothing being wrong, below which something may be."""
ODDS = {
    "rate": 0.05,
    "collect": 0.05,
    "exchanged": 0.02,
    "channels": 0.005,
    "sensors": 0.005,
    "turned": 0.005,
    "all turned": 0.00025,
    "bias": 0.02,
    "run": 0.02,
}
"""Prior odds that a campaign has one of a kind; the search has these, too."""
AS_IT_LAY = float(np.log(1e4))
"""Log odds that labels are exchanged where the unit's accelerometers say so, rather than that these are wrong."""
AGAIN = 0.3
"""How probably labels that are exchanged, or signs turned, in one run are so in more: whoever did it did so again."""
_WIDE = 30.0  # standard errors that what is wrong is off by, unless it is more
_TOLD = 1e-3  # of a rate: where the others leave less, nothing tells what it should be
_HARDLY_ANY = 4.0  # logs: of many runs those are not asked about that the data make no likelier than that less
_FIRST = 3  # runs of which it is asked what else is wrong beside what is likeliest of them
_LEAST_RUNS = 2  # of so few both are all
_AT_ONCE = 4000  # ways of which it is asked how probable they are: of a life all of them would fill the memory
_NEXT_TO_NONE = 1e-20  # of what the likeliest has: ways that are less probable do not even decide between two
_TIMES = np.geomspace(0.05, 500.0, 93)  # that standard errors are too small by
_RIGHT, _NEARLY = 0.7, 0.15  # probability that they are as stated, within
_OTHERWISE = 0.7  # and else the usual size of the logarithm of how many times they are not


@dataclass(frozen=True)
class Cause:
    """One thing that may be wrong with a run: what, in which `rows` (k,), of some `channels` or, empty, of all.

    `off` is by how much, deg/hr, its first row is off in each channel, (c,); nothing where that is no matter. `instead`
    are the rates (k, c) of its rows that the other sensor shows, where the two were exchanged.
    """

    what: str
    run: int
    rows: tuple[int, ...]
    channels: tuple[int, ...] = ()
    off: tuple[float, ...] = ()
    instead: tuple[tuple[float, ...], ...] = ()

    @property
    def place(self) -> tuple[object, ...]:
        """What it is one with: a collect of which a rate is wrong is a wrong collect, and a bias is its run's."""
        if self.what in ("rate", "collect"):
            return (self.run, self.rows)
        return (self.what, self.run, self.rows, None if self.what == "bias" else self.channels)


@dataclass(frozen=True)
class OtherSensor:
    """What another sensor shows in the same collects: its `rates` (n, c), NaN where it took none.

    `labels` says of a run how much likelier they are, in logs, with two of its places exchanged; `instead` how much
    with the rates that this sensor shows in it.
    """

    rates: FloatArray
    labels: Callable[[int], Mapping[tuple[int, ...], float]]
    instead: Callable[[int], float]

    def rows(self, rows: IntArray) -> Self:
        """Return what it shows in some of them."""
        return replace(self, rates=self.rates[rows])


_Several = TypeVar("_Several", "_Tried", "_Runs")
_Ways = tuple[FloatArray, FloatArray, Callable[[int], tuple[Cause, ...]]]
"""Log odds (t,) before the data of ways to explain rates, the squares (t,) that they leave, and the causes of each."""


class Asked:
    """What may be wrong with whitened rates, each with its log odds before the data and the squares that it leaves.

    `beside` is what another sensor shows in the same collects; runs in `own_bias` may have a bias of their own.
    """

    def __init__(self, rates: Whitened, own_bias: Collection[int] = (), beside: OtherSensor | None = None) -> None:
        self.rates, self._own_bias, self._beside = rates, own_bias, beside

    @property
    def times(self) -> float:
        """How many times as far from each other as their standard errors say rates are."""
        return float(np.sqrt(max(self.rates.squares, 0.0) / max(self.rates.freedom, 1.0)))

    @property
    def as_filed(self) -> float:
        """Log probability of the rates if nothing is wrong with them."""
        return float(self._evidence(np.array([self.rates.squares]))[0])

    def weighed(self, run: int | None = None) -> tuple[float, list[tuple[tuple[Cause, ...], float]]]:
        """Return how probable it is that nothing is wrong, and causes with their probability, the likeliest first.

        One, or two in two runs, which hide behind each other. Of one `run` alone, if asked for.
        """
        if self.rates.freedom < 1.0:
            return 1.0, []
        singly = [_at(each, np.isin(each.runs, each.runs if run is None else run)) for each in self._tried()]
        ways = [*(each.ways() for each in singly), *self._twice(singly)]
        nothing, found = self._posterior(ways)
        if nothing < DOUBTED and run is None:
            nothing, found = self._posterior([*ways, *self._another(singly)])
        return nothing, found

    def _posterior(self, ways: Sequence[_Ways]) -> tuple[float, list[tuple[tuple[Cause, ...], float]]]:
        weights = np.concatenate([np.zeros(1), *(log_odds for log_odds, *_ in ways)])
        weights += self._evidence(np.concatenate([np.array([self.rates.squares]), *(left for _, left, _ in ways)]))
        weights = np.exp(weights - logsumexp(weights))
        ends = np.cumsum([1, *(len(left) for _, left, _ in ways)])
        told = 1 + np.flatnonzero(weights[1:] > _NEXT_TO_NONE * weights[1:].max(initial=0.0))
        of = np.searchsorted(ends, told, side="right") - 1
        found = [(ways[w][2](k), float(weights[i])) for i, w, k in zip(told, of, told - ends[of], strict=True)]
        return float(weights[0]), sorted(found, key=lambda each: -each[1])

    def _another(self, singly: Sequence[_Tried]) -> Iterator[_Ways]:
        """Yield what leaves least of a run whose rates it tells, of a few, with all that is unlike it in others."""
        first: dict[int, tuple[_Tried, int]] = {}
        telling = [each for each in singly if each.moved is not None]
        for _, k, i in sorted((left, k, i) for k, each in enumerate(telling) for i, left in enumerate(each.left)):
            first.setdefault(int(telling[k].runs[i]), (telling[k], i))
        for one, i in [*first.values()][:_FIRST]:
            known, moved = one.one(i), np.zeros(0) if one.moved is None else one.moved[i]
            rates = self.rates.moved(known.run, moved, float(one.left[i]))
            for other in Asked(rates, self._own_bias, self._beside)._tried():
                if (other.what, other.channels) != (known.what, known.channels):
                    yield _at(other, other.runs != known.run).ways((known,), float(one.log_odds[i]))

    def _twice(self, singly: Sequence[_Tried]) -> Iterator[_Ways]:
        """Yield the same mistake in two of several runs, with its log odds and what it leaves: less than either alone.

        What all runs would share is none of theirs, and whose rates are another sensor's that one tells.
        """
        alike: dict[tuple[object, ...], list[tuple[_Tried, FloatArray]]] = {}
        runs = len(self.rates.collects.conditions.of_each_run)
        for each in singly:
            if each.moved is not None and each.instead is None and runs > _LEAST_RUNS:
                moved = zip(each.runs.tolist(), each.moved, strict=True)
                shown = np.array([self.rates.shown(run) @ by for run, by in moved])
                places, which = np.unique(each.place, axis=0, return_inverse=True)
                for k, place in enumerate(places.tolist()):
                    own = np.flatnonzero(which.reshape(-1) == k)
                    of = alike.setdefault((each.what, *place, each.channels), [])
                    of.append((_at(each, own), shown[own]))
        for several in alike.values():
            shown, alone = np.vstack([by for _, by in several]), np.concatenate([each.left for each, _ in several])
            log_odds = np.concatenate([each.log_odds for each, _ in several])
            reach = np.linalg.norm(shown, axis=1)  # what has too little in common with any is in no pair
            near = np.flatnonzero(alone - self.rates.squares < 2.0 * reach * reach.max(initial=0.0))
            causes = [each.one(k) for each, _ in several for k in range(len(each.left) * bool(len(near)))]
            left = alone[near, None] + alone[near] - self.rates.squares - 2.0 * shown[near] @ shown[near].T
            i, j = np.nonzero(np.triu(left < np.minimum(alone[near, None], alone[near]), 1))
            both = partial(_both, causes, near[i], near[j])
            yield log_odds[near[i]] + made_again(2, runs), left[i, j], both

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
            most = left.max(axis=1, initial=-np.inf)
            out[few] = most + np.log(np.sum(np.exp(left - most[:, None]), axis=1))
        return out

    def labels(self, run: int) -> dict[tuple[int, ...], float]:
        """Return how much likelier, in logs, these rates are with each two places in a run exchanged."""
        (own,) = (each for runs in _Runs.of(self.rates, [run]) for each in runs.exchanged())
        likelier = (self._evidence(own.left) - self.as_filed).tolist()
        return dict(zip(map(tuple, own.place.tolist()), likelier, strict=True))

    def with_others(self, run: int, rates: FloatArray) -> float:
        """Return how much likelier, in logs, these rates are with others (k, c) in a run: not at all if one lacks."""
        (own,) = (each for runs in _Runs.of(self.rates, [run]) for each in runs.otherwise("sensors", rates[None]))
        return float(self._evidence(own.left)[0]) - self.as_filed if len(own.left) else -np.inf

    def seen_from(self) -> FloatArray:
        """Return how far off each rate must be to be doubted, deg/hr, (n, c); infinite where nothing tells."""
        rates, size = self.rates, np.geomspace(1.0, 1e6, 300)
        apart = np.zeros(rates.known.shape)
        for run, rows in rates.collects.conditions.of_each_run.items():
            apart[rows] = np.diag(rates.of(run)[0]).reshape(len(rows), -1)
        told = rates.known & (apart > _TOLD)
        against = np.log(DOUBTED) + np.log(ODDS["rate"] / apart.size) - 0.5 * np.log1p(_WIDE**2 * apart[told])
        nothing, wrong = self._evidence(rates.freedom + size), self._evidence(np.array([rates.freedom]))
        squares = size[np.minimum(np.searchsorted(wrong - nothing, -against), len(size) - 1)]
        out = np.full(apart.shape, np.inf)
        out[told] = np.sqrt(squares / apart[told]) / rates.weight[told]
        return out

    def _tried(self) -> Iterator[_Tried]:
        """Yield each cause with its log odds, less what it pays for being anywhere, and the squares that it leaves."""
        (n, channels), every = self.rates.known.shape, self.rates.collects.conditions.of_each_run
        runs, many = [*_Runs.of(self.rates, every)], len(every)
        of = {"rate": n * channels, "collect": n, "exchanged": max(sum(int(each.may_be.sum()) for each in runs), 1)}
        of |= {what: many * count for what, count in Counter(what for what, _ in of_a_run(channels)).items()}
        of |= {"sensors": many, "run": many, "bias": many * (channels + (channels > 1))}
        log_odds = {what: float(np.log(ODDS[what] / places)) for what, places in of.items()}
        for each in runs:
            likelier = self._evidence(self.rates.squares - each.most) - self.as_filed
            for tried in self._of(_at(each, likelier >= np.log(many) - _HARDLY_ANY), many, log_odds["exchanged"]):
                yield replace(tried, log_odds=tried.log_odds + log_odds[tried.what])

    def _of(self, runs: _Runs, many: int, exchanged: float) -> Iterator[_Tried]:
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
            told = _at(runs, runs.known[..., some].sum(axis=(1, 2)) > 1)
            yield from told.otherwise(what, put_right(told.measured, what, some), some)
        if many > 1:
            yield from _at(runs, ~np.isin(runs.runs, [*self._own_bias])).of_its_own()
            yield from runs.anywhere("run", np.eye(runs.free.shape[1]))
        if beside is not None:
            for tried in runs.otherwise("sensors", beside.rates[runs.rows]):
                # What is no longer this sensor's is the other's, which must not agree less with it for that.
                theirs = [min(beside.instead(run), 0.0) for run in tried.runs.tolist()]
                yield replace(tried, log_odds=np.array(theirs), instead=beside.rates[tried.rows])


@dataclass(frozen=True)
class _Tried:
    """Causes (t,) of one sort, each in one of `runs` (t,), which have `rows` (t, k), at a `place` (t, q) among these.

    `off` (t, c) and `instead` (t, k, c) are those of the causes, `moved` (t, k·c) is how each moves its run's rates.
    """

    what: str
    channels: tuple[int, ...]
    runs: IntArray
    rows: IntArray
    place: IntArray
    left: FloatArray
    log_odds: FloatArray
    off: FloatArray | None = None
    moved: FloatArray | None = None
    instead: FloatArray | None = None

    def one(self, i: int) -> Cause:
        """Return one of them."""
        off = () if self.off is None else tuple(self.off[i].tolist())
        instead = () if self.instead is None else tuple(map(tuple, self.instead[i].tolist()))
        rows = tuple(self.rows[i][self.place[i]].tolist())
        return Cause(self.what, int(self.runs[i]), rows, self.channels, off, instead)

    def ways(self, beside: tuple[Cause, ...] = (), log_odds: float = 0.0) -> _Ways:
        """Return them as ways to explain rates, beside a cause that has such log odds."""
        return log_odds + self.log_odds, self.left, lambda i: (*beside, self.one(i))


@dataclass(frozen=True)
class _Runs:
    """Rates (m, k, c) of `runs` (m,) that have as many `rows` (m, k): what a change of them leaves of the squares.

    `free` (m, k·c, k·c) and `apart` (m, k·c) are what squares and products of a change add, `may_be` (m, p) the pairs
    of collects, of different positions, that may be exchanged.
    """

    squares: float
    runs: IntArray
    rows: IntArray
    known: BoolArray
    weight: FloatArray
    measured: FloatArray
    free: FloatArray
    apart: FloatArray
    may_be: BoolArray

    @classmethod
    def of(cls, rates: Whitened, runs: Collection[int]) -> Iterator[_Runs]:
        """Yield some runs, by how many rows they have."""
        every, conditions = rates.collects.conditions.of_each_run, rates.collects.conditions
        position = np.unique(conditions.position, return_inverse=True)[1]
        for size in sorted({len(every[run]) for run in runs}):
            own = [run for run in runs if len(every[run]) == size]
            rows, (i, j) = np.array([every[run] for run in own]), np.triu_indices(size, 1)
            free, apart = (np.array(each) for each in zip(*map(rates.of, own), strict=True))
            measured = np.where(known := rates.known[rows], rates.collects.rates_deg_per_hr[rows], np.nan)
            may_be = position[rows[:, i]] != position[rows[:, j]]
            yield cls(rates.squares, np.array(own), rows, known, rates.weight[rows], measured, free, apart, may_be)

    @property
    def most(self) -> FloatArray:
        """By how much whatever may be wrong with each run lessens the squares at most, (m,)."""
        size, along, _ = _along(self.free, self.apart)
        return np.asarray(np.sum(along**2 * size, axis=1))

    def rows_off(self) -> Iterator[_Tried]:
        """Yield rates, and collects, that may be anywhere."""
        (_, rows, channels), unit = self.known.shape, np.eye(self.free.shape[1])
        for row in range(rows):
            own = unit[:, row * channels : (row + 1) * channels]
            for c in range(channels):
                yield from _at(self, self.known[:, row, c]).anywhere("rate", own[:, [c]], (c,), row)
            yield from _at(self, self.known[:, row].sum(axis=1) > 1).anywhere("collect", own, (), row)

    def of_its_own(self) -> Iterator[_Tried]:
        """Yield another bias of each channel, and of all: a unit that is switched on anew has."""
        level = self.weight / np.maximum(self.weight.max(axis=1, keepdims=True), 1e-12)
        columns = (level[..., None] * np.eye(level.shape[2])).reshape(*self.apart.shape, -1)
        for c in range(level.shape[2]):
            told = self.known[..., c].sum(axis=1) > 1
            yield from _at(self, told).anywhere("bias", columns[told][..., [c]], (c,))
        if level.shape[2] > 1:
            yield from self.anywhere("bias", columns)

    def anywhere(
        self, what: str, columns: FloatArray, channels: tuple[int, ...] = (), row: int = -1
    ) -> Iterator[_Tried]:
        """Yield a cause along columns (k·c, q), or (m, k·c, q), of one row or of all; what it pays for that."""
        across = np.swapaxes(columns, -1, -2)
        size, off, directions = _along(across @ self.free @ columns, (across @ self.apart[..., None])[..., 0])
        wide = np.maximum(off**2, _WIDE**2) * size
        left = self.squares - np.sum(off**2 * size * wide / (1.0 + wide), axis=1)
        first = np.s_[:, max(row, 0)]
        by = (columns @ (directions @ off[..., None])).reshape(self.known.shape)[first]
        tried = self._tried(what, channels, left, off=by / np.maximum(self.weight[first], 1e-12))
        tried = replace(tried, log_odds=-0.5 * np.log1p(wide).sum(axis=1))
        yield _at(tried if row < 0 else replace(tried, place=tried.place[:, [row]]), np.any(size, axis=1))

    def exchanged(self) -> Iterator[_Tried]:
        """Yield the pairs of collects that may stand under each other's labels: of many poses there are very many."""
        i, j = np.triu_indices(self.rows.shape[1], 1)
        apart, which = self.measured[:, j] - self.measured[:, i], np.arange(len(i))
        told = self.may_be & np.isfinite(apart).all(axis=2)
        moved = np.zeros((*told.shape, *self.known.shape[1:]))
        moved[:, which, i], moved[:, which, j] = apart * self.weight[:, i], -apart * self.weight[:, j]
        moved = np.where(told[..., None], moved.reshape(*told.shape, self.apart.shape[1]), 0.0)
        left = self.squares + 2.0 * (moved @ self.apart[..., None])[..., 0] + np.sum(moved @ self.free * moved, axis=2)
        m, pair = np.nonzero(told)
        place, own = np.stack([i[pair], j[pair]], axis=1), _at(self, m)
        yield replace(own._tried("exchanged", (), left[m, pair], moved=moved[m, pair]), place=place)

    def otherwise(self, what: str, rates: FloatArray, channels: tuple[int, ...] = ()) -> Iterator[_Tried]:
        """Yield a cause by which other rates (m, k, c), all known, were measured, and what it leaves."""
        moved = np.where(self.weight > 0.0, (rates - self.measured) * self.weight, 0.0).reshape(self.apart.shape)
        left = self.squares + np.sum(moved * (2.0 * self.apart + (self.free @ moved[..., None])[..., 0]), axis=1)
        yield _at(self._tried(what, channels, left, moved=moved), np.isfinite(left))

    def _tried(self, what: str, channels: tuple[int, ...], left: FloatArray, **of: FloatArray) -> _Tried:
        place = np.broadcast_to(np.arange(self.rows.shape[1]), self.rows.shape)
        return _Tried(what, channels, self.runs, self.rows, place, left, np.zeros(len(left)), **of)


def _along(squares: FloatArray, products: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return sizes (m, q) of directions (m, q, q) of squares, and how far off products (m, q) are; 0 where untold."""
    size, directions = np.linalg.eigh(squares)
    size = np.where(size > _TOLD, size, 0.0)
    off = (np.swapaxes(directions, 1, 2) @ products[..., None])[..., 0] / np.where(size > 0.0, size, np.inf)
    return size, off, directions


def _at(of: _Several, index: IntArray | BoolArray) -> _Several:
    """Return some of them."""
    some: dict[str, Any] = {name: own[index] for name, own in vars(of).items() if isinstance(own, np.ndarray)}
    return replace(of, **some)


def _in_common(log_odds: float, elsewhere: float | None) -> float:
    """Return by how much another sensor's rates, so many logs likelier with labels exchanged, move those log odds.

    A label is a collect's, which all sensors have in common: nearly always it is exchanged for all, or for none.
    """
    if elsewhere is None:
        return 0.0
    alone = float(np.log1p(-COMMON))
    both = float(np.logaddexp(np.log(COMMON) + elsewhere, alone))
    return both - float(np.logaddexp(0.0, log_odds + alone + elsewhere))


def made_again(times: int, runs: int) -> float:
    """Return the log odds that a mistake was made in one more of so many runs, the `times`-th: any others may be it."""
    return float(np.log(AGAIN * times / (runs - times + 1)))


def all_of(causes: Sequence[str]) -> str:
    """Say of one way to explain rates what is wrong: one thing, or several."""
    return f"{'both ' * (len(causes) == 2)}{', and '.join(causes)}"


def _both(causes: Sequence[Cause], i: IntArray, j: IntArray, k: int) -> tuple[Cause, Cause]:
    return causes[i[k]], causes[j[k]]
