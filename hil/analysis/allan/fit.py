"""Overlapping Allan deviation of one or several gap-free stretches, and N, B and K fitted to it, with intervals.

    fit = NoiseFit(octaves([stretch], interval_s=0.01))
    fit.deviation.tau_s, fit.deviation.low, fit.deviation.high, fit.terms["N"].value     # octaves, 95 % intervals

The deviations are allantools'. A gap is never bridged: second differences are taken within a stretch, and the variances
of the stretches are averaged with their counts of differences as weights. So the longest tau is set by the longest
stretch, and everything that was recorded counts. Equivalent degrees of freedom (Greenhall and Riley 2003) depend on the
kind of noise; `NoiseKind` says which is taken at each tau.

The model is a sum of variances, one per kind of noise, each with its slope in a log-log plot of the deviation:

    sigma²(tau) = 3 Q²/tau² + N²/tau + (2 ln2/pi) B² + K² tau/3
    slope            -1        -1/2          0           +1/2

An estimated variance scatters about the true one as chi-square with its equivalent degrees of freedom, so the fit is
the maximum of that (gamma) likelihood: weights edf/2 over the model's own variance squared, found by reweighting
non-negative least squares. Octaves of overlapping averages share data, so that the product of their likelihoods claims
too much: how they are correlated follows from the fitted spectrum and the averages' responses to it, and profile
likelihoods are widened by what that makes of each term's variance (Godambe's information). A term that the record does
not show gets an upper bound, not a value.

The slopes are those of averages over the whole of each interval. No record says whether its samples are such averages
or values at an instant, of which averages of m have a variance that is larger by 1/(2 m²) in a random walk, by 0.19 to
0.44 in flicker for m = 1. So much the model may be wrong by where these two make the variance: flicker alone would
otherwise show a white noise that is not there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, nnls
from scipy.special import chdtrc, chdtri

from hil.campaign import FloatArray, IntArray

CONFIDENCE = 0.95
"""The probability that every interval of this package is stated at."""


class NoiseKind(IntEnum):
    """Power-law noise by the exponent of its spectrum, as `edf_greenhall` counts it."""

    QUANTISATION = 2  # white in angle
    WHITE = 0  # white in rate: angle random walk
    FLICKER = -1  # bias instability
    RANDOM_WALK = -2  # rate random walk


SLOPES: Mapping[str, float] = {"Q": -1.0, "N": -0.5, "B": 0.0, "K": 0.5}
"""The slope of each term's deviation against tau in a log-log plot."""

_KINDS = np.array([*NoiseKind], dtype=np.int64)  # of the same terms
_FLICKER = 2.0 * np.log(2.0) / np.pi
_ROUNDS = 60
_MOST_ROUNDS_OF_KINDS = 4
_LEAST_CHANCE = 0.01
_FILTERED = 8
_FREQUENCIES = 1 << 14
_SEEN = chdtri(1, 1.0 - CONFIDENCE)


@dataclass(frozen=True)
class Octaves:
    """Allan variances at octave multiples of the sampling interval, before anything is said about the noise.

    `multiple` (k,) counts samples per average, `variance` (k,) is in the unit of the data squared, `samples` holds the
    length of each stretch.
    """

    interval_s: float
    multiple: IntArray
    variance: FloatArray
    samples: tuple[int, ...]

    @property
    def tau_s(self) -> FloatArray:
        """The averaging times, shape (k,)."""
        return np.asarray(self.interval_s * self.multiple, dtype=np.float64)

    def edf(self, kind: IntArray) -> FloatArray:
        """Return the equivalent degrees of freedom at each multiple, summed over the stretches, shape (k,)."""
        from allantools.ci import edf_greenhall

        total = np.zeros(len(self.multiple))
        for count, times in sorted(Counter(self.samples).items()):
            for place, (multiple, alpha) in enumerate(zip(self.multiple.tolist(), kind.tolist(), strict=True)):
                if 2 * multiple <= count:
                    total[place] += times * edf_greenhall(int(alpha), 2, int(multiple), count + 1, overlapping=True)
        return total


