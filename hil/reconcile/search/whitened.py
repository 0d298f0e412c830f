"""Columns of many candidates whitened at every noise point: what no base changes, so that it is computed once.

Against a base only the part that the base can imitate is taken off: of the inner products, not of the columns, which is
the same and much less to compute. A search that is repeated with every fold and every base shares these columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import FloatArray, IntArray


@dataclass(frozen=True)
class Group:
    """Candidates of one number of columns q: `members` (j,) are their places among all.

    `white` (t, N, j·q) are their columns whitened and scaled to unit norm, `norms` (t, j, q) what they were divided by,
    and `gram` (t, j, q, q) the inner products within each candidate.
    """

    members: IntArray
    white: FloatArray
    norms: FloatArray
    gram: FloatArray

    @classmethod
    def of(cls, members: IntArray, white: FloatArray, size: int) -> Group:
        """Scale whitened columns (t, N, j·q), in place, and multiply them out."""
        norms = np.sqrt(np.einsum("tnk,tnk->tk", white, white))
        white /= np.where(norms > 0, norms, 1.0)[:, None, :]
        shaped = (len(white), len(members), size)
        return cls(members, white, norms.reshape(shaped), _within(white, size))

    @property
    def size(self) -> int:
        """How many columns a candidate has."""
        return int(self.gram.shape[-1])

    def take(self, places: IntArray) -> Group:
        """Return the group with some of its candidates, numbered anew by the caller."""
        columns = (places[:, None] * self.size + np.arange(self.size)).ravel()
        white = self.white[:, :, columns]
        return Group(self.members[places], white, self.norms[:, places], self.gram[:, places])

    def beside(self, basis: FloatArray) -> FloatArray:
        """Inner products (t, j, q, q) of what is left beside an orthonormal basis (t, N, p) of the whitened base."""
        return np.asarray(self.gram - _within(np.swapaxes(basis, 1, 2) @ self.white, self.size))

    def scores(self, residual: FloatArray) -> FloatArray:
        """Inner products (t, j, q, m) with whitened residuals (t, N, m), of which the base has been taken off."""
        score = np.swapaxes(self.white, 1, 2) @ residual
        return score.reshape(len(score), len(self.members), self.size, -1)


@dataclass(frozen=True)
class Whitened:
    """The columns, (N, q), of `count` candidates of one block, by q; a candidate without any is in no group."""

    count: int
    groups: tuple[Group, ...]

    @classmethod
    def of(cls, whitening: FloatArray, columns: Sequence[FloatArray]) -> Whitened:
        """Whiten the columns (N, q) of each candidate with every one of the matrices `whitening` (t, N, N)."""
        sizes = np.array([c.shape[1] for c in columns], dtype=np.int64)
        groups = []
        for size in sorted(set(sizes.tolist()) - {0}):
            members = np.flatnonzero(sizes == size)
            stacked = np.concatenate([columns[int(j)] for j in members], axis=1)
            groups.append(Group.of(members, whitening @ stacked, size))
        return cls(len(columns), tuple(groups))

    def take(self, candidates: IntArray) -> Whitened:
        """Return some of the candidates, their places (j,) in ascending order."""
        new_place = np.full(self.count, -1)
        new_place[candidates] = np.arange(len(candidates))
        groups = []
        for group in self.groups:
            here = np.flatnonzero(new_place[group.members] >= 0)
            if len(here):
                some = group.take(here)
                groups.append(Group(new_place[some.members], some.white, some.norms, some.gram))
        return Whitened(len(candidates), tuple(groups))


def _within(columns: FloatArray, size: int) -> FloatArray:
    """Inner products within each candidate, (t, j, q, q), of columns (t, n, j·q) of any length n."""
    if size == 1:
        return np.asarray(np.einsum("tnk,tnk->tk", columns, columns)[:, :, None, None])
    t, n, k = columns.shape
    apart = np.ascontiguousarray(columns.reshape(t, n, k // size, size).transpose(0, 2, 1, 3))
    return np.asarray(np.swapaxes(apart, 2, 3) @ apart)
