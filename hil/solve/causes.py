"""All that may be wrong with a run: how probable each is before the data, and what it leaves of the rates."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Self

import numpy as np
from scipy.special import logsumexp

from hil.campaign import Conditions, FloatArray, IntArray
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


_Way = tuple[tuple[Cause, ...], float, float]
"""Causes, their log odds before the data, and the squares that they leave."""


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
        singly = [each for each in self._tried() if run in (None, each.cause.run)]
        tried = [((each.cause,), each.log_odds, each.left) for each in singly] + [*self._twice(singly)]
        nothing, found = self._posterior(tried)
        if nothing < DOUBTED and run is None:
            nothing, found = self._posterior([*tried, *self._another(singly)])
        return nothing, found

    def _posterior(self, tried: Sequence[_Way]) -> tuple[float, list[tuple[tuple[Cause, ...], float]]]:
        weights = np.array([0.0, *(log_odds for _, log_odds, _ in tried)])
        weights = weights + self._evidence(np.array([self.rates.squares, *(left for *_, left in tried)]))
        weights = np.exp(weights - logsumexp(weights))
        found = [(causes, float(p)) for (causes, *_), p in zip(tried, weights[1:], strict=True)]
        return float(weights[0]), sorted(found, key=lambda each: -each[1])

    def _another(self, singly: Sequence[_Tried]) -> Iterator[_Way]:
        """Yield what leaves least of a run whose rates it tells, of a few, with all that is unlike it in others."""
        first: dict[int, tuple[_Tried, FloatArray]] = {}
        for each in sorted(singly, key=lambda each: each.left):
            if each.moved is not None:
                first.setdefault(each.cause.run, (each, each.moved))
        for one, moved in [*first.values()][:_FIRST]:
            known = one.cause
            rates = self.rates.moved(known.run, moved, one.left)
            for other in Asked(rates, self._own_bias, self._beside)._tried():
                unlike = (other.cause.what, other.cause.channels) != (known.what, known.channels)
                if unlike and other.cause.run != known.run:
                    yield (known, other.cause), one.log_odds + other.log_odds, other.left

    def _twice(self, singly: Sequence[_Tried]) -> Iterator[_Way]:
        """Yield the same mistake in two of several runs, with its log odds and what it leaves: less than either alone.

        What all runs would share is none of theirs, and whose rates are another sensor's that one tells.
        """
        alike: dict[tuple[object, ...], list[tuple[_Tried, FloatArray]]] = {}
        runs = self.rates.collects.conditions.of_each_run
        for each in singly:
            if each.moved is not None and not each.cause.instead and len(runs) > _LEAST_RUNS:
                places = tuple(row - runs[each.cause.run][0] for row in each.cause.rows)
                alike.setdefault((each.cause.what, places, each.cause.channels), []).append((each, each.moved))
        all_show = {run: self.rates.shown(run) for run in {each.cause.run for of in alike.values() for each, _ in of}}
        for several in alike.values():
            shown = np.array([all_show[each.cause.run] @ moved for each, moved in several])
            alone = np.array([each.left for each, _ in several])
            left = alone[:, None] + alone - self.rates.squares - 2.0 * shown @ shown.T
            less = np.triu(left < np.minimum(alone[:, None], alone), 1)
            for i, j in np.argwhere(less).tolist():
                one, other = several[i][0], several[j][0]
                yield (one.cause, other.cause), one.log_odds + made_again(2, len(runs)), float(left[i, j])

    def _evidence(self, squares: FloatArray) -> FloatArray:
        """Log probability of residual squares (h,), whatever the size of the noise."""
        size = np.log(_TIMES)
        prior = np.full(len(size), 1.0 / len(size))
        if self.rates.stated:
            right, otherwise = np.exp(-0.5 * (size / _NEARLY) ** 2), np.exp(-np.abs(size) / _OTHERWISE)
            prior = _RIGHT * right / right.sum() + (1.0 - _RIGHT) * otherwise / otherwise.sum()
        left = 0.5 * np.maximum(squares, 0.0)[:, None] / _TIMES**2
        return np.asarray(logsumexp(np.log(prior) - self.rates.freedom * size - left, axis=1))

    def labels(self, run: int) -> dict[tuple[int, ...], float]:
        """Return how much likelier, in logs, these rates are with each two places in a run exchanged."""
        conditions = self.rates.collects.conditions
        own = _Run(self.rates, run, conditions.of_each_run[run])
        tried = [*own.exchanged(_pairs(conditions, conditions.of_each_run[run]))]
        likelier = self._evidence(np.array([each.left for each in tried])) - self.as_filed
        return {own.places(each.cause): float(logs) for each, logs in zip(tried, likelier, strict=True)}

    def with_others(self, run: int, rates: FloatArray) -> float:
        """Return how much likelier, in logs, these rates are with others (k, c) in a run: not at all if one lacks."""
        own = _Run(self.rates, run, self.rates.collects.conditions.of_each_run[run])
        left = next((each.left for each in own.otherwise(Cause("sensors", run, own.rows), rates)), np.inf)
        return float(self._evidence(np.array([left]))[0]) - self.as_filed

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
        (n, channels), conditions = self.rates.known.shape, self.rates.collects.conditions
        runs = {run: _Run(self.rates, run, rows) for run, rows in conditions.of_each_run.items()}
        pairs = {run: _pairs(conditions, rows) for run, rows in conditions.of_each_run.items()}
        of = {"rate": n * channels, "collect": n, "exchanged": max(sum(map(len, pairs.values())), 1)}
        whole = of_a_run(channels)
        of |= {what: len(runs) * sum(what == other for other, _ in whole) for what, _ in whole}
        of |= {"sensors": len(runs), "run": len(runs), "bias": len(runs) * (channels + (channels > 1))}
        log_odds = {what: float(np.log(ODDS[what] / many)) for what, many in of.items()}
        gains = self._evidence(self.rates.squares - np.array([0.0, *(each.most for each in runs.values())]))
        for (run, each), most in zip(runs.items(), gains[1:] - gains[0], strict=True):
            if most < np.log(len(runs)) - _HARDLY_ANY:
                continue
            tried = [*each.rows_off()]
            elsewhere, alone = self._beside.labels(run) if self._beside else {}, log_odds["exchanged"]
            tried += (
                replace(one, log_odds=_in_common(alone, elsewhere.get(each.places(one.cause))))
                for one in each.exchanged(pairs[run])
            )
            if len(each.rows) > 1:
                for what, some in whole:
                    if each.known[:, some].sum() > 1:
                        laid = put_right(each.measured, what, some)
                        tried += each.otherwise(Cause(what, run, each.rows, some), laid)
                if run not in self._own_bias and len(runs) > 1:
                    tried += each.of_its_own()
                if self._beside is not None:
                    other = self._beside.rates[list(each.rows)]
                    exchanged = Cause("sensors", run, each.rows, instead=(*map(tuple, other.tolist()),))
                    # What is no longer this sensor's is the other's, which must not agree less with it for that.
                    theirs = min(self._beside.instead(run), 0.0)
                    tried += (replace(of, log_odds=theirs) for of in each.otherwise(exchanged, other))
                if len(runs) > 1:
                    tried += each.anywhere(Cause("run", run, each.rows), np.eye(each.known.size))
            yield from (replace(of, log_odds=of.log_odds + log_odds[of.cause.what]) for of in tried)


@dataclass(frozen=True)
class _Tried:
    """A cause, its log odds, the squares that it leaves, and how it moves its run's rates (k·c,), if that is known."""

    cause: Cause
    log_odds: float
    left: float
    moved: FloatArray | None = None


