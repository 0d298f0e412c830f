"""Gap accounting: from the counters of good frames to lost frames, repeated frames and an unwrapped sequence."""

from __future__ import annotations

import numpy as np

from drivers.frames.description import CounterDescription
from drivers.frames.layout import FrameBatch, FrameLayout, IntArray
from drivers.frames.wire import Rows


class FrameSequence:
    """Follows the counter of one frame type over any number of feeds.

    A frame whose counter did not move repeats the one before it: it is counted and left out. A counter that moved by
    more than one step means lost frames; outages of a whole turn of the counter and more cannot be seen in it, and are
    resolved by arrival time elsewhere. Without a counter, frames are numbered as they arrive.
    """

    def __init__(self, layout: FrameLayout) -> None:
        self._layout = layout
        self._counter = layout.description.counter
        self._last: int | None = None  # counter of the last frame
        self._sequence = -1  # its unwrapped number, in frames
        self._continuous = True

    def interrupt(self) -> None:
        """Frames are left out on purpose from here to the next one: they are not lost, and it repeats nothing."""
        self._continuous = False

    def take(self, rows: Rows, starts: IntArray) -> tuple[FrameBatch, int, int]:
        """Return the frames that are not repetitions, how many were lost between them, and how many were repeated."""
        if self._counter is None or not len(rows):
            sequence = self._sequence + 1 + np.arange(len(rows), dtype=np.int64)
            self._sequence += len(rows)
            return FrameBatch(self._layout, rows, starts, sequence), 0, 0
        counters = self._layout.wire_values(rows, self._counter.field).astype(np.int64)
        moved = self._moved(counters, self._counter)
        if (moved == self._counter.step).all():  # the usual case
            sequence = np.arange(self._sequence + 1, self._sequence + 1 + len(rows))
            self._last, self._sequence, self._continuous = int(counters[-1]), int(sequence[-1]), True
            return FrameBatch(self._layout, rows, starts, sequence), 0, 0
        # A counter between two steps belongs to the nearer; one that moved at all is no repetition.
        step = self._counter.step
        steps = np.where(moved == 0, 0, np.maximum(1, (moved + step // 2) // step))
        repeated = steps == 0
        if not self._continuous:
            steps[0] = max(1, int(steps[0]))
            repeated[0] = False
        gaps = np.maximum(steps - 1, 0)
        lost = int(gaps.sum()) - (0 if self._continuous else int(gaps[0]))
        sequence = self._sequence + np.cumsum(steps)
        self._last, self._sequence, self._continuous = int(counters[-1]), int(sequence[-1]), True
        if not repeated.any():
            return FrameBatch(self._layout, rows, starts, sequence), lost, 0
        keep = ~repeated
        batch = FrameBatch(self._layout, np.ascontiguousarray(rows[keep]), starts[keep], sequence[keep])
        return batch, lost, int(repeated.sum())

    def _moved(self, counters: IntArray, counter: CounterDescription) -> IntArray:
        """Return by how much each counter is ahead of the one before; the very first is one step ahead of nothing."""
        before = counters[0] - counter.step if self._last is None else self._last
        moved = counters.copy()
        moved[1:] -= counters[:-1]
        moved[0] -= before
        moved %= counter.modulus
        return moved
