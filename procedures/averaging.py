"""The mean of a series and a standard error that is honest about correlation.

    average = average_series(time_s, rates)        # (n,), (n, c)
    average.mean, average.se                       # (c,), (c,)

Neighbouring samples of a gyro are not independent: filters, vibration and bias instability correlate them, and
sigma/sqrt(n) is then too small, for AR(1) with rho = 0.9 by a factor of 4.4. What counts is the long-run variance, the
spectral density of the noise at zero frequency, V: var(mean) = V / n.

V comes from an autoregression (the VARHAC estimator of den Haan and Levin, NBER technical working paper 197, 1996):
V = s^2 / (1 - sum(phi))^2. Whether there is any correlation at all is asked of the Bayesian information criterion, so
that white noise nearly always gets sigma/sqrt(n) with no added scatter; how much memory there is, of Akaike's, which
keeps enough orders for white noise on top of a slow process. The small-sample bias of the coefficients after a mean
and a slope have been removed is corrected at first order, sum(phi) += (2 + 4 sum(phi)) / n (Tjoestheim and Paulsen,
Biometrika 70, 1983). What a short autoregression cannot see (a slow wander below much white noise) shows in the
scatter of batch means: where that is larger than V allows, at several batch lengths and at the 0.2 % level, it is used
instead. A wander slower than about a tenth of the collect cannot be told from its mean by anything within it.

The noise is taken about a straight line, so that a drift, which is reported beside the mean with its own standard
error, is not mistaken for noise.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from drivers.frames.wire import FloatArray

_BATCHES = (8, 16, 32)
_BATCH_LEVEL = 0.002
_LEAST_PER_BATCH = 4
_PERSISTENCE = 3.0  # the sum of coefficients stays this many samples' worth below 1: no memory beyond the series


@dataclass(frozen=True)
class Average:
    """Means of c channels over one interval. Every array has shape (c,); units are those of the series and seconds.

    `slope_se` and `half_difference_se` follow from the same long-run variance as `se`. `inflation` is
    `se / (sd / sqrt(n))`, 1 for white noise. NaN where fewer than 3 samples leave nothing to judge by.
    """

    n: int
    mean: FloatArray
    se: FloatArray
    sd: FloatArray
    slope_per_s: FloatArray
    slope_se_per_s: FloatArray
    half_difference: FloatArray  # mean of the second half minus mean of the first
    half_difference_se: FloatArray

    @property
    def inflation(self) -> FloatArray:
        """How much larger the standard error is than that of as many independent samples."""
        white = self.sd / np.sqrt(max(self.n, 1))
        return np.asarray(np.divide(self.se, white, out=np.ones_like(self.se), where=white > 0.0))


def average_series(time_s: FloatArray, values: FloatArray) -> Average:
    """Average `values`, shape (n, c), taken at `time_s`, shape (n,), in order and without missing rows.

    A few missing samples are closed up; correlation is counted from sample to sample. Raises `ValueError` where the
    shapes do not agree or a value is not finite.
    """
    time_s, values = np.asarray(time_s, dtype=float), np.asarray(values, dtype=float)
    if values.ndim != 2 or time_s.shape != values.shape[:1]:
        raise ValueError(f"times of shape {time_s.shape} do not fit values of shape {values.shape}")
    if not (np.isfinite(values).all() and np.isfinite(time_s).all()):
        raise ValueError("a series to be averaged holds values that are not finite")
    n, c = values.shape
    unknown = np.full(c, np.nan)
    if n == 0:
        return Average(0, *(unknown,) * 7)
    mean = values.mean(axis=0)
    if n < 3:
        return Average(n, mean, *(unknown,) * 6)
    centred_s = time_s - time_s.mean()
    spread = float(centred_s @ centred_s)
    slope = centred_s @ (values - mean) / spread if spread > 0.0 else np.zeros(c)
    noise = values - mean - centred_s[:, None] * slope
    variance = long_run_variance(noise)
    se = np.sqrt(variance / n)
    half = n // 2
    return Average(
        n=n,
        mean=mean,
        se=se,
        sd=np.sqrt(np.square(noise).sum(axis=0) / (n - 2)),
        slope_per_s=slope,
        slope_se_per_s=np.sqrt(variance / spread) if spread > 0.0 else unknown,
        half_difference=values[n - half :].mean(axis=0) - values[:half].mean(axis=0),
        half_difference_se=2.0 * se,
    )


def long_run_variance(noise: FloatArray) -> FloatArray:
    """Return V of each column of `noise`, shape (n, c), from which a straight line has been removed."""
    variance = _autoregressive(noise)
    n = len(noise)
    for batches in _BATCHES:
        size = n // batches
        if size < _LEAST_PER_BATCH:
            break
        means = noise[: batches * size].reshape(batches, size, -1).mean(axis=1)
        # The line took two degrees of freedom from the batches as well.
        freedom = batches - 2
        scatter = size * np.square(means - means.mean(axis=0)).sum(axis=0)
        variance = np.where(scatter > chdtri(freedom, _BATCH_LEVEL) * variance, scatter / freedom, variance)
    return variance


def _autoregressive(noise: FloatArray) -> FloatArray:
    """Return V by an autoregression whose order each column chooses for itself, up to about the cube root of n."""
    n, c = noise.shape
    highest = min(round(n ** (1.0 / 3.0)) + 2, n // 5)
    covariance = np.array([np.sum(noise[lag:] * noise[: n - lag], axis=0) / n for lag in range(highest + 1)])  # biased
    power = covariance[0]
    freedom = n / max(n - 2, 1)  # of the line that was removed
    chosen = power * freedom
    white = np.log(np.where(power > 0.0, power, 1.0)) * n
    least = np.full(c, np.inf)
    coloured = np.zeros(c, dtype=bool)
    coefficients = np.zeros((0, c))
    remaining = power.copy()
    for order in range(1, highest + 1):
        # Levinson and Durbin's recursion, all columns at once.
        predicted = np.sum(coefficients * covariance[order - 1 : 0 : -1], axis=0)
        reflection = np.divide(covariance[order] - predicted, remaining, out=np.zeros(c), where=remaining > 0.0)
        coefficients = np.vstack([coefficients - reflection * coefficients[::-1], reflection[None, :]])
        remaining = remaining * (1.0 - np.square(reflection))
        misfit = n * np.log(np.where(remaining > 0.0, remaining, 1.0))
        coloured |= misfit + order * np.log(n) < white
        criterion = misfit + 2.0 * order
        total = coefficients.sum(axis=0)
        total = np.minimum(total + (2.0 + 4.0 * total) / n, 1.0 - _PERSISTENCE / n)
        candidate = remaining * freedom / np.square(1.0 - total)
        better = criterion < least
        chosen = np.where(better, candidate, chosen)
        least = np.where(better, criterion, least)
    return np.asarray(np.where(coloured, chosen, power * freedom))
