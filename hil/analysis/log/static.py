"""Where in a log the unit was at rest: a test against the log's own quietest tenth, told with what ended each stretch.

    stretches, sentences = static_stretches(log, StaticTest())

The log is cut into windows. Of each of the six channels the variance within a window is compared with that within the
quietest tenth of the windows: `times` so much is noise, more is motion. This is the static detector of D. Tedaldi,
A. Pretto and E. Menegatti, "A robust and easy to implement method for IMU calibration without external equipments"
(ICRA 2014), for each channel instead of for the norm of accelerations alone: gyros see a turn about the vertical, and
accelerometers a shift. What is quiet window by window may still have been moved slowly: within a stretch neither the
direction of f nor the integral of the rates about a straight line may go further than `moved_deg`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import fdtrc

from hil.analysis.log.reading import NAMES, Log
from hil.campaign import BoolArray, FloatArray, IntArray
from hil.errors import InputError

_FEWEST = 20  # samples that a variance is taken of, and windows that tell what is usual
_QUIETEST = 0.1  # of the windows: what everything is compared with
_SIGMAS = 5.0  # of the windows' own noise, beside what a unit may be moved by
_ARC_S = 3600.0
_ROUNDING = 1e-9


@dataclass(frozen=True)
class StaticTest:
    """What counts as static: windows of `window_s`, variances up to `times` the quietest, stretches of `shortest_s`.

    `moved_deg` is how far a unit may turn within a stretch and count as not moved.
    """

    window_s: float = 0.5
    times: float = 4.0
    shortest_s: float = 1.0
    moved_deg: float = 0.5


@dataclass(frozen=True)
class Stretch:
    """The `rows` of a log's samples in which the unit was at rest, and why it begins and ends there."""

    rows: slice
    begins: str
    ends: str


class _Windows:
    """k windows of n samples: the `first` sample of each (k,), means and variances (k, 6).

    None goes across a gap; what is left before a gap is in none. `frozen` (k,) is where a stream stands still: all
    channels show one value, as no measurement does.
    """

    def __init__(self, log: Log, test: StaticTest) -> None:
        self.n = n = max(_FEWEST, round(test.window_s / log.interval_s))
        edges = [*np.flatnonzero(log.begins).tolist(), len(log.row)]
        self.first = np.concatenate([np.arange(a, b - n + 1, n) for a, b in pairwise(edges)])
        if not len(self.first):
            raise InputError(f"{log.path}: no {n} samples follow each other without a gap; --window changes how many")
        values = log.values[self.first[:, None] + np.arange(n)]
        self.frozen = ~np.ptp(values, axis=1).any(axis=1)
        self.mean, self.variance = values.mean(axis=1), values.var(axis=1, ddof=1)


