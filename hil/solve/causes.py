"""All that may be wrong with a run: how probable before the data, and what each leaves of whitened rates."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar

import numpy as np

from hil.campaign import BoolArray, FloatArray, IntArray
from hil.model.effects.prior import COMMON
from hil.solve.whitened import Whitened

ODDS = {
    "rate": 0.05,
    "collect": 0.05,
    "exchanged": 0.02,
    "channels": 0.005,
    "sensors": 0.005,
    "turned": 0.005,
    "all turned": 0.00025,
    "bias": 0.02,
    "MU": 0.02,
    "run": 0.02,
}
"""Prior odds that a campaign has one of a kind; the search has these, too."""
OWN = {"bias": "B", "MU": "MU"}
"""What a run may have of its own, so that nothing is wrong with its rates, and how the names of that begin."""
AS_IT_LAY = float(np.log(1e4))
"""Log odds that labels are exchanged where the unit's accelerometers say so, rather than that these are wrong."""
MOSTLY = float(np.log(COMMON / (1.0 - COMMON)))
"""Log odds that labels which are exchanged in one sensor are so in another that was recorded with it."""
AGAIN = 0.3
"""How probably labels that are exchanged, or signs turned, in one run are so in more: whoever did it did so again."""
WIDE = 30.0
"""Standard errors that what is wrong is off by, unless it is more."""
TOLD = 1e-3
"""Of a rate: where the others leave less, nothing tells what it should be."""
_FELT = 0.1  # of what MU does to the rate that it moves most
_Several = TypeVar("_Several", "Tried", "Runs")


@dataclass(frozen=True)
class Cause:
    """One thing that may be wrong with a run: what, in which `rows` (k,), of some `channels` or, empty, of all.

    `off` is by how much, deg/hr, the row that is off most is in each channel, (c,); nothing where that is no matter.
    `instead` are the rates (k, c) of its rows that the other sensor shows, where the two were exchanged.
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
        return (self.what, self.run, self.rows, None if self.what in OWN else self.channels)


Ways = tuple[FloatArray, FloatArray, Callable[[int], tuple[Cause, ...]]]
"""Log odds (t,) before the data of ways to explain rates, the squares (t,) that they leave, and the causes of each."""


def made_again(times: int, runs: int) -> float:
    """Return the log odds that a mistake was made in one more of so many runs, the `times`-th: any others may be it."""
    return float(np.log(AGAIN * times / (runs - times + 1)))


def all_of(causes: Sequence[str]) -> str:
    """Say of one way to explain rates what is wrong: one thing, or several."""
    return f"{'both ' * (len(causes) == 2)}{', and '.join(causes)}"


@dataclass(frozen=True)
class Tried:
    """Causes (t,) of one sort, each in one of `runs` (t,), which have `rows` (t, k), at a `place` (t, q) among these.

    `off` (t, c) and `instead` (t, k, c) are those of the causes, `moved` (t, k·c) is how each moves its run's rates. Of
    what several runs may have, `values` says which it is, and `along` (t, k·c, q) and `size` (t, c, q) what each of
    these does to its rates, and by how much, deg/hr, to that which is off most.
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
    values: tuple[int, ...] = ()
    along: FloatArray | None = None
    size: FloatArray | None = None

    def one(self, i: int, own: FloatArray | None = None) -> Cause:
        """Return one of them, or with other values (q,) of its run's own."""
        off = () if self.off is None else tuple(self.off[i].tolist())
        if own is not None and self.size is not None:
            off = tuple((self.size[i] @ own).tolist())
        instead = () if self.instead is None else tuple(map(tuple, self.instead[i].tolist()))
        rows = tuple(self.rows[i][self.place[i]].tolist())
        return Cause(self.what, int(self.runs[i]), rows, self.channels, off, instead)

    def ways(self, beside: tuple[Cause, ...] = (), log_odds: float = 0.0) -> Ways:
        """Return them as ways to explain rates, beside a cause that has such log odds."""
        return log_odds + self.log_odds, self.left, lambda i: (*beside, self.one(i))


