"""What the rates do by themselves: ordinary noise, a calibration per temperature, and each scatter of the catalogue.

The covariance of a block of rows is, up to one unknown scale s²,

    V = D + o² O + Σ a² C + Σ t² T

with D the stated white noise, O an offset of each run, C effects on the scatter, and T values of one of the base's
parameters at each temperature. D with O is ordinary noise; a C is a hypothesis with prior odds, as one on the mean is.
All but T is handed on from row to row; T is as many columns as there are temperatures, with sizes that are known.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from functools import cached_property
from itertools import product

import numpy as np

from hil.campaign import BoolArray, Conditions, FloatArray, IntArray
from hil.model.effects.base import VarianceEffect
from hil.model.effects.prior import OFFSETS, log_offset, scatter_log_odds, sizes_up_to
from hil.model.effects.scatter import Scatter
from hil.reconcile.search.chains import COMPARED, PIECE, Chain, chain_of, grouped, in_time, joined
from hil.reconcile.search.filters import Filter, filter_of
from hil.reconcile.search.points import FOLLOWS, LEVELS, Kind, Points, Profile, log_profile, values_over_temperature
from hil.solve.rows import Block

TAKEN = 8.0
"""Times what the base leaves of the rates that an effect on the scatter is at most: a base takes most of a walk."""
SHOWN = 2.0  # and that an offset from run to run is: a base takes next to nothing of those
HUGE = 10.0  # times the usual variance, from which on that of a row says no more of the others'
TOGETHER = 2
"""Effects on the scatter that are weighed together: no night tells three from two."""
FEWEST_RUNS = 4
"""Runs of which one can be held out, and that tell what changes from one to the next: of fewer, collects do."""
ALIKE = 0.985  # covariances of which the cosine is larger are one and the same to these rows
LARGEST = 2_500_000
"""Numbers that are whitened at once: twenty megabytes, and still in step with the processor's cache."""
KEPT = 500_000
"""Rows times models of the noise up to which what whitens them is kept: some two hundred megabytes."""


