"""Effects that show inside a collect: tests of its series of samples.

Every test gives a p-value per channel that is exact or errs on the cautious side, with the estimates and a sentence.
The regressions (settling, ramp, jump) work on block averages, so that filtered samples do not count as independent,
and widen their errors by the correlation that is left. A p-value is NaN where the series is too short to ask.

    findings = SettlingInCollect().test(series, sensor)
    findings[0].p_value, findings[0].estimates["S_deg_per_hr"]
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import fdtrc, ndtr, stdtr

from hil.campaign import FloatArray, Series
from hil.model.effects.base import Parameter
from hil.model.effects.inside import FEWEST, FEWEST_BESIDE, OF_NORMAL, SeriesEffect, SeriesFinding

_BLOCKS = 60
_SETTLING_TAUS = np.array([0.02, 0.04, 0.08, 0.15, 0.3])  # of the collect's duration
_NEIGHBOURS = 12  # periodogram ordinates on each side that make the background
_FEWEST_BESIDE = 6  # ordinates on a side below which nothing is asked: a tone has at least so many cycles in a collect
_BURST = 2.5  # standard deviations from the middle beyond which a block counts no more
_COLOURED = 2.5  # standard deviations of the correlation of white noise, from which on it is none
_RATE = "deg/hr"


def blocked(series: Series, channel: int) -> tuple[FloatArray, FloatArray]:
    """Return times, s, and averages, deg/hr, (k,) each, of at most 60 equal blocks of a channel (or fewer samples)."""
    known = np.isfinite(series.rates_deg_per_hr[:, channel])
    times, rates = series.t_s[known], series.rates_deg_per_hr[known, channel]
    size = max(len(rates) // _BLOCKS, 1)
    count = len(rates) // size
    shape = (count, size)
    return times[: count * size].reshape(shape).mean(axis=1), rates[: count * size].reshape(shape).mean(axis=1)


def best_regressor(rates: FloatArray, nuisance: FloatArray, candidates: FloatArray) -> tuple[int, float, float, bool]:
    """Return index, coefficient and p-value of the candidate, of (n, k), that explains most beside `nuisance` (n, m).

    And whether what it leaves is coloured: each of its values tells of the next, beyond chance.

    The p-value is the F test's, with residual variance widened by positive lag-1 correlation, times k. What stands out
    of the middle by more than two and a half standard deviations counts as that: one burst is no settling and no step.
    """
    basis, _ = np.linalg.qr(nuisance)
    plain = rates - basis @ (basis.T @ rates)
    middle = float(np.median(plain))
    spread = _BURST * OF_NORMAL * float(np.median(np.abs(plain - middle)))
    left = np.clip(plain, middle - spread, middle + spread) if spread > 0.0 else plain
    beside = candidates - basis @ (basis.T @ candidates)
    norms = np.sum(beside**2, axis=0)
    usable = norms > 1e-6 * np.sum(candidates**2, axis=0)
    norms = np.where(usable, norms, np.inf)
    sizes = beside.T @ plain / norms
    index = int(np.argmax(sizes**2 * np.where(usable, norms, 0.0)))
    coefficient = float(beside[:, index] @ left / norms[index])
    explained = coefficient**2 * float(norms[index]) if usable[index] else 0.0
    residual = left - beside[:, index] * coefficient
    freedom = len(rates) - nuisance.shape[1] - 1
    power = float(residual @ residual)
    if power <= 1e-20 * max(float(rates @ rates), 1e-300):  # no noise at all: certain where anything is explained
        return index, float(sizes[index]), 0.0 if explained > power else 1.0, False
    correlation = float(residual[1:] @ residual[:-1]) / power
    # Residuals of a fit look less correlated than the noise is (Kendall); without correlation nothing is widened.
    correlation = min(max(correlation + (1.0 + 4.0 * correlation) / len(rates), 0.0), 0.99)
    wider = (1.0 + correlation) / (1.0 - correlation)
    statistic = explained / (power / freedom * wider)
    p_value = float(fdtrc(1, max(freedom / wider, 3.0), statistic)) * candidates.shape[1]
    return index, float(sizes[index]), min(p_value, 1.0), correlation > _COLOURED / math.sqrt(len(rates))


class Tone(SeriesEffect):
    """A spectral line above its surroundings: the largest ratio of a periodogram ordinate to its neighbours' mean."""

    id = "beat"
    family = "vibration"
    title = "Tone (spin beat, vibration, interference)"
    equation = "R += a cos(2 pi f t + phase)"
    parameters = (Parameter("a", _RATE, (0.1, 5.0)),)
    signature = "A sinusoid of constant frequency; in averages it leaves a pseudo-random remainder."
    confusable_with = ("arw", "vre")
    experiment = "Run one sensor at a time; stop the chamber's fan; look whether the line moves with the spin."

    def _test_channel(self, series: Series, channel: int) -> SeriesFinding:
        step, power = _periodogram(series, channel)
        if len(power) < 2 * _NEIGHBOURS:
            return SeriesFinding(math.nan, {}, "too few samples for a spectrum")
        if not np.any(power):
            return SeriesFinding(1.0, {}, "nothing changes")
        return SeriesFinding(*self._line(step, power, 1))

    def summary(self, series: Series, channel: int) -> FloatArray:
        """Return the sample spacing in s, then the periodogram, (k,)."""
        step, power = _periodogram(series, channel)
        return np.concatenate([[step], power]) if len(power) >= 2 * _NEIGHBOURS else np.empty(0)

    def together(self, summaries: Sequence[FloatArray]) -> tuple[float, Mapping[str, float], str] | None:
        """Look for a line in the mean spectrum of the collects that have the usual length and spacing."""
        lengths = [len(summary) for summary in summaries if len(summary)]
        if not lengths:
            return None
        usual = max(set(lengths), key=lengths.count)
        alike = np.stack([summary for summary in summaries if len(summary) == usual])
        step = float(np.median(alike[:, 0]))
        alike = alike[np.abs(alike[:, 0] - step) < 1e-3 * step]
        if len(alike) < FEWEST_BESIDE or not np.any(alike[:, 1:]):
            return None
        return self._line(step, alike[:, 1:].mean(axis=0), len(alike))

    @staticmethod
    def _line(step: float, power: FloatArray, averaged: int) -> tuple[float, dict[str, float], str]:
        """Return the strongest line of a spectrum, averaged over so many collects."""
        samples = 2 * len(power) + 1
        background, neighbours = _surroundings(power)
        # Under locally flat noise each ratio is F distributed, with twice as many degrees of freedom as ordinates.
        p_values = fdtrc(2 * averaged, 2 * neighbours * averaged, power / np.maximum(background, 1e-300))
        index = int(np.argmin(p_values))
        amplitude = 2.0 / samples * math.sqrt(max(float(power[index] - background[index]), 0.0))
        frequency = (index + 1) / (samples * step)
        estimates = {"a_deg_per_hr": amplitude, "frequency_hz": frequency}
        sentence = f"have a line at {frequency:.4g} Hz with amplitude {amplitude:.3g} deg/hr"
        if averaged == 1:
            sentence = sentence.removeprefix("have ")
        return min(float(p_values[index]) * len(power), 1.0), estimates, sentence


