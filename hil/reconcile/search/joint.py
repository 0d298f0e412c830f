"""Evidence for parameters that several blocks share: a scale factor, a phase.

All combinations of the few noise points of each block that matter for a unit are weighed at once, and so are all units
of one size that act on the same blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.evidence import INVISIBLE, ZELLNER_G, BlockEvidence, State
from hil.reconcile.search.whitened import Group
from hil.solve.likelihood import log_sum


@dataclass(frozen=True)
class JointColumns:
    """Units of one size that share their parameters over `blocks`: their whitened columns in each of these blocks.

    `units` (j,) are their places among all units.
    """

    units: IntArray
    blocks: tuple[int, ...]
    parts: tuple[Group, ...]

    def take(self, places: IntArray, units: IntArray) -> JointColumns:
        """Return some of the units, with new places among all."""
        return JointColumns(units, self.blocks, tuple(part.take(places) for part in self.parts))


class JointEvidence:
    """Evidence for joint units beside the bases of their blocks, for what these leave of the data (`states[block]`).

    A state is what `BlockEvidence.state` returns: residuals (t, N, m), RSS (t, m), log likelihood (t, m).
    """

    def __init__(self, blocks: Sequence[BlockEvidence], states: Sequence[State]) -> None:
        self.blocks = blocks
        self._states = states

    def log_factors(self, columns: JointColumns) -> FloatArray:
        """Return the log Bayes factors of units of one size, shape (j, m)."""
        pieces = [self._piece(b, group) for b, group in zip(columns.blocks, columns.parts, strict=True)]
        points = [
            self._points(b, piece, columns.parts[0].size) for b, piece in zip(columns.blocks, pieces, strict=True)
        ]
        combined = [list(product(*here)) for here in zip(*points, strict=True)]  # of each unit, its blocks' points
        unit = np.repeat(np.arange(len(combined)), [len(own) for own in combined])
        places = np.array([combination for own in combined for combination in own])
        chosen = [piece.take(places[:, k], unit) for k, piece in enumerate(pieces)]
        weight = np.sum([piece.log_weight for piece in chosen], axis=0)
        terms = weight + _joint_factors(chosen)
        own = [unit == j for j in range(len(combined))]
        return np.array([log_sum(terms[rows]) - log_sum(weight[rows]) for rows in own])

    def _piece(self, b: int, group: Group) -> _Piece:
        """What the block says of the units at each of its noise points."""
        block = self.blocks[b]
        residual, rss, log_null = self._states[b]
        gram = group.beside(block.projection.basis) * (group.norms[..., :, None] * group.norms[..., None, :])
        score = group.scores(residual) * group.norms[..., None]
        power = block.prior.a + 0.5 * block.projection.freedom
        units = len(group.members)
        offset = np.repeat((block.prior.b + 0.5 * rss)[:, None], units, axis=1)
        return _Piece(gram, score, group.norms**2, offset, np.repeat(log_null[:, None], units, axis=1), power)

    def _points(self, b: int, piece: _Piece, size: int) -> list[list[int]]:
        """For each unit the noise points that are best without it and with it."""
        log_null = self._states[b][2]
        ridge = piece.gram + 1e-6 * piece.before.max(axis=(0, 2))[:, None, None] * np.eye(size)
        explained = np.einsum("tjqm,tjqm->tjm", piece.score, np.linalg.solve(ridge, piece.score))
        share = np.clip(0.5 * explained / piece.offset, 0.0, 1.0 - 1e-9)
        with_unit = piece.log_weight - piece.power * np.log1p(-share)
        first = int(np.argmax(log_null.mean(axis=1)))
        best = np.argsort(-with_unit.mean(axis=2), axis=0)[:2]
        return [list(dict.fromkeys([first, *own])) for own in best.T.tolist()]


@dataclass(frozen=True)
class _Piece:
    """One block at several noise points, for several units or for pairs of point and unit in place of (t, j).

    Gram (t, j, q, q), score (t, j, q, m), norms (t, j, q), offset and weight (t, j, m).
    """

    gram: FloatArray
    score: FloatArray
    before: FloatArray
    offset: FloatArray
    log_weight: FloatArray
    power: float

    def take(self, point: IntArray, unit: IntArray) -> _Piece:
        """Return pairs of a point and a unit, in this order, repeated where asked for."""
        gram, score, before = self.gram[point, unit], self.score[point, unit], self.before[point, unit]
        return _Piece(gram, score, before, self.offset[point, unit], self.log_weight[point, unit], self.power)


def _joint_factors(chosen: Sequence[_Piece]) -> FloatArray:
    """Log Bayes factors (t, m); the scale of each block is re-estimated with the candidate in place."""
    offsets = [c.offset for c in chosen]
    changes = [np.zeros_like(c.offset) for c in chosen]
    before = np.sum([c.before for c in chosen], axis=0)
    normal = 1.0 / np.sqrt(np.where(before > 0, before, 1.0))
    rank = np.zeros_like(chosen[0].offset)
    for _ in range(2):
        precision = [c.power / offset for offset, c in zip(offsets, chosen, strict=True)]
        pairs = list(zip(precision, chosen, strict=True))
        scaled = normal[:, :, None] * normal[:, None, :]
        gram = np.sum([p[:, :, None, None] * (c.gram * scaled)[:, None] for p, c in pairs], axis=0)
        whole = np.sum([p.mean(axis=1)[:, None] * c.before for p, c in pairs], axis=0) * normal**2
        score = np.sum([p[:, :, None] * np.swapaxes(c.score * normal[:, :, None], 1, 2) for p, c in pairs], axis=0)
        values, vectors = np.linalg.eigh(gram)
        usable = values > INVISIBLE**2 * np.maximum(whole.max(axis=1), 1e-300)[:, None, None]
        inverse = np.where(usable, 1.0 / np.where(usable, values, 1.0), 0.0)
        turned = inverse[..., None] * (np.swapaxes(vectors, 2, 3) @ score[..., None])
        fit = (vectors @ turned)[..., 0] * normal[:, None]
        rank = usable.sum(axis=2).astype(np.float64)
        changes = [2.0 * np.einsum("tmq,tqm->tm", fit, c.score) - np.sum((fit @ c.gram) * fit, axis=2) for c in chosen]
        offsets = [
            np.maximum(c.offset - 0.5 * change, 1e-9 * c.offset) for c, change in zip(chosen, changes, strict=True)
        ]
    terms = []
    for g in ZELLNER_G:
        total = -0.5 * rank * np.log1p(g) - np.log(len(ZELLNER_G))
        for c, change in zip(chosen, changes, strict=True):
            share = 0.5 * change / c.offset * (g / (1.0 + g))
            total = total - c.power * np.log1p(-np.clip(share, None, 1.0 - 1e-9))
        terms.append(total)
    return np.where(rank > 0, log_sum(np.array(terms)), 0.0)
