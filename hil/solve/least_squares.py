"""Weighted least squares over any set of collects, batched: one campaign or 10⁵ Monte Carlo draws are the same call.

    >>> solution = solve([[1.0, 1.0], [1.0, -1.0], [1.0, 1.0]], [3.0, 1.0, 3.2], sigma=0.9, names=("BA", "GSA"))
    >>> solution.values.round(2), solution.se.round(2)
    (array([2.05, 1.05]), array([0.55, 0.55]))
    >>> solve([[1.0, 1.0]], [3.0], names=("BA", "GSA")).observability.sentences
    ('BA + GSA is seen, BA - GSA is not',)

A number that the rows cannot support is NaN, never a guess: a parameter that is only seen mixed with others has no
value, and without stated noise and without a residual there is no covariance.

The normal equations with one step of refinement serve the well-conditioned (all that the fast path accepts has a
condition number below 10⁴); everything else goes through the singular value decomposition of the design.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hil.campaign import FloatArray
from hil.solve.identifiability import Observability, describe, directions_seen
from procedures.words import counted

RANK_TOLERANCE = 1e-9
"""A combination counts as unseen where its singular value is this small beside the largest."""

_FAST_CONDITION = 1e4


@dataclass(frozen=True, repr=False)
class Solution:
    """Values of p parameters from m rows, over any leading dimensions.

    `values` (..., p) and `covariance` (..., p, p) are NaN where unknown; `residuals` (..., m) are observed minus
    fitted, NaN in missing rows; `chi_square` (...) is the whitened sum of squares; `rank` and `degrees_of_freedom`
    (...) count combinations seen and residuals left. `shortest` and `shortest_covariance` are the solution of least
    norm, of which only the seen combinations mean anything.
    """

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    chi_square: FloatArray
    rank: NDArray[np.int64]
    degrees_of_freedom: NDArray[np.int64]
    design: FloatArray
    measured: NDArray[np.bool_]
    rank_tolerance: float
    shortest: FloatArray
    shortest_covariance: FloatArray

    def __repr__(self) -> str:
        if self.rank.shape:
            return f"<{self.rank.size} solutions for {', '.join(self.names)}>"
        parts = [f"{n} = {v:.4g} ± {e:.2g}" for n, v, e in zip(self.names, self.values, self.se, strict=True)]
        return f"<{', '.join(parts)}; {counted(int(self.degrees_of_freedom), 'degree')} of freedom>"

    @property
    def se(self) -> FloatArray:
        """Standard errors, shape (..., p); NaN where the covariance is unknown."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1)))

    @cached_property
    def condition_number(self) -> FloatArray:
        """Largest over smallest singular value of the measured rows in the parameters' own units, shape (...).

        Unweighted: it is a property of the orientations (1 + √2 for the report's three at 1 g), not of the noise.
        Infinite where some combination is not seen.
        """
        rows = self.design * self.measured[..., None]
        if rows.shape[-2] < rows.shape[-1]:
            return np.full(self.rank.shape, np.inf)
        singular = np.linalg.svd(rows, compute_uv=False)
        with np.errstate(divide="ignore", invalid="ignore"):
            condition = singular[..., 0] / singular[..., -1]
        return np.asarray(np.where(self.rank == len(self.names), condition, np.inf))

    @property
    def residual_rms(self) -> FloatArray:
        """Root mean square of the residuals over the measured rows, shape (...); NaN without degrees of freedom."""
        count = np.maximum(self.measured.sum(axis=-1), 1)
        rms = np.sqrt(np.nansum(self.residuals**2, axis=-1) / count)
        return np.asarray(np.where(self.degrees_of_freedom > 0, rms, np.nan))

    @cached_property
    def observability(self) -> Observability:
        """What one solution, which is no batch, can and cannot know."""
        seen = self.design * self.measured[:, None]
        return describe(self.names, seen, _scale(self.design, self.measured), self.rank_tolerance)

    def combinations(self) -> tuple[tuple[str, float, float], ...]:
        """Return the seen combinations of parameters that are not known singly: text, value, standard error."""
        found = self.observability
        values = found.seen @ self.shortest
        errors = np.sqrt(np.einsum("qp,pr,qr->q", found.seen, self.shortest_covariance, found.seen))
        return tuple(zip(found.seen_text, values.tolist(), errors.tolist(), strict=True))


