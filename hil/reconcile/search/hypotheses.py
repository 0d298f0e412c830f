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
from hil.model.effects.base import Effect
from hil.model.effects.catalogue import named
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.evidence import INVISIBLE, BlockEvidence, relevant_points
from hil.reconcile.search.joint import JointColumns, JointEvidence
from hil.reconcile.search.whitened import Whitened
from hil.solve.identifiability import orthonormal, project_out, share_within, unit_columns
from hil.solve.likelihood import NoiseTable
from hil.solve.rows import Block

_ACTS = 0.03  # a parameter that moves a block less than this, beside the block it moves most, does not tie the two
_SAME = 0.98
_FEW = 2
_PLAIN = 5.0  # a value that is one number is this many times as probable as one that follows temperature in some form


@dataclass(frozen=True)
class Unit:
    """One part of a hypothesis: the candidate of one sensor, its blocks, and the columns, (N, q), that act in each."""

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

    @property
    def effect(self) -> Effect | None:
        """The effect of the catalogue that it is named after; None for a term of the second tier."""
        own = self.candidate.effect
        return None if own is None or self.tier != 1 else named(own)


def hypotheses(candidates: Sequence[Candidate], blocks: Sequence[Block]) -> list[Hypothesis]:
    """Merge candidates over sensors, cut them into units, leave out what cannot be seen, and share out the prior."""
    merged: dict[tuple[object, ...], list[Candidate]] = {}
    for candidate in candidates:
        shape = (candidate.searched, candidate.before_degC)
        key = (candidate.tier, candidate.name, shape, candidate.form)
        merged.setdefault(key, []).append(candidate)
    found = []
    for members in merged.values():
        units = tuple(unit for member in members for unit in units_of(member, blocks))
        if units:
            found.append(Hypothesis(members[0].name, members[0].tier, units))
    return seen(found, blocks)


def units_of(candidate: Candidate, blocks: Sequence[Block]) -> list[Unit]:
    """Cut a candidate into units: one per block, or one where a parameter acts on several blocks."""
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


@dataclass(frozen=True)
class Layout:
    """The columns of all units, whitened at the noise points of every block: made once, for many bases and data sets.

    Units are numbered hypothesis by hypothesis: those of the h-th are `starts[h]` to `starts[h + 1]`. `units[b]` (j,)
    are the units that one block has for itself, in the order of `own[b]`.
    """

    hypotheses: Sequence[Hypothesis]
    tables: Sequence[NoiseTable]
    starts: IntArray
    units: Sequence[IntArray]
    own: Sequence[Whitened]
    joint: Sequence[JointColumns]

    @classmethod
    def of(cls, found: Sequence[Hypothesis], tables: Sequence[NoiseTable]) -> Layout:
        """Number all units and whiten their columns."""
        starts = np.cumsum([0, *(len(h.units) for h in found)])
        numbered = list(enumerate(unit for h in found for unit in h.units))
        by_block = [[(i, u) for i, u in numbered if u.blocks == (b,)] for b in range(len(tables))]
        own = [
            Whitened.of(table.whitening, [unit.columns[0] for _, unit in members])
            for table, members in zip(tables, by_block, strict=True)
        ]
        shared: dict[tuple[tuple[int, ...], int], list[tuple[int, Unit]]] = {}
        for i, unit in numbered:
            if unit.is_joint:
                shared.setdefault((unit.blocks, unit.columns[0].shape[1]), []).append((i, unit))
        joint = []
        for (blocks, _), members in shared.items():
            parts = [
                Whitened.of(tables[b].whitening, [unit.columns[k] for _, unit in members]).groups[0]
                for k, b in enumerate(blocks)
            ]
            joint.append(JointColumns(np.array([i for i, _ in members]), blocks, tuple(parts)))
        return cls(
            found,
            tables,
            starts,
            [np.array([i for i, _ in members], dtype=np.int64) for members in by_block],
            own,
            joint,
        )

    def take(self, index: Sequence[int]) -> Layout:
        """Return the layout of some of the hypotheses."""
        kept = np.concatenate([np.arange(self.starts[h], self.starts[h + 1]) for h in index])
        number = np.full(self.starts[-1], -1)
        number[kept] = np.arange(len(kept))
        here = [np.flatnonzero(number[units] >= 0) for units in self.units]
        joint = []
        for columns in self.joint:
            places = np.flatnonzero(number[columns.units] >= 0)
            if len(places):
                joint.append(columns.take(places, number[columns.units[places]]))
        return Layout(
            [self.hypotheses[h] for h in index],
            self.tables,
            np.cumsum([0, *(len(self.hypotheses[h].units) for h in index)]),
            [number[units[places]] for units, places in zip(self.units, here, strict=True)],
            [white.take(places) for white, places in zip(self.own, here, strict=True)],
            joint,
        )

    def beside(self, blocks: Sequence[Block]) -> Evidence:
        """Return the evidence beside the bases that the blocks have now."""
        evidence = [
            BlockEvidence(block, table, white)
            for block, table, white in zip(blocks, self.tables, self.own, strict=True)
        ]
        return Evidence(evidence, self)


