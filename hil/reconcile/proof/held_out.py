"""Whether the gap shrank on data that was held out, with the selection repeated inside every fold.

With noise, base and amplitudes normal, what is predicted for some rows from all others is in closed form: with P the
inverse of the covariance of all rows, the error of the held-out rows H is P_HH^-1 (P y)_H and its covariance P_HH^-1.
The evidence of a set from the other rows alone is that from all, less the log density of H given them: so in every fold
the set is chosen that the other rows make most probable, and H is predicted with it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.block_search import BlockSearch
from hil.reconcile.search.evidence import ROUNDING
from hil.reconcile.search.filters import Filter
from hil.reconcile.search.fitted import FittedBlock, fitted_block
from hil.reconcile.search.noise import FEWEST_RUNS
from hil.reconcile.search.posterior import Found, Posterior
from hil.reconcile.search.sets import Set

SETS = 8  # sets among which a fold chooses: what is not among these with all rows is not without some
BEYOND = 30.0  # rows whose prediction is this many noises uncertain ask for what the others say nothing about
WIDE = 1e4  # deviation of a base parameter, in noises: as good as free
FLIPS = 4000  # of signs at random: the chance of an improvement is known to a part in so many
_Folds = Mapping[int, tuple[IntArray, FloatArray]]
"""Of folds, their rows (k,) in the order of time, and what noise by itself makes of P among them, (k, k)."""


@dataclass(frozen=True)
class Predicted:
    """One fold of one block under a set: its rows, log density, errors (rows,) and a factor of their covariance."""

    rows: IntArray
    log_density: float
    error: FloatArray
    factor: FloatArray


@dataclass(frozen=True)
class HeldOut:
    """By fold: squared errors, raw and standardised, and log densities, each before and after, (2, f); rows (f,).

    `errors` are, by block, those of its rows before and after, (2, N), deg/hr; NaN where nothing could be predicted.
    """

    raw: FloatArray
    scaled: FloatArray
    rows: IntArray
    log_density: FloatArray
    errors: Sequence[FloatArray]

    @property
    def rms(self) -> list[float]:
        """Root mean square before and after, deg/hr."""
        return [float(np.sqrt(each)) for each in self._per_rate(self.raw)]

    @property
    def standardised(self) -> list[float]:
        """Mean square in units of the noise, before and after."""
        return self._per_rate(self.scaled)

    @property
    def log_score(self) -> list[float]:
        """Mean log predictive density per rate, before and after."""
        return self._per_rate(self.log_density)

    def _per_rate(self, of_folds: FloatArray) -> list[float]:
        return list((of_folds.sum(axis=1) / max(int(self.rows.sum()), 1)).tolist())

    def improvement_p_value(self) -> float:
        """Chance that signs of the folds' improvements, flipped at random, add up to as much."""
        gains = self.log_density[1] - self.log_density[0]
        flipped = (np.random.default_rng(0).integers(0, 2, (FLIPS, len(gains))) * 2 - 1) @ gains
        least = gains.sum() - ROUNDING * np.abs(gains).sum()  # the very signs that there are add up to as much
        return float((1 + np.sum(flipped >= least)) / (1 + FLIPS))


_Key = tuple[int, int, Set, frozenset[str]]  # sensor, block, terms and what scatters


def held_out(posterior: Posterior, before: Found, lead: Found) -> HeldOut | None:
    """Predict every run from the others, before and after; None where none can be.

    Rows that the lead calls wrong, and a run that alone is another, are predicted by nobody. Where nothing is added,
    after is before.
    """
    others = posterior.sets[:SETS] if lead != before else ()
    sets = [before, lead, *(f for f in others if f not in (before, lead))]
    known: dict[_Key, dict[int, Predicted]] = {}
    for number, b in ((n, b) for n, search in posterior.searches.items() for b in range(len(search.blocks))):
        search = posterior.searches[number]
        own: set[int] = set()
        for term in (search.terms[j] for j in lead.terms[number]):
            if (part := term.parts[b]) is not None:
                wrong = term.is_mistake and term.candidate.effect is None
                own.update(part.rows.tolist() if wrong or np.ptp(search.blocks[b].block.run[part.rows]) == 0 else ())
        beside = Rows(search.blocks[b], own)
        for key in dict.fromkeys((number, b, found.terms[number], found.scatter) for found in sets):
            known[key] = dict(beside.runs(fitted_block(search, *key[2:], b)))
    return _together(posterior, sets, known)


