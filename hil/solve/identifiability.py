"""What a design can tell, and tell apart: spans, projecting out the base, overlaps, classes, what is seen in words.

    whiten = whitener(conditions, sigma, columns, sizes)            # W, with W V Wᵀ = 1
    base = orthonormal(whiten @ base_columns)                       # (N, b)
    seen = visible(whiten @ effect_columns, base, sizes)            # what is left of an effect beside the base
    seen.kept, overlap_table([[seen], [other]])

Rows are the rates of all collects and channels, flattened to N = n·c. No data enters: it is linear algebra on the
conditions, so it can be asked before a night is spent. Whoever asks what columns span, what is left of them beside
others, or which are independent asks here, so that all mean the same by it. Each row of a design sees one combination
of the parameters. Where the rows do not span every parameter, the directions left over change no rate at all: no amount
of averaging finds them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import BoolArray, Conditions, FloatArray, IntArray
from hil.model.effects.columns import flattened

RANK_TOLERANCE = 1e-8
"""Directions weaker than this fraction of an effect's own norm are numerical noise, not columns."""

SAME_CLASS = 0.95
"""Effects that overlap by more than this either way are one class: only the class can be reported."""

CANNOT_BE_SEEN = 0.1
"""An effect that keeps less of its norm than this is absorbed by the base model's parameters."""

LEAK = 1e-4
"""A parameter counts as known where an unseen combination of size 100 moves it by less than 0.01 deg/hr.

That is the resolution of the report's own runs. Below it a tilt of a tenth of a milliradian would make every bias
unknowable.
"""


@dataclass(frozen=True)
class Whitener:
    """The matrix W, (N, N), with W V Wᵀ = 1 for the covariance V of N measured rates that only runs have in common.

    `blocks` has it run by run, for r runs with b rates each: their rows (r, b), and W's blocks (r, b, b).
    """

    blocks: Sequence[tuple[IntArray, FloatArray]]

    def __matmul__(self, columns: FloatArray) -> FloatArray:
        """Return columns (n·c, p) whitened, (N, p), without the rows that were not measured, run by run."""
        white = [(block @ columns[rows]).reshape(rows.size, -1) for rows, block in self.blocks]
        return np.concatenate([np.zeros((0, columns.shape[1])), *white])

    def back(self, white: FloatArray) -> FloatArray:
        """Return Wᵀ times what was whitened, (N, p): of each row, its product with the row by itself, whitened."""
        out, ends = [np.zeros((0, white.shape[1]))], np.cumsum([rows.size for rows, _ in self.blocks])
        for (rows, block), own in zip(self.blocks, np.split(white, ends[:-1]), strict=True):
            out.append((np.swapaxes(block, 1, 2) @ own.reshape(*rows.shape, -1)).reshape(rows.size, -1))
        return np.concatenate(out)