class Evidence:
    """Evidence for all hypotheses over all blocks."""

    def __init__(self, blocks: Sequence[BlockEvidence], layout: Layout) -> None:
        self.blocks = blocks
        self.layout = layout

    def log_factors(self, y: Sequence[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
        """Return log Bayes factors (h, m), and those of each one's units (u, m), for data sets `y[block]` (N, m)."""
        starts = self.layout.starts
        units = np.zeros((starts[-1], y[0].shape[1]))
        states = [block.state(values) for block, values in zip(self.blocks, y, strict=True)]
        for block, places, state in zip(self.blocks, self.layout.units, states, strict=True):
            units[places] = block.log_factors_of(state)
        if self.layout.joint:
            joint = JointEvidence(self.blocks, states)
            for columns in self.layout.joint:
                units[columns.units] = joint.log_factors(columns)
        counts = np.diff(starts)
        totals = np.zeros((len(counts), units.shape[1]))
        for count in np.unique(counts):
            some = np.flatnonzero(counts == count)
            totals[some] = _inclusion(units[starts[some][:, None] + np.arange(count)])
        return totals, np.split(units, starts[1:-1])


def _inclusion(units: FloatArray) -> FloatArray:
    """Combine units, each touched or not with even odds and at least one touched, (h, u, m) → (h, m)."""
    count = units.shape[1]
    if count == 1:
        return np.asarray(units[:, 0])
    log_all = np.sum(np.logaddexp(0.0, units), axis=1)  # sum over all subsets, the empty one included
    return np.asarray(log_all + np.log(-np.expm1(-np.maximum(log_all, 1e-12))) - np.log(2.0**count - 1.0))


def build_evidence(
    found: Sequence[Hypothesis],
    blocks: Sequence[Block],
    tables: Sequence[NoiseTable],
    rich: Sequence[Sequence[FloatArray]],
    *,
    keep_all: bool = False,
) -> Evidence:
    """Lay out the columns of all units and compute their evidence at the noise points that matter for these data.

    `rich` are models of the means of each block, each (N, p). `keep_all` keeps every noise point of the tables,
    whatever these data say (a layout that many units share).
    """
    if not keep_all:
        tables = [
            table.take(relevant_points(block, table, extra))
            for block, table, extra in zip(blocks, tables, rich, strict=True)
        ]
    return Layout.of(found, tables).beside(blocks)


def seen(found: Sequence[Hypothesis], blocks: Sequence[Block]) -> list[Hypothesis]:
    """Leave out what this layout cannot see, and second-tier terms that the catalogue already has a name for.

    The prior is shared out again among what is left, so that neither takes part of it.
    """
    bases = [orthonormal(block.base) for block in blocks]
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
        if h.candidate.effect.plain_form == "constant"
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
    effect = hypothesis.effect
    plain = "constant" if effect is None else effect.plain_form
    return _PLAIN if hypothesis.candidate.form == plain else 1.0


def _unit_spans(unit: Unit, bases: Sequence[FloatArray]) -> list[FloatArray]:
    """What is left of a unit beside the base in each of its blocks, as an orthonormal basis."""
    return [
        orthonormal(project_out(bases[block], unit_columns(columns)), INVISIBLE, scale=1.0)
        for block, columns in zip(unit.blocks, unit.columns, strict=True)
    ]


def _known(unit: Unit, part: Sequence[FloatArray], known: Mapping[int, Sequence[FloatArray]]) -> bool:
    """Whether a unit of few columns lies within a catalogue effect of few columns in the same block."""
    own = part[0]
    if own.shape[1] == 0:
        return True
    if unit.is_joint or own.shape[1] > 1:
        return False
    return any(share_within(span, own[:, 0]) > _SAME for span in known.get(unit.blocks[0], []))