class _Run:
    """The rates (k, c) of one run: what a change of them leaves of the squares."""

    def __init__(self, rates: Whitened, run: int, rows: IntArray) -> None:
        self.rows, self.known, self.weight = tuple(rows.tolist()), rates.known[rows], rates.weight[rows]
        self.measured = np.where(self.known, rates.collects.rates_deg_per_hr[rows], np.nan)
        self._run, self._squares = run, rates.squares
        self._free, self._apart = rates.of(run)

    def places(self, cause: Cause) -> tuple[int, ...]:
        """Return at which places in the run a cause's rows stand."""
        return tuple(self.rows.index(row) for row in cause.rows)

    @property
    def most(self) -> float:
        """By how much whatever may be wrong with the run lessens the squares at most."""
        size, directions = np.linalg.eigh(self._free)
        told = size > _TOLD
        return float(np.sum((directions[:, told].T @ self._apart) ** 2 / size[told]))

    def rows_off(self) -> Iterator[_Tried]:
        """Yield its rates, and its collects, that may be anywhere."""
        unit = np.eye(self.known.size).reshape(*self.known.shape, -1)
        for i, row in enumerate(self.rows):
            for c in np.flatnonzero(self.known[i]).tolist():
                yield from self.anywhere(Cause("rate", self._run, (row,), (c,)), unit[i, [c]].T)
            if self.known[i].sum() > 1:
                yield from self.anywhere(Cause("collect", self._run, (row,)), unit[i].T)

    def of_its_own(self) -> Iterator[_Tried]:
        """Yield another bias of each channel, and of all: a unit that is switched on anew has."""
        level = self.weight / np.maximum(self.weight.max(axis=0), 1e-12)
        columns = (level[..., None] * np.eye(level.shape[1])).reshape(level.size, -1)
        for c in np.flatnonzero(self.known.sum(axis=0) > 1).tolist():
            yield from self.anywhere(Cause("bias", self._run, self.rows, (c,)), columns[:, [c]])
        if level.shape[1] > 1:
            yield from self.anywhere(Cause("bias", self._run, self.rows), columns)

    def anywhere(self, cause: Cause, columns: FloatArray) -> Iterator[_Tried]:
        """Yield a cause along columns (k·c, q), if anything tells of it, what it pays for that, and what it leaves."""
        size, directions = np.linalg.eigh(columns.T @ self._free @ columns)
        if (told := size > _TOLD).any():
            size, directions = size[told], directions[:, told]
            off = directions.T @ (columns.T @ self._apart) / size
            wide = np.maximum(off**2, _WIDE**2) * size
            row = self.rows.index(cause.rows[0])
            of_row = (columns @ (directions @ off)).reshape(self.known.shape)[row]
            cause = replace(cause, off=tuple((of_row / np.maximum(self.weight[row], 1e-12)).tolist()))
            left = self._squares - float(np.sum(off**2 * size * wide / (1.0 + wide)))
            yield _Tried(cause, -0.5 * float(np.log1p(wide).sum()), left)

    def exchanged(self, pairs: Sequence[tuple[int, int]]) -> Iterator[_Tried]:
        """Yield the pairs of collects that may stand under each other's labels: of many poses there are very many."""
        i, j = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        moved, which = np.zeros((len(i), *self.known.shape)), np.arange(len(i))
        apart = self.measured[j] - self.measured[i]
        moved[which, i], moved[which, j] = apart * self.weight[i], -apart * self.weight[j]
        told = np.isfinite(moved).all(axis=(1, 2))
        flat = moved[told].reshape(int(told.sum()), self.known.size)
        left = self._squares + 2.0 * flat @ self._apart + np.sum((flat @ self._free) * flat, axis=1)
        for pair, squares, own in zip(which[told].tolist(), left.tolist(), flat, strict=True):
            yield _Tried(Cause("exchanged", self._run, (self.rows[i[pair]], self.rows[j[pair]])), 0.0, squares, own)

    def otherwise(self, cause: Cause, rates: FloatArray) -> Iterator[_Tried]:
        """Yield a cause by which other rates (k, c), all known, were measured, and what it leaves."""
        moved = np.where(self.weight > 0.0, (rates - self.measured) * self.weight, 0.0).reshape(-1)
        if np.isfinite(moved).all():
            left = self._squares + float(2.0 * moved @ self._apart + moved @ self._free @ moved)
            yield _Tried(cause, 0.0, left, moved)


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


def _pairs(conditions: Conditions, rows: IntArray) -> list[tuple[int, int]]:
    """Return which collects of a run, by place in it, may be exchanged: of different positions."""
    position = conditions.position[rows].tolist()
    return [(i, j) for i, j in combinations(range(len(rows)), 2) if position[i] != position[j]]
