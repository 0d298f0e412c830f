"""From which size on `hil reconcile` names an effect: what its search asks for, in closed form, without any data.

Something is called missing where sets with effects are (1 - α)/α times as probable as nothing, the prior odds of names,
shapes and sizes included. Columns X beside the base with amplitudes N(0, S) cost √det (1 + X'X S), and leave of what
shows what is not like them. Nothing has to explain it by noise that is larger: of a scale, and with offsets from run to
run, that the search has priors of, and of which so many runs and rows beside the base tell how large they are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaln, ndtr, ndtri

from hil.campaign import FloatArray
from hil.model.effects.base import Effect, Parameter
from hil.model.effects.prior import ALPHA, HOLDS, UNSEEN, ladder, log_offset, log_sum, middle, sizes_up_to
from hil.solve.causes import ODDS
from hil.solve.identifiability import Visible, Whitener

PROBABILITY = 0.9
"""How probably what is promised is found."""
_SURE = float(ndtri(PROBABILITY))
DEVIATIONS = np.append(0.0, np.geomspace(0.3, 1e4, 100))
"""Deviations that an effect may show, (d,): what is between is as near as a search's own sizes are."""
USUAL = 41
"""By so many of them, up to twenty, most effects are found; the others are asked again by all."""
_ALIKE = 0.75  # what explains a smaller part of the squares hardly adds to the odds of what explains them
_LARGEST = 100.0  # of an offset from run to run, in white noises
_HALVINGS = 20  # of a factor: to one in ten thousand, between shapes that differ by a million


@dataclass(frozen=True)
class Smallest:
    """From which size on one parameter is found with the promised probability when it acts alone; infinite where never.

    The `value` is that of nights of any shape, of which it takes `shape` to be found; `easiest` that of the easiest.
    """

    parameter: Parameter
    value: float
    shape: Mapping[str, float]
    easiest: float
    easiest_shape: Mapping[str, float]


@dataclass(frozen=True)
class Asked:
    """An effect in some `shapes` (k,), how each is `seen` (k,), and the `log_prior` of each before the data."""

    effect: Effect
    parameters: tuple[Parameter, ...]
    shapes: Sequence[Mapping[str, float]]
    seen: Sequence[Visible]
    log_prior: float


class Rows:
    """Rows as they are whitened, run by run, an orthonormal `base` (N, b), and white noise `sigma` (n, c), deg/hr.

    `starts` (r,) is where runs begin, `channel` (N, c) which channel a row is of, in ones and zeros, and `alike` (N, c)
    what moves a channel alike.
    """

    def __init__(self, whiten: Whitener, base: FloatArray, sigma: FloatArray) -> None:
        channels = sigma.shape[1]
        rows = np.concatenate([np.zeros(0, dtype=np.int64), *(own.ravel() for own, _ in whiten.blocks)])
        sizes = np.array([size for own, _ in whiten.blocks for size in [own.shape[1]] * len(own)], dtype=np.int64)
        self.starts, self.channel = np.cumsum(sizes) - sizes, np.eye(channels)[rows % channels]
        self.alike = whiten @ np.tile(np.eye(channels), (len(sigma), 1))
        self.base, self.whiten, self.white = base, whiten, sigma.ravel()[rows, None] ** 2

    def squares(self, white: FloatArray) -> FloatArray:
        """Return the squares (2c, p) of columns (N, p) by channel: of what a whole run has in common, then the rest."""
        sums = np.add.reduceat(self.alike[:, :, None] * white[:, None, :], self.starts)
        norms = np.maximum(np.add.reduceat(self.alike**2, self.starts), 1e-300)[:, :, None]
        shared = np.sum(sums**2 / norms, axis=0)
        return np.concatenate([shared, np.maximum(self.channel.T @ white**2 - shared, 0.0)])

    def in_one(self, white: FloatArray) -> FloatArray:
        """Return how much of the squares (p,) of columns (N, p) beside the base a single wrong rate can explain."""
        own = [np.sum(block**2, axis=1).ravel() for _, block in self.whiten.blocks]
        left = np.concatenate([np.zeros(0), *own]) - np.sum(self.whiten.back(self.base) ** 2, axis=1)
        along = self.whiten.back(white) ** 2 / np.where(left > UNSEEN**2 * left.max(initial=0.0), left, np.inf)[:, None]
        return np.asarray(along.max(axis=0, initial=0.0) / np.maximum(np.sum(white**2, axis=0), 1e-300))

    @cached_property
    def freedom(self) -> FloatArray:
        """How many directions (2c,) the base leaves, as `squares` has them."""
        runs = np.sum(np.add.reduceat(self.channel, self.starts) > 0.0, axis=0)
        every = np.concatenate([runs, self.channel.sum(axis=0) - runs])
        return np.asarray(np.maximum(every - self.squares(self.base).sum(axis=1), 0.0))

    @cached_property
    def known(self) -> FloatArray:
        """By how many directions (2c,) it is known how large the noise is: white noise by stated errors, too."""
        stated = 2.0 * HOLDS[0][0] * HOLDS[0][2]
        within = np.arange(len(self.freedom)) >= len(self.freedom) // 2
        return np.asarray(np.maximum(self.freedom, 1.0) + stated * within)

    @cached_property
    def offsets(self) -> tuple[FloatArray, FloatArray]:
        """The log priors (t,) of offsets from run to run, and by what they multiply the variance of a run, (c, t)."""
        sizes = np.array([0.0, *sizes_up_to(_LARGEST)])
        rows = np.add.reduceat(self.channel, self.starts)
        there = rows > 0.0
        assumed = np.add.reduceat(self.alike**2, self.starts)  # what is known of a run's mean, over its variance
        mean = np.divide(
            1.0, np.add.reduceat(self.channel / self.white, self.starts), where=there, out=np.zeros(rows.shape)
        )
        usual = np.sum(self.channel * self.white, axis=0) / np.maximum(self.channel.sum(axis=0), 1.0)
        every = assumed[..., None] * (mean[..., None] + usual[:, None] * sizes**2)  # (r, c, t)
        runs = there.sum(axis=0)[:, None]
        none = np.ones((len(runs), len(sizes)))  # of a channel without rows nothing is more
        times = np.divide(every.sum(axis=0), runs, where=runs > 0, out=none)
        return -np.array([log_offset(size) for size in sizes]), times

    def log_evidence(self, shares: FloatArray, deviations: FloatArray = DEVIATIONS) -> FloatArray:
        """Return how probable noise makes rows (log) that show so many deviations (d,), (…, d), up to a constant.

        `shares` (…, 2c) of squares are by channel, as `squares` has them; other directions have what noise makes. It is
        of any scale, as far as stated errors hold, and has offsets of any size from run to run, as in a search.
        """
        squares = np.maximum(shares[..., None, :] * (deviations[:, None] ** 2 - 1.0) + self.freedom, 0.0)
        of_runs, rest = np.split(squares[..., None], 2, axis=-2)  # (…, d, c, 1)
        (runs, others), (log_prior, times) = np.split(self.freedom[:, None], 2), self.offsets
        out = []
        for a, b, weight in HOLDS:
            power = a + 0.5 * (runs + others)
            log_scale = np.log(weight) + a * np.log(b) - gammaln(a) + gammaln(power)
            fits = power * np.log(b + 0.5 * (of_runs / times + rest)) + 0.5 * runs * np.log(times)
            out.append(log_sum(log_prior + log_scale - fits, -1))
        return np.asarray(np.logaddexp.reduce(out, axis=0).sum(axis=-1))


