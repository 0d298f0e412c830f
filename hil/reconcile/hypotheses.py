"""Candidates of all sensors together: which parts of the data each one touches, and what all parts say jointly.

A hypothesis is a candidate (name, shape, form) on every sensor where it can exist. Its columns fall into units: one per
block where its parameters are the block's own, one per sensor where a parameter acts on several blocks (a scale
factor, a phase). A unit may be touched or not, with even odds, so that an effect of one channel alone is not asked to
pay for the other, and an effect of both is not split in two.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.blocks import Block
from hil.reconcile.candidates import Candidate
from hil.reconcile.evidence import _G, _INVISIBLE, BlockEvidence, NoiseTable, _log_sum

_ACTS = 0.03  # a parameter that moves a block less than this, beside the block it moves most, does not tie the two
_SAME = 0.98
_FEW = 2
_PLAIN = 5.0  # a value that is one number is this many times as probable as one that follows temperature in some form
_FOLLOWS = frozenset({"bias_T", "GS_T"})
"""Names that mean following temperature: their plain form is the straight line."""


@dataclass(frozen=True)
class Unit:
    """One part of a hypothesis: the candidate of one sensor, its blocks, and which of its columns act in each."""

    candidate: Candidate
    blocks: tuple[int, ...]
    columns: tuple[FloatArray, ...]
    parameters: tuple[int, ...]

    @property
    def is_joint(self) -> bool:
        """Whether parameters are shared by several blocks."""
        return len(self.blocks) > 1


@dataclass(frozen=True)
class Hypothesis:
    """One name at one shape and form, with its units and its share of the prior."""

    name: str
    tier: int
    units: tuple[Unit, ...]
    log_prior: float = 0.0

    @property
    def candidate(self) -> Candidate:
        """The candidate on the first sensor."""
        return self.units[0].candidate


def hypotheses(candidates: Sequence[Candidate], blocks: Sequence[Block]) -> list[Hypothesis]:
    """Merge candidates over sensors, cut them into units, leave out what cannot be seen, and share out the prior."""
    merged: dict[tuple[object, ...], list[Candidate]] = {}
    for candidate in candidates:
        shape = (*sorted(candidate.shape.items()), candidate.before_degC)
        key = (candidate.tier, candidate.name, shape, candidate.form)
        merged.setdefault(key, []).append(candidate)
    found = []
    for members in merged.values():
        units = tuple(unit for member in members for unit in _units(member, blocks))
        if units:
            found.append(Hypothesis(members[0].name, members[0].tier, units))
    return seen(found, blocks)


def _units(candidate: Candidate, blocks: Sequence[Block]) -> list[Unit]:
    own = [b for b, block in enumerate(blocks) if block.sensor == candidate.sensor]
    selected = {b: blocks[b].select(candidate.columns) for b in own}
    norms = {b: np.sqrt(np.mean(selected[b] ** 2, axis=0)) for b in own}
    largest = np.max([norms[b] for b in own], axis=0)
    acts = {b: (norms[b] > _ACTS * largest) & (largest > 0) for b in own}
    shared = np.sum([acts[b] for b in own], axis=0) > 1
    if np.any(shared):
        touched = tuple(b for b in own if np.any(acts[b]))
        used = np.flatnonzero(np.any([acts[b] for b in touched], axis=0))
        return [Unit(candidate, touched, tuple(selected[b][:, used] for b in touched), tuple(used.tolist()))]
    return [
        Unit(candidate, (b,), (selected[b][:, acts[b]],), tuple(np.flatnonzero(acts[b]).tolist()))
        for b in own
        if np.any(acts[b])
    ]


class Evidence:
    """Evidence for all hypotheses over all blocks."""

    def __init__(
        self, blocks: Sequence[BlockEvidence], found: Sequence[Hypothesis], places: Sequence[tuple[int, ...]]
    ) -> None:
        self.blocks = blocks
        self.hypotheses = found
        self._places = places

    def log_factors(self, y: Sequence[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
        """Return log Bayes factors (h, m), and those of each one's units (u, m), for data sets `y[block]` (N, m)."""
        per_block = [block.log_factors(values) for block, values in zip(self.blocks, y, strict=True)]
        joint = (
            JointEvidence(self.blocks, y) if any(unit.is_joint for h in self.hypotheses for unit in h.units) else None
        )
        totals, parts = [], []
        for hypothesis, places in zip(self.hypotheses, self._places, strict=True):
            units = np.array(
                [
                    per_block[unit.blocks[0]][place] if not unit.is_joint else joint.log_factor(unit)  # type: ignore[union-attr]
                    for unit, place in zip(hypothesis.units, places, strict=True)
                ]
            )
            parts.append(units)
            totals.append(_inclusion(units))
        return np.array(totals), parts