class SettlingInCollect(SeriesEffect):
    """An exponential at the beginning of the collect, beside level and slope."""

    id = "settle"
    size = "S_deg_per_hr"
    family = "dynamics"
    title = "Settling after index"
    equation = "R += S exp(-t/tau)"
    parameters = (Parameter("S", _RATE, (5.0, 100.0)),)
    signature = "The head of the collect stands off and dies away."
    confusable_with = ("drift", "jump")
    experiment = "Discard the head, and compare."

    def summary(self, series: Series, channel: int) -> FloatArray:
        """Return the duration in s, then S in deg/hr at each time constant, fitted beside level and slope, (k,)."""
        times, rates = blocked(series, channel)
        if len(rates) < FEWEST:
            return np.empty(0)
        basis, _ = np.linalg.qr(_level_and_slope(times))
        shapes = np.exp(-times[:, None] / _taus_s(times))
        beside = shapes - basis @ (basis.T @ shapes)
        sizes = beside.T @ rates / np.sum(beside**2, axis=0)
        return np.concatenate([[times[-1] - times[0]], sizes])

    def together(self, summaries: Sequence[FloatArray]) -> tuple[float, Mapping[str, float], str] | None:
        """Ask whether S is other than zero on average: Student's t, which needs nothing of the noise inside."""
        known = [summary for summary in summaries if len(summary)]
        if len(known) < FEWEST_BESIDE:
            return None
        sizes = np.stack(known)[:, 1:]
        error = np.maximum(np.std(sizes, axis=0, ddof=1) / math.sqrt(len(sizes)), 1e-300)
        t = np.abs(sizes.mean(axis=0)) / error
        best = int(np.argmax(t))
        p_value = min(2.0 * float(stdtr(len(sizes) - 1, -t[best])) * sizes.shape[1], 1.0)
        size = float(sizes[:, best].mean())
        tau = float(_SETTLING_TAUS[best] * np.mean([summary[0] for summary in known]))
        estimates = {"S_deg_per_hr": size, "se_deg_per_hr": float(error[best]), "tau_s": tau}
        return p_value, estimates, f"begin {size:+.3g} +- {error[best]:.2g} deg/hr off and settle in about {tau:.3g} s"

    def _test_channel(self, series: Series, channel: int) -> SeriesFinding:
        times, rates = blocked(series, channel)
        taus = _taus_s(times)
        candidates = np.exp(-times[:, None] / taus)
        index, size, p_value, coloured = best_regressor(rates, _level_and_slope(times), candidates)
        estimates = {"S_deg_per_hr": size, "tau_s": float(taus[index])}
        return SeriesFinding(
            p_value, estimates, f"begins {size:+.3g} deg/hr off and settles in about {taus[index]:.3g} s", coloured
        )


