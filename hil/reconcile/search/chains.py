"""Noise as states that rows hand on in the order of time.

Whatever scatters is a coefficient drawn anew for a run or a power cycle, or one that wanders and forgets: either way a
state that each row keeps in part and adds to.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model.effects.columns import middle_hr
from hil.model.effects.scatter import Scatter

PIECE = 16
"""Rows at most that are whitened by one matrix; from piece to piece states are handed on."""
COMPARED = 256
"""Rows by which covariances are compared: what is the same in so many is the same in all."""


@dataclass(frozen=True)
class Chain:
    """Independent states of unit size: what each does to the rows, `columns` (N, s), and how they go on, (N, s) each.

    At row i a state is `keep` times what it was, and `kick` times something new. Rows are in the order of time.
    """

    columns: FloatArray
    keep: FloatArray
    kick: FloatArray

    def __len__(self) -> int:
        return int(self.columns.shape[1])

    @cached_property
    def begins(self) -> IntArray:
        """The rows (m,) to which those before hand nothing on: stretches begin there."""
        return np.flatnonzero(~np.any(self.keep, axis=1) | (np.arange(len(self.keep)) == 0))

    @cached_property
    def pieces(self) -> list[IntArray]:
        """The rows of stretches in as few pieces as have `PIECE` rows at most, as `cut` returns them."""
        lengths = np.diff(np.append(self.begins, len(self.keep)))
        size = -(-lengths // -(-lengths // PIECE))
        return self.cut((np.arange(len(self.keep)) - np.repeat(self.begins, lengths)) // np.repeat(size, lengths))

    def cut(self, label: IntArray) -> list[IntArray]:
        """Return the rows of stretches cut where labels (N,) change, (p, m, n) of those that are cut alike.

        Pieces that are shorter than others are filled up with row N, which is none.
        """
        starts = np.append(True, label[1:] != label[:-1])
        starts[self.begins] = True
        at = np.flatnonzero(starts)
        alike: dict[tuple[int, ...], list[int]] = {}
        lengths = np.split(np.diff(np.append(at, len(label))), np.searchsorted(at, self.begins[1:]))
        for begin, own in zip(self.begins.tolist(), lengths, strict=True):
            alike.setdefault(tuple(own.tolist()), []).append(begin)
        out = []
        for pieces, begins in alike.items():
            rows = np.full((len(pieces), len(begins), max(pieces)), len(label))
            for own, length, end in zip(rows, pieces, np.cumsum(pieces).tolist(), strict=True):
                own[:, :length] = np.add.outer(begins, np.arange(end - length, end))
            out.append(rows)
        return out

    def scaled(self, factor: float) -> "Chain":
        """Return the same states, each row moved by `factor` times as much."""
        return replace(self, columns=factor * self.columns)

    @cached_property
    def sizes(self) -> FloatArray:
        """The variance of every state at every row, (N, s)."""
        states = zip((self.keep.T**2).tolist(), (self.kick.T**2).tolist(), strict=True)
        grown = [
            accumulate(zip(*state, strict=True), lambda own, at: at[0] * own + at[1], initial=0.0) for state in states
        ]
        return np.reshape([[*own][1:] for own in grown], self.columns.T.shape).T

    @cached_property
    def variance(self) -> FloatArray:
        """The variance of every row, (N,)."""
        return np.asarray(np.sum(self.columns**2 * self.sizes, axis=1))

    @cached_property
    def covariance(self) -> FloatArray:
        """The covariance of the first `COMPARED` rows, (n, n), in the order of time."""
        few = slice(COMPARED)
        across, out = self.columns[few] * self.sizes[few], np.diag(0.5 * self.variance[few])
        for i, (seen, keep) in enumerate(zip(self.columns[few], self.keep[few], strict=True)):
            across[:i] *= keep
            out[i, :i] = across[:i] @ seen
        return out + out.T


def in_time(conditions: Conditions, rows: IntArray) -> IntArray:
    """Return the places of rows (N,) of the conditions in the order of time."""
    return np.argsort(middle_hr(conditions)[rows], kind="stable")


def chain_of(scatter: Scatter, conditions: Conditions, rows: IntArray, channel: IntArray) -> Chain:
    """Return what scatters rows (N,), each of a channel (N,), given in the order of time, as a chain."""
    columns = scatter.columns[rows, channel]
    columns = columns[:, np.any(columns, axis=0)]
    if scatter.group is not None:
        return grouped(columns, scatter.group[rows])
    hours = middle_hr(conditions)
    keep, kick = scatter.step(np.diff(hours[rows]))
    since = np.sqrt(hours[rows[0]] - hours.min()) if scatter.walk else 1.0
    return _chain(columns, np.append(0.0, keep), np.append(since, kick))


def grouped(columns: FloatArray, group: IntArray) -> Chain:
    """Return states with columns (N, s) that are drawn anew for every label of a group (N,)."""
    starts = np.append(True, group[1:] != group[:-1])
    if starts.sum() > len(np.unique(group)):  # not together in time: a state for each, from the first row on
        each = np.equal.outer(group, np.unique(group)).astype(np.float64)
        columns = (columns[:, :, None] * each[:, None, :]).reshape(len(columns), -1)
        starts = np.arange(len(group)) == 0
    return _chain(columns, np.where(starts, 0.0, 1.0), np.where(starts, 1.0, 0.0))


def _chain(columns: FloatArray, keep: FloatArray, kick: FloatArray) -> Chain:
    wide = np.ones(columns.shape[1])
    return Chain(np.asarray(columns), np.outer(keep, wide), np.outer(kick, wide))


def joined(chains: Sequence[Chain], rows: int) -> Chain:
    """Return one chain with the states of all, for `rows` rows."""
    none = np.zeros((rows, 0))
    parts = ([none, *(getattr(c, name) for c in chains)] for name in ("columns", "keep", "kick"))
    return Chain(*(np.hstack(part) for part in parts))
