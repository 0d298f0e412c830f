"""One block of rows as it is searched: the noise that its rows leave probable, and what whitens any columns there."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.model.effects.prior import HOLDS
from hil.reconcile.search.evidence import SEEN, Beside, Scale, less
from hil.reconcile.search.filters import Filter
from hil.reconcile.search.likely_noise import likely_points
from hil.reconcile.search.noise import KEPT, Noise
from hil.reconcile.search.points import Points
from hil.solve.identifiability import independent_columns
from hil.solve.rows import Block

SCANNED = 6  # points of the noise at which every term is tried: a scan proposes, and what it proposes is weighed at all
GLANCED = 4
"""Points at which terms are tried beside which the noise is then looked at anew, and first of all many units."""


@dataclass
class BlockSearch:
    """One block: its rows `y` (N,) in units of its noise, the points at which it is weighed, those scanned (t,)."""

    block: Block
    noise: Noise
    points: Points
    scales: Sequence[Scale]
    y: FloatArray
    unit: float
    beside: Beside = field(init=False)
    scanned: IntArray = field(init=False)
    _filters: Sequence[tuple[IntArray, Filter]] = ()

    @classmethod
    def of(cls, block: Block, noise: Noise) -> "BlockSearch":
        """Weigh the block at the noise that its rows leave probable."""
        unit = float(np.sqrt(noise.unit))
        scales = HOLDS if block.sigma_stated else HOLDS[1:]
        out = cls(block, noise, noise.grid, scales, block.y / unit, unit)
        out.choose([np.zeros((len(block.y), 0))])
        out.scanned = out.scanned[:GLANCED]
        return out

    def choose(self, extras: Sequence[FloatArray], units: Sequence[FloatArray] = ()) -> None:
        """Keep the points that are probable with one of several further columns (N, q) in the base.

        For one of several `units`, whose rates are (N,) deg/hr each, where such are given.
        """
        data = [y / self.unit for y in units] or [self.y]
        self.points, best = likely_points(self.noise, self.scales, data, self.block.base, extras)
        self.scanned, self._filters = np.argsort(-best)[:SCANNED], ()
        self.measure(self.y)

    def add(self, extras: Sequence[FloatArray]) -> None:
        """Keep more points: those that are probable with one of several further columns (N, q) in the base.

        And quieter ones than beside the first, which are scanned: a further term may explain what is left to scatter.
        """
        more, beside = likely_points(self.noise, self.scales, [self.y], self.block.base, extras, quieter=True)
        best, known = int(np.argmax(beside)), {key: k for k, key in enumerate(self.points.told_by)}
        for key in more.told_by:
            known.setdefault(key, len(known))
        place = np.array([known[key] for key in more.told_by])
        self.points, self._filters = self.points.beside(more.take(np.flatnonzero(place >= len(self.points)))), ()
        self.scanned = place[np.append(best, np.flatnonzero(more.quieter(best)))]
        self.measure(self.y)

    def measure(self, y: FloatArray) -> None:
        """Take other data (N,), in units of the noise."""
        self.y = y
        base = independent_columns(self.block.base, SEEN)
        rows = np.column_stack([self.noise.by_station, base[self.noise.order], y[self.noise.order]])
        self.beside = Beside.of(self.noise, self.points, self.scales, *self._white(rows))

    def projected(self, columns: FloatArray, at: IntArray | slice = slice(None)) -> FloatArray:
        """Return columns (N, k), deg/hr, at some of the points, whitened and less what the base can do, (t, N, k)."""
        return less(self.beside.basis[at], self.whitened(columns, at))

    def scanned_columns(self, columns: FloatArray, some: IntArray) -> FloatArray:
        """Return columns (N, k), deg/hr, as `projected` does, at some of the points that are scanned, (t, N, k)."""
        return self.projected(columns, self.scanned[some])

    def pulled(self, white: FloatArray, at: IntArray) -> FloatArray:
        """Return what rows (t, r, N) that were whitened at some of the points make of columns, in deg/hr, (t, r, N).

        Their products with whitened columns are those with columns as they were.
        """
        known = less(self.beside.values[at], np.swapaxes(white, 1, 2))
        out = np.empty(known.shape)
        for here, own in self._at(at):
            out[here[:, None], self.noise.order] = own.back(known[here])
        return np.swapaxes(out, 1, 2) / self.unit

    def whitened(self, columns: FloatArray, at: IntArray | slice = slice(None)) -> FloatArray:
        """Return columns (N, k), deg/hr, at some of the points, with rows that are independent, in time, (t, N, k)."""
        return less(self.beside.values[at], self._white(columns[self.noise.order] / self.unit, at)[0])

    def _white(self, columns: FloatArray, at: IntArray | slice = slice(None)) -> tuple[FloatArray, FloatArray]:
        """Whiten columns (N, k), in the order of time, at some of the points: (t, N, k), and half log dets (t,)."""
        many = len(np.arange(len(self.points))[at])
        out, half_log_det = np.empty((many, *columns.shape)), np.empty(many)
        for here, own in self._at(at):
            out[here], half_log_det[here] = own.whiten(columns), own.half_log_det
        return out, half_log_det

    def _at(self, at: IntArray | slice) -> Iterator[tuple[IntArray, Filter]]:
        """Yield places among some of the points, and what whitens there."""
        wanted = np.arange(len(self.points))[at]
        if len(self.points) * len(self.y) > KEPT:
            yield from self.noise.filters(self.points.take(wanted))
            return
        self._filters = self._filters or list(self.noise.filters(self.points))
        for places, own in self._filters:
            place = np.full(len(self.points), -1)
            place[places] = np.arange(len(places))
            if len(here := np.flatnonzero(place[wanted] >= 0)):
                yield here, own.take(place[wanted[here]])
