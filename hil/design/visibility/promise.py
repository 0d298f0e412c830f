"""From which size on `hil reconcile` names an effect: what its search asks for, in closed form, without any data.

An effect is called missing where sets with it are (1 - α)/α times as probable as nothing, the prior odds of its name,
its shape and its size included. Columns X beside the base with amplitudes N(0, S) make the rows exp(½ s) / √det (1 +
X'X S) times as probable as none, s being the square of what they explain, shrunk. What explains much may also be noise
that is larger: of what a whole run has in common so many runs tell how large it is, of the rest so many rows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaln, ndtr, ndtri

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import Effect, Parameter
from hil.model.effects.prior import ALPHA, HOLDS, UNSEEN, ladder, middle
from hil.solve.causes import ODDS
from hil.solve.identifiability import Visible, Whitener

PROBABILITY = 0.9
"""How probably what is promised is found."""
_SURE = float(ndtri(PROBABILITY))
_LEFT = 4.0
"""Squares that a value may leave of what it explains, as noise of four more rows would."""
_HALVINGS = 20
"""Of a factor: to one in ten thousand, between shapes that differ by a million."""


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


class Rows:
    """Rows as they are whitened, run by run, and an orthonormal `base` (N, b).

    `starts` (r,) is where runs begin, `channel` (N, c) which channel a row is of, in ones and zeros, and `alike` (N, c)
    what moves a channel alike.
    """

    def __init__(self, whiten: Whitener, base: FloatArray, channels: int) -> None:
        rows = np.concatenate([np.zeros(0, dtype=np.int64), *(own.ravel() for own, _ in whiten.blocks)])
        sizes = np.array([size for own, _ in whiten.blocks for size in [own.shape[1]] * len(own)], dtype=np.int64)
        self.starts, self.channel = np.cumsum(sizes) - sizes, np.eye(channels)[rows % channels]
        self.alike = whiten @ np.tile(np.eye(channels), (rows.max(initial=-1) // channels + 1, 1))
        self.base, self.whiten = base, whiten

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
        return np.asarray(every - self.squares(self.base).sum(axis=1))


def found_from(
    effect: Effect,
    conditions: Conditions,
    shapes: Sequence[Mapping[str, float]],
    seen: Sequence[Visible],
    log_prior: float,
    rows: Rows,
) -> tuple[Smallest, ...]:
    """Return from which size on each parameter is found; `log_prior` is that of each of the shapes (k,), `seen` so."""
    parameters = effect.parameters_for(conditions)
    reach, needed = thresholds(effect, conditions, seen, log_prior, rows)
    with np.errstate(divide="ignore"):
        alone = (needed + _SURE) / reach
    largest = np.array([each.largest for each in parameters])
    low, high = np.minimum([alone.min(axis=0), alone.max(axis=0)], largest)
    ever = (high < largest) | (_share(largest, reach, needed) >= PROBABILITY)
    for _ in range(_HALVINGS if np.any(ever & (low < high)) else 0):
        size = np.sqrt(low) * np.sqrt(high)
        enough = _share(size, reach, needed) >= PROBABILITY
        low, high = np.where(enough, low, size), np.where(enough, size, high)
    most, hardest = np.where(ever, high, np.inf), np.where(alone <= high, alone, 0.0).argmax(axis=0)
    easiest = np.where(alone <= largest, alone, np.inf)
    return tuple(
        Smallest(each, float(most[p]), shapes[hardest[p]], float(easiest[k, p]), shapes[k])
        for p, (each, k) in enumerate(zip(parameters, easiest.argmin(axis=0).tolist(), strict=True))
    )


def _share(size: FloatArray, reach: FloatArray, needed: FloatArray) -> FloatArray:
    """Return in which share of nights a size (p,) is found, its shape being any (k, p)."""
    return np.asarray(ndtr(size * reach - needed).sum(axis=0) / len(needed))


def thresholds(
    effect: Effect, conditions: Conditions, seen: Sequence[Visible], log_prior: float, rows: Rows
) -> tuple[FloatArray, FloatArray]:
    """Return by how many deviations a unit of each parameter shows in each shape, and how many it takes, (k, p)."""
    parameters = effect.parameters_for(conditions)
    columns = np.stack([one.residual * (one.kept > UNSEEN) for one in seen])  # (k, N, p)
    centre = np.array([middle(each) for each in parameters])
    sizes, log_weights = ladder(parameters[0].typical)
    blocks = rows.channel.T > 0.0 if effect.per_channel else [slice(None)]  # else a value acts on all channels
    gram = np.stack([np.swapaxes(own, 1, 2) @ own for own in (columns[:, each] for each in blocks)], axis=1)
    values, vectors = np.linalg.eigh(gram * np.multiply.outer(centre, centre))
    values = np.maximum(values, 0.0)
    shrunk = 1.0 + values[..., None] * sizes**2  # (k, b, p, o)
    price = log_weights - 0.5 * np.log(shrunk).sum(axis=2)  # (k, b, o)
    idle = np.logaddexp.reduce(price, axis=2)
    own = np.arange(len(seen))[:, None], np.argmax(np.diagonal(gram, axis1=2, axis2=3), axis=1)  # block of each, (k, p)
    at_rest = idle.sum(axis=1)[:, None] - idle[own]
    log_odds = np.log(1.0 / ALPHA - 1.0) - log_prior - at_rest
    squares = np.stack([rows.squares(one) for one in columns])  # (k, 2c, p)
    shares = squares / np.maximum(squares.sum(axis=1, keepdims=True), 1e-300)
    needed = noise_unknown(2.0 * (log_odds[..., None] - price[own]), shares, rows.freedom)
    # One rate that is wrong, as large, explains what shows in it: the rest has to tell, or the odds of the two.
    log_wrong = np.log((ODDS["rate"] + ODDS["collect"]) / len(rows.channel))
    beside = np.maximum(1.0 - np.stack([rows.in_one(one) for one in columns]), 1e-12)
    needed = np.maximum(needed, np.sqrt(2.0 * np.maximum(log_odds + log_wrong, 0.0) / beside)[..., None])
    turned = (vectors * values[:, :, None] / centre[:, None]) ** 2
    reach = np.sqrt(turned @ (sizes**2 / shrunk))[*own, np.arange(len(parameters))]  # (k, p, o)
    with np.errstate(divide="ignore", invalid="ignore"):
        # What a value far beyond its usual size leaves would have to be noise.
        whole = np.diagonal(gram, axis1=2, axis2=3)[*own, np.arange(len(parameters))][..., None]
        needed = np.where(needed**2 * (whole / reach**2 - 1.0) > _LEFT, np.inf, needed)
        best = np.argmin((needed + _SURE) / reach, axis=2)[..., None]
    return np.take_along_axis(reach, best, 2)[..., 0], np.take_along_axis(needed, best, 2)[..., 0]


def noise_unknown(log_factor: FloatArray, shares: FloatArray, freedom: FloatArray) -> FloatArray:
    """Return the deviations (k, p, o) that make twice a log Bayes factor, where only rows tell how large the noise is.

    Where ν rows do, squares x make ν log(1 + x/ν). Where `shares` f (k, s, p) of x have a `freedom` ν each, that holds
    to the second order with 1/ν = Σ f²/ν. That errors hold is as good as rows to what differs from collect to collect;
    and if nobody knows how wrong they are, as little is left of them: either has to be less probable.
    """
    several = np.arange(len(freedom)) >= len(freedom) // 2
    needed, (right, *_) = [], HOLDS
    for a, _, weight in HOLDS:
        own = np.maximum(freedom + 2.0 * a * several, 1.0)
        per = np.maximum(np.einsum("ksp,s->kp", shares**2, 1.0 / own), 1e-12)[..., None]
        rows = np.maximum(1.0 / per - 2.0 * a, 1.0)
        less = 2.0 * (np.log(right[2] / weight) + _evidence(right[0], rows) - _evidence(a, rows))
        with np.errstate(over="ignore"):
            needed.append(np.sqrt(np.expm1(np.maximum(log_factor - less, 0.0) * per) / per))
    return np.asarray(np.max(needed, axis=0))


def _evidence(a: float, rows: FloatArray) -> FloatArray:
    """Return the log evidence of rows that scatter as they are stated, by errors that are right to inverse-gamma a."""
    return np.asarray(gammaln(a + 0.5 * rows) - gammaln(a) + a * np.log(a) - (a + 0.5 * rows) * np.log(a + 0.5 * rows))