class Deviation:
    """Allan deviations at k averaging times `tau_s` in the unit of the data, shape (k,) each.

    `edf` are equivalent degrees of freedom for the kind of noise `kind`; `low` and `high` bound the `deviation` at
    `CONFIDENCE`.
    """

    def __init__(self, measured: Octaves, kind: IntArray) -> None:
        from allantools.ci import confidence_interval

        self.tau_s, self.deviation = measured.tau_s, np.sqrt(measured.variance)
        self.edf, self.kind = measured.edf(kind), kind
        bounds = [confidence_interval(d, e, CONFIDENCE) for d, e in zip(self.deviation, self.edf, strict=True)]
        self.low, self.high = np.array(bounds, dtype=np.float64).T


def octaves(stretches: Sequence[FloatArray], interval_s: float) -> Octaves:
    """Return the overlapping Allan variances of gap-free stretches, (n,) each, at multiples 1, 2, 4, … of the interval.

    A multiple is there where some stretch has two averages of that length to compare. Raises `ValueError` where no
    stretch has three samples.
    """
    from allantools import oadev

    longest = max((len(stretch) for stretch in stretches), default=0)
    if longest < 3:
        raise ValueError("no stretch has three samples: there is nothing to compare")
    multiples = 2 ** np.arange(int(np.log2(longest // 2)) + 1)
    squares, weights = np.zeros(len(multiples)), np.zeros(len(multiples))
    for stretch in stretches:
        own = multiples[2 * multiples <= len(stretch)]
        if not len(own):
            continue
        # allantools drops averaging times with a single difference; the count is then one, and so is its weight.
        _, deviation, _, counts = oadev(stretch, rate=1.0, data_type="freq", taus=own.astype(np.float64))
        here = slice(0, len(deviation))
        squares[here] += counts * np.asarray(deviation) ** 2
        weights[here] += counts
    seen = weights > 0
    return Octaves(interval_s, multiples[seen], squares[seen] / weights[seen], tuple(len(each) for each in stretches))


@dataclass(frozen=True)
class Term:
    """One coefficient: its value, and the interval at `CONFIDENCE`; `low` is 0 where the record does not show it."""

    value: float
    low: float
    high: float

    @property
    def seen(self) -> bool:
        """Whether the record tells the term from nothing."""
        return self.low > 0.0


class NoiseFit:
    """The terms Q, N, B, K in the data's unit and seconds, and how well they describe the deviations.

    `misfit` is the deviance over its degrees of freedom: about 1 where the four terms describe the record, and
    `describes` says whether chance would exceed it in at least 1 % of records. Where they do not, averages of fewer
    than eight samples are left out (a unit's own filter shapes them), and `model_error` is the relative error of the
    deviations that had to be allowed for; the intervals include it.
    """

    def __init__(self, measured: Octaves) -> None:
        chosen = np.ones(len(measured.multiple), dtype=bool)
        fitted = _Fitted.to(measured, chosen)
        self.misfit, self.describes = fitted.deviance / max(fitted.freedom, 1), fitted.chance >= _LEAST_CHANCE
        if not self.describes:
            longer = measured.multiple >= _FILTERED
            chosen = longer if np.count_nonzero(longer) > len(SLOPES) else chosen
            fitted = _Fitted.to(measured, chosen).levelled()
        self.terms = {name: Term(*fitted.interval(place)) for place, name in enumerate(SLOPES)}
        # Which noise dominates at each tau is decided by the fit itself.
        self.deviation = Deviation(measured, _KINDS[np.argmax(_columns(measured.tau_s) * fitted.squares, axis=1)])
        self.fitted_from_s = float(measured.interval_s * measured.multiple[chosen][0])
        self.model_error = fitted.model_error

    def at(self, tau_s: FloatArray, *, only_seen: bool = False) -> FloatArray:
        """Return the fitted deviation at `tau_s`, shape (k,); `only_seen` leaves out terms that may be nothing."""
        used = [term.value if term.seen or not only_seen else 0.0 for term in self.terms.values()]
        squares = np.square(used)
        return np.asarray(np.sqrt(_columns(np.asarray(tau_s, dtype=np.float64)) @ squares))


@dataclass(frozen=True)
class _Fitted:
    """The likeliest squares (p,) of the terms by variances (k,), with degrees of freedom, of correlations (k, k)."""

    columns: FloatArray
    variance: FloatArray
    edf: FloatArray
    squares: FloatArray
    shared: FloatArray
    model_error: float = 0.0

    @classmethod
    def to(cls, measured: Octaves, chosen: NDArray[np.bool_]) -> _Fitted:
        """Fit, and let the fit say which noise dominates at each tau."""
        columns = _columns(measured.tau_s)
        variance = measured.variance[chosen]
        kind = np.zeros(len(columns), dtype=np.int64)
        for _ in range(_MOST_ROUNDS_OF_KINDS):
            edf = measured.edf(kind)[chosen]
            squares = _maximum(columns[chosen], variance, edf)
            dominant = _KINDS[np.argmax(columns * squares, axis=1)]
            if np.array_equal(dominant, kind):
                break
            kind = dominant
        slow = columns[:, 2:] @ squares[2:] / (columns @ squares)
        shared = _shared(measured, squares)[np.ix_(chosen, chosen)]
        found = cls(columns[chosen], variance, edf, squares, shared)
        return found.allowing((0.25 * slow / measured.multiple**2)[chosen])

    @property
    def deviance(self) -> float:
        return _deviance(self.columns @ self.squares, self.variance, self.edf)

    @property
    def _left(self) -> FloatArray:
        """The covariance (k, k) of what the fit leaves of the variances, in units of their own scatter."""
        seen = self._weighed[:, self.squares > 0.0]
        beside = np.eye(len(seen)) - seen @ np.linalg.pinv(seen)
        return np.asarray(beside @ self.shared @ beside)

    @property
    def _weighed(self) -> FloatArray:
        """The terms' shares of each variance in units of its scatter, (k, p), as large as the whole each."""
        relative = self.columns / (self.columns @ self.squares)[:, None]
        return np.asarray(np.sqrt(0.5 * self.edf)[:, None] * relative / np.linalg.norm(relative, axis=0))

    @property
    def freedom(self) -> float:
        """What the deviance is on average."""
        return float(np.trace(self._left))

    @property
    def chance(self) -> float:
        """How probable a larger deviance is: its mean and variance are those of a scaled chi-square (Satterthwaite)."""
        mean, squares = self.freedom, float(np.sum(self._left**2))
        return float(chdtrc(mean**2 / squares, self.deviance * mean / squares)) if mean > 1e-6 else 1.0

    def allowing(self, error: float | FloatArray) -> _Fitted:
        """Fit again, where the model's deviations may be wrong by a relative error, of all or of each (k,)."""
        # A deviation wrong by e has a variance wrong by 2e, which is the scatter of 1 / (2 e²) degrees of freedom.
        edf = 1.0 / (1.0 / self.edf + 2.0 * np.square(error))
        own = np.sqrt(edf / self.edf)
        shared = np.where(np.eye(len(own)), 1.0, self.shared * np.outer(own, own))
        return replace(self, edf=edf, squares=_maximum(self.columns, self.variance, edf), shared=shared)

    def levelled(self) -> _Fitted:
        """Allow for a relative error of the model, so large that what is left is as large as it should be."""

        def excess(error: float) -> float:
            found = self.allowing(error)
            return float(found.deviance - found.freedom)

        if self.freedom <= 1e-6 or excess(0.0) <= 0.0:
            return self
        error = float(brentq(excess, 0.0, 10.0, rtol=1e-3))
        return replace(self.allowing(error), model_error=error)

    def interval(self, place: int) -> tuple[float, float, float]:
        """Return one term's coefficient with its profile-likelihood interval.

        The other terms' squares may be less than nothing here: a bound on them would be one on this term, too, and its
        interval too narrow wherever another is about nothing. What is likely enough is measured from the best fit that
        is possible: one with less than nothing in it would call that fit itself unlikely.
        """
        others, own = np.delete(self.columns, place, axis=1), self.columns[:, place]
        row = np.linalg.pinv(self._weighed)[place]
        # By so much is the variance of a term larger than if the octaves were independent.
        limit = self.deviance + _SEEN * float(row @ self.shared @ row / (row @ row))

        def excess(value: float) -> float:
            given = own * value**2
            rest = (_maximum(others, self.variance, self.edf, given, bounded=bounded) for bounded in (True, False))
            return float(min(_deviance(others @ r + given, self.variance, self.edf) for r in rest) - limit)

        best = float(np.sqrt(self.squares[place]))
        # Above `most` the term alone exceeds every measured variance tenfold.
        most = float(np.sqrt(10.0 * np.max(self.variance / own)))
        low = 0.0 if excess(0.0) <= 0.0 else float(brentq(excess, 0.0, best, rtol=1e-3))
        high = float(brentq(excess, best, most, rtol=1e-3)) if excess(most) > 0.0 else most
        return best, min(low, best), max(high, best)


def _shared(measured: Octaves, squares: FloatArray) -> FloatArray:
    """Return the correlations of the octaves' variances, (k, k), under the fitted spectrum of rates."""
    longest, tau_s = max(measured.samples), measured.interval_s
    cycles = np.geomspace(0.5 / longest, 0.5, _FREQUENCIES)  # per sample
    turn = 2.0 * np.sin(np.pi * cycles)
    spectrum = np.stack([turn**2 / tau_s**2, np.full_like(turn, 1.0 / tau_s), 0.5 / (np.pi * cycles), tau_s / turn**2])
    averages = np.sin(np.pi * np.outer(measured.multiple, cycles)) ** 2 / (measured.multiple[:, None] * turn)
    power = (squares @ spectrum) * averages**2 * np.sqrt(cycles)  # evenly in the logarithm of the frequency
    scale = np.linalg.norm(power, axis=1)
    return np.asarray(power @ power.T / np.outer(scale, scale))


def _columns(tau_s: FloatArray) -> FloatArray:
    """Return the variance at each tau of a unit of Q, N, B, K, shape (k, 4)."""
    return np.stack([3.0 / tau_s**2, 1.0 / tau_s, np.full_like(tau_s, _FLICKER), tau_s / 3.0], -1)


def _maximum(
    columns: FloatArray, variance: FloatArray, edf: FloatArray, fixed: FloatArray | None = None, *, bounded: bool = True
) -> FloatArray:
    """Return the likeliest squares (p,) of the terms, none below 0 if `bounded`, beside `fixed` variance (k,)."""
    given = np.zeros_like(variance) if fixed is None else fixed
    fitted = variance.copy()
    squares = np.zeros(columns.shape[1])
    for _ in range(_ROUNDS):
        weight = np.sqrt(edf) / fitted
        scale = np.linalg.norm(columns * weight[:, None], axis=0)
        rows, left = columns * weight[:, None] / scale, (variance - given) * weight
        squares = (nnls(rows, left)[0] if bounded else np.linalg.lstsq(rows, left, rcond=None)[0]) / scale
        next_fit = np.maximum(columns @ squares + given, 1e-2 * variance)
        # Half steps in the logarithm: the weights of a poor first fit would otherwise swing.
        change = float(np.max(np.abs(np.log(next_fit / fitted))))
        fitted = np.sqrt(fitted * next_fit)
        if change < 1e-6:
            break
    return np.asarray(squares)


def _deviance(fitted: FloatArray, variance: FloatArray, edf: FloatArray) -> float:
    ratio = variance / np.maximum(fitted, 1e-300)
    return float(np.sum(edf * (ratio - 1.0 - np.log(ratio))))
