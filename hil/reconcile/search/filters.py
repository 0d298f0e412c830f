"""Rates made independent of each other by a filter, whatever their noise hands on from row to row.

Taking from every row what the rows before it predict (Kalman 1960) gives rates independent of each other, and the
determinant of their covariance, in time that is linear in rows. Pieces of rows are filtered side by side.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.chains import Chain


@dataclass(frozen=True)
class Stretches:
    """Stretches that are cut alike, and what whitens each piece at t models of the noise.

    `rows` (p, m, n) are places in columns (N + 1, k), the last of zeros. `own` (p, m, t, n, n) whitens a piece by
    itself, `entering` (p, m, t, n, s) what states are on entering takes from its rows; a piece hands on `learned`
    (p, m, t, s, n) of its rows and `kept` (p, m, t, s, s) of the states.
    """

    rows: IntArray
    own: FloatArray
    entering: FloatArray
    learned: FloatArray
    kept: FloatArray

    def take(self, index: IntArray) -> Stretches:
        """Return some of the models."""
        return Stretches(self.rows, *(np.take(own, index, axis=2) for own in self._parts))

    @property
    def _parts(self) -> tuple[FloatArray, ...]:
        return self.own, self.entering, self.learned, self.kept

    def whiten(self, columns: FloatArray, out: FloatArray) -> None:
        """Write rows of columns (N + 1, k) into `out` (t, N + 1, k), independent of each other."""
        states = np.zeros((*self.kept.shape[1:4], columns.shape[1]))
        for piece, rows in enumerate(self.rows):
            given = columns[rows]
            white = _of_every_model(self.own[piece], given)
            if piece:
                white -= self.entering[piece] @ states
            out[:, rows] = np.swapaxes(white, 0, 1)
            if piece + 1 < len(self.rows):
                states = _of_every_model(self.learned[piece], given) + self.kept[piece] @ states

    def back(self, white: FloatArray, out: FloatArray) -> None:
        """Write into `out` (t, N + 1, k) what the transpose of whitening makes of rows (t, N + 1, k)."""
        later = np.zeros((*self.kept.shape[1:4], white.shape[2]))
        own, entering, learned, kept = (np.swapaxes(of, 3, 4) for of in self._parts)
        for piece, rows in reversed([*enumerate(self.rows)]):
            given = np.swapaxes(white[:, rows], 0, 1)
            out[:, rows] = np.swapaxes(own[piece] @ given + learned[piece] @ later, 0, 1)
            later = kept[piece] @ later - entering[piece] @ given

    def inner(self) -> FloatArray:
        """Return W'W of the rows of each piece, (p, m, t, n, n), W being what whitens all rows."""
        out = np.swapaxes(self.own, 3, 4) @ self.own
        later = np.zeros_like(self.kept[0])
        for piece in reversed(range(1, len(self.rows))):
            entering, kept, learned = self.entering[piece], self.kept[piece], self.learned[piece - 1]
            later = np.swapaxes(entering, 2, 3) @ entering + np.swapaxes(kept, 2, 3) @ later @ kept
            out[piece - 1] += np.swapaxes(learned, 2, 3) @ later @ learned
        return out


def _of_every_model(parts: FloatArray, given: FloatArray) -> FloatArray:
    """Return what parts (m, t, a, n) of every model make of the same rows (m, n, k), (m, t, a, k), in one product."""
    many, models, size, rows = parts.shape
    return (parts.reshape(many, models * size, rows) @ given).reshape(many, models, size, -1)


@dataclass(frozen=True)
class Filter:
    """What makes rows of t models of the noise independent of each other, found once for any number of columns.

    `half_log_det` (t,) is half the log of the determinant of each.
    """

    stretches: Sequence[Stretches]
    half_log_det: FloatArray

    def take(self, index: IntArray) -> Filter:
        """Return some of the models, those at `index` (k,)."""
        if np.array_equal(index, np.arange(len(self.half_log_det))):
            return self
        return Filter([each.take(index) for each in self.stretches], self.half_log_det[index])

    def whiten(self, columns: FloatArray) -> FloatArray:
        """Return columns (N, k), in the order of time, with rows that are independent, (t, N, k)."""
        given = np.vstack([columns, np.zeros(columns.shape[1])])
        out = np.empty((len(self.half_log_det), *given.shape))
        for each in self.stretches:
            each.whiten(given, out)
        return out[:, :-1]

    def back(self, white: FloatArray) -> FloatArray:
        """Return W'w (t, N, k) of rows w (t, N, k), W being what whitens: of whitened columns, V^-1 times them."""
        given = np.concatenate([white, np.zeros_like(white[:, :1])], axis=1)
        out = np.empty(given.shape)
        for each in self.stretches:
            each.back(given, out)
        return out[:, :-1]


