"""Noise as states that rows hand on in the order of time, and rates made independent of each other by a filter.

Whatever scatters is a coefficient drawn anew for a run or a power cycle, or one that wanders and forgets: either way a
state that each row keeps in part and adds to. Taking from every row what the rows before it predict (Kalman 1960) gives
rates independent of each other, and the determinant of their covariance, in time that is linear in rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model.effects.base import Scatter, middle_hr


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
    def variance(self) -> FloatArray:
        """The variance of every row, (N,)."""
        own, out = np.zeros(self.columns.shape[1]), np.zeros(len(self.columns))
        for i, (seen, keep, kick) in enumerate(zip(self.columns, self.keep, self.kick, strict=True)):
            own = keep**2 * own + kick**2
            out[i] = seen**2 @ own
        return out

    @cached_property
    def covariance(self) -> FloatArray:
        """The covariance of the rows, (N, N), in the order of time."""
        rows = len(self.columns)
        own, across = np.zeros(self.columns.shape[1]), np.zeros((rows, self.columns.shape[1]))
        out = np.zeros((rows, rows))
        for i, (seen, keep, kick) in enumerate(zip(self.columns, self.keep, self.kick, strict=True)):
            across[:i] *= keep
            own = keep**2 * own + kick**2
            out[i, :i] = out[:i, i] = across[:i] @ seen
            out[i, i] = seen**2 @ own
            across[i] = seen * own
        return out


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
class Whitened:
    """Columns with independent rows, (t, N, k), at t models of the noise; half the log determinant of each, (t,)."""

    columns: FloatArray
    half_log_det: FloatArray


def whitened(
    chains: Sequence[Chain], of: IntArray, amounts: FloatArray, white: FloatArray, columns: FloatArray
) -> Whitened:
    """Whiten columns (N, k), in the order of time, at t models of the noise, each `of` one of the chains, (t,).

    The chains have as many states and the same stretches, which are filtered side by side as the models are. `amounts`
    (t, s) are the sizes of the states, `white` (t, N) the variance of each row by itself.
    """
    (points, states), wide = amounts.shape, columns.shape[1]
    seen_by, keeps, kicks = (np.array([getattr(c, name) for c in chains]) for name in ("columns", "keep", "kick"))
    out, scale = np.empty((points, *columns.shape)), np.empty((points, len(columns)))
    for stretches in chains[0].stretches():
        expected = np.zeros((points, len(stretches), states, wide))
        covariance = np.zeros((points, len(stretches), states, states))
        diagonal = np.einsum("tmss->tms", covariance)
        for rows in stretches.T:
            at = of[:, None], rows
            keep = keeps[at]
            if np.any(keep != 1.0):
                expected *= keep[..., None]
                covariance *= keep[..., :, None] * keep[..., None, :]
            diagonal += kicks[at] ** 2
            seen = amounts[:, None, :] * seen_by[at]
            gain = (covariance @ seen[..., None])[..., 0]
            own = 1.0 / np.sqrt(np.einsum("tms,tms->tm", seen, gain) + white[:, rows])
            gain *= own[..., None]
            row = (columns[rows] - (seen[..., None, :] @ expected)[..., 0, :]) * own[..., None]
            expected += gain[..., None] * row[..., None, :]
            covariance -= gain[..., None] * gain[..., None, :]
            out[:, rows], scale[:, rows] = row, own
    return Whitened(out, -np.sum(np.log(scale), axis=1))
