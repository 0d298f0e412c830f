"""How probable a block of rows is with a set of effects beside the base: one closed form, for one set or for many.

With whitened rows, the base's columns projected out, and amplitudes a ~ N(m, S) of the columns X, the rates are normal
with covariance s² (1 + X S X'/s²). The scale s² has an inverse-gamma prior; S is measured by the scale that this very
set leaves, so that what is integrated is a Student t (Box & Tiao 1973, 2.7). Everything is averaged over the points of
the noise, over the sizes that an amplitude may have, and over how strongly the stated errors hold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.special import gammaln

from hil.campaign import FloatArray, IntArray
from hil.model.effects.prior import log_sum
from hil.reconcile.search.noise import Noise
from hil.reconcile.search.points import Points

Scale = tuple[float, float, float]
SEEN = 1e-6
"""A direction of which less is left beside the base is the base's."""
ROUNDING = 1e-13
"""Share of the squared residuals that rounding may cost."""
LEAST = 1e-12
"""Sum of squares below which nothing but rounding is left."""


@dataclass(frozen=True)
class Amplitude:
    """What is known of amplitudes (p,) before the data: normal about `mean`, of `deviation` times one of the `sizes`.

    `deviation` and `mean` are (p,), `sizes` and their `log_weights` (u,): one size is right for all p.
    """

    deviation: FloatArray
    sizes: FloatArray
    log_weights: FloatArray
    mean: FloatArray


@dataclass(frozen=True)
class Options:
    """Every size that the amplitudes (q,) of a term may have: log weights (o,), means and deviations (o, q)."""

    log_weights: FloatArray
    mean: FloatArray
    deviation: FloatArray

    @classmethod
    def of(cls, amplitudes: Sequence[Amplitude]) -> "Options":
        """Lay the priors of a term out, size by size."""
        return cls(
            np.concatenate([a.log_weights for a in amplitudes]),
            np.concatenate([np.repeat(a.mean[None], len(a.sizes), axis=0) for a in amplitudes]),
            np.concatenate([np.outer(a.sizes, a.deviation) for a in amplitudes]),
        )

    def __len__(self) -> int:
        return len(self.log_weights)


@dataclass(frozen=True)
class Beside:
    """Rows whitened at every point, (t, N), with a base projected out, and what is left of the data there.

    `values` (t, N, v) whitens what follows temperature by a known size: columns X become X − values values' X. `basis`
    (t, N, p) spans the base, `residual` (t, N) is what it leaves, `rss` (t,) its square, `log_noise` (t,) the log
    determinants of the noise, and `log_base` (t,) of noise and base, as they stand in the evidence. The part of the
    basis that was added last is columns times `turn` (t, q, q).
    """

    scales: Sequence[Scale]
    values: FloatArray
    basis: FloatArray
    residual: FloatArray
    rss: FloatArray
    log_noise: FloatArray
    log_base: FloatArray
    freedom: int
    turn: FloatArray

    @classmethod
    def of(
        cls, noise: Noise, points: Points, scales: Sequence[Scale], white: FloatArray, half_log_det: FloatArray
    ) -> "Beside":
        """Project the base out of data: `white` has the columns by temperature, the base's, and the data last."""
        many = noise.by_station.shape[1]
        factor = np.array([noise.factor(int(p)) for p in points.profile])
        seen = white[:, :, :many] @ factor[:, :, np.any(factor, axis=(0, 1))]
        # 1 + seen seen' has the inverse root 1 − U (1 − (1 + λ)^-½) U', λ being the squares of what is seen.
        squares, vectors = np.linalg.eigh(np.swapaxes(seen, 1, 2) @ seen)
        root = np.sqrt(1.0 + np.maximum(squares, 0.0))
        values = seen @ (vectors / np.sqrt(root * (1.0 + root))[:, None, :])
        log_noise = -half_log_det - np.sum(np.log(root), axis=1)
        known = less(values, white[:, :, many:])
        residual = known[:, :, -1]
        none, rss = (known[:, :, :0], known[:, :0, :0]), np.zeros(len(points))
        alone = cls(scales, values, none[0], residual, rss, log_noise, log_noise, residual.shape[1], none[1])
        return alone.beside(known[:, :, :-1])

    def beside(self, columns: FloatArray) -> "Beside":
        """Add projected columns (t, N, q) to the base, those that are combinations of others left out."""
        squares, vectors = np.linalg.eigh(np.swapaxes(columns, 1, 2) @ columns)
        usable = squares > SEEN**2 * squares.max(axis=1, initial=LEAST, keepdims=True)
        size = np.where(usable, squares, 1.0)
        turn = vectors * np.where(usable, size**-0.5, 0.0)[:, None, :]
        own = columns @ turn
        left = less(own, self.residual[:, :, None])[:, :, 0]
        rss = np.maximum(np.einsum("tn,tn->t", left, left), LEAST)
        log_base = self.log_base - 0.5 * np.sum(np.log(size), axis=1)
        freedom = self.freedom - int(usable.sum(axis=1).max(initial=0))
        basis = np.concatenate([self.basis, own], axis=2) if self.basis.shape[2] else own
        return replace(self, basis=basis, residual=left, rss=rss, log_base=log_base, freedom=freedom, turn=turn)

    def at(self, index: IntArray | slice) -> "Beside":
        """Return some of the points."""
        names = ("values", "basis", "residual", "rss", "log_noise", "log_base", "turn")
        return replace(self, **{name: getattr(self, name)[index] for name in names})

    def student(self, left: FloatArray) -> FloatArray:
        """Log evidence (s, t, …) of quadratic forms `left` (1, t, …) under every scale, prior of the point apart."""
        shape = (len(self.rss),) + (1,) * (left.ndim - 2)
        return student(left, self.log_base.reshape(shape), self.scales, self.freedom)

    def scale_left(self, left: FloatArray) -> FloatArray:
        """Return what s² most probably is under every scale where a fit leaves `left` (…), (s, …)."""
        a, b, *_ = _under(self.scales, self.freedom, left.ndim)
        return np.asarray((b + 0.5 * left) / (a + 0.5 * self.freedom))

    def log_null(self) -> FloatArray:
        """Log evidence of the base alone at every point, (t,), the point's prior apart."""
        return log_sum(self.student(self.rss[None]))