def _inclusion(units: FloatArray) -> FloatArray:
    """Combine units, each touched or not with even odds and at least one touched, (u, m) → (m,)."""
    count = len(units)
    if count == 1:
        return np.asarray(units[0])
    log_all = np.sum(np.logaddexp(0.0, units), axis=0)  # sum over all subsets, the empty one included
    return np.asarray(log_all + np.log(-np.expm1(-np.maximum(log_all, 1e-12))) - np.log(2.0**count - 1.0))


class JointEvidence:
    """Evidence for parameters shared by several blocks, at the few noise points of each block that matter for them."""

    def __init__(self, blocks: Sequence[BlockEvidence], y: Sequence[FloatArray]) -> None:
        self.blocks = blocks
        self._states = [block.projection.log_null(values, block.prior) for block, values in zip(blocks, y, strict=True)]

    def log_factor(self, unit: Unit) -> FloatArray:
        """Return the log Bayes factor of one unit, shape (m,): all combinations of the blocks' noise points at once."""
        pieces = [self._pieces(b, columns) for b, columns in zip(unit.blocks, unit.columns, strict=True)]
        places = np.indices([len(piece.before) for piece in pieces]).reshape(len(pieces), -1)
        chosen = [piece.take(place) for piece, place in zip(pieces, places, strict=True)]
        weight = np.sum([piece.log_weight for piece in chosen], axis=0)
        return _log_sum(weight + _joint_factors(chosen)) - _log_sum(weight)

    def _pieces(self, b: int, columns: FloatArray) -> _Piece:
        """What the block says of the unit at its best noise points, without and with the unit."""
        block = self.blocks[b]
        residual, rss, log_null = self._states[b]
        white = block.noise.whitening @ columns
        projected = block.projection.beside(white)
        gram = np.swapaxes(projected, 1, 2) @ projected
        score = np.swapaxes(projected, 1, 2) @ residual
        before = np.einsum("tnk,tnk->tk", white, white)
        power = block.prior.a + 0.5 * block.projection.freedom
        offset = block.prior.b + 0.5 * rss
        ridge = gram + 1e-6 * before.max() * np.eye(gram.shape[1])
        explained = np.einsum("tqm,tqm->tm", score, np.linalg.solve(ridge, score))
        with_unit = log_null - power * np.log1p(-np.clip(0.5 * explained / offset, 0.0, 1.0 - 1e-9))
        order_null, order_unit = np.argsort(-log_null.mean(axis=1)), np.argsort(-with_unit.mean(axis=1))
        best = dict.fromkeys([int(order_null[0]), int(order_unit[0]), int(order_unit[min(1, len(order_unit) - 1)])])
        return _Piece(gram, score, before, offset, log_null, power).take(np.array(list(best)))


@dataclass(frozen=True)
class _Piece:
    """One block at several noise points: Gram (t, q, q), score (t, q, m), norms (t, q), offset and weight (t, m)."""

    gram: FloatArray
    score: FloatArray
    before: FloatArray
    offset: FloatArray
    log_weight: FloatArray
    power: float

    def take(self, place: IntArray) -> _Piece:
        """Return some points, in this order, repeated where asked for."""
        gram, score, before = self.gram[place], self.score[place], self.before[place]
        return _Piece(gram, score, before, self.offset[place], self.log_weight[place], self.power)


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
        usable = values > _INVISIBLE**2 * np.maximum(whole.max(axis=1), 1e-300)[:, None, None]
        inverse = np.where(usable, 1.0 / np.where(usable, values, 1.0), 0.0)
        turned = inverse[..., None] * (np.swapaxes(vectors, 2, 3) @ score[..., None])
        fit = (vectors @ turned)[..., 0] * normal[:, None]
        rank = usable.sum(axis=2).astype(np.float64)
        changes = [2.0 * np.einsum("tmq,tqm->tm", fit, c.score) - np.sum((fit @ c.gram) * fit, axis=2) for c in chosen]
        offsets = [
            np.maximum(c.offset - 0.5 * change, 1e-9 * c.offset) for c, change in zip(chosen, changes, strict=True)
        ]
    terms = []
    for g in _G:
        total = -0.5 * rank * np.log1p(g) - np.log(len(_G))
        for c, change in zip(chosen, changes, strict=True):
            share = 0.5 * change / c.offset * (g / (1.0 + g))
            total = total - c.power * np.log1p(-np.clip(share, None, 1.0 - 1e-9))
        terms.append(total)
    return np.where(rank > 0, _log_sum(np.array(terms)), 0.0)


def build_evidence(
    found: Sequence[Hypothesis],
    blocks: Sequence[Block],
    tables: Sequence[NoiseTable],
    rich: Sequence[Sequence[FloatArray]],
    *,
    keep_all: bool = False,
) -> Evidence:
    """Lay out the columns of all units block by block and compute their evidence tables.

    `keep_all` keeps every noise point of the tables, whatever these data say (a layout that many units share).
    """
    columns: list[list[FloatArray]] = [[] for _ in blocks]
    places: list[tuple[int, ...]] = []
    for hypothesis in found:
        here = []
        for unit in hypothesis.units:
            if unit.is_joint:
                here.append(-1)
            else:
                here.append(len(columns[unit.blocks[0]]))
                columns[unit.blocks[0]].append(unit.columns[0])
        places.append(tuple(here))
    evidence = [
        BlockEvidence(block, table, cols, extra, keep_all=keep_all)
        for block, table, cols, extra in zip(blocks, tables, columns, rich, strict=True)
    ]
    return Evidence(evidence, found, places)


