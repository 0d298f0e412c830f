"""Whether the gap shrank on data that was held out, with the selection repeated inside every fold.

A run (or a pose, where there is one run only) is left out; what is missing is searched for and named again in the rest,
everything is refitted there, and the run that was not seen is predicted with and without what was added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import BoolArray, FloatArray, IntArray
from hil.reconcile.search.fit import UNSEEN, Added, BlockNoise, Fit, chosen_units, refit
from hil.reconcile.search.hypotheses import Hypothesis, Layout
from hil.reconcile.search.problem import LEAST_FREEDOM
from hil.solve.identifiability import (
    combinations_beside,
    independent_columns,
    orthonormal,
    project_out,
    unit_columns,
)
from hil.solve.likelihood import NoiseTable, ScalePrior, restricted_likelihood
from hil.solve.rows import Block

_FLIPS = 2000
_ENOUGH_FOLDS = 6
_MOSTLY = 0.6
_KEPT_POINTS = 20
_FEW = 6
_LOOKED_AT = 30
_MOST = 0.7
_ALIKE = 1e-3  # of log evidence


@dataclass(frozen=True)
class HeldOut:
    """Squared errors of held-out rows by fold, (folds,): raw sums in (deg/hr)², standardised ones, before and after."""

    raw_before: FloatArray
    raw_after: FloatArray
    scaled_before: FloatArray
    scaled_after: FloatArray
    rows: IntArray
    expected: FloatArray

    @classmethod
    def of(cls, sums: FloatArray, rows: IntArray) -> HeldOut:
        """Make it of sums (5, folds): raw before and after, standardised before and after, expected; rows (folds,)."""
        return cls(sums[0], sums[1], sums[2], sums[3], rows, sums[4])

    @property
    def floor(self) -> float:
        """Rms that the noise alone leaves on held-out rows, refitted parameters included, deg/hr."""
        return float(np.sqrt(self.expected.sum() / max(int(self.rows.sum()), 1)))

    @property
    def rms(self) -> tuple[float, float]:
        """Raw rms before and after, deg/hr."""
        total = max(int(self.rows.sum()), 1)
        return float(np.sqrt(self.raw_before.sum() / total)), float(np.sqrt(self.raw_after.sum() / total))

    @property
    def standardised(self) -> tuple[float, float]:
        """Standardised mean squares before and after (1 is noise)."""
        total = max(int(self.rows.sum()), 1)
        return float(self.scaled_before.sum() / total), float(self.scaled_after.sum() / total)

    def spoiling_fold(self) -> int | None:
        """Return the one fold without which the rest improves, where it alone spoils the sum; None otherwise.

        A step between two runs cannot be placed by the others when one of the two is held out.
        """
        gain = self.scaled_before - self.scaled_after
        if len(gain) < _ENOUGH_FOLDS or gain.sum() > 0:
            return None
        worst = int(np.argmin(gain))
        rest = np.delete(gain, worst)
        best = float(rest.max(initial=0.0))
        return worst if rest.sum() - best > 0 and np.mean(rest > 0) > _MOSTLY else None

    def without(self, fold: int) -> HeldOut:
        """Return the comparison without one fold."""
        return HeldOut(*(np.delete(getattr(self, name), fold) for name in self.__dataclass_fields__))

    def taken_back(self) -> HeldOut:
        """Return the comparison with nothing added: after is as before."""
        return replace(self, raw_after=self.raw_before, scaled_after=self.scaled_before)

    def starting_from(self, other: HeldOut) -> HeldOut:
        """Return the comparison with the same folds of `other`, on other rates, as what was before."""
        return replace(self, raw_before=other.raw_before, scaled_before=other.scaled_before)

    def improvement_p_value(self, rng: np.random.Generator) -> float:
        """Paired sign flips by fold: how often chance alone would improve this much."""
        gain = self.scaled_before - self.scaled_after
        if len(gain) < 2 or not np.any(gain):
            return 1.0
        signs = rng.choice([-1.0, 1.0], size=(_FLIPS, len(gain)))
        return float((1 + np.sum(signs @ gain >= gain.sum())) / (1 + _FLIPS))


def by_run(blocks: Sequence[Block], place_of_run: Sequence[IntArray]) -> list[list[BoolArray]]:
    """Return the rows, (N,), held out in every block, by fold: one per run, or per collect where runs are few."""
    several = len(np.unique(np.concatenate(place_of_run))) >= 4
    labels = list(place_of_run) if several else [block.order for block in blocks]
    values = np.unique(np.concatenate(labels))
    return [[label == value for label in labels] for value in values]


def in_blocks(blocks: Sequence[Block], place_of_run: Sequence[IntArray], count: int = 6) -> list[list[BoolArray]]:
    """Return folds of neighbouring runs (or collects), `count` of them: in each the rows, (N,), of every block."""
    folds = by_run(blocks, place_of_run)
    cut = np.array_split(np.arange(len(folds)), min(count, len(folds)))
    return [[np.any([folds[i][b] for i in part], axis=0) for b in range(len(blocks))] for part in cut if len(part)]


def held_out(
    folds: Sequence[Sequence[BoolArray]],
    blocks: Sequence[Block],
    tables: Sequence[NoiseTable],
    noise: Sequence[BlockNoise],
    hypotheses: Sequence[Hypothesis],
    steps: int,
    points: Sequence[IntArray],
    designs: Sequence[FloatArray],
) -> list[HeldOut]:
    """Predict every fold from the others, before and with one effect, two, … up to `steps` that are searched in each.

    `designs[b]` (N, p) are base and effects together. A fold that the others cannot predict at all (the only run at its
    temperature, where values belong to temperatures) is not counted: it could not judge anything.
    """
    whole = [
        fold
        for fold in folds
        if all((~held).sum() > b.base.shape[1] + 2 for held, b in zip(fold, blocks, strict=True))
        and not any(_is_beyond(design, held) for design, held in zip(designs, fold, strict=True))
    ]
    sums = np.zeros((max(steps, 1), 5, len(whole)))
    rows = np.array([sum(int(held.sum()) for held in fold) for fold in whole], dtype=np.int64)
    asked = hypotheses if steps else ()
    few = Layout.of(asked, [table.take(point[:_FEW]) for table, point in zip(tables, points, strict=True)])
    many = Layout.of(asked, [table.take(point) for table, point in zip(tables, points, strict=True)])
    for i, fold in enumerate(whole):
        keep = [~held for held in fold]
        added = _select(keep, blocks, few, many, steps)
        kept_noise = [n.take(own) for n, own in zip(noise, keep, strict=True)]
        held_noise = [n.take(held) for n, held in zip(noise, fold, strict=True)]
        plain = refit(blocks, kept_noise, [], keep)
        for k in range(len(sums)):
            if k and k >= len(added):  # nothing more was found: as with one effect fewer
                sums[k, :, i] = sums[k - 1, :, i]
                continue
            some = added[: k + 1]
            full = refit(blocks, kept_noise, some, keep) if some else plain
            for b, held in enumerate(fold):
                if np.any(held):
                    sums[k, :4, i] += _errors(plain, full, held_noise[b], b, held)
                    sums[k, 4, i] += _expected(blocks[b], noise[b], kept_noise[b], some, b, len(blocks), held)
    return [HeldOut.of(part, rows) for part in sums]


def _errors(before: Fit, after: Fit, noise: BlockNoise, b: int, held: BoolArray) -> FloatArray:
    """Squared errors of one block's held-out rows, raw before and after, standardised before and after, (4,).

    `noise` is that of the held-out rows.
    """
    errors = (before.residual[b][held], after.residual[b][held])
    raw = [float(error @ error) for error in errors]
    return np.array(raw + [float(np.sum((noise.whitening @ error) ** 2)) for error in errors])


def in_sample(blocks: Sequence[Block], noise: Sequence[BlockNoise], steps: Sequence[Added]) -> HeldOut:
    """Residuals of the fits themselves, before and after, as one fold: where nothing can be held out."""
    plain, full = refit(blocks, noise, []), refit(blocks, noise, steps)
    sums = np.zeros((5, 1))
    for b, block in enumerate(blocks):
        sums[:4, 0] += _errors(plain, full, noise[b], b, np.ones(len(block.y), dtype=bool))
        sums[4, 0] += float(np.trace(noise[b].covariance))
    rows = np.array([sum(len(block.y) for block in blocks)])
    return HeldOut.of(sums, rows)


def _is_beyond(design: FloatArray, held: BoolArray) -> bool:
    """Whether a held-out row asks for something that the other rows say nothing about."""
    if not np.any(held) or design.shape[1] == 0:
        return False
    scaled = unit_columns(design)
    rows = scaled[held].T
    rest = project_out(orthonormal(scaled[~held].T, 1e-6, scale=1.0), rows)
    return bool(np.linalg.norm(rest) > 0.1 * np.linalg.norm(rows))


def _expected(
    block: Block, noise: BlockNoise, kept_noise: BlockNoise, added: Sequence[Added], b: int, count: int, held: BoolArray
) -> float:
    """Sum of squares that noise alone leaves on held-out rows when everything is refitted on the others.

    `noise` is that of all rows, `kept_noise` that of the others.
    """
    extra = [columns for effect in added if (columns := effect.columns(count)[b]) is not None]
    kept = ~held
    design = independent_columns(np.hstack([block.base, *(_seen_beside(block.base, e, kept) for e in extra)]), 1e-6)
    white = kept_noise.whitening
    fitted = np.linalg.pinv(white @ design[kept], rcond=1e-8) @ white
    error = np.zeros((int(held.sum()), len(block.y)))
    error[:, held] = np.eye(int(held.sum()))
    error[:, kept] = -design[held] @ fitted
    return float(np.trace(error @ noise.covariance @ error.T))


def _seen_beside(base: FloatArray, columns: FloatArray, kept: BoolArray) -> FloatArray:
    """What of an effect the kept rows show beside the base, (N, k): the fit gives the rest to the base."""
    norm = np.linalg.norm(columns[kept], axis=0)
    scaled = columns / np.where(norm > 0.0, norm, 1.0)
    return np.asarray(scaled @ combinations_beside(orthonormal(base[kept]), scaled[kept], UNSEEN))


def _select(keep: Sequence[BoolArray], blocks: Sequence[Block], few: Layout, many: Layout, steps: int) -> list[Added]:
    """Search again on the rows that are kept, for as many effects as all rows show, at few and then at many noises.

    A row with a base column of its own says nothing of anything else, so that the tables made for all rows serve.
    """
    present = [b.with_base(np.eye(len(b.y))[:, ~rows]) for b, rows in zip(blocks, keep, strict=True)]
    added: list[Added] = []
    for _ in range(steps):
        if min(len(b.y) - b.base.shape[1] for b in present) < LEAST_FREEDOM:
            break
        strongest = np.sort(np.argsort(-_weighed(few, present)[0])[:_LOOKED_AT])
        shown = [i for i in strongest.tolist() if _shows(many.hypotheses[i], keep)]
        if not shown:
            break
        likely = [many.hypotheses[i] for i in shown]
        posterior, units = _weighed(many.take(shown), present)
        best = _best(likely, posterior)
        alike = [h for h, value in zip(likely, posterior, strict=True) if posterior[best] - value < _ALIKE]
        added.append(chosen_units(_average(likely[best], alike), units[best][:, 0]))
        extra = added[-1].columns(len(present))
        present = [b if e is None else b.with_base(e) for b, e in zip(present, extra, strict=True)]
    return added


def _average(best: Hypothesis, alike: Sequence[Hypothesis]) -> Hypothesis:
    """The mean of the best shape and those that the kept rows cannot part from it: a step beside the run held out."""
    blocks, form = [unit.blocks for unit in best.units], best.candidate.form
    same = [
        h for h in alike if (h.name, h.candidate.form) == (best.name, form) and [u.blocks for u in h.units] == blocks
    ]
    units = []
    for unit, several in zip(best.units, zip(*(h.units for h in same), strict=True), strict=True):
        parts = zip(*(one.columns for one in several), strict=True)
        units.append(replace(unit, columns=tuple(np.mean(columns, axis=0) for columns in parts)))
    return replace(best, units=tuple(units))


def _kind(hypothesis: Hypothesis) -> tuple[object, ...]:
    """What two shapes of one name and form have in common."""
    return (hypothesis.name, hypothesis.candidate.form, *(unit.blocks for unit in hypothesis.units))


def _shows(hypothesis: Hypothesis, keep: Sequence[BoolArray]) -> bool:
    """Whether most of an effect lies in the kept rows: from its last traces nobody could tell its size elsewhere."""
    return all(
        _square(columns[keep[b]]) > _MOST**2 * _square(columns)
        for unit in hypothesis.units
        for b, columns in zip(unit.blocks, unit.columns, strict=True)
    )


def _square(columns: FloatArray) -> float:
    return float(np.einsum("nk,nk->", columns, columns))


def _weighed(layout: Layout, blocks: Sequence[Block]) -> tuple[FloatArray, list[FloatArray]]:
    """Log posterior odds of each hypothesis (h,), and the log Bayes factors of its units."""
    factors, units = layout.beside(blocks).log_factors([block.y[:, None] for block in blocks])
    return factors[:, 0] + np.array([h.log_prior for h in layout.hypotheses]), units


def _best(hypotheses: Sequence[Hypothesis], posterior: FloatArray) -> int:
    """The strongest shape of the strongest name."""
    totals: dict[str, float] = {}
    for hypothesis, value in zip(hypotheses, posterior, strict=True):
        totals[hypothesis.name] = float(np.logaddexp(totals.get(hypothesis.name, -np.inf), value))
    name = max(totals, key=lambda n: totals[n])
    places = [i for i, h in enumerate(hypotheses) if h.name == name]
    return places[int(np.argmax(posterior[places]))]


def noise_points(bases: Sequence[Block], table: NoiseTable) -> IntArray:
    """Return the noise points at which the folds search, the most probable of each base in turn, (t,).

    `bases` are one block as it is and with everything that was found: a missing effect looks like noise.
    """
    orders = []
    for block in bases:
        (log_null, _), *_ = restricted_likelihood(table, [block.base], block.y, ScalePrior.of(block))
        orders.append(np.argsort(-log_null)[:_KEPT_POINTS])
    return np.array(list(dict.fromkeys(np.column_stack(orders).ravel().tolist())))