class Noise:
    """The parts of a block's covariance, in units of its usual white variance; rows are in the order of time."""

    def __init__(
        self,
        block: Block,
        conditions: Conditions,
        effects: Sequence[VarianceEffect],
        stated: Sequence[Scatter] = (),
    ) -> None:
        """`stated` is what the model states beside D. The base has values that stand."""
        self.block, self.conditions = block, conditions
        self.order = in_time(conditions, block.rows)
        rows, channel, run = (own[self.order] for own in (block.rows, block.channel, block.run))
        self.unit = _usual(block.sigma**2)
        self.white = block.sigma[self.order] ** 2 / self.unit
        apart = np.equal.outer(channel, np.unique(channel)).astype(np.float64)
        self.usual = apart @ np.array([_usual(self.white[own]) for own in apart.T > 0.0])
        self.offset = grouped(apart, run)
        known = [chain_of(part, conditions, rows, channel) for part in stated]
        self.stated = joined([c.scaled(1.0 / np.sqrt(self.unit)) for c in known], len(rows))
        self._laid = values_over_temperature(block, conditions, self.order)
        self._follow(calibrated=False)
        runs = len(np.unique(run))
        self.has_offsets = runs > 1 and len(rows) / runs / apart.shape[1] > 1.5
        self.alike: dict[str, dict[str, float]] = {}  # by name what is the same here, so many times as probable
        self.kinds = list(self._kinds(effects, rows, channel)) if self.has_offsets else []
        self.sorts = list(dict.fromkeys(frozenset({name} - {""}) for name in ("", *(k.name for k in self.kinds))))
        self._chains: dict[bytes, Chain] = {}
        self._whitens: list[tuple[IntArray, Filter]] = []
        self._shown: tuple[FloatArray, FloatArray, FloatArray] = (np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros(0))
        *_, offsets, levels = self._tried
        self.grid = self._at([[0.0] * len(self.kinds) + [*both] for both in product(offsets, levels)])
        self.grow(self.grid.take(np.flatnonzero(self.grid.offset < max(offsets))))

    def at_each_temperature(self) -> "Noise":
        """Return the same noise beside a base that has values at each temperature, where it was at several."""
        out = copy(self)
        out.sorts, out._whitens = [*self.sorts], [*self._whitens]
        out._follow(calibrated=len(np.unique(self.block.station)) > 1 and bool(self.block.values.shape[1]))
        return out

    def _follow(self, *, calibrated: bool) -> None:
        by_station, shapes = self._laid
        many = by_station.shape[1] * calibrated  # values that stand are the base's own
        self.calibrated, self.by_station = calibrated, by_station[:, :many]
        self._shapes = [own[:many, :many] for own in shapes]
        self._known: dict[int, FloatArray] = {}
        self.profiles: dict[Profile, int] = {FOLLOWS[:1] * self.block.values.shape[1]: 0}  # with their places

    def _kinds(self, effects: Sequence[VarianceEffect], rows: IntArray, channel: IntArray) -> Iterator[Kind]:
        """Yield what these rows can tell from ordinary noise and each other; what is `alike` is kept apart."""
        ordinary = [np.eye(len(self.offset.covariance)), np.diag(self.white[:COMPARED]), self.offset.covariance]
        known, conditions = [("", 1.0, _unit(own)) for own in ordinary], self.conditions
        for effect in effects:
            if not effect.applies_to(conditions.sensor) or effect.missing(conditions):
                continue
            grid = effect.shape_grid(conditions)
            for shape in grid:
                parts = [chain_of(part, conditions, rows, channel) for part in effect.scatter(conditions, shape)]
                chain = joined(parts, len(rows))
                size = float(np.mean(chain.variance))
                if size <= 0.0:
                    continue
                chain = chain.scaled(1.0 / np.sqrt(size))
                own, odds = _unit(chain.covariance), effect.odds / len(grid)
                same = next((each for each in known if np.vdot(own, each[2]) > ALIKE), None)
                if same is not None:
                    if same[0] not in ("", effect.id):
                        self.alike.setdefault(same[0], {})[effect.id] = odds / same[1]
                    continue
                (parameter,) = effect.parameters_for(conditions)[:1]
                name = effect.id if self.block.sigma_stated or np.triu(own, 1).any() else ""
                known.append((name if len(grid) == 1 else "", odds, own))
                yield Kind(name, effect, shape, chain, float(np.sqrt(size)), parameter)

    @cached_property
    def _tried(self) -> list[dict[float, float]]:
        """Sizes of every kind, of an offset, and levels that are tried, with the log prior of each."""
        levels = LEVELS if np.ptp(self.white / self.usual) > 1e-6 else {1.0: 1.0}
        left = self.block.y - self.block.base @ np.linalg.lstsq(self.block.base, self.block.y)[0]
        seen = float(np.sqrt(np.mean(left**2) / self.unit))
        offsets = (OFFSETS[0], *sizes_up_to(SHOWN * seen)) if self.has_offsets else OFFSETS[:1]
        out = []
        for entry in self.kinds:
            share = np.log(2.0) / sum(k.effect is entry.effect for k in self.kinds)
            white = float(np.sqrt(self.unit)) / entry.unit_deg_per_hr
            amounts = sizes_up_to(min(entry.parameter.bounds[1] / white, TAKEN * seen))
            own = {size: entry.parameter.log_density(size * white) + float(np.log(share)) for size in amounts}
            out.append({0.0: 0.0, **own})
        out.append({size: -float(np.log(len(offsets))) - log_offset(size) for size in offsets})
        return [*out, {level: float(np.log(share)) for level, share in levels.items()}]

    def _at(self, sizes: Sequence[Sequence[float]]) -> Points:
        """Return models of which each has sizes (v + 2,) of everything, and values that stand."""
        of = [frozenset(k.name for k, size in zip(self.kinds, own, strict=False) if k.name and size) for own in sizes]
        self.sorts += [own for own in dict.fromkeys(of) if own not in self.sorts]
        log_prior = [sum(known[size] for known, size in zip(self._tried, own, strict=True)) for own in sizes]
        every = np.array(sizes)
        amount, offset, level = every[:, :-2], every[:, -2], every[:, -1]
        sort, stand = np.array([self.sorts.index(own) for own in of]), np.zeros(len(sizes), dtype=np.int64)
        return Points(sort, amount, offset, level, stand, np.array(log_prior))

    def grow(self, points: Points) -> bool:
        """Add to the grid what differs in one thing from some points, and tell whether any is new.

        That may be one more effect on the scatter, up to `TOGETHER`, each in one shape at a time.
        """
        known = {*self.grid.keys}
        new: dict[bytes, FloatArray] = {}
        for (own, sort), (place, tried) in product(zip(points.sizes, points.sort, strict=True), enumerate(self._tried)):
            alike = [place]
            if place < len(self.kinds):
                effect, name = self.kinds[place].effect, self.kinds[place].name
                alike = [k for k, kind in enumerate(self.kinds) if kind.effect is effect]
                if len(self.sorts[sort] | {name} - {""}) > TOGETHER:
                    continue
            for size in tried:
                other = own.copy()
                other[alike] = 0.0
                other[place] = size
                if other.tobytes() not in known:
                    new[other.tobytes()] = other
        if new:
            self.grid = self.grid.beside(self._at([own.tolist() for own in new.values()]))
        return bool(new)

    def products(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return inner products (t, k, k) of columns (N, k) whitened on the grid, half the log dets (t,), made once."""
        asked, known = ([own.tobytes() for own in each.T] for each in (columns, self._shown[0]))
        if not {*asked} <= {*known}:
            known, self._shown = asked, (columns, np.zeros((0, len(asked), len(asked))), np.zeros(0))
        given, gram, half_log_det = self._shown
        new, most = np.arange(len(gram), len(self.grid)), max(1, LARGEST // max(given.size, 1))
        more, further = np.empty((len(new), *gram.shape[1:])), np.empty(len(new))
        for at, own in self.filters(self.grid.take(new)) if len(new) else ():
            further[at] = own.half_log_det
            for few in np.split(np.arange(len(at)), range(most, len(at), most)):
                white = own.take(few).whiten(given)
                more[at[few]] = np.swapaxes(white, 1, 2) @ white
        if len(new):
            gram, half_log_det = np.concatenate([gram, more]), np.concatenate([half_log_det, further])
        self._shown = given, gram, half_log_det
        index = np.array([known.index(own) for own in asked])
        return gram if asked == known else gram[:, index[:, None], index], half_log_det

    def filters(self, points: Points) -> Iterator[tuple[IntArray, Filter]]:
        """Yield places (k,) among the points with what whitens there, the base's values apart; the grid's are kept."""
        place = {key: k for k, key in enumerate(self.grid.keys)}
        of = np.array([place.get(key, -1) for key in points.keys], dtype=np.int64)
        if len(self.grid) * len(self.order) > KEPT or (of < 0).any():
            yield from self._filters(points)
            return
        new = np.arange(sum(len(places) for places, _ in self._whitens), len(self.grid))
        self._whitens += [(new[at], own) for at, own in self._filters(self.grid.take(new))]
        for places, own in self._whitens:
            here = np.flatnonzero(np.isin(of, places))
            if len(here):
                yield here, own.take(np.searchsorted(places, of[here]))

    def _filters(self, points: Points) -> Iterator[tuple[IntArray, Filter]]:
        """So many at once that no piece is larger than some tens of megabytes."""
        most = max(1, LARGEST // (len(self.order) * PIECE))
        alike: dict[tuple[int, bytes], list[int]] = {}
        for t, there in enumerate(points.amount > 0.0):
            chain = self._chain(there)
            alike.setdefault((len(chain), chain.begins.tobytes()), []).append(t)
        for places in map(np.array, alike.values()):
            for at in (places[first : first + most] for first in range(0, len(places), most)):
                yield at, self.filter_at(points.take(at))

    def _chain(self, there: BoolArray) -> Chain:
        """Return what rows hand on beside some of the kinds, of which `there` (v,) tells."""
        key = there.tobytes()
        if key not in self._chains:
            kinds = [kind.chain for kind, has in zip(self.kinds, there, strict=True) if has]
            self._chains[key] = joined([self.stated, self.offset, *kinds], len(self.order))
        return self._chains[key]

    def filter_at(self, points: Points, label: IntArray | None = None) -> Filter:
        """Return what whitens at points (t,) whose kinds hand on alike, in pieces that a `label` (N,) cuts."""
        there = points.amount > 0.0
        kept, of = np.unique(there, axis=0, return_inverse=True)
        many = [len(self.stated), len(self.offset), *(len(kind.chain) for kind in self.kinds)]
        every = np.column_stack([np.ones(len(points)), points.offset, points.amount])
        states = np.array([np.repeat(np.arange(len(many)), many * np.append([True, True], has)) for has in kept])
        sizes = np.take_along_axis(every, states[of.ravel()], axis=1)
        white = self._white(points.level)
        return filter_of([self._chain(has) for has in kept], of.ravel(), sizes, white, label)

    def log_odds(self, points: Points) -> FloatArray:
        """Return the log odds of what scatters at every point beside the likeliest of it, (t,)."""
        odds = scatter_log_odds(kind.effect for kind in self.kinds if kind.name)
        each = [[odds[name] for name in sort] for sort in self.sorts]
        return np.array([sum(own) - max(own, default=0.0) for own in each])[points.sort]

    def factor(self, profile: int) -> FloatArray:
        """Return the factor (r, r) of what is known of the columns `by_station` (N, r) before the data."""
        if profile not in self._known:
            parts = [far * self._shapes[shape] for far, shape in [*self.profiles][profile]]
            size, stations = len(parts), len(self._shapes[0])
            out = np.zeros((size, stations, size, stations))
            for k, part in enumerate(parts):
                out[k, :, k, :] = part
            self._known[profile] = out.reshape(size * stations, size * stations)
        return self._known[profile]

    def place(self, profile: Profile) -> int:
        """Return the place of a profile, which is kept from now on."""
        return self.profiles.setdefault(profile, len(self.profiles))

    def log_profile(self, profile: Profile) -> float:
        """Return the log prior of a profile, where values may follow temperature."""
        return log_profile(profile) if self.calibrated else 0.0

    def covariance(self, point: Points) -> FloatArray:
        """Return V (n, n) of one point for the first `COMPARED` rows in time, over the usual white variance."""
        values = self.by_station[:COMPARED] @ self.factor(int(point.profile[0]))
        out = np.diag(self._white(point.level)[0, :COMPARED]) + self.stated.covariance + values @ values.T
        sizes, chains = [*point.offset, *point.amount[0]], [self.offset, *(kind.chain for kind in self.kinds)]
        for size, chain in zip(sizes, chains, strict=True):
            out += size**2 * chain.covariance if size else 0.0
        return np.asarray(out)

    def variance(self, points: Points) -> FloatArray:
        """Return the variance of every row at every point, (t, N), in units of the usual white variance.

        In the block's own order of rows, what base values do over temperature apart.
        """
        out = self._white(points.level) + self.stated.variance + points.offset[:, None] ** 2 * self.offset.variance
        for amount, kind in zip(points.amount.T, self.kinds, strict=True):
            out = out + np.outer(amount**2, kind.chain.variance)
        return np.asarray(out[:, np.argsort(self.order)])

    def stated_variance(self) -> FloatArray:
        """Return the variance that the model states beside the rows' own errors, (N,), (deg/hr)²."""
        return np.asarray(self.unit * self.stated.variance[np.argsort(self.order)])

    def following(self, profile: int) -> FloatArray:
        """Return S (N, r), with SS' what base values that follow temperature add to V, in the block's own order."""
        return np.asarray((self.by_station @ self.factor(profile))[np.argsort(self.order)])

    def _white(self, level: FloatArray) -> FloatArray:
        return np.asarray(self.white + level[:, None] * (self.usual - self.white))


def _usual(variance: FloatArray) -> float:
    """Return the mean of variances (k,), of which one that is huge says nothing of the others'."""
    return float(np.mean(np.minimum(variance, HUGE * np.median(variance))))


def _unit(covariance: FloatArray) -> FloatArray:
    """Return a covariance (n, n) over its norm: how alike two are is then their inner product."""
    return np.asarray(covariance / max(float(np.linalg.norm(covariance)), 1e-300))