def _together(
    posterior: Posterior, sets: Sequence[Found], known: Mapping[_Key, Mapping[int, Predicted]]
) -> HeldOut | None:
    """Choose a set in every fold by the rows that are not in it, and add up what it predicts for those that are."""
    blocks = [(n, b) for n, s in posterior.searches.items() for b in range(len(s.blocks))]
    rows = []
    errors = [np.full((2, len(posterior.searches[n].blocks[b].y)), np.nan) for n, b in blocks]
    for fold in sorted({fold for own in known.values() for fold in own}):
        at = [[known[(n, b, f.terms[n], f.scatter)].get(fold) for n, b in blocks] for f in sets]
        # A set beside which other rows are out of reach predicts something else: it cannot be compared.
        at = [
            [p if p and q and np.array_equal(p.rows, q.rows) else None for p, q in zip(a, at[1], strict=True)]
            for a in at
        ]
        usable = [all(a[k] is not None for a in at[:2]) for k in range(len(blocks))]
        if not any(usable):
            continue
        density = np.array([sum(p.log_density for p, u in zip(a, usable, strict=True) if u and p) for a in at])
        tried = [not any(u and p is None for p, u in zip(a, usable, strict=True)) for a in at]
        weights = np.where(tried, [f.log_weight for f in sets], -np.inf)
        chosen = 1 + likeliest_without(weights[1:], density[1:])
        rows.append([_sums(at[k], at[1], usable) for k in (0, chosen)])
        for when, k in enumerate((0, chosen)):
            for error, predicted in zip(errors, at[k], strict=True):
                if predicted is not None:
                    error[when, predicted.rows] = predicted.error
    if not rows:
        return None
    table = np.array(rows)
    return HeldOut(table[:, :, 0].T, table[:, :, 1].T, table[:, 0, 3].astype(np.int64), table[:, :, 2].T, errors)


def likeliest_without(log_weights: FloatArray, log_densities: FloatArray) -> int:
    """Return which set, of weights (s,) with all rows, the rows make most probable that are not held out.

    `log_densities` (s,) are those of the held-out rows given the others: what these rows said for a set is taken back.
    """
    return int(np.argmax(log_weights - log_densities))


def _sums(blocks: Sequence[Predicted | None], lead: Sequence[Predicted | None], usable: Sequence[bool]) -> list[float]:
    """Squared errors, the same in units of what the lead expects, log density, and rows."""
    pairs = [(p, q) for p, q, u in zip(blocks, lead, usable, strict=True) if u and p is not None and q is not None]
    return [
        float(sum(p.error @ p.error for p, _ in pairs)),
        float(sum(np.sum(np.linalg.solve(q.factor, p.error) ** 2) for p, q in pairs)),
        float(sum(p.log_density for p, _ in pairs)),
        float(sum(len(p.error) for p, _ in pairs)),
    ]