class Ramp(SeriesEffect):
    """A straight slope through the collect."""

    id = "drift"
    size = "slope_deg_per_hr_per_min"
    family = "noise"
    title = "Ramp within the collect"
    equation = "R += slope t"
    parameters = (Parameter("slope", "deg/hr/min", (0.1, 5.0)),)
    signature = "The second half differs from the first, steadily."
    confusable_with = ("settle", "jump", "bias_Tdot", "warmup", "soak_insufficient")
    experiment = "Collect again after a longer soak."

    def _test_channel(self, series: Series, channel: int) -> SeriesFinding:
        times, rates = blocked(series, channel)
        _, slope, p_value, coloured = best_regressor(rates, np.ones((len(times), 1)), (times - times.mean())[:, None])
        found, words = {"slope_deg_per_hr_per_min": 60.0 * slope}, f"drifts by {60.0 * slope:+.3g} deg/hr per minute"
        return SeriesFinding(p_value, found, words, coloured)


class JumpInCollect(SeriesEffect):
    """A step of the level at some instant of the collect, beside level and slope."""

    id = "jump"
    size = "J_deg_per_hr"
    family = "noise"
    title = "Step within the collect"
    equation = "R += J after t_J"
    parameters = (Parameter("J", _RATE, (5.0, 15.0)),)
    signature = "Two levels with an edge between."
    confusable_with = ("settle", "drift")
    experiment = "Repeat the collect."

    def _test_channel(self, series: Series, channel: int) -> SeriesFinding:
        times, rates = blocked(series, channel)
        edges = np.arange(3, len(times) - 2)
        candidates = (np.arange(len(times))[:, None] >= edges[None, :]).astype(np.float64)
        index, size, p_value, coloured = best_regressor(rates, _level_and_slope(times), candidates)
        at = float(0.5 * (times[edges[index] - 1] + times[edges[index]]))
        return SeriesFinding(
            p_value, {"J_deg_per_hr": size, "t_s": at}, f"steps by {size:+.3g} deg/hr at {at:.3g} s", coloured
        )


