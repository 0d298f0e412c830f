"""What the rates do by themselves: ordinary noise, a calibration per temperature, and each scatter of the catalogue.

The covariance of a block of rows is, up to one unknown scale s²,

    V = D + o² O + a² C + Σ t² T

with D the stated white noise, O an offset of each run, C one effect on the scatter, and T values of one of the base's
parameters at each temperature. D with O is ordinary noise; C is a hypothesis with prior odds, as one on the mean is.
All but T is handed on from row to row; T is as many columns as there are temperatures, with sizes that are known.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model.effects.base import Parameter, Scatter, VarianceEffect
from hil.reconcile.search.chains import PIECE, Chain, chain_of, grouped, in_time, joined
from hil.reconcile.search.filters import Filter, filter_of
from hil.reconcile.search.profiles import FIXED, Profile, values_over_temperature
from hil.solve.rows import Block

OFFSETS = (0.0, 0.7, 1.4, 2.8, 5.6, 11.0)
"""Of an offset per run, and of an effect on the scatter, in white noises: 24 runs tell no less than a factor of two.

What is typically larger is tried as far as that and `TAKEN` allow: a walk larger than all that is tried looks as if it
came back."""
TAKEN = 8.0
"""Times what the base leaves of the rates that an effect on the scatter is at most: a base takes most of a walk."""
LEVELS = {0.15: 0.3, 1.0: 0.7}
"""Share of the usual variance in every row's own, with its prior: standard errors leave out what differs by collect."""
HUGE = 10.0
"""Times the usual variance, from which on that of a row says no more of the others'."""
FEWEST_RUNS = 4
"""Runs of which one can be held out, and that tell what changes from one to the next: of fewer, collects do."""
ALIKE = 0.985
"""Covariances of which the cosine is larger are one and the same to these rows."""
LARGEST = 2_500_000
"""Numbers that are whitened at once: twenty megabytes, and still in step with the processor's cache."""
KEPT = 500_000
"""Rows times models of the noise up to which what whitens them is kept: some two hundred megabytes."""
COMPARED = 256
"""Rows by which covariances are compared: what is the same in so many is the same in all."""


@dataclass(frozen=True)
class Kind:
    """An effect on the scatter at one shape, as a block of rows shows it: states that make a mean variance of one.

    `unit_deg_per_hr` is the deviation that they had at unit size.
    """

    effect: VarianceEffect
    shape: Mapping[str, float]
    chain: Chain
    unit_deg_per_hr: float
    parameter: Parameter


