"""Rates made independent of each other by a filter, whatever their noise hands on from row to row.

Taking from every row what the rows before it predict (Kalman 1960) gives rates independent of each other, and the
determinant of their covariance, in time that is linear in rows. Pieces of rows are filtered side by side.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.chains import Chain


@dataclass(frozen=True)
class Stretches:
    """Stretches that are cut alike, and what whitens each piece at t models of the noise.

    `rows` (p, m, n) are places in columns (N + 1, k), the last of zeros. Of a piece's own rows `own` (p, m, t, n + s,
    n) makes rows that are independent, and the states that it hands on; from these `entering` (p, m, t, n + s, s) takes
    what was handed to it.
    """

    rows: IntArray
    own: FloatArray
    entering: FloatArray

    def inner(self) -> FloatArray:
        """Return W'W of the rows of each piece, (p, m, t, n, n), W being what whitens all rows."""
        pieces, *_, size, rows = self.own.shape
        later = np.zeros((*self.own.shape[:3], size, size))
        later[..., range(rows), range(rows)] = 1.0
        for piece in reversed(range(1, pieces)):
            entering = self.entering[piece]
            later[piece - 1, :, :, rows:, rows:] = np.swapaxes(entering, 2, 3) @ later[piece] @ entering
        return np.asarray(np.swapaxes(self.own, 3, 4) @ later @ self.own)


@dataclass(frozen=True)
class Filter:
    """What makes rows of t models of the noise independent of each other, found once for any number of columns.

    `half_log_det` (t,) is half the log of the determinant of each.
    """

    stretches: Sequence[Stretches]
    half_log_det: FloatArray

    def take(self, index: IntArray) -> "Filter":
        """Return some of the models, those at `index` (k,)."""
        if np.array_equal(index, np.arange(len(self.half_log_det))):
            return self
        some = [
            replace(each, own=np.take(each.own, index, axis=2), entering=np.take(each.entering, index, axis=2))
            for each in self.stretches
        ]
        return Filter(some, self.half_log_det[index])

    def whiten(self, columns: FloatArray) -> FloatArray:
        """Return columns (N, k), in the order of time, with rows that are independent, (t, N, k)."""
        given = np.vstack([columns, np.zeros(columns.shape[1])])
        out = np.empty((len(self.half_log_det), *given.shape))
        for each in self.stretches:
            pieces, stretches, models, size, rows = each.own.shape
            own = each.own.reshape(pieces, stretches, models * size, rows) @ given[each.rows]
            own = own.reshape(pieces, stretches, models, size, -1)
            for before, after, entering in zip(own, own[1:], each.entering[1:], strict=False):
                after -= entering @ before[:, :, rows:]
            out[:, each.rows] = np.moveaxis(own[:, :, :, :rows], 2, 0)
        return out[:, :-1]

    def back(self, white: FloatArray) -> FloatArray:
        """Return W'w (t, N, k) of rows w (t, N, k), W being what whitens: of whitened columns, V^-1 times them."""
        given = np.concatenate([white, np.zeros_like(white[:, :1])], axis=1)
        out = np.empty(given.shape)
        for each in self.stretches:
            pieces, stretches, models, size, rows = each.own.shape
            own = np.zeros((pieces, stretches, models, size, given.shape[2]))
            own[:, :, :, :rows] = np.moveaxis(given[:, each.rows], 0, 2)
            for piece in reversed(range(1, pieces)):
                own[piece - 1, :, :, rows:] = -np.swapaxes(each.entering[piece], 2, 3) @ own[piece]
            out[:, each.rows] = np.moveaxis(np.swapaxes(each.own, 3, 4) @ own, 2, 0)
        return out[:, :-1]