class Lattice(SeriesEffect):
    """Values that are multiples of a step which is coarse beside the noise."""

    id = "quant"
    family = "noise"
    title = "Quantisation"
    equation = "R = step round(R/step)"
    parameters = (Parameter("step", _RATE, (0.001, 0.1)),)
    signature = "Few distinct values, equally spaced."
    confusable_with = ("saturation",)
    experiment = "Average longer, or add a dither."

    def _test_channel(self, series: Series, channel: int) -> SeriesFinding:
        rates = _known(series, channel)
        step = lattice_step(rates)
        share = step**2 / 12.0 / max(float(np.var(rates)), 1e-300)
        # Continuous noise repeats no value; a fine lattice is only how the file was printed.
        if np.ptp(rates) == 0.0:
            return SeriesFinding(
                0.0, {"step_deg_per_hr": math.inf, "variance_share": 1.0}, f"every value is {rates[0]:.6g} deg/hr"
            )
        coarse = step > 0.0 and share > 0.05
        estimates = {"step_deg_per_hr": step, "variance_share": min(share, 1.0)}
        return SeriesFinding((0.0 if coarse else 1.0), estimates, f"values stand {step:.3g} deg/hr apart")


class Saturation(SeriesEffect):
    """Too many samples at exactly the largest or the smallest value."""

    id = "saturation"
    family = "electronics"
    title = "Saturation"
    equation = "R = limit where |R| would exceed it"
    parameters = (Parameter("limit", _RATE, (100.0, 10000.0)),)
    signature = "The extreme value repeats; the distribution is cut off."
    confusable_with = ("quant", "jump")
    experiment = "A wider range, or less vibration."

    def _test_channel(self, series: Series, channel: int) -> SeriesFinding:
        rates = _known(series, channel)
        sides = [(self._pile(rates), float(rates.max())), (self._pile(-rates), float(rates.min()))]
        (p_value, count), limit = min(sides, key=lambda side: side[0][0])
        estimates = {"limit_deg_per_hr": limit, "samples": float(count)}
        return SeriesFinding(min(2.0 * p_value, 1.0), estimates, f"{count} samples stand at exactly {limit:.6g} deg/hr")

    @staticmethod
    def _pile(rates: FloatArray) -> tuple[float, int]:
        """Return the chance that normal samples which reach the largest value all stay in it, and how many there are.

        Beyond a limit nothing is left; noise that reaches a lattice's cell goes past it with a known probability.
        """
        top, middle = rates.max(), float(np.median(rates))
        count = int(np.sum(rates == top))
        spread = OF_NORMAL * float(np.median(np.abs(rates - middle)))
        if count < 3 or spread == 0.0:
            return 1.0, count
        half = 0.5 * lattice_step(rates)
        reach, beyond = ndtr((middle - top + half) / spread), ndtr((middle - top - half) / spread)
        stays = 1.0 - float(beyond / max(reach, 1e-300))
        return stays ** (count - 1), count


