"""Whether the samples of a collect are those of a stationary unit that is being measured: pure functions on arrays.

Each returns a finding in words, or nothing. None looks at more than one property, so that the reason names it.
"""

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from drivers.frames.wire import FloatArray
from procedures.verdict import Judgement, Verdict

_GAP = 1.5  # sample intervals; anything longer has lost at least one sample
_FEW = 30  # samples: with fewer nothing is said about their noise
_WITHIN, _SIGMAS_WITHIN = 0.9, 1.6449  # nine tenths of a normal distribution lie within so many sigmas
_SPIKE_SIGMAS = 12.0
_REPEATS = 0.1  # of the samples
_CLIPPED = 0.005  # of the samples on one extreme value …
_CLIPPED_LEAST = 5
_CLIPPED_RATIO = 3.0  # … and this many times more than on the value next to it


def missing_in_gaps(time_s: FloatArray, sample_rate_hz: float) -> int:
    """Return how many samples the gaps of `time_s`, (n,), would have held, less those that came in bunches."""
    if len(time_s) < 2:
        return 0
    intervals = np.diff(time_s) * sample_rate_hz
    late = intervals[intervals > _GAP] - 1.0
    early = 1.0 - intervals[intervals < 1.0 / _GAP]
    return max(round(float(late.sum() - early.sum())), 0)


def moved(accelerations_g: FloatArray, per_second: float, limit_g: float) -> tuple[float, bool]:
    """Return the largest departure of a one-second mean from the whole mean, g, and whether it exceeds the limit.

    `accelerations_g` has shape (n, c). A stationary unit's accelerometers show only their noise; a knock, a slip of
    the mount or an index that has not ended shows as a step.
    """
    size = max(round(per_second), 1)
    blocks = len(accelerations_g) // size
    if blocks < 2 or accelerations_g.shape[1] == 0:
        return 0.0, False
    means = accelerations_g[: blocks * size].reshape(blocks, size, -1).mean(axis=1)
    departure = float(np.abs(means - np.median(means, axis=0)).max())
    return departure, departure > limit_g


def longest_run(values: FloatArray) -> int:
    """Return the length of the longest run of identical values in `values`, shape (n,)."""
    if len(values) == 0:
        return 0
    changes = np.flatnonzero(np.diff(values) != 0.0)
    edges = np.concatenate(([-1], changes, [len(values) - 1]))
    return int(np.diff(edges).max())


def same_samples(channels: Mapping[str, FloatArray]) -> Iterator[tuple[str, str]]:
    """Yield the pairs of channels, each (n,), whose samples agree to the last bit, or but for their sign."""
    for (one, first), (other, second) in combinations(channels.items(), 2):
        alive = len(first) > _FEW and np.ptp(first) > 0.0
        if alive and (np.array_equal(first, second) or np.array_equal(first, -second)):
            yield one, other


def not_measured(values: FloatArray, frozen: float) -> Judgement | None:
    """Say what contradicts that `values`, shape (n,), are a rate and its noise, sampled anew every time; None if so.

    A rate shows noise of many values: it does not stand still for `frozen` samples, does not toggle, repeats itself no
    oftener than its steps make likely, does not pile up on one extreme value, and no sample lies where noise cannot be.
    """
    stuck = longest_run(values)
    if 0.0 < frozen <= stuck:
        return Judgement(Verdict.FAIL, f"did not change for {stuck} samples: it is not being measured")
    n = len(values)
    if n < _FEW:
        return None
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) == 2:
        low, high = levels
        said = f"shows only {low:g} and {high:g} deg/hr: what lies between is not measured"
        return Judgement(Verdict.INCONCLUSIVE, said)
    if len(levels) < 3:
        return None
    for end, neighbour in ((-1, -2), (0, 1)):
        if counts[end] >= max(_CLIPPED_LEAST, _CLIPPED * n) and counts[end] > _CLIPPED_RATIO * counts[neighbour]:
            return Judgement(Verdict.FAIL, f"is clipped at {levels[end]:g} deg/hr")
    return _spikes(values) or _repeats(values, float(np.diff(levels).min()))


def _spikes(values: FloatArray) -> Judgement | None:
    """Judge samples that lie where noise cannot be: they count where they move the mean by more than its error."""
    middle = float(np.median(values))
    apart = np.abs(values - middle)
    spread = float(np.quantile(apart, _WITHIN)) / _SIGMAS_WITHIN  # of a coarse channel half may be at the median
    far = apart > _SPIKE_SIGMAS * spread
    if spread == 0.0 or not far.any():
        return None
    rest = values[~far]
    shift = float(values.mean() - rest.mean())
    if abs(shift) < float(rest.std()) / np.sqrt(len(rest)):
        return None
    reason = (
        f"has {int(far.sum())} of {len(values)} samples up to {apart.max():.4g} deg/hr from the others, which move its "
        f"mean by {shift:+.4g} deg/hr: look at the cable and its ground"
    )
    return Judgement(Verdict.FAIL, reason)


def _repeats(values: FloatArray, step: float) -> Judgement | None:
    """Judge how often a sample is the one before it: a channel renewed seldom has fewer samples than it sends."""
    changes = np.diff(values)
    changed = changes[changes != 0.0]
    share = 1.0 - len(changed) / len(changes)
    likely = step / float(np.sqrt(2.0 * np.pi * np.mean(changed**2)))  # that rounding to steps hides a change
    if share <= _REPEATS + 3.0 * likely:
        return None
    return Judgement(Verdict.MARGINAL, f"repeats {share:.0%} of its samples: it is renewed less often than it is sent")


def slope_per_min(time_s: FloatArray, values: FloatArray) -> float | None:
    """Return the least-squares slope of a series, (n,), in units per minute; None where there are too few samples."""
    usable = np.isfinite(values)
    if int(usable.sum()) < 2:
        return None
    t, y = time_s[usable] - time_s[usable].mean(), values[usable]
    spread = float(t @ t)
    return 60.0 * float(t @ y) / spread if spread > 0.0 else None
