"""Noise as states that rows hand on in the order of time, and rates made independent of each other by a filter.

Whatever scatters is a coefficient drawn anew for a run or a power cycle, or one that wanders and forgets: either way a
state that each row keeps in part and adds to. Taking from every row what the rows before it predict (Kalman 1960) gives
rates independent of each other, and the determinant of their covariance, in time that is linear in rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model.effects.base import Scatter, middle_hr

PIECE = 24
"""Rows at most that are whitened by one matrix; from piece to piece states are handed on."""


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

    def stretches(self) -> list[IntArray]:
        """Return the rows of the stretches, (m, n) for each length n that there is."""
        lengths = np.diff(np.append(self.begins, len(self.keep)))
        return [self.begins[lengths == n][:, None] + np.arange(n) for n in np.unique(lengths).tolist()]

    def scaled(self, factor: float) -> Chain:
        """Return the same states, each row moved by `factor` times as much."""
        return replace(self, columns=factor * self.columns)

    def first(self, rows: int) -> Chain:
        """Return the chain of the first rows only."""
        return Chain(self.columns[:rows], self.keep[:rows], self.kick[:rows])

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
        """The covariance of the rows, (N, N), in the order of time."""
        across, out = self.columns * self.sizes, np.diag(0.5 * self.variance)
        for i, (seen, keep) in enumerate(zip(self.columns, self.keep, strict=True)):
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


@dataclass(frozen=True)
class Stretches:
    """Stretches of equal length, cut into pieces, and what whitens each at t models of the noise.

    `rows` (m, p, n) are places in columns (N, k), N where the last piece has fewer. `own` (t, m, p, n, n) whitens a
    piece by itself, `entering` (t, m, p, n, s) what states are on entering takes from its rows; a piece hands on
    `learned` (t, m, p, s, n) of its rows and `kept` (t, m, p, s, s) of the states.
    """

    rows: IntArray
    own: FloatArray
    entering: FloatArray
    learned: FloatArray
    kept: FloatArray

    def take(self, index: IntArray) -> Stretches:
        """Return some of the models."""
        return Stretches(self.rows, *(own[index] for own in (self.own, self.entering, self.learned, self.kept)))

    def whiten(self, columns: FloatArray, out: FloatArray) -> None:
        """Write rows of columns (N + 1, k), the last of zeros, into `out` (t, N + 1, k), independent of each other."""
        states = None
        for piece, rows in enumerate(np.moveaxis(self.rows, 1, 0)):
            given = columns[rows]
            white = self.own[:, :, piece] @ given
            if states is not None:
                white -= self.entering[:, :, piece] @ states
            out[:, rows] = white
            if piece + 1 < self.rows.shape[1]:
                learned = self.learned[:, :, piece] @ given
                states = learned if states is None else learned + self.kept[:, :, piece] @ states


@dataclass(frozen=True)
class Filter:
    """What makes rows of t models of the noise independent of each other, found once for any number of columns.

    `half_log_det` (t,) is half the log of the determinant of each.
    """

    stretches: Sequence[Stretches]
    half_log_det: FloatArray

    def take(self, index: IntArray) -> Filter:
        """Return some of the models, those at `index` (k,)."""
        return Filter([each.take(index) for each in self.stretches], self.half_log_det[index])

    def whiten(self, columns: FloatArray) -> FloatArray:
        """Return columns (N, k), in the order of time, with rows that are independent, (t, N, k)."""
        rows, wide = columns.shape
        given = np.vstack([columns, np.zeros((1, wide))])
        out = np.empty((len(self.half_log_det), rows + 1, wide))
        for each in self.stretches:
            each.whiten(given, out)
        return out[:, :rows]


def filter_of(chains: Sequence[Chain], of: IntArray, amounts: FloatArray, white: FloatArray) -> Filter:
    """Return what whitens rows at t models of the noise, each `of` one of the chains, (t,).

    The chains have as many states and the same stretches, which are filtered side by side as the models are. `amounts`
    (t, s) are the sizes of the states, `white` (t, N) the variance of each row by itself.
    """
    names, nothing = ("columns", "keep", "kick"), (0.0, 1.0, 0.0)
    # One row more, which is none, fills up what a stretch that is cut into pieces lacks.
    seen_by, keeps, kicks = (
        np.array([np.pad(getattr(c, name), ((0, 1), (0, 0)), constant_values=empty) for c in chains])
        for name, empty in zip(names, nothing, strict=True)
    )
    white = np.pad(white, ((0, 0), (0, 1)), constant_values=1.0)
    out, half_log_det = [], np.zeros(len(of))
    for stretches in chains[0].stretches():
        pieces = -(-stretches.shape[1] // PIECE)
        missing = -stretches.shape[1] % pieces
        rows = np.pad(stretches, ((0, 0), (0, missing)), constant_values=white.shape[1] - 1)
        at = of[:, None, None], rows
        parts = amounts[:, None, None, :] * seen_by[at], keeps[at], kicks[at], white[:, rows]
        seen, keep, kick, own = (_last(part) for part in parts)
        gain, scale = _gains(seen, keep, kick, own)
        half_log_det -= np.sum(np.log(scale), axis=(0, 2))
        cut = (own.reshape(pieces, -1, *own.shape[1:]) for own in (seen, keep, gain, scale))
        out.append(_pieces(rows.reshape(len(rows), pieces, -1), *cut))
    return Filter(out, half_log_det)


def _last(part: FloatArray) -> FloatArray:
    """Return an array with its first two axes last: what is done to few numbers of each of many takes whole arrays."""
    return np.ascontiguousarray(np.moveaxis(part, (0, 1), (-2, -1)))


def _gains(seen: FloatArray, keep: FloatArray, kick: FloatArray, white: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what states learn of each row made independent, (n, s, t, m), and what it is scaled by, (n, t, m).

    `seen` (n, s, t, m) is what the states do to the rows, `white` (n, t, m) each row's own variance.
    """
    gain, scale = np.empty(seen.shape), np.empty(white.shape)
    covariance = np.zeros((seen.shape[1], *seen.shape[1:]))
    diagonal = np.einsum("sstm->stm", covariance)
    forgets, kicks = np.any(keep != 1.0, axis=(1, 2, 3)).tolist(), kick**2
    for i, forget in enumerate(forgets):
        if forget:
            covariance *= keep[i, :, None] * keep[i]
        diagonal += kicks[i]
        learned = np.einsum("rstm,stm->rtm", covariance, seen[i])
        scale[i] = own = 1.0 / np.sqrt(np.einsum("stm,stm->tm", seen[i], learned) + white[i])
        learned *= own
        covariance -= learned[:, None] * learned
        gain[i] = learned
    return gain, scale


def _pieces(rows: IntArray, seen: FloatArray, keep: FloatArray, gain: FloatArray, scale: FloatArray) -> Stretches:
    """Return what all pieces do to any rows and to any states on entering: the filter of a basis of both."""
    pieces, size, states, *of = seen.shape
    handed = np.zeros((pieces, states, states + size, *of))
    handed[:, :, :states] = np.eye(states)[..., None, None]
    found = np.zeros((pieces, size, states + size, *of))
    for i, known in enumerate(range(states, states + size)):
        handed[:, :, :known] *= keep[:, i, :, None]
        row = found[:, i, : known + 1]
        row[:, known] = 1.0
        row[:, :known] = -np.einsum("pstm,pswtm->pwtm", seen[:, i], handed[:, :, :known])
        row *= scale[:, i, None]
        handed[:, :, : known + 1] += gain[:, i, :, None] * row[:, None]
    found, handed = (np.moveaxis(own, 0, -1) for own in (found, handed))
    own, entering = _last(found[:, states:]), _last(-found[:, :states])
    return Stretches(rows, own, entering, _last(handed[:, states:]), _last(handed[:, :states]))