class Bursts(SeriesEffect):
    """Noise that comes in bursts: the variance differs between parts of the collect (Levene's test about medians)."""

    id = "hash"
    family = "noise"
    title = "Bursts, ball-retainer noise"
    equation = "sigma(t) not constant"
    parameters = (Parameter("variance_ratio", "1", (2.0, 10.0)),)
    signature = "Quiet and noisy stretches, mostly in the cold."
    confusable_with = ("saturation", "jump")
    experiment = "Spin-motor current beside the rates."

    def _test_channel(self, series: Series, channel: int) -> SeriesFinding:
        rates = np.diff(_known(series, channel))[::2]  # disjoint differences: blind to level and slope
        parts = np.array_split(rates, min(12, len(rates) // 8))
        if len(parts) < 2 or np.ptp(rates) == 0.0:
            return SeriesFinding(1.0, {"variance_ratio": 1.0}, "no change of the noise")
        variances = np.array([np.var(part) for part in parts])
        ratio = float(variances.max() / max(float(np.median(variances)), 1e-300))
        sentence = f"the noisiest part has {ratio:.3g} times the usual variance"
        return SeriesFinding(equal_spread(parts), {"variance_ratio": ratio}, sentence)


def equal_spread(parts: Sequence[FloatArray]) -> float:
    """Return the p-value of Levene's test about medians (Brown-Forsythe) that parts, (n,) each, vary the same."""
    distances = [np.abs(part - np.median(part)) for part in parts]
    everything = np.concatenate(distances)
    between = sum(len(part) * (part.mean() - everything.mean()) ** 2 for part in distances) / (len(parts) - 1)
    freedom = len(everything) - len(parts)
    within = sum(float(np.sum((part - part.mean()) ** 2)) for part in distances) / freedom
    return float(fdtrc(len(parts) - 1, freedom, between / within)) if within > 0.0 else 1.0


def lattice_step(rates: FloatArray) -> float:
    """Return the step of which all differences of rates (n,) are multiples; 0 for none, or too few repeats to tell."""
    values = np.unique(rates)
    if len(values) == 1:
        return 0.0
    step = float(np.diff(values).min())
    if len(values) > 0.9 * len(rates) and len(rates) > 4:
        return 0.0
    multiples = np.diff(values) / step
    return step if np.allclose(multiples, np.round(multiples), atol=0.02) else 0.0


def _periodogram(series: Series, channel: int) -> tuple[float, FloatArray]:
    """Return the spacing of a channel's samples and its periodogram without mean and Nyquist; zeros if it is still."""
    known = np.isfinite(series.rates_deg_per_hr[:, channel])
    taken = series.t_s[known]
    step = float(np.median(np.diff(taken)))
    times = taken[0] + step * np.arange(round((taken[-1] - taken[0]) / step) + 1)
    rates = np.interp(times, taken, series.rates_deg_per_hr[known, channel])  # those that are missing, too
    step, power = float(times[1] - times[0]), np.zeros((len(rates) - 1) // 2)
    if np.ptp(rates) > 1e-9 * np.abs(rates).max():
        trend = np.polynomial.Polynomial.fit(times, rates, 1)(times)
        power = np.abs(np.fft.rfft(rates - trend)[1 : len(power) + 1]) ** 2
    return step, power


def _known(series: Series, channel: int) -> FloatArray:
    rates = series.rates_deg_per_hr[:, channel]
    return rates[np.isfinite(rates)]


def _taus_s(times: FloatArray) -> FloatArray:
    return _SETTLING_TAUS * float(times[-1] - times[0])


def _level_and_slope(times: FloatArray) -> FloatArray:
    return np.stack([np.ones_like(times), times - times.mean()], -1)


def _surroundings(power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean of the louder side's neighbours of every ordinate, the next one left out, and how many they are.

    On a slope (correlated noise, a settling) one side always lies above; only a line lies above both. An ordinate with
    few neighbours on one side cannot show that: its background is infinite.
    """
    sums = np.concatenate([[0.0], np.cumsum(power)])
    place = np.arange(len(power))
    sides = []
    for first, last in ((place - 1 - _NEIGHBOURS, place - 1), (place + 2, place + 2 + _NEIGHBOURS)):
        low, high = np.clip(first, 0, len(power)), np.clip(last, 0, len(power))
        count = high - low
        mean = (sums[high] - sums[low]) / np.maximum(count, 1)
        sides.append((np.where(count >= _FEWEST_BESIDE, mean, np.inf), np.maximum(count, 1)))
    (left, left_count), (right, right_count) = sides
    return np.maximum(left, right), np.where(left >= right, left_count, right_count).astype(np.float64)