def seen(found: Sequence[Hypothesis], blocks: Sequence[Block]) -> list[Hypothesis]:
    """Leave out what this layout cannot see, and second-tier terms that the catalogue already has a name for.

    The prior is shared out again among what is left, so that neither takes part of it.
    """
    bases = [_span(block.base) for block in blocks]
    spans = [[_unit_spans(unit, bases) for unit in h.units] for h in found]
    visible = [any(np.any([s.shape[1] for s in unit]) for unit in h) for h in spans]
    found = _irregular_apart(found, visible)
    known: dict[int, list[FloatArray]] = {}
    for place, (hypothesis, parts) in enumerate(zip(found, spans, strict=True)):
        if visible[place] and hypothesis.tier == 1 and hypothesis.candidate.form != "table":
            for unit, part in zip(hypothesis.units, parts, strict=True):
                if not unit.is_joint and 1 <= part[0].shape[1] <= _FEW:
                    known.setdefault(unit.blocks[0], []).append(part[0])
    kept = []
    for place, (hypothesis, parts) in enumerate(zip(found, spans, strict=True)):
        if not visible[place]:
            continue
        if hypothesis.tier == 2 and all(
            _known(unit, part, known) for unit, part in zip(hypothesis.units, parts, strict=True)
        ):
            continue
        kept.append(hypothesis)
    return share_prior(kept, found)


def _irregular_apart(found: Sequence[Hypothesis], visible: Sequence[bool]) -> list[Hypothesis]:
    """Take the name from values per setpoint of a term that the base already has as one number.

    What is left is irregular: certain perhaps, but it follows temperature in no way that an effect of the catalogue
    does, so it belongs to the second tier. A term that the base lacks altogether is itself at every setpoint.
    """
    whole = {
        h.name
        for h, seen_ in zip(found, visible, strict=True)
        if seen_ and h.candidate.form == "constant" and h.candidate.effect is not None
        if h.candidate.effect.id not in _FOLLOWS
    }
    out = []
    for hypothesis in found:
        irregular = hypothesis.tier == 1 and hypothesis.candidate.form == "table" and hypothesis.name not in whole
        apart = replace(hypothesis, tier=2, name=f"{hypothesis.name} × setpoint by setpoint")
        out.append(apart if irregular else hypothesis)
    return out


def share_prior(
    found: Sequence[Hypothesis], asked: Sequence[Hypothesis], catalogue_share: float = 0.8
) -> list[Hypothesis]:
    """Share the prior out: 80 to 20 between catalogue and second tier, names evenly within, shapes within a name.

    A name whose plain form is in the base already keeps only the share of the forms that are left (`asked` are all).
    """
    names = {tier: len({h.name for h in found if h.tier == tier}) for tier in (1, 2)}
    weights = [_form_weight(h) for h in found]
    totals: dict[str, float] = {}
    for hypothesis in asked:
        totals[hypothesis.name] = totals.get(hypothesis.name, 0.0) + _form_weight(hypothesis)
    share = {1: catalogue_share if names[2] else 1.0, 2: 1.0 - catalogue_share if names[1] else 1.0}
    return [
        replace(h, log_prior=float(np.log(share[h.tier] / names[h.tier] * w / totals[h.name])))
        for h, w in zip(found, weights, strict=True)
    ]


def _form_weight(hypothesis: Hypothesis) -> float:
    plain = "line" if hypothesis.name in _FOLLOWS else "constant"
    return _PLAIN if hypothesis.candidate.form == plain else 1.0


def _span(columns: FloatArray) -> FloatArray:
    if columns.shape[1] == 0:
        return np.zeros((columns.shape[0], 0))
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left, singular, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(left[:, singular > 1e-7])


def _unit_spans(unit: Unit, bases: Sequence[FloatArray]) -> list[FloatArray]:
    """What is left of a unit beside the base in each of its blocks, as an orthonormal basis."""
    out = []
    for block, columns in zip(unit.blocks, unit.columns, strict=True):
        scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        rest = scaled - bases[block] @ (bases[block].T @ scaled)
        left, singular, _ = np.linalg.svd(rest, full_matrices=False)
        out.append(left[:, singular > _INVISIBLE])
    return out


def _known(unit: Unit, part: Sequence[FloatArray], known: Mapping[int, Sequence[FloatArray]]) -> bool:
    """Whether a unit of few columns lies within a catalogue effect of few columns in the same block."""
    own = part[0]
    if own.shape[1] == 0:
        return True
    if unit.is_joint or own.shape[1] > 1:
        return False
    return any(float(np.linalg.norm(span.T @ own[:, 0])) > _SAME for span in known.get(unit.blocks[0], []))
