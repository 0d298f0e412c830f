"""Whether the samples of a collect are those of a stationary unit that is being measured: pure functions on arrays.

Each returns a finding in words, or nothing. None looks at more than one property, so that the reason names it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_GAP = 1.5  # sample intervals; anything longer has lost at least one sample
_CLIPPED = 0.005  # of the samples on one extreme value …
_CLIPPED_LEAST = 5
_CLIPPED_RATIO = 3.0  # … and this many times more than on the value next to it


def missing_in_gaps(time_s: FloatArray, sample_rate_hz: float) -> int:
    """Return how many samples the gaps between `time_s`, shape (n,), would have held at the nominal rate.

    Samples that arrived in a bunch after a pause are not missing: what came early is set off against what came late.
    """
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


def clipped(values: FloatArray) -> float | None:
    """Return the value at which a series, shape (n,), is clipped, or None.

    Clipping piles samples up on the extreme value itself: more of them than the tail of any noise, also of a coarsely
    quantised one, would put there.
    """
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) < 3:
        return None
    for end, neighbour in ((-1, -2), (0, 1)):
        enough = max(_CLIPPED_LEAST, _CLIPPED * len(values))
        if counts[end] >= enough and counts[end] > _CLIPPED_RATIO * counts[neighbour]:
            return float(levels[end])
    return None


def slope_per_min(time_s: FloatArray, values: FloatArray) -> float | None:
    """Return the least-squares slope of a series, (n,), in units per minute; None where there are too few samples."""
    usable = np.isfinite(values)
    if int(usable.sum()) < 2:
        return None
    t, y = time_s[usable] - time_s[usable].mean(), values[usable]
    spread = float(t @ t)
    return 60.0 * float(t @ y) / spread if spread > 0.0 else None