def whitener(conditions: Conditions, sigma: FloatArray, columns: FloatArray, from_run_to_run: FloatArray) -> Whitener:
    """Return what whitens collects with white noise and scatter from run to run.

    `sigma` (n, c) is the standard deviation of each average, NaN where it was not measured, `from_run_to_run` (p,) that
    of the parameters with these `columns` (n, c, p). Raises LinAlgError where a covariance is not positive.
    """
    channels, scattering = sigma.shape[1], from_run_to_run * flattened(columns)
    measured = np.flatnonzero(np.isfinite(sigma))
    own = conditions.run[measured // channels]
    by_run = np.split(measured[np.argsort(own, kind="stable")], np.flatnonzero(np.diff(np.sort(own))) + 1)
    blocks = []
    for size in {len(rows) for rows in by_run} - {0}:
        rows = np.array([each for each in by_run if len(each) == size])
        covariance = scattering[rows] @ np.swapaxes(scattering[rows], 1, 2)
        covariance[:, np.arange(size), np.arange(size)] += sigma.ravel()[rows] ** 2
        blocks.append((rows, np.linalg.inv(np.linalg.cholesky(covariance))))
    return Whitener(blocks)


def unit_columns(columns: FloatArray) -> FloatArray:
    """Return the columns (..., N, p), each of norm one; a column of zeros stays as it is."""
    norms = np.linalg.norm(columns, axis=-2, keepdims=True)
    return np.asarray(columns / np.where(norms > 0.0, norms, 1.0))


def orthonormal(columns: FloatArray, tolerance: float = RANK_TOLERANCE, *, scale: float | None = None) -> FloatArray:
    """Return an orthonormal basis (N, r) of what the columns (N, p) span; r may be less than p, or zero.

    Directions weaker than `tolerance` are none. They are weighed after scaling every column to unit norm; with `scale`,
    against that norm instead. Of several, (..., N, p), they are zero: (..., N, p).
    """
    if scale is None:
        columns, scale = unit_columns(columns), 1.0
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    usable = singular > tolerance * scale
    return np.asarray(left[:, usable] if usable.ndim == 1 else left * usable[..., None, :])


def project_out(base: FloatArray, columns: FloatArray) -> FloatArray:
    """Return columns (..., N, p) less their part in the orthonormal `base` (..., N, b)."""
    return np.asarray(columns - base @ (np.swapaxes(base, -1, -2) @ columns))


def kept_shares(base: FloatArray, columns: FloatArray) -> FloatArray:
    """Return how much of each column's norm an orthonormal `base` leaves, (p,): 0 nothing, 1 all of it."""
    return np.asarray(np.linalg.norm(project_out(base, unit_columns(columns)), axis=0))


def independent_columns(columns: FloatArray, tolerance: float = RANK_TOLERANCE) -> FloatArray:
    """Return the columns, in order, without those that are combinations of earlier ones, shape (N, p')."""
    if 0 < columns.shape[1] <= columns.shape[0]:
        left = np.abs(np.diagonal(np.linalg.qr(columns, mode="r")))
        if np.all(left > tolerance * np.linalg.norm(columns, axis=0)) and np.all(left > 0):
            return columns.astype(np.float64)
    kept: list[int] = []
    basis = np.zeros(columns.shape)
    for place, column in enumerate(columns.T):
        remainder = column.astype(np.float64)
        size = np.linalg.norm(column)
        for _ in range(2):  # once more, as the first subtraction leaves rounding errors
            remainder = project_out(basis[:, : len(kept)], remainder)
        norm = np.linalg.norm(remainder)
        if size > 0 and norm > tolerance * size:
            basis[:, len(kept)] = remainder / norm
            kept.append(place)
    return columns[:, kept].astype(np.float64)


def smallest_fit(columns: FloatArray, target: FloatArray, tolerance: float) -> FloatArray:
    """Return the values (p,) of columns (N, p), at unit norm each, that fit a target (N,) best.

    Of combinations that the rows leave open to within `tolerance` the smallest is taken.
    """
    norms = np.linalg.norm(columns, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    return np.asarray(np.linalg.lstsq(columns / norms, target, rcond=tolerance)[0] / norms)


@dataclass(frozen=True)
class Visible:
    """What is left of an effect's whitened columns beside the base.

    `residual` (N, p) is per unit of each parameter, in standard deviations; `weighted` the same per typical size of
    each; `basis` (N, r) spans it; `kept` is the fraction of the typical-size norm that is left.
    """

    residual: FloatArray
    weighted: FloatArray
    basis: FloatArray
    kept: float

    @property
    def rank(self) -> int:
        """How many directions the effect has that the base does not absorb."""
        return int(self.basis.shape[1])


def visible(columns: FloatArray, base: FloatArray, sizes: FloatArray) -> Visible:
    """Project whitened `columns` (N, p) beside an orthonormal `base`; `sizes` (p,) weigh parameters of unlike units."""
    residual = project_out(base, columns)
    weighted = residual * sizes
    whole = float(np.linalg.norm(columns * sizes))
    left = float(np.linalg.norm(weighted))
    if whole == 0.0 or left <= RANK_TOLERANCE * whole:
        return Visible(np.zeros_like(residual), np.zeros_like(residual), np.zeros((len(columns), 0)), 0.0)
    return Visible(residual, weighted, orthonormal(weighted, scale=whole), min(left / whole, 1.0))


def overlap_table(effects: Sequence[Sequence[Visible]]) -> FloatArray:
    """Return the overlaps of all pairs of effects with shape parameters, (k, k), one on the diagonal.

    The best match in the other's shapes, averaged over one's own; the smaller of both ways round, so that a narrow
    effect inside a broad one is not called the same. A shape of which nothing is left is like nothing, nor unlike.
    """
    effects = [[one for one in several if one.rank] for several in effects]
    shapes = [one for several in effects for one in several]
    if not shapes:
        return np.zeros((len(effects), len(effects)))
    bases, weighted = [one.basis for one in shapes], [one.weighted for one in shapes]
    power = (np.hstack(bases).T @ np.hstack(weighted)) ** 2
    for axis, every in enumerate((bases, weighted)):
        power = np.add.reduceat(power, np.cumsum([0, *(of.shape[1] for of in every[:-1])]), axis=axis)
    whole = np.array([float(np.sum(one.weighted**2)) for one in shapes])
    # [a, b]: how much of shape b shape a can reproduce; an overlap needs both ways round.
    fraction = np.sqrt(np.divide(power, whole, out=np.zeros_like(power), where=whole > 0.0).clip(max=1.0))
    mutual = np.minimum(fraction, fraction.T)
    there = np.flatnonzero([len(several) for several in effects])
    ends = np.cumsum([len(effects[k]) for k in there.tolist()])
    best = np.maximum.reduceat(mutual, np.append(0, ends[:-1]))  # of each effect (k,) the nearest to each shape
    mean = np.array([of.mean(axis=1) for of in np.split(best, ends[:-1], axis=1)])
    table = np.zeros((len(effects), len(effects)))
    table[np.ix_(there, there)] = np.minimum(mean, mean.T)
    np.fill_diagonal(table, 1.0)
    return table


def classes(overlaps: FloatArray) -> tuple[tuple[int, ...], ...]:
    """Return the groups of indices that are linked by overlaps (k, k) above `SAME_CLASS`, in order of first member."""
    return tuple(map(tuple, linked_groups(overlaps > SAME_CLASS, np.ones(len(overlaps), np.bool_))))


@dataclass(frozen=True)
class Observability:
    """One design's verdict.

    `seen` (q, p) holds the combinations that are seen of parameters that are not seen by themselves, `seen_text` the
    same in words; `sentences` has one for each group of entangled parameters.
    """

    seen: FloatArray
    seen_text: tuple[str, ...]
    sentences: tuple[str, ...]


def directions_seen(rows: FloatArray, scale: FloatArray, tolerance: float) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Split parameter space by what unweighted rows (..., m, p) see, columns divided by `scale` (..., p).

    Returns orthonormal directions (..., p, p) as rows, which of them are seen (..., p), and which parameters are
    known (..., p). Weights play no part: what can be seen is a matter of orientations, not of noise.
    """
    _, singular, directions = np.linalg.svd(rows / scale[..., None, :], full_matrices=True)
    padded = np.zeros(directions.shape[:-1])
    padded[..., : singular.shape[-1]] = singular
    seen = padded > tolerance * np.maximum(padded[..., :1], np.finfo(np.float64).tiny)
    leak = np.sqrt(np.einsum("...pq,...p->...q", directions**2, (~seen).astype(np.float64)))
    return np.asarray(directions), np.asarray(seen), np.asarray(leak <= LEAK)


def describe(names: Sequence[str], rows: FloatArray, scale: FloatArray, tolerance: float) -> Observability:
    """Put into words what one design (m, p) can and cannot know of the parameters called `names`."""
    directions, seen, known = directions_seen(rows, scale, tolerance)
    blind = directions[~seen]
    mixing = blind.T @ blind
    combinations, texts, sentences = [np.zeros((0, len(names)))], [], []
    for group in linked_groups(np.abs(mixing) > LEAK**2, ~known):
        members = [names[j] for j in group]
        unseen_count = round(float(np.trace(mixing[np.ix_(group, group)])))
        visible = _readable(_span(directions[seen][:, group], len(group) - unseen_count) * scale[group])
        hidden = _readable(_span(blind[:, group], unseen_count) / scale[group])
        combinations.append(visible @ np.eye(len(names))[group])
        told, untold = ([combination_text(members, row) for row in rows] for rows in (visible, hidden))
        texts += told
        is_seen, is_not = (f"{', '.join(of)} {'are' if len(of) > 1 else 'is'}" for of in (told, untold))
        sentences.append(f"{is_seen} seen, {is_not} not" if told else f"{is_not} not seen")
    return Observability(np.concatenate(combinations), tuple(texts), tuple(sentences))


def combination_text(names: Sequence[str], coefficients: FloatArray) -> str:
    """Write a combination, (p,), as people do, without terms below a thousandth of the largest.

    >>> combination_text(("BA", "GSA", "GSB"), np.array([1.0, 1e-5, -0.016]))
    'BA - 0.016 GSB'
    """
    text = ""
    for name, value in zip(names, coefficients, strict=True):
        if abs(value) < 1e-3 * np.abs(coefficients).max():
            continue
        size = "" if abs(abs(value) - 1.0) < 5e-4 else f"{abs(value):.3g} "
        sign = (" - " if value < 0 else " + ") if text else ("-" if value < 0 else "")
        text += f"{sign}{size}{name}"
    return text


def linked_groups(linked: BoolArray, entangled: BoolArray) -> list[list[int]]:
    """Gather the entangled of k things into groups that are linked (k, k) to one another, in order of first member."""
    members = np.flatnonzero(entangled)
    if not len(members):
        return []
    from scipy.sparse.csgraph import connected_components  # imported late: few designs have anything entangled

    count, group = connected_components(linked[np.ix_(members, members)], directed=False)
    return [members[group == number].tolist() for number in range(count)]


def _span(rows: FloatArray, count: int) -> FloatArray:
    """Return `count` orthonormal rows that span the given ones."""
    return np.asarray(np.linalg.svd(rows.T @ rows)[2][:count])


def _readable(rows: FloatArray) -> FloatArray:
    """Reduce rows so that each holds one parameter, scaled to 1, that no other row holds."""
    reduced = rows.copy()
    for i in range(len(reduced)):
        pivot = int(np.argmax(np.abs(reduced[i]) > 0.5 * np.abs(reduced[i]).max()))
        reduced[i] /= reduced[i, pivot]
        others = np.arange(len(reduced)) != i
        reduced[others] -= reduced[others, pivot, None] * reduced[i]
    return reduced