class Rows:
    """One block's rows in the order of time, those that are `wrong` predicted by nobody, beside any set."""

    def __init__(self, search: BlockSearch, wrong: set[int]) -> None:
        self.search, self._order = search, search.noise.order
        self.right = ~np.isin(self._order, list(wrong))
        self._known: dict[int, tuple[Filter, _Folds]] = {}  # most sets share their noise

    def _folds(self, block: FittedBlock) -> tuple[Filter, _Folds]:
        """Return what whitens the rows at the noise of a set, and its folds."""
        if block.at not in self._known:
            label = by_run(block)[self._order]
            together = np.count_nonzero(np.diff(label)) < len(np.unique(label))
            point = self.search.points.take(np.array([block.at]))
            by = self.search.noise.filter_at(point, label if together else np.zeros_like(label))
            self._known[block.at] = by, dict(self._products(by, label))
        return self._known[block.at]

    def _inverse(self, block: FittedBlock, by: Filter) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return P y, (N,), U (N, k) and W (k, N).

        P is the inverse covariance that noise alone makes less UW: base, amplitudes and values over temperature are few
        columns (Woodbury).
        """
        base, (mean, deviation) = block.search.block.base, block.weighed.prior()
        size = np.sqrt(block.scale) * self.search.unit
        base = base / np.maximum(np.abs(base).max(axis=0), 1e-12) * WIDE * np.sqrt(np.mean(block.variance))
        values = self.search.noise.following(int(self.search.points.profile[block.at])) * size
        data = block.search.block.y - block.columns @ mean
        columns = np.column_stack([base, values, block.columns * deviation, data])[self._order] / size
        (white,) = by.whiten(columns)
        (pulled,), gram = by.back(white[None]), white.T @ white
        taken, inner = pulled[:, :-1], np.eye(gram.shape[1] - 1) + gram[:-1, :-1]
        back = np.linalg.solve(inner, np.column_stack([taken.T, gram[:-1, -1]]))
        return pulled[:, -1] - taken @ back[:, -1], taken, back[:, :-1]

    def runs(self, block: FittedBlock) -> Iterator[tuple[int, Predicted]]:
        """Yield of each run what the others predict for it by a set."""
        by, folds = self._folds(block)
        left, taken, back = self._inverse(block, by)
        least, asked = BEYOND**2 * block.variance[self._order], dict(folds)
        size = np.sqrt(block.scale) * self.search.unit
        while asked:
            many = len(next(iter(asked.values()))[0])
            alike = [fold for fold, (own, _) in asked.items() if len(own) == many]
            rows, products = (np.array(own) for own in zip(*map(asked.pop, alike), strict=True))
            covariance = size**2 * np.linalg.inv(products - taken[rows] @ np.swapaxes(back.T[rows], 1, 2))
            known = np.diagonal(covariance, axis1=1, axis2=2) < least[rows]
            for k in np.flatnonzero(known.any(axis=1) & ~known.all(axis=1)).tolist():
                asked[alike[k]] = rows[k][known[k]], products[k][np.ix_(known[k], known[k])]
            told = np.flatnonzero(known.all(axis=1) & (many > 0))
            rows, covariance = rows[told], covariance[told]
            error = (covariance @ left[rows][..., None])[..., 0] / size
            factor = np.linalg.cholesky(0.5 * (covariance + np.swapaxes(covariance, 1, 2)))
            alone = np.linalg.solve(factor, error[..., None])[..., 0]
            log_det = np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
            density = -0.5 * np.sum(alone**2, axis=1) - log_det - 0.5 * float(np.log(2.0 * np.pi)) * many
            for k, place in enumerate(told):
                yield alike[place], Predicted(self._order[rows[k]], float(density[k]), error[k], factor[k])

    def _products(self, by: Filter, label: IntArray) -> Iterator[tuple[int, tuple[IntArray, FloatArray]]]:
        """Yield of each fold its rows (k,) that are not wrong, and P of noise alone among them, (k, k)."""
        parts: dict[int, list[tuple[IntArray, FloatArray]]] = {}
        for each in by.stretches:
            for rows, inner in zip(
                each.rows.reshape(-1, each.rows.shape[2]), np.concatenate(each.inner()[:, :, 0]), strict=True
            ):
                there = np.flatnonzero(np.append(self.right, False)[rows])
                for fold in np.unique(label[rows[there]]).tolist():
                    own = there[label[rows[there]] == fold]
                    parts.setdefault(fold, []).append((rows[own], inner[np.ix_(own, own)]))
        for fold, of in sorted(parts.items()):
            yield fold, (np.concatenate([rows for rows, _ in of]), block_diag(*(inner for _, inner in of)))


def by_run(block: FittedBlock) -> IntArray:
    """Number the rows (N,) by run; where there are few runs, by collect."""
    own = block.search.block
    return own.run if len(np.unique(own.run)) >= FEWEST_RUNS else own.rows
