"""What the last digits of printed means and sigmas say about the runs behind them.

Runs that were written down to 0.01 have a mean that is a multiple of 0.01/n: the digits tell n. And three such runs can
have only certain sigmas (with n - 1) beside a given mean. Both are checks on single digits that no identity needs.
"""

from collections.abc import Sequence

import numpy as np

_RESOLUTIONS = (0.1, 0.01, 0.001)
_MOST_RUNS = 8
_ENOUGH = 0.85  # of the means must lie on a lattice before one is believed


def off_lattice(mean: float, half_digit: float, resolution: float, runs: int) -> float:
    """Return how far a mean lies from the nearest multiple of resolution / runs, beyond its rounding; 0 if on it."""
    step = resolution / runs
    return max(abs(mean - step * round(mean / step)) - 1.02 * half_digit, 0.0)


def run_resolution(groups: Sequence[Sequence[float]], half_digit: float) -> float | None:
    """Return what the runs were written down to, judged by all printed means in groups of equal n; None if unknown."""
    total = sum(len(group) for group in groups)
    for resolution in _RESOLUTIONS:
        if resolution / 5 < 8 * half_digit:  # so fine a lattice would hold any number
            break
        on = sum(max(_count_on(group, half_digit, resolution, runs) for runs in range(1, 6)) for group in groups)
        if total >= 6 and on >= _ENOUGH * total:
            return resolution
    return None


def runs_told(means: Sequence[float], half_digit: float, resolution: float) -> int | None:
    """Return the smallest number of runs for which every mean lies on the lattice; None where there is none."""
    for runs in range(1, _MOST_RUNS + 1):
        if resolution / runs < 8 * half_digit:
            break
        if _count_on(means, half_digit, resolution, runs) == len(means):
            return runs
    return None


def sigma_gap(mean: float, sigma: float, resolution: float) -> float:
    """Return how far a sigma is from the nearest that three runs at `resolution` with this mean can have (n - 1).

    With deviations a/3, b/3 and -(a+b)/3 of the resolution, 9 sum(d²) = 2 (a² + ab + b²) and a = b = -S modulo 3,
    S the sum of the three runs: for every a the two nearest b are tried.
    """
    total = round(3 * mean / resolution)
    target = 9.0 * (sigma / resolution) ** 2  # a² + ab + b², which is half of 9 sum(d²) = 9 * 2 sigma²
    most = int(np.sqrt(4.0 / 3.0 * target)) + 4
    a = np.arange(-most, most + 1)
    a = a[(a + total) % 3 == 0].astype(np.float64)
    root = np.sqrt(np.maximum(target - 0.75 * a**2, 0.0)) - 0.5 * a
    nearest = 3.0 * np.floor((root + total) / 3.0) - total
    tried = np.stack([nearest, nearest + 3.0])
    found = resolution * np.sqrt((a**2 + a * tried + tried**2) / 9.0)
    return float(np.min(np.abs(found - sigma)))


def _count_on(means: Sequence[float], half_digit: float, resolution: float, runs: int) -> int:
    return sum(off_lattice(mean, half_digit, resolution, runs) == 0.0 for mean in means)