@dataclass(frozen=True)
class Runs:
    """Rates (m, k, c) of `runs` (m,) that have as many `rows` (m, k): what a change of them leaves of the squares.

    `free` (m, k·c, k·c) and `apart` (m, k·c) are what squares and products of a change add, `may_be` (m, p) the pairs
    of collects, of different positions, that may be exchanged, `mu` (m, k·c, q) what MU of a run does to its rates.
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
    mu: FloatArray

    @classmethod
    def of(cls, rates: Whitened, runs: Collection[int]) -> Iterator[Self]:
        """Yield some runs, by how many rows they have."""
        every, conditions = rates.collects.conditions.of_each_run, rates.collects.conditions
        position = np.unique(conditions.position, return_inverse=True)[1]
        for size in sorted({len(every[run]) for run in runs}):
            own = [run for run in runs if len(every[run]) == size]
            rows, (i, j) = np.array([every[run] for run in own]), np.triu_indices(size, 1)
            free, apart = (np.array(each) for each in zip(*map(rates.of, own), strict=True))
            measured = np.where(known := rates.known[rows], rates.collects.rates_deg_per_hr[rows], np.nan)
            may_be = position[rows[:, i]] != position[rows[:, j]]
            mu = np.array([rates.own(run, "MU") for run in own])
            yield cls(rates.squares, np.array(own), rows, known, rates.weight[rows], measured, free, apart, may_be, mu)

    @property
    def most(self) -> FloatArray:
        """By how much whatever may be wrong with each run lessens the squares at most, (m,)."""
        size, off, _ = off_along(self.free, self.apart)
        return np.asarray(np.sum(off**2 * size, axis=1))

    def rows_off(self) -> Iterator[Tried]:
        """Yield rates, and collects, that may be anywhere."""
        (_, rows, channels), unit = self.known.shape, np.eye(self.free.shape[1])
        for row in range(rows):
            own = unit[:, row * channels : (row + 1) * channels]
            for c in range(channels):
                told = some_of(self, self.known[:, row, c])
                yield from told.anywhere("rate", own[:, [c]], (c,), row, (row * channels + c,))
            yield from some_of(self, self.known[:, row].sum(axis=1) > 1).anywhere("collect", own, (), row)

    def of_its_own(self) -> Iterator[Tried]:
        """Yield another bias of each channel, and of all: a unit that is switched on anew has. And another MU."""
        level = self.weight / np.maximum(self.weight.max(axis=1, keepdims=True), 1e-12)
        columns = (level[..., None] * np.eye(level.shape[2])).reshape(*self.apart.shape, -1)
        for c in range(level.shape[2]):
            told = self.known[..., c].sum(axis=1) > 1
            yield from some_of(self, told).anywhere("bias", columns[told][..., [c]], (c,), values=(c,))
        if level.shape[2] > 1:
            yield from self.anywhere("bias", columns, values=tuple(range(level.shape[2])))
        if self.mu.shape[2]:
            moved = self.mu / np.maximum(np.abs(self.mu).max(axis=(1, 2), keepdims=True), 1e-12)
            felt = (np.abs(moved) > _FELT).sum(axis=(1, 2)) > moved.shape[2]  # else one rate tells it, and is wrong
            for some in ((0,), (1,), (0, 1)):
                yield from some_of(self, felt).anywhere("MU", moved[felt][..., some], values=some)

    def anywhere(
        self,
        what: str,
        columns: FloatArray,
        channels: tuple[int, ...] = (),
        row: int = -1,
        values: tuple[int, ...] = (),
    ) -> Iterator[Tried]:
        """Yield a cause along columns (k·c, q), or (m, k·c, q), of one row or of all; what it pays for that."""
        across = np.swapaxes(columns, -1, -2)
        size, off, directions = off_along(across @ self.free @ columns, (across @ self.apart[..., None])[..., 0])
        row_of_most = np.abs(columns).sum(axis=-1).reshape(-1, *self.known.shape[1:]).sum(axis=(0, 2)).argmax()
        less, paid = explained(size, off)
        most, every = np.s_[:, row if row >= 0 else row_of_most], (len(self.runs), *columns.shape[-2:])
        own_columns = np.broadcast_to(columns, every)
        does = (
            own_columns.reshape(*self.known.shape, columns.shape[-1])[most]
            / np.maximum(self.weight[most], 1e-12)[..., None]
        )
        by = (does @ (directions @ off[..., None]))[..., 0]
        own = {"along": own_columns, "size": does} if values else {}
        tried = replace(self._tried(what, channels, self.squares - less, off=by, **own), log_odds=-paid, values=values)
        yield some_of(tried if row < 0 else replace(tried, place=tried.place[:, [row]]), np.any(size, axis=1))

    def exchanged(self) -> Iterator[Tried]:
        """Yield the pairs of collects that may stand under each other's labels: of many poses there are very many."""
        i, j = np.triu_indices(self.rows.shape[1], 1)
        apart, which = self.measured[:, j] - self.measured[:, i], np.arange(len(i))
        told = self.may_be & np.isfinite(apart).all(axis=2)
        moved = np.zeros((*told.shape, *self.known.shape[1:]))
        moved[:, which, i], moved[:, which, j] = apart * self.weight[:, i], -apart * self.weight[:, j]
        moved = np.where(told[..., None], moved.reshape(*told.shape, self.apart.shape[1]), 0.0)
        left = self.squares + 2.0 * (moved @ self.apart[..., None])[..., 0] + np.sum(moved @ self.free * moved, axis=2)
        m, pair = np.nonzero(told)
        place, own = np.stack([i[pair], j[pair]], axis=1), some_of(self, m)
        yield replace(own._tried("exchanged", (), left[m, pair], moved=moved[m, pair]), place=place)

    def otherwise(self, what: str, rates: FloatArray, channels: tuple[int, ...] = ()) -> Iterator[Tried]:
        """Yield a cause by which other rates (m, k, c), all known, were measured, and what it leaves."""
        moved = np.where(self.weight > 0.0, (rates - self.measured) * self.weight, 0.0).reshape(self.apart.shape)
        left = self.squares + np.sum(moved * (2.0 * self.apart + (self.free @ moved[..., None])[..., 0]), axis=1)
        yield some_of(self._tried(what, channels, left, moved=moved), np.isfinite(left))

    def _tried(self, what: str, channels: tuple[int, ...], left: FloatArray, **of: Any) -> Tried:
        place = np.broadcast_to(np.arange(self.rows.shape[1]), self.rows.shape)
        return Tried(what, channels, self.runs, self.rows, place, left, np.zeros(len(left)), **of)


def explained(size: FloatArray, off: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return by how much less squares are, (m,), with what may be `off` (m, q) anywhere, and what it pays for that."""
    wide = np.maximum(off**2, WIDE**2) * size
    return np.sum(off**2 * size * wide / (1.0 + wide), axis=1), 0.5 * np.log1p(wide).sum(axis=1)


def off_along(squares: FloatArray, products: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return sizes (m, q) of directions (m, q, q) of squares, and how far off products (m, q) are; 0 where untold."""
    size, directions = np.linalg.eigh(squares)
    size = np.where(size > TOLD, size, 0.0)
    off = (np.swapaxes(directions, 1, 2) @ products[..., None])[..., 0] / np.where(size > 0.0, size, np.inf)
    return size, off, directions


def some_of(of: _Several, index: IntArray | BoolArray) -> _Several:
    """Return some of them: those at `index` (k,), or where it says so, (m,)."""
    if index.dtype == bool and index.all():
        return of  # nearly always
    some: dict[str, Any] = {name: own[index] for name, own in vars(of).items() if isinstance(own, np.ndarray)}
    return replace(of, **some)