def solve(
    design: ArrayLike,
    observed: ArrayLike,
    sigma: ArrayLike | None = None,
    *,
    names: Sequence[str] | None = None,
    rank_tolerance: float = RANK_TOLERANCE,
) -> Solution:
    """Solve design · values = observed by weighted least squares.

    `design` (..., m, p) in the parameters' units, `observed` (..., m), NaN where missing; the noise is stated as
    `sigma` (..., m) or a scalar, or not at all; rows whose noise is correlated are whitened before. Leading dimensions
    broadcast. Without stated noise the rows weigh alike and the covariance comes from the residuals: NaN where there
    are none.
    Raises ValueError for shapes that do not fit, a non-finite design, or noise that is not positive.
    """
    rows, data = np.asarray(design, dtype=np.float64), np.asarray(observed, dtype=np.float64)
    _check(rows, data, names)
    measured = ~np.isnan(data)
    # With nothing missing the mask is shared by the batch, and so is the factorisation of a shared design.
    mask = np.ones(data.shape[-1:], dtype=bool) if measured.all() else measured
    noise = np.where(mask, 1.0 if sigma is None else np.asarray(sigma, dtype=np.float64), 1.0)
    if not np.all(np.isfinite(noise) & (noise > 0.0)):
        raise ValueError("sigma must be positive and finite in every measured row")
    weight = mask / noise  # zero for missing rows, which leaves them out of every sum
    white, seen = rows * weight[..., None], np.where(mask, data, 0.0) * weight
    operator, spread, rank, known = _invert(rows, white, weight, _scale(rows, mask), rank_tolerance)
    values = _apply(operator, seen)
    values = values + _apply(operator, seen - _apply(white, values))
    remainder = seen - _apply(white, values)
    batch = values.shape[:-1]
    chi_square = np.einsum("...m,...m->...", remainder, remainder)
    degrees = np.broadcast_to(mask.sum(axis=-1) - rank, batch)
    if sigma is None:
        with np.errstate(invalid="ignore", divide="ignore"):
            spread = spread * np.where(degrees > 0, chi_square / degrees, np.nan)[..., None, None]
    square = known[..., :, None] & known[..., None, :]
    spread = np.broadcast_to(spread, (*batch, *spread.shape[-2:]))
    return Solution(
        names=tuple(names) if names is not None else tuple(f"x{j}" for j in range(rows.shape[-1])),
        values=np.where(known, values, np.nan),
        covariance=spread if known.all() else np.where(square, spread, np.nan),
        residuals=np.where(measured, data - _apply(rows, values), np.nan),
        chi_square=chi_square,
        rank=np.broadcast_to(rank, batch),
        degrees_of_freedom=degrees,
        design=rows,
        measured=mask,
        rank_tolerance=rank_tolerance,
        shortest=values,
        shortest_covariance=spread,
    )


def _apply(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Multiply (..., i, j) by (..., j); leading dimensions broadcast."""
    return np.asarray(np.einsum("...ij,...j->...i", matrix, vector))


def _check(rows: FloatArray, data: FloatArray, names: Sequence[str] | None) -> None:
    if rows.ndim < 2 or data.ndim < 1 or rows.shape[-2] != data.shape[-1]:
        raise ValueError(
            f"design {rows.shape} and observed {data.shape} do not fit: (..., m, p) and (..., m) are needed"
        )
    if not np.all(np.isfinite(rows)):
        raise ValueError("the design holds values that are not finite")
    if np.any(np.isinf(data)):
        raise ValueError("the observed values hold an infinity; mark missing rows with NaN")
    if names is not None and len(names) != rows.shape[-1]:
        raise ValueError(f"{len(names)} names for {rows.shape[-1]} parameters")


def _scale(rows: FloatArray, mask: NDArray[np.bool_]) -> FloatArray:
    """Scale of each column: its rms where above 1, so that squares of temperatures do not hide a bias.

    A small column is never magnified: a direction hardly excited must look as small as it is.
    """
    count = np.maximum(mask.sum(axis=-1), 1)[..., None]
    rms = np.sqrt(np.einsum("...mp,...m->...p", rows**2, mask.astype(np.float64)) / count)
    return np.asarray(np.maximum(rms, 1.0))


def _invert(
    rows: FloatArray, white: FloatArray, weight: FloatArray, scale: FloatArray, tolerance: float
) -> tuple[FloatArray, FloatArray, NDArray[np.int64], NDArray[np.bool_]]:
    """Return what makes values of observations, by what is seen, their covariance, the rank, and which are known."""
    scaled, mask = white / scale[..., None, :], weight > 0.0
    turned = np.swapaxes(scaled, -1, -2)
    *batch, parameters = turned.shape[:-1]
    spread = np.broadcast_to(weight.max(axis=-1) / np.where(mask, weight, np.inf).min(axis=-1), batch)
    short = np.broadcast_to(mask.sum(axis=-1) < parameters, batch)
    safe = np.where(short[..., None, None], np.eye(parameters), turned @ scaled)
    try:
        inverse = np.linalg.inv(safe)
    except np.linalg.LinAlgError:
        inverse, slow = np.zeros_like(safe), np.ones(batch, dtype=bool)
    else:  # Frobenius norms bound the condition number from above; the weights' ratio that of the unweighted rows
        bound = np.sqrt(np.einsum("...pq,...pq->...", safe, safe) * np.einsum("...pq,...pq->...", inverse, inverse))
        slow = np.asarray(short | ~(np.sqrt(bound) * spread < min(_FAST_CONDITION, 0.1 / tolerance)))
    operator = inverse @ turned
    rank = np.full(batch, parameters, dtype=np.int64)
    known = np.ones((*batch, parameters), dtype=bool)
    if np.any(slow):
        measured = np.broadcast_to(rows * mask[..., None], scaled.shape)[slow]
        widths = np.broadcast_to(scale, (*batch, parameters))[slow]
        directions, seen, known[slow] = directions_seen(measured, widths, tolerance)
        # In the coordinates of the seen combinations the problem has full rank; unseen columns are exactly zero.
        kept = directions * seen[..., None]
        back = np.linalg.pinv(scaled[slow] @ np.swapaxes(kept, -1, -2), rcond=1e-14)
        operator[slow] = np.swapaxes(kept, -1, -2) @ back
        inverse[slow] = operator[slow] @ np.swapaxes(operator[slow], -1, -2)
        rank[slow] = seen.sum(axis=-1)
    return operator / scale[..., :, None], inverse / (scale[..., :, None] * scale[..., None, :]), rank, known
