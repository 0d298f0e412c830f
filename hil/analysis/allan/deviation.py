"""Overlapping Allan deviation of one or several gap-free stretches, with confidence intervals.

    found = allan_deviation([stretch], interval_s=0.01)
    found.tau_s, found.deviation, found.low, found.high      # octaves, 95 % intervals

The deviations are allantools'. A gap is never bridged: second differences are taken within a stretch, and the variances
of the stretches are averaged with their counts of differences as weights. So the longest tau is set by the longest
stretch, and everything that was recorded counts. Equivalent degrees of freedom (Greenhall and Riley 2003) depend on the
kind of noise; `NoiseKind` says which is taken at each tau.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from hil.campaign import FloatArray, IntArray

CONFIDENCE = 0.95
"""The probability that every interval of this package is stated at."""


class NoiseKind(IntEnum):
    """Power-law noise by the exponent of its spectrum, as `edf_greenhall` counts it."""

    QUANTISATION = 2  # white in angle
    WHITE = 0  # white in rate: angle random walk
    FLICKER = -1  # bias instability
    RANDOM_WALK = -2  # rate random walk


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
        for count in sorted(set(self.samples)):
            times = self.samples.count(count)
            for place, (multiple, alpha) in enumerate(zip(self.multiple.tolist(), kind.tolist(), strict=True)):
                if 2 * multiple <= count:
                    phases = count + 1
                    total[place] += times * edf_greenhall(int(alpha), 2, int(multiple), phases, overlapping=True)
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