@dataclass(frozen=True)
class Member:
    """A term in a block: which of its parameters it has here (q,), every size of them, projected columns (t, N, q)."""

    parameters: IntArray
    options: Options
    columns: FloatArray


@dataclass(frozen=True)
class Inner:
    """Inner products (t, n, n) of the columns of some terms and one of zeros, with the data (t, n), and places."""

    gram: FloatArray
    score: FloatArray
    places: Mapping[int, IntArray]

    @classmethod
    def of(cls, beside: Beside, terms: Mapping[int, Member]) -> "Inner":
        """Multiply the columns of terms, by place, with each other and with what the base leaves of the data."""
        none = np.zeros_like(beside.residual[..., None])
        laid = np.concatenate([*(own.columns for own in terms.values()), none], axis=2)
        gram, score = np.swapaxes(laid, 1, 2) @ laid, (beside.residual[:, None, :] @ laid)[:, 0]
        ends = np.cumsum([0, *(len(own.parameters) for own in terms.values())])
        return cls(gram, score, {j: np.arange(a, b) for j, (a, b) in zip(terms, pairwise(ends), strict=True)})


def student(left: FloatArray, log_base: FloatArray, scales: Sequence[Scale], freedom: int) -> FloatArray:
    """Return the log evidence (s, …) of quadratic forms `left` (s or 1, …), with log determinants, by scale."""
    _, b, power, constant = _under(scales, freedom, left.ndim - 1)
    return np.asarray(constant + log_base - power * np.log(b + 0.5 * left))


@cache
def _under(scales: Sequence[Scale], freedom: int, further: int) -> tuple[FloatArray, ...]:
    """Return a, b, power and constant of every scale's prior, (s, 1, …) with so many further axes."""
    a, b, weight = np.array(scales).T.reshape(3, -1, *(1,) * further)
    power = a + 0.5 * freedom
    return a, b, power, a * np.log(b) - gammaln(a) + gammaln(power) + np.log(weight)


def less(basis: FloatArray, columns: FloatArray) -> FloatArray:
    """Return columns (t, N, k) less what a basis (t, N, p) can do, or the `values` of a base that is known."""
    return np.asarray(columns - basis @ (np.swapaxes(basis, 1, 2) @ columns)) if basis.shape[2] else columns


def bordered(gram: FloatArray, score: FloatArray, rss: FloatArray) -> FloatArray:
    """Return 1 + Gram (q, q, …) with scores (q, …) and squared residuals (…,) beside it, (q + 1, q + 1, …).

    `eliminated`, it tells what amplitudes N(0, 1) leave of the squares, and half of log det (1 + Gram).
    """
    size = len(score)
    both = np.empty((size + 1, size + 1, *score.shape[1:]))
    both[:size, :size] = gram
    both[range(size), range(size)] += 1.0
    both[size, :size] = both[:size, size] = score
    both[size, size] = np.maximum(rss, 0.0) * (1.0 + ROUNDING) + LEAST  # of as few rates as the base has values: 0
    return both


def eliminated(both: FloatArray, columns: int | None = None) -> tuple[FloatArray, FloatArray]:
    """Return what columns leave of squares, (…,), and half of their log det, of inner products (q + 1, q + 1, …).

    The squares' own are last. Of many small matrices whole arrays take a tenth of the time of one after the other. Of
    the first `columns` alone, in place, all the rest is left.
    """
    half_log_det = np.zeros(both.shape[2:])
    for i in range(len(both) - 1 if columns is None else columns):
        half_log_det += 0.5 * np.log(both[i, i])
        both[i + 1 :, i + 1 :] -= both[i + 1 :, i, None] * (both[i, i + 1 :] / both[i, i])
    return both[-1, -1], half_log_det


def swept(both: FloatArray, less: FloatArray, columns: int) -> FloatArray:
    """Sweep the first columns of matrices (q, q, …) in place (Beaton 1964), and return half of their log det, (…,).

    That leaves −G^-1 of these columns' products G, G^-1 B of what is beside them, and C − B'G^-1 B of the rest. Swept
    again they are what they were, B with the other sign. `less` (q, …) is the diagonal less 1, and 1 less that of G^-1
    then: kept apart, neither what is next to nothing nor what is very large is lost to rounding.
    """
    half_log_det = np.zeros(both.shape[2:])
    for i in range(columns):
        own, pivot, alone = both[i].copy(), both[i, i].copy(), less[i].copy()
        half_log_det += 0.5 * np.log(np.abs(pivot))
        rest = own / pivot
        both -= own[:, None] * rest
        less -= own * rest
        both[i] = both[:, i] = rest
        both[i, i], less[i] = -1.0 / pivot, alone / np.abs(pivot)
    return half_log_det