@dataclass(frozen=True)
class Points:
    """Models of a block's noise, (t,) each: which kind (-1: ordinary), what of everything, and the log prior within it.

    `profile` is a place in the noise's profiles.
    """

    kind: IntArray
    amount: FloatArray
    offset: FloatArray
    level: FloatArray
    profile: IntArray
    log_prior: FloatArray

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def keys(self) -> Iterator[tuple[float, ...]]:
        """Yield of each what it is a model of, whatever the profile."""
        return zip(*(own.tolist() for own in (self.kind, self.amount, self.offset, self.level)), strict=True)

    def take(self, index: IntArray) -> Points:
        """Return some of the points."""
        return Points(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


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
        self.unit = float(np.mean(np.minimum(block.sigma**2, HUGE * np.median(block.sigma**2))))
        self.white = block.sigma[self.order] ** 2 / self.unit
        apart = np.equal.outer(channel, np.unique(channel)).astype(np.float64)
        self.offset = grouped(apart, run)
        known = [chain_of(part, conditions, rows, channel) for part in stated]
        self.stated = joined([c.scaled(1.0 / np.sqrt(self.unit)) for c in known], len(rows))
        self._laid = by_station, _ = values_over_temperature(block, conditions, self.order)
        self._follow(calibrated=False)
        runs = len(np.unique(run))
        self.has_offsets = runs > 1 and len(rows) / runs / apart.shape[1] > 1.5
        self.kinds = list(self._kinds(conditions, effects, rows, channel, by_station)) if self.has_offsets else []
        ordinary = [self.stated, self.offset]
        self._chains = {k: joined([*ordinary, kind.chain], len(rows)) for k, kind in enumerate(self.kinds)}
        self._chains[-1] = joined(ordinary, len(rows))

    def at_each_temperature(self) -> Noise:
        """Return the same noise beside a base that has values at each temperature, where it was at several."""
        out = copy(self)
        out._follow(calibrated=len(np.unique(self.block.station)) > 1 and bool(self.block.values.shape[1]))
        return out

    def _follow(self, *, calibrated: bool) -> None:
        by_station, shapes = self._laid
        many = by_station.shape[1] * calibrated  # values that stand are the base's own
        self.calibrated, self.by_station = calibrated, by_station[:, :many]
        self._shapes = [own[:many, :many] for own in shapes]
        self._known: dict[int, FloatArray] = {}
        self.profiles: list[Profile] = [(FIXED,) * self.block.values.shape[1]]

    def _kinds(
        self,
        conditions: Conditions,
        effects: Sequence[VarianceEffect],
        rows: IntArray,
        channel: IntArray,
        by_station: FloatArray,
    ) -> Iterator[Kind]:
        """Yield what these rows can tell from ordinary noise and from each other."""
        few = min(len(rows), COMPARED)
        known = [np.eye(few), np.diag(self.white[:few]), self.offset.first(few).covariance]
        # Where nothing was repeated a value that is another in each run is one that is another at each temperature.
        of_values = by_station[:few].reshape(few, self.block.values.shape[1], -1)
        known += [own @ own.T for own in np.moveaxis(of_values, 1, 0) if own.shape[1] > 1]
        known = [_unit(own) for own in known]
        for effect in effects:
            if not effect.applies_to(conditions.sensor) or effect.missing(conditions):
                continue
            for shape in effect.shape_grid(conditions):
                parts = [chain_of(part, conditions, rows, channel) for part in effect.scatter(conditions, shape)]
                chain = joined(parts, len(rows))
                size = float(np.mean(chain.variance))
                own = _unit(chain.first(few).covariance)
                if size <= 0.0 or any(np.vdot(own, other) > ALIKE for other in known):
                    continue
                known.append(own)
                (parameter,) = effect.parameters_for(conditions)[:1]
                yield Kind(effect, shape, chain.scaled(1.0 / np.sqrt(size)), float(np.sqrt(size)), parameter)

    @cached_property
    def grid(self) -> Points:
        """Return ordinary noise and every effect on the scatter beside it, with a base that stands."""
        offsets = OFFSETS if self.has_offsets else OFFSETS[:1]
        levels = LEVELS if np.ptp(self.white) > 1e-6 else {1.0: 1.0}
        rows = [
            (-1, 0.0, offset, level, 0, float(np.log(share / len(offsets))) - _log_offset(offset))
            for offset, (level, share) in product(offsets, levels.items())
        ]
        left = self.block.y - self.block.base @ np.linalg.lstsq(self.block.base, self.block.y)[0]
        most = TAKEN * float(np.sqrt(np.mean(left**2) / self.unit))
        for kind, entry in enumerate(self.kinds):
            of_one = [k for k in self.kinds if k.effect is entry.effect]
            white = float(np.sqrt(self.unit)) / entry.unit_deg_per_hr
            largest = min(entry.parameter.bounds[1] / white, most)
            larger = np.ceil(np.log2(max(largest / OFFSETS[-1], 1.0)) - 0.5)
            amounts = (*OFFSETS[1:], *(OFFSETS[-1] * 2.0 ** (k + 1) for k in range(int(larger))))
            for amount, offset, (level, share) in product(amounts, OFFSETS[:-1], levels.items()):
                value = amount * white
                log_prior = entry.parameter.log_density(value) + float(np.log(np.log(2.0) / len(of_one)))
                log_prior += float(np.log(share / len(offsets))) - _log_offset(offset)
                rows.append((kind, amount, offset, level, 0, log_prior))
        kind_of, amount, offset, level, profile, log_prior = np.array(rows, dtype=np.float64).T
        return Points(kind_of.astype(np.int64), amount, offset, level, profile.astype(np.int64), log_prior)

    def products(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return inner products (t, k, k) of columns (N, k) whitened all over the grid, half the log dets (t,)."""
        gram, half_log_det = np.empty((len(self.grid), *[columns.shape[1]] * 2)), np.empty(len(self.grid))
        most = max(1, LARGEST // max(columns.size, 1))
        for at, own in self._of_grid or self.filters(self.grid):
            half_log_det[at] = own.half_log_det
            for few in (np.arange(first, min(first + most, len(at))) for first in range(0, len(at), most)):
                white = own.take(few).whiten(columns)
                gram[at[few]] = np.swapaxes(white, 1, 2) @ white
        return gram, half_log_det

    @cached_property
    def _of_grid(self) -> Sequence[tuple[IntArray, Filter]]:
        """What whitens all over the grid, none where that is too much to be kept."""
        return list(self._filters(self.grid)) if len(self.grid) * len(self.order) <= KEPT else []

    def filters(self, points: Points) -> Iterator[tuple[IntArray, Filter]]:
        """Yield places (k,) among the points with what whitens there, the base's values apart; the grid's, if kept."""
        place = {own: k for k, own in enumerate(self.grid.keys)}
        of = np.array([place.get(own, -1) for own in points.keys])
        if (len(points) and not (of >= 0).all()) or not self._of_grid:
            yield from self._filters(points)
            return
        for places, own in self._of_grid:
            here = np.flatnonzero(np.isin(of, places))
            if len(here):
                yield here, own.take(np.searchsorted(places, of[here]))

    def _filters(self, points: Points) -> Iterator[tuple[IntArray, Filter]]:
        """So many at once that no piece is larger than some tens of megabytes."""
        most = max(1, LARGEST // (len(self.order) * PIECE))
        alike: dict[tuple[int, bytes], list[int]] = {}
        for kind in np.unique(points.kind).tolist():
            alike.setdefault((len(self._chains[kind]), self._chains[kind].begins.tobytes()), []).append(kind)
        for kinds in alike.values():
            places = np.flatnonzero(np.isin(points.kind, kinds))
            for at in (places[first : first + most] for first in range(0, len(places), most)):
                yield at, self.filter_at(points.take(at))

    def filter_at(self, points: Points, further: FloatArray | None = None, label: IntArray | None = None) -> Filter:
        """Return what whitens at points (t,) whose kinds hand on alike; with a `further` variance (t, N) of rows."""
        kinds = np.unique(points.kind).tolist()
        chains = [self._chains[kind] for kind in kinds]
        each = [len(self.stated), len(self.offset), len(chains[0]) - len(self._chains[-1])]
        sizes = np.repeat(np.stack([np.ones(len(points)), points.offset, points.amount], axis=1), each, axis=1)
        white = self._white(points.level) + (0.0 if further is None else further)
        return filter_of(chains, np.searchsorted(kinds, points.kind), sizes, white, label)

    def factor(self, profile: int) -> FloatArray:
        """Return the factor (r, r) of what is known of the columns `by_station` (N, r) before the data."""
        if profile not in self._known:
            parts = [far * self._shapes[shape] for far, shape in self.profiles[profile]]
            size, stations = len(parts), len(self._shapes[0])
            out = np.zeros((size, stations, size, stations))
            for k, part in enumerate(parts):
                out[k, :, k, :] = part
            self._known[profile] = out.reshape(size * stations, size * stations)
        return self._known[profile]

    def place(self, profile: Profile) -> int:
        """Return the place of a profile, which is kept from now on."""
        if profile not in self.profiles:
            self.profiles.append(profile)
        return self.profiles.index(profile)

    def covariance(self, point: Points, first: int) -> FloatArray:
        """Return V (n, n) of one point for the `first` n rows in the order of time, over the usual white variance."""
        kind, values = int(point.kind[0]), self.by_station[:first] @ self.factor(int(point.profile[0]))
        out = np.diag(self._white(point.level)[0, :first]) + self.stated.first(first).covariance + values @ values.T
        out += point.offset[0] ** 2 * self.offset.first(first).covariance
        return out + (point.amount[0] ** 2 * self.kinds[kind].chain.first(first).covariance if kind >= 0 else 0.0)

    def variance(self, points: Points) -> FloatArray:
        """Return the variance of every row at every point, (t, N), in units of the usual white variance.

        In the block's own order of rows, what base values do over temperature apart.
        """
        out = self._white(points.level) + self.stated.variance + points.offset[:, None] ** 2 * self.offset.variance
        for kind in set(points.kind.tolist()) - {-1}:
            out[points.kind == kind] += np.outer(
                points.amount[points.kind == kind] ** 2, self.kinds[kind].chain.variance
            )
        return np.asarray(out[:, np.argsort(self.order)])

    def stated_variance(self) -> FloatArray:
        """Return the variance that the model states beside the rows' own errors, (N,), (deg/hr)²."""
        return np.asarray(self.unit * self.stated.variance[np.argsort(self.order)])

    def following(self, profile: int) -> FloatArray:
        """Return S (N, r), with SS' what base values that follow temperature add to V, in the block's own order."""
        return np.asarray((self.by_station @ self.factor(profile))[np.argsort(self.order)])

    def _white(self, level: FloatArray) -> FloatArray:
        share = level[:, None]
        return np.asarray((1.0 - share) * self.white + share)


def _log_offset(offset: float) -> float:
    """How much less probable an offset is for its size (log)."""
    return float(np.log1p((offset / 4.0) ** 2))


def _unit(covariance: FloatArray) -> FloatArray:
    """Return a covariance (n, n) over its norm: how alike two are is then their inner product."""
    return np.asarray(covariance / max(float(np.linalg.norm(covariance)), 1e-300))