def found_from(every: Sequence[Asked], rows: Rows) -> list[tuple[Smallest, ...]]:
    """Return of each effect from which size on each parameter is found."""
    return [_smallest(*each) for each in zip(every, *thresholds(every, rows), strict=True)]


def _smallest(asked: Asked, reach: FloatArray, needed: FloatArray) -> tuple[Smallest, ...]:
    with np.errstate(divide="ignore"):
        alone = (needed + _SURE) / reach
    largest = np.array([each.largest for each in asked.parameters])
    low, high = np.minimum([alone.min(axis=0), alone.max(axis=0)], largest)
    ever = (high < largest) | (_share(largest, reach, needed) >= PROBABILITY)
    for _ in range(_HALVINGS if np.any(ever & (low < high)) else 0):
        size = np.sqrt(low) * np.sqrt(high)
        enough = _share(size, reach, needed) >= PROBABILITY
        low, high = np.where(enough, low, size), np.where(enough, size, high)
    most, hardest = np.where(ever, high, np.inf), np.where(alone <= high, alone, 0.0).argmax(axis=0)
    easiest, shapes = np.where(alone <= largest, alone, np.inf), asked.shapes
    return tuple(
        Smallest(each, float(most[p]), shapes[hardest[p]], float(easiest[k, p]), shapes[k])
        for p, (each, k) in enumerate(zip(asked.parameters, easiest.argmin(axis=0).tolist(), strict=True))
    )


def _share(size: FloatArray, reach: FloatArray, needed: FloatArray) -> FloatArray:
    """Return in which share of nights a size (p,) is found, its shape being any (k, p)."""
    return np.asarray(ndtr(size * reach - needed).sum(axis=0) / len(needed))