def static_stretches(log: Log, test: StaticTest) -> tuple[list[Stretch], list[str]]:
    """Return the stretches in which the unit was at rest, and in sentences the test, its level, and what was moved.

    Raises `InputError` where there is no stretch, or the test could find none.
    """
    if not (test.times > 1.0 and min(test.window_s, test.shortest_s, test.moved_deg) > 0.0):
        raise InputError("--times must be more than 1, --window, --shortest and --moved more than 0")
    windows = _Windows(log, test)
    m, reference = _quietest(log, windows)
    ratio = windows.variance / reference
    quiet: BoolArray = np.asarray((ratio.max(axis=1) <= test.times) & ~windows.frozen)
    level = len(NAMES) * float(fdtrc(windows.n - 1, m * (windows.n - 1), test.times))
    test_in_words = (
        f"static: windows of {windows.n} samples ({windows.n * log.interval_s:.3g} s) in which no channel varies more "
        f"than {test.times:g} times as much (variance) as in the quietest tenth, which white "
        f"noise does in {level:.1g} of the windows; at least {test.shortest_s:g} s; moved by {test.moved_deg:g} "
        "deg at most"
    )
    said = [test_in_words]
    stretches = []
    segment = np.cumsum(log.begins, dtype=np.int64)[windows.first]
    for begin, end in _runs(quiet, segment):
        borders = []
        for at, inside in ((begin - 1, begin), (end, end - 1)):
            if not 0 <= at < len(quiet):
                borders.append((0, "the log begins" if at < 0 else "the log ends"))
            elif segment[at] != segment[inside]:
                borders.append((0, "a gap in time"))
            else:  # motion begins or ends somewhere in the window beside: half a window is left to it
                borders.append((windows.n // 2, _motion(log, windows, ratio, at)))
        (after, begins), (before, ends) = borders
        first, last = int(windows.first[begin]) + after, int(windows.first[end - 1]) + windows.n - before
        if (last - first) * log.interval_s < test.shortest_s * (1.0 - _ROUNDING):
            continue
        if moved := _moved(log, windows, reference, slice(begin, end), test):
            said.append(f"rows {log.row[first]}-{log.row[last - 1]} are quiet and yet not used: {moved}")
        else:
            stretches.append(Stretch(slice(first, last), begins, ends))
    if not stretches:
        raise InputError(
            f"{log.path}: the unit is nowhere at rest for {test.shortest_s:g} s ({'; '.join(said)}); "
            "--times, --window and --shortest change the test"
        )
    return stretches, said


def _quietest(log: Log, windows: _Windows) -> tuple[int, FloatArray]:
    """Return how many windows are the quietest tenth, and the median of each channel's variances in them, (6,)."""
    steps = np.abs(np.diff(log.values, axis=0))
    step = np.array([column[column > 0.0].min() for column in steps.T])
    variance = np.maximum(windows.variance, step**2 / 12.0)  # no less than that of rounding to the smallest step
    together = np.log(variance).mean(axis=1)
    together[windows.frozen] = np.inf
    m = min(max(_FEWEST, round(_QUIETEST * len(together))), len(together))
    return m, np.asarray(np.median(variance[np.argsort(together)[:m]], axis=0))


def _runs(quiet: BoolArray, segment: IntArray) -> Iterator[tuple[int, int]]:
    """Yield the first and the last window (not included) of quiet ones that follow each other in one segment."""
    joined = quiet[1:] & quiet[:-1] & (np.diff(segment) == 0)
    begins = np.flatnonzero(quiet & ~np.concatenate([[False], joined]))
    ends = np.flatnonzero(quiet & ~np.concatenate([joined, [False]])) + 1
    yield from zip(begins.tolist(), ends.tolist(), strict=True)


def _motion(log: Log, windows: _Windows, ratio: FloatArray, at: int) -> str:
    row, worst = log.row[windows.first[at]], int(np.argmax(ratio[at]))
    if windows.frozen[at]:
        return f"row {row}: the stream stands still"
    return f"row {row}: {NAMES[worst]} varies {ratio[at, worst]:.3g} times as much as in the quietest tenth"


def _moved(log: Log, windows: _Windows, reference: FloatArray, rows: slice, test: StaticTest) -> str:
    """Return in words how the unit was moved within a stretch of quiet windows, or nothing."""
    mean, n = windows.mean[rows], windows.n
    noise = np.sqrt(reference / n)
    f = mean[:, 3:] / np.linalg.norm(mean[:, 3:], axis=1, keepdims=True)
    usual = np.median(f, axis=0)
    tilt_deg = float(np.rad2deg(np.linalg.norm(f - usual, axis=1).max()))
    if tilt_deg > test.moved_deg + _SIGMAS * np.rad2deg(noise[3:].max()):
        return f"f turns by {tilt_deg:.2g} deg within"
    window_s, k = n * log.interval_s, len(mean)
    at = np.arange(k) - 0.5 * (k - 1)
    about = mean[:, :3] - mean[:, :3].mean(axis=0)
    about = about - np.outer(at, at @ about) / max(at @ at, 1.0)
    turned_deg = np.ptp(np.cumsum(about, axis=0), axis=0) * window_s / _ARC_S
    allowed_deg = test.moved_deg + _SIGMAS * noise[:3] * window_s * np.sqrt(k) / _ARC_S
    worst = int(np.argmax(turned_deg - allowed_deg))
    if turned_deg[worst] > allowed_deg[worst]:
        return f"{NAMES[worst]} turns by {turned_deg[worst]:.2g} deg within"
    return ""
