"""Candidates of all sensors together: which parts of the data each one touches, and what all parts say jointly.

A hypothesis is a candidate (name, shape, form) on every sensor where it can exist. Its columns fall into units: one per
block where its parameters are the block's own, one per sensor where a parameter acts on several blocks (a scale factor, a
phase). A unit may be touched or not, with even odds, so that an effect of one channel alone is not asked to pay for the
other, and an effect of both is not split in two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from hil.campaign import FloatArray
from hil.reconcile.blocks import Block
from hil.reconcile.candidates import Candidate
from hil.reconcile.evidence import _G, _INVISIBLE, BlockEvidence, NoiseTable, _log_sum

_ACTS = 1e-9
_JOINT_POINTS = 3
_SAME = 0.98
_PLAIN = 5.0  # a value that is one number is this many times as probable as one that follows temperature in some form


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
        key = (candidate.tier, candidate.name, tuple(sorted(candidate.shape.items())), candidate.form)
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
    scale = np.abs(candidate.columns).max(axis=(0, 1))
    acts = {b: np.abs(selected[b]).max(axis=0) > _ACTS * np.maximum(scale, 1e-300) for b in own}
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
        """Return log Bayes factors (h, m) and, per hypothesis, those of its units (u, m), for data sets `y[block]` (N, m)."""
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
    """Evidence for parameters shared by several blocks, at a few noise points of each block."""

    def __init__(self, blocks: Sequence[BlockEvidence], y: Sequence[FloatArray]) -> None:
        self.blocks = blocks
        self._points, self._states = [], []
        for block, values in zip(blocks, y, strict=True):
            residual, rss, log_null = block.projection.log_null(values, block.prior)
            order = np.argsort(-log_null.mean(axis=1))
            quiet = np.argsort(rss.mean(axis=1) / np.maximum(block.projection.freedom, 1))[::-1]
            points = list(dict.fromkeys([int(order[0]), int(quiet[0]), *order.tolist()]))[:_JOINT_POINTS]
            self._points.append(points)
            self._states.append((residual, rss, log_null))

    def log_factor(self, unit: Unit) -> FloatArray:
        """Return the log Bayes factor of one unit, shape (m,)."""
        pieces = [self._piece(b, columns) for b, columns in zip(unit.blocks, unit.columns, strict=True)]
        factors, weights = [], []
        for combination in product(*(range(len(self._points[b])) for b in unit.blocks)):
            chosen = [
                (*pieces[i][k], *self._scale(b, self._points[b][k]))
                for i, (b, k) in enumerate(zip(unit.blocks, combination, strict=True))
            ]
            factors.append(_joint_factor(chosen))
            weights.append(
                sum(self._states[b][2][self._points[b][k]] for b, k in zip(unit.blocks, combination, strict=True))
            )
        weight = np.array(weights)
        return _log_sum(weight + np.array(factors)) - _log_sum(weight)

    def _piece(self, b: int, columns: FloatArray) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        block = self.blocks[b]
        out = []
        for point in self._points[b]:
            projected = block.projection.maker[point] @ columns
            before = np.sum((block.noise.whitening[point] @ columns) ** 2, axis=0)
            out.append((projected.T @ projected, projected.T @ self._states[b][0][point], before))
        return out

    def _scale(self, b: int, point: int) -> tuple[FloatArray, float]:
        block = self.blocks[b]
        return block.prior.b + 0.5 * self._states[b][1][point], block.prior.a + 0.5 * block.projection.freedom


def _joint_factor(chosen: Sequence[tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]]) -> FloatArray:
    """Log Bayes factor at fixed noise points; the scale of each block is re-estimated with the candidate in place."""
    draws = chosen[0][1].shape[1]
    offsets = [c[3] for c in chosen]
    changes = [np.zeros(draws) for _ in chosen]
    before = np.sum([c[2] for c in chosen], axis=0)
    normal = 1.0 / np.sqrt(np.where(before > 0, before, 1.0))
    rank = np.zeros(draws)
    for _ in range(2):
        precision = [c[4] / offset for offset, c in zip(offsets, chosen, strict=True)]
        gram = np.sum(
            [p[:, None, None] * (c[0] * normal[:, None] * normal) for p, c in zip(precision, chosen, strict=True)],
            axis=0,
        )
        whole = np.sum([p.mean() * c[2] for p, c in zip(precision, chosen, strict=True)], axis=0) * normal**2
        score = np.sum(
            [p[:, None] * (c[1] * normal[:, None]).T for p, c in zip(precision, chosen, strict=True)], axis=0
        )
        values, vectors = np.linalg.eigh(gram)
        usable = values > _INVISIBLE**2 * max(float(whole.max()), 1e-300)
        inverse = np.where(usable, 1.0 / np.where(usable, values, 1.0), 0.0)
        fit = np.einsum("mqk,mk,mrk,mr->mq", vectors, inverse, vectors, score) * normal
        rank = usable.sum(axis=1).astype(np.float64)
        changes = [2.0 * np.einsum("mq,qm->m", fit, c[1]) - np.einsum("mq,qr,mr->m", fit, c[0], fit) for c in chosen]
        offsets = [np.maximum(c[3] - 0.5 * change, 1e-9 * c[3]) for c, change in zip(chosen, changes, strict=True)]
    terms = []
    for g in _G:
        total = -0.5 * rank * np.log1p(g) - np.log(len(_G))
        for c, change in zip(chosen, changes, strict=True):
            share = 0.5 * change / c[3] * (g / (1.0 + g))
            total = total - c[4] * np.log1p(-np.clip(share, None, 1.0 - 1e-9))
        terms.append(total)
    return np.where(rank > 0, _log_sum(np.array(terms)), 0.0)


def build_evidence(
    found: Sequence[Hypothesis],
    blocks: Sequence[Block],
    tables: Sequence[NoiseTable],
    rich: Sequence[Sequence[FloatArray]],
) -> Evidence:
    """Lay out the columns of all units block by block and compute their evidence tables."""
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
        BlockEvidence(block, table, cols, extra)
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
    direction: dict[int, list[tuple[tuple[int, ...], FloatArray]]] = {}
    for place, (hypothesis, parts) in enumerate(zip(found, spans, strict=True)):
        if visible[place] and hypothesis.tier == 1:
            for unit, part in zip(hypothesis.units, parts, strict=True):
                if not unit.is_joint and part[0].shape[1] == 1:
                    direction.setdefault(unit.blocks[0], []).append((unit.blocks, part[0][:, 0]))
    known = {block: np.array([v for _, v in entries]) for block, entries in direction.items()}
    kept = []
    for place, (hypothesis, parts) in enumerate(zip(found, spans, strict=True)):
        if not visible[place]:
            continue
        if hypothesis.tier == 2 and all(
            _known(unit, part, known) for unit, part in zip(hypothesis.units, parts, strict=True)
        ):
            continue
        kept.append(hypothesis)
    return share_prior(kept)


def share_prior(found: Sequence[Hypothesis], catalogue_share: float = 0.8) -> list[Hypothesis]:
    """Share the prior out: 80 to 20 between catalogue and second tier, names evenly within, shapes evenly within a name."""
    names = {tier: len({h.name for h in found if h.tier == tier}) for tier in (1, 2)}
    weights = np.array([_PLAIN if h.candidate.form == "constant" else 1.0 for h in found])
    totals: dict[str, float] = {}
    for hypothesis, weight in zip(found, weights, strict=True):
        totals[hypothesis.name] = totals.get(hypothesis.name, 0.0) + weight
    share = {1: catalogue_share if names[2] else 1.0, 2: 1.0 - catalogue_share if names[1] else 1.0}
    return [
        replace(h, log_prior=float(np.log(share[h.tier] / names[h.tier] * w / totals[h.name])))
        for h, w in zip(found, weights, strict=True)
    ]


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


def _known(unit: Unit, part: Sequence[FloatArray], known: dict[int, FloatArray]) -> bool:
    """Whether a one-column unit has the direction of a catalogue effect in the same block."""
    if part[0].shape[1] == 0:
        return True
    if unit.is_joint or part[0].shape[1] != 1 or unit.blocks[0] not in known:
        return False
    return bool(np.max(np.abs(known[unit.blocks[0]] @ part[0][:, 0])) > _SAME)
