"""When a sample was taken, on the bench's clock: from its counter, and from when it arrived.

The counter gives even spacing; the arrival tells where on the clock it belongs. A frame can arrive late, never early,
so that the earliest arrivals are the right ones: the offset between counter and clock is the least that was seen, let
go slowly (`_DRIFT`) because the unit's oscillator is not the bench's. A unit that is set to another rate is followed
at the rate that it has, so that its samples are where they were taken, however wrong the description is.
"""

import numpy as np

from drivers.frames.wire import FloatArray, IntArray

_DRIFT = 200e-6  # s/s; crystal oscillators are within 100 ppm each
_RESTART_S = 2.0  # a counter so far ahead of the clock was not counting: it began anew
_MEASURED_S = 20.0  # over which the rate is measured …
_AGREED = 0.02  # … twice, to the same result …
_ANOTHER_RATE = 0.04  # … before it is believed: no oscillator is so far off
_SILENCE_S = 1.0  # without a counter, frames so late mean that others were lost before them


class SampleClock:
    """Places frames of one stream in time; `turn_frames` is when the counter comes round, None where there is none."""

    def __init__(self, rate_hz: float, turn_frames: int | None) -> None:
        self._period_s = 1.0 / rate_hz
        self._measured = (-np.inf, 0, np.inf)  # since when, from which frame on, and the period that came out before
        self._turn_frames = turn_frames
        self._offset_s: float | None = None
        self.anew = True  # whether the newest frames were placed without regard to those before them
        self._shift = 0  # frames that the counter did not show
        self._last_sequence = 0
        self._last_time_s = -np.inf
        self._last_arrival_s = 0.0

    def stamp(self, sequence: IntArray, arrival_s: float) -> tuple[FloatArray, int]:
        """Return the times of n ≥ 1 frames that had arrived by `arrival_s`, shape (n,), s, never decreasing.

        `sequence` is their unwrapped counter in frames. The second value corrects the number of lost frames: whole
        turns of the counter that passed unseen in an outage (positive), or frames that only a counter that began anew
        seems to have skipped (negative).
        """
        self._follow(int(sequence[-1]), arrival_s)
        self.anew = self._offset_s is None
        numbers = sequence + self._shift
        correction = 0
        if self._offset_s is None:
            self._offset_s = arrival_s - float(numbers[-1]) * self._period_s
        else:
            correction = self._correction(arrival_s - float(numbers[-1]) * self._period_s - self._offset_s)
            if correction:
                # Frames went missing at the widest step; those before it are where they were.
                steps = np.diff(numbers, prepend=self._last_sequence)
                numbers[int(np.argmax(steps)) :] += correction
                self._shift += correction
            latest_s = arrival_s - float(numbers[-1]) * self._period_s
            drifted_s = self._offset_s + _DRIFT * (arrival_s - self._last_arrival_s)
            follows_s = self._last_time_s + 0.5 * self._period_s - float(numbers[0]) * self._period_s
            self._offset_s = max(min(latest_s, drifted_s), follows_s)
        times_s = self._offset_s + numbers.astype(np.float64) * self._period_s
        self._last_sequence = int(numbers[-1])
        self._last_time_s = float(times_s[-1])
        self._last_arrival_s = arrival_s
        return times_s, correction if self._turn_frames is not None else 0

    def _follow(self, newest: int, arrival_s: float) -> None:
        """Count by the rate that the unit has, where that is another one than the description's for long enough."""
        began_s, first, before_s = self._measured
        passed_s, frames = arrival_s - began_s, newest - first
        if 0.0 <= passed_s < _MEASURED_S and frames >= 0:
            return
        period_s = passed_s / frames if frames > 0 else np.inf
        self._measured = (arrival_s, newest, period_s)
        if frames <= 0 or abs(period_s - before_s) > _AGREED * period_s:
            return
        if abs(period_s - self._period_s) > _ANOTHER_RATE * period_s:
            self._period_s, self._offset_s = period_s, None

    def _correction(self, late_s: float) -> int:
        """Return by how many frames the sequence is behind the clock, given how late the newest frame seems."""
        if late_s < -_RESTART_S:
            return int(np.floor(late_s / self._period_s))
        if self._turn_frames is None:
            return int(late_s / self._period_s) if late_s > _SILENCE_S else 0
        turns = round(late_s / (self._turn_frames * self._period_s))
        return max(0, turns) * self._turn_frames