def thresholds(every: Sequence[Asked], rows: Rows) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return of each effect by how many deviations a unit of each parameter shows, and how many it takes, (k, p).

    What shows is explained by the effect, by any other as far as it is like it, or by nothing: by noise that is as
    large, or by one rate that is wrong. How much it takes scatters with the noise that rows show.
    """
    shown = [np.concatenate([one.residual * (one.kept > UNSEEN) for one in asked.seen], axis=1) for asked in every]
    directions = np.concatenate(shown, axis=1)  # (N, m), shape by shape
    whole = np.linalg.norm(directions, axis=0)
    directions /= np.maximum(whole, 1e-300)
    priced = [_sizes(asked, columns, rows) for asked, columns in zip(every, shown, strict=True)]
    odds = _below_each_other([each for each, _ in priced], -np.inf)  # (m, o)
    share = _below_each_other([each for _, each in priced], 0.0)
    many = [len(asked.parameters) for asked in every for _ in asked.shapes]
    shape = np.repeat(np.arange(len(many)), many)
    shares = rows.squares(directions).T
    alike, in_one = (directions.T @ directions) ** 2, rows.in_one(directions)
    log_wrong = np.log((ODDS["rate"] + ODDS["collect"]) / len(rows.channel))
    needed = np.full(len(whole), np.inf)
    for deviations in (DEVIATIONS[:USUAL], DEVIATIONS):
        unfound = np.flatnonzero((whole > 0.0) & np.isinf(needed))
        for m, table in zip(unfound.tolist(), rows.log_evidence(shares[unfound], deviations), strict=True):
            near = np.flatnonzero(alike[m] > _ALIKE)
            sizes = _at(table, 1.0 - alike[m, near, None] * share[near]) + odds[near, :, None]
            of_column = log_sum(sizes, 1)
            of_shape = np.maximum.reduceat(of_column, np.flatnonzero(np.diff(shape[near], prepend=-1)))
            nothing = np.logaddexp(table, log_wrong + _at(table, 1.0 - in_one[m]))
            needed[m] = _first(log_sum(of_shape, 0) - nothing - np.log(1.0 / ALPHA - 1.0))
    scatter = np.ones(len(whole))
    found = np.isfinite(needed)
    scatter[found] = np.hypot(1.0, needed[found] * np.sqrt(0.5 * np.sum(shares[found] ** 2 / rows.known, axis=1)))
    ends = np.cumsum([columns.shape[1] for columns in shown])[:-1]

    def by_effect(each: FloatArray) -> list[FloatArray]:
        parts = zip(every, np.split(each / scatter, ends), strict=True)
        return [own.reshape(len(asked.seen), -1) for asked, own in parts]

    return by_effect(whole), by_effect(needed)


def _sizes(asked: Asked, columns: FloatArray, rows: Rows) -> tuple[FloatArray, FloatArray]:
    """Return of each column (N, m) and size the log prior odds, others at rest, and the share that it explains, (m, o).

    An amplitude that is larger than it may be pays for it in what is left.
    """
    centre = np.array([middle(each) for each in asked.parameters])
    sizes, log_weights = ladder(asked.parameters[0].typical)
    by_shape = np.moveaxis(columns.reshape(len(columns), len(asked.seen), -1), 1, 0)  # (k, N, p)
    blocks = rows.channel.T > 0.0 if asked.effect.per_channel else [slice(None)]  # else a value acts on all channels
    gram = np.stack([np.swapaxes(own, 1, 2) @ own for own in (by_shape[:, each] for each in blocks)], axis=1)
    values, vectors = np.linalg.eigh(gram * np.multiply.outer(centre, centre))
    values = np.maximum(values, 0.0)
    shrunk = 1.0 + values[..., None] * sizes**2  # (k, b, p, o)
    price = log_weights - 0.5 * np.log(shrunk).sum(axis=2)  # (k, b, o)
    idle = np.logaddexp.reduce(price, axis=2)
    whole = np.diagonal(gram, axis1=2, axis2=3)  # (k, b, p)
    own = np.arange(len(asked.seen))[:, None], np.argmax(whole, axis=1)  # block of each, (k, p)
    turned = (vectors * values[:, :, None] / centre[:, None]) ** 2
    explained = (turned @ (sizes**2 / shrunk))[*own, np.arange(len(centre))]  # (k, p, o)
    all_of_it = whole[*own, np.arange(len(centre))][..., None]
    share = np.divide(explained, all_of_it, where=all_of_it > 0.0, out=np.zeros_like(explained))
    odds = asked.log_prior + price[own] + (idle.sum(axis=1)[:, None] - idle[own])[..., None]
    return odds.reshape(-1, len(sizes)), np.minimum(share, 1.0).reshape(-1, len(sizes))


def _below_each_other(tables: Sequence[FloatArray], fill: float) -> FloatArray:
    """Return tables (m, o) of some sizes each below each other, as wide as the widest."""
    most = max(table.shape[1] for table in tables)
    return np.concatenate([np.pad(t, ((0, 0), (0, most - t.shape[1])), constant_values=fill) for t in tables])


def _at(table: FloatArray, share: FloatArray) -> FloatArray:
    """Return a log evidence of the first deviations, (d,), where a share (…) of squares is left, (…, d)."""
    deviations = DEVIATIONS[: len(table)]
    return np.asarray(np.interp(deviations * np.sqrt(np.maximum(share, 0.0))[..., None], deviations, table))


def _first(excess: FloatArray) -> float:
    """Return the deviations from which on a log (d,) is more than nothing; infinite where it never is."""
    if not np.any(excess > 0.0):
        return np.inf
    at = max(int(np.argmax(excess > 0.0)), 1)
    return float(np.interp(0.0, excess[at - 1 : at + 1], DEVIATIONS[at - 1 : at + 1]))