def filter_of(
    chains: Sequence[Chain], of: IntArray, amounts: FloatArray, white: FloatArray, label: IntArray | None = None
) -> Filter:
    """Return what whitens rows at t models of the noise, each `of` one of the chains, (t,).

    The chains have as many states and the same stretches, which are filtered side by side as the models are. `amounts`
    (t, s) are the sizes of the states, `white` (t, N) the variance of each row by itself. Pieces are cut by a `label`
    (N,), if one is given.
    """
    # One row more, which is none, fills up what a piece lacks.
    of_chains = [
        np.stack([np.vstack([own := getattr(c, name), np.full(own.shape[1], empty)]) for c in chains], axis=2)
        for name, empty in (("columns", 0.0), ("keep", 1.0), ("kick", 0.0))
    ]
    white, out, half_log_det = np.pad(white, ((0, 0), (0, 1)), constant_values=1.0).T, [], np.zeros(len(of))
    for rows in chains[0].pieces if label is None else chains[0].cut(label):
        # Axes of which there are few come first: what is done to few numbers of each of many takes whole arrays.
        at = rows.reshape(-1, rows.shape[2]).T
        seen, keep, kick = (np.take(np.swapaxes(own[at], 1, 2), of, axis=3) for own in of_chains)
        seen *= amounts.T[:, None]
        size, states = seen.shape[:2]
        each = [own.reshape(*own.shape[:-2], -1) for own in (seen, keep, kick, white[at])]
        start = np.zeros((states, states, each[0].shape[2]))
        start = _entered(each, start, len(rows)) if len(rows) > 1 else start
        gain, scale, _ = _gains(*each, start=start)
        half_log_det -= np.sum(np.log(scale).reshape(-1, len(of)), axis=0)
        made = _of_basis(each[0], each[1], gain, scale, rows=True)
        made = np.ascontiguousarray(made.reshape(len(made) * made.shape[1], -1).T)
        made = made.reshape(*rows.shape[:2], len(of), size + states, states + size)
        out.append(Stretches(rows, made[..., states:], -made[..., :states]))
    return Filter(out, half_log_det)


def _gains(
    seen: FloatArray, keep: FloatArray, kick: FloatArray, white: FloatArray, *, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what states learn of each row made independent, (n, s, m), and what it is scaled by, (n, m).

    `seen` (n, s, m) is what the states do to the rows of a piece, at one model of the noise, `white` (n, m) each row's
    own variance, `start` (s, s, m) the covariance of the states before them; that after them is returned last.
    """
    gain, scale, covariance = np.empty(seen.shape), np.empty(white.shape), start.copy()
    diagonal = np.einsum("ssm->sm", covariance)
    forgets, kicks = np.any(keep != 1.0, axis=(1, 2)).tolist(), kick**2
    for i, forget in enumerate(forgets):
        if forget:
            covariance *= keep[i, :, None] * keep[i]
        diagonal += kicks[i]
        learned = np.einsum("rsm,sm->rm", covariance, seen[i])
        scale[i] = own = 1.0 / np.sqrt(np.einsum("sm,sm->m", seen[i], learned) + white[i])
        learned *= own
        covariance -= learned[:, None] * learned
        gain[i] = learned
    return gain, scale, covariance


def _entered(parts: Sequence[FloatArray], start: FloatArray, pieces: int) -> FloatArray:
    """Return the covariance of the states on entering each piece, (s, s, m), the first of each stretch's at `start`.

    What a piece makes of any covariance is known from what it makes of states that are known (Särkkä & García-Fernández
    2021): from piece to piece it is handed on by matrices of the size of the states.
    """
    gain, scale, ends = _gains(*parts, start=start)
    found, handed = np.split(_of_basis(parts[0], parts[1], gain, scale, rows=False), [len(gain)])
    tells = np.einsum("nsm,nrm->srm", found, found)
    kept, tells, ends, out = (
        np.moveaxis(own.reshape(*own.shape[:2], pieces, -1), (0, 1), (-2, -1)).copy()
        for own in (handed, tells, ends, start)
    )
    for piece in range(pieces - 1):
        entered = np.linalg.solve(np.eye(len(start)) + out[piece] @ tells[piece], out[piece])
        out[piece + 1] = kept[piece] @ entered @ np.swapaxes(kept[piece], 1, 2) + ends[piece]
    return np.moveaxis(out, (-2, -1), (0, 1)).reshape(start.shape)


def _of_basis(seen: FloatArray, keep: FloatArray, gain: FloatArray, scale: FloatArray, *, rows: bool) -> FloatArray:
    """Return rows made independent, and the states after them, (n + s, b, m), of each state, and of each row."""
    size, states, models = seen.shape
    out = np.zeros((size + states, states + size * rows, models))
    handed = out[size:]
    handed[:, :states] = np.eye(states)[..., None]
    for i, (row, own) in enumerate(zip(out, scale, strict=False)):
        known = states + i * rows
        handed[:, :known] *= keep[i, :, None]
        row[:known] = np.einsum("sm,swm->wm", seen[i] * -own, handed[:, :known])
        row[known : known + rows] = own
        handed[:, : known + rows] += gain[i, :, None] * row[: known + rows]
    return out
