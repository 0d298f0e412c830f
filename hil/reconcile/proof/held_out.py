"""Whether the gap shrank on data that was held out, with the selection repeated inside every fold.

With noise, base and amplitudes normal, what is predicted for some rows from all others is in closed form: with P the
inverse of the covariance of all rows, the error of the held-out rows H is P_HH^-1 (P y)_H and its covariance P_HH^-1.
The evidence of a set from the other rows alone is that from all, less the log density of H given them: so in every fold
the set is chosen that the other rows make most probable, and H is predicted with it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.fitted import FittedBlock, fitted_block
from hil.reconcile.search.noise import FEWEST_RUNS
from hil.reconcile.search.posterior import Found, Posterior

SETS = 8
"""Sets among which a fold chooses: what is not among these with all rows is not without some."""
BEYOND = 30.0
"""Rows whose prediction is this many noises uncertain ask for what the others say nothing about."""
FLIPS = 4000
"""Of signs at random: the chance of an improvement is known to a part in so many."""
_Folds = Mapping[int, tuple[IntArray, FloatArray]]
"""Of folds, their rows (k,) and the inner products (k, k) of these."""


@dataclass(frozen=True)
class Predicted:
    """One fold of one block under a set: its rows, log density, errors (rows,), a factor of their covariance."""

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
        return float((1 + np.sum(flipped >= gains.sum())) / (1 + FLIPS))


Proof = tuple[HeldOut, HeldOut]
"""What is predicted of rows that were held out: by run, and by contiguous block."""


def held_out(posterior: Posterior, before: Found, lead: Found) -> Proof | None:
    """Predict every run from the others, and every block of runs, before and after; None where no run can be.

    Rows that the lead calls wrong are predicted by nobody.
    """
    folds = (by_run, in_blocks)
    sets = [before, lead, *(f for f in posterior.sets[:SETS] if f not in (before, lead))]
    known: list[dict[tuple[object, ...], dict[int, Predicted]]] = [{} for _ in folds]
    whitened: dict[tuple[int, int, int], tuple[FloatArray, list[_Folds]]] = {}  # most sets share their noise
    for number, b, found in (
        (n, b, f) for n, s in posterior.searches.items() for b in range(len(s.blocks)) for f in sets
    ):
        key = (number, b, found.terms[number], found.kind)
        if key in known[0]:
            continue
        block = fitted_block(posterior.searches[number], found.terms[number], found.kind, b)
        if (noise := (number, b, block.at)) not in whitened:
            wrong, rows = _wrong_rows(posterior, lead, number, b), len(block.search.block.y)
            white = block.search.whitened(np.eye(rows), np.array([block.at]))[0]
            whitened[noise] = white, [_products(white, cut(block), wrong) for cut in folds]
        white, products = whitened[noise]
        beside = block.beside_noise(white)
        for own, of_folds in zip(known, products, strict=True):
            own[key] = dict(_predicted(block, white, beside, of_folds))
    runs, blocks = (_together(posterior, sets, own) for own in known)
    return None if runs is None else (runs, blocks or runs)


def _together(
    posterior: Posterior, sets: Sequence[Found], known: Mapping[tuple[object, ...], Mapping[int, Predicted]]
) -> HeldOut | None:
    """Choose a set in every fold by the rows that are not in it, and add up what it predicts for those that are."""
    blocks = [(n, b) for n, s in posterior.searches.items() for b in range(len(s.blocks))]
    rows = []
    errors = [np.full((2, len(posterior.searches[n].blocks[b].y)), np.nan) for n, b in blocks]
    for fold in sorted({fold for own in known.values() for fold in own}):
        at = [[known[(n, b, f.terms[n], f.kind)].get(fold) for n, b in blocks] for f in sets]
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


def _wrong_rows(posterior: Posterior, lead: Found, number: int, b: int) -> set[int]:
    search = posterior.searches[number]
    terms = [search.terms[j] for j in lead.terms[number] if search.terms[j].is_mistake]
    parts = [t.parts[b] for t in terms if t.candidate.effect is None]
    return {int(i) for part in parts if part is not None for i in np.flatnonzero(part.columns.any(axis=1))}


def _products(white: FloatArray, folds: IntArray, wrong: set[int]) -> _Folds:
    """Return of each fold its rows (k,) that are not wrong, and the inner products (k, k) of their whitened columns."""
    right, of_row = ~np.isin(np.arange(len(folds)), list(wrong)), np.ascontiguousarray(white.T)
    each = {fold: np.flatnonzero((folds == fold) & right) for fold in np.unique(folds).tolist()}
    return {fold: (rows, (own := of_row[rows]) @ own.T) for fold, rows in each.items()}


def _predicted(
    block: FittedBlock, white: FloatArray, beside: tuple[FloatArray, FloatArray], folds: _Folds
) -> Iterator[tuple[int, Predicted]]:
    """Yield of each fold what the other rows predict for it."""
    y, (taken, back) = block.search.block.y - block.columns @ block.weighed.prior()[0], beside
    pulled = white.T @ (white @ y) / block.scale - taken @ (back @ y)
    least, asked = BEYOND**2 * block.variance, dict(folds)
    while asked:
        size = len(next(iter(asked.values()))[0])
        alike = [fold for fold, (own, _) in asked.items() if len(own) == size]
        rows, products = (np.array(own) for own in zip(*map(asked.pop, alike), strict=True))
        covariance = np.linalg.inv(products / block.scale - taken[rows] @ np.swapaxes(back.T[rows], 1, 2))
        known = np.diagonal(covariance, axis1=1, axis2=2) < least[rows]
        for k in np.flatnonzero(known.any(axis=1) & ~known.all(axis=1)).tolist():
            asked[alike[k]] = rows[k][known[k]], products[k][np.ix_(known[k], known[k])]
        told = np.flatnonzero(known.all(axis=1) & (size > 0))
        rows, covariance = rows[told], covariance[told]
        error = (covariance @ pulled[rows][..., None])[..., 0]
        factor = np.linalg.cholesky(0.5 * (covariance + np.swapaxes(covariance, 1, 2)))
        alone = np.linalg.solve(factor, error[..., None])[..., 0]
        log_det = np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
        density = -0.5 * np.sum(alone**2, axis=1) - log_det - 0.919 * size
        for k, place in enumerate(told):
            yield alike[place], Predicted(rows[k], float(density[k]), error[k], factor[k])


def by_run(block: FittedBlock) -> IntArray:
    """Number the rows (N,) by run; where there are few runs, by collect."""
    own = block.search.block
    return own.run if len(np.unique(own.run)) >= FEWEST_RUNS else own.rows


def in_blocks(block: FittedBlock) -> IntArray:
    """Number the rows (N,) by contiguous sixths of the campaign's runs."""
    place = by_run(block)
    return np.asarray((6 * (place - place.min())) // (np.ptp(place) + 1))