def filter_of(
    chains: Sequence[Chain], of: IntArray, amounts: FloatArray, white: FloatArray, label: IntArray | None = None
) -> Filter:
    """Return what whitens rows at t models of the noise, each `of` one of the chains, (t,).

    The chains have as many states and the same stretches, which are filtered side by side as the models are. `amounts`
    (t, s) are the sizes of the states, `white` (t, N) the variance of each row by itself. Pieces are cut by a `label`
    (N,), if one is given.
    """
    names, nothing = ("columns", "keep", "kick"), (0.0, 1.0, 0.0)
    # One row more, which is none, fills up what a piece lacks.
    seen_by, keeps, kicks = (
        np.array([np.vstack([own := getattr(c, name), np.full(own.shape[1], empty)]) for c in chains])
        for name, empty in zip(names, nothing, strict=True)
    )
    white = np.pad(white, ((0, 0), (0, 1)), constant_values=1.0)
    out, half_log_det = [], np.zeros(len(of))
    for rows in chains[0].pieces if label is None else chains[0].cut(label):
        at = of[:, None, None], rows.reshape(-1, rows.shape[2])
        parts = amounts[:, None, None, :] * seen_by[at], keeps[at], kicks[at], white[:, at[1]]
        each = [_last(part) for part in parts]
        start = np.zeros((*[amounts.shape[1]] * 2, len(of), len(at[1])))
        start = _entered(each, start, len(rows)) if len(rows) > 1 else start
        gain, scale, _ = _gains(*each, start=start)
        half_log_det -= np.sum(np.log(scale), axis=(0, 2))
        out.append(Stretches(rows, *_pieces(each, gain, scale, rows.shape[:2])))
    return Filter(out, half_log_det)


def _last(part: FloatArray) -> FloatArray:
    """Return an array with its first two axes last: what is done to few numbers of each of many takes whole arrays."""
    return np.ascontiguousarray(np.moveaxis(part, (0, 1), (-2, -1)))


def _gains(
    seen: FloatArray, keep: FloatArray, kick: FloatArray, white: FloatArray, *, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what states learn of each row made independent, (n, s, t, q), and what it is scaled by, (n, t, q).

    `seen` (n, s, t, q) is what the states do to the rows of a piece, `white` (n, t, q) each row's own variance, `start`
    (s, s, t, q) the covariance of the states before them; that after them is returned last.
    """
    gain, scale, covariance = np.empty(seen.shape), np.empty(white.shape), start.copy()
    diagonal = np.einsum("sstq->stq", covariance)
    forgets, kicks = np.any(keep != 1.0, axis=(1, 2, 3)).tolist(), kick**2
    for i, forget in enumerate(forgets):
        if forget:
            covariance *= keep[i, :, None] * keep[i]
        diagonal += kicks[i]
        learned = np.einsum("rstq,stq->rtq", covariance, seen[i])
        scale[i] = own = 1.0 / np.sqrt(np.einsum("stq,stq->tq", seen[i], learned) + white[i])
        learned *= own
        covariance -= learned[:, None] * learned
        gain[i] = learned
    return gain, scale, covariance


def _entered(parts: Sequence[FloatArray], start: FloatArray, pieces: int) -> FloatArray:
    """Return the covariance of the states on entering each piece, (s, s, t, q), the first of each stretch's at `start`.

    What a piece makes of any covariance is known from what it makes of states that are known (Särkkä & García-Fernández
    2021): from piece to piece it is handed on by matrices of the size of the states.
    """
    gain, scale, ends = _gains(*parts, start=start)
    found, handed = _of_basis(parts[0], parts[1], gain, scale, rows=False)
    tells = np.einsum("nstq,nrtq->srtq", found, found)
    kept, tells, ends, out = (
        np.moveaxis(own.reshape(*own.shape[:3], pieces, -1), (0, 1), (-2, -1)).swapaxes(0, 1).copy()
        for own in (handed, tells, ends, start)
    )
    for piece in range(pieces - 1):
        entered = np.linalg.solve(np.eye(len(start)) + out[piece] @ tells[piece], out[piece])
        out[piece + 1] = kept[piece] @ entered @ np.swapaxes(kept[piece], 2, 3) + ends[piece]
    return np.ascontiguousarray(np.moveaxis(out.swapaxes(0, 1), (-2, -1), (0, 1)).reshape(start.shape))


def _pieces(
    parts: Sequence[FloatArray], gain: FloatArray, scale: FloatArray, cut: tuple[int, int]
) -> Iterator[FloatArray]:
    """Yield what all pieces do to any rows and to any states on entering: the filter of a basis of both."""
    found, handed = _of_basis(parts[0], parts[1], gain, scale, rows=True)
    states = len(handed)
    for own in (found[:, states:], -found[:, :states], handed[:, states:], handed[:, :states]):
        yield np.ascontiguousarray(np.transpose(own, (3, 2, 0, 1)).reshape(*cut, own.shape[2], *own.shape[:2]))


def _of_basis(
    seen: FloatArray, keep: FloatArray, gain: FloatArray, scale: FloatArray, *, rows: bool
) -> tuple[FloatArray, FloatArray]:
    """Return rows (n, b, t, q) made independent, and states (s, b, t, q) after them, of each state, and of each row."""
    size, states, *of = seen.shape
    handed = np.zeros((states, states + size * rows, *of))
    handed[:, :states] = np.eye(states)[..., None, None]
    found = np.zeros((size, *handed.shape[1:]))
    for i, row in enumerate(found):
        known = states + i * rows
        handed[:, :known] *= keep[i, :, None]
        row[known : known + rows] = 1.0
        row[:known] = -np.einsum("stq,swtq->wtq", seen[i], handed[:, :known])
        row *= scale[i]
        handed[:, : known + rows] += gain[i, :, None] * row[: known + rows]
    return found, handed
