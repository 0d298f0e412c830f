"""Gap accounting: from the counters of good frames to lost frames, repeated frames and an unwrapped sequence."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frames.description import FrameDescription
from drivers.frames.wire import IntArray

Mask = NDArray[np.bool_]


class FrameSequence:
    """Follows the counter of one frame type over any number of feeds.

    A frame whose counter did not move repeats the one before it: it is counted and left out. A counter that moved by
    more than one step means lost frames; outages of a whole turn of the counter and more cannot be seen in it, and are
    resolved by arrival time elsewhere. Without a counter, the unit's own time tells, and without that, frames are
    numbered as they arrive.
    """

    def __init__(self, frame: FrameDescription, rate_hz: float) -> None:
        self._counter = frame.counter
        self._time = frame.time if frame.counter is None else None
        self._rate_hz = rate_hz
        self.last: float | None = None  # counter (or time) of the last frame
        self.number = -1  # its unwrapped number, in frames
        self._continuous = True

    def interrupt(self) -> None:
        """Frames are left out on purpose from here to the next one: they are not lost, and it repeats nothing."""
        self._continuous = False

    def take(
        self, n: int, present: Callable[[str], Mask | None], wire: Callable[[str], NDArray[Any]]
    ) -> tuple[Mask, IntArray, int]:
        """Make n frames a part of the sequence; `present` says which have a field (None: all), `wire` its values.

        Return which rows are no repetitions, shape (n,), their numbers, shape (kept,), and how many frames were lost
        between them. Frames that lack the counter (it may be an item) do not move it: they get the number of the one
        before.
        """
        told_by = self._counter or self._time
        if told_by is None or not n:
            first, self.number = self.number + 1, self.number + n
            return np.ones(n, np.bool_), first + np.arange(n, dtype=np.int64), 0
        there = present(told_by.field)
        if there is not None and not there.any():
            return np.ones(n, np.bool_), np.full(n, self.number), 0
        first, values = self.number, wire(told_by.field)
        if there is not None:
            values = values[there]
        # Decimals of a line of text stay what they are.
        numbers, lost, moved = self._follow(
            self._steps(values if values.dtype.kind == "f" else values.astype(np.int64))
        )
        if there is None:
            return moved, numbers[moved], lost
        keep, before = np.ones(n, np.bool_), np.cumsum(there) - 1
        keep[there] = moved
        return keep, np.where(before >= 0, numbers[before], first)[keep], lost

    def _steps(self, values: NDArray[Any]) -> IntArray:
        """Return by how many frames each frame is ahead of the one before."""
        if self._counter is not None:
            moved, step = self._moved(values, self._counter.step, self._counter.modulus), self._counter.step
            # A counter between two steps belongs to the nearer; one that moved at all is no repetition.
            steps = np.ones(len(moved), np.int64)
            if not (moved == step).all():
                steps = np.where(moved == 0, 0, np.maximum(1, (moved + step // 2) // step)).astype(np.int64)
        else:
            time = self._time
            modulus = None if time is None else time.modulus
            moved = self._moved(values, 0, modulus)
            frames = np.rint(moved * (self._rate_hz * (1.0 if time is None else time.resolution)))
            steps = np.maximum(1, frames).astype(np.int64)  # no time is twice the same by mistake, nor goes back
        self.last = values[-1].item()
        return steps

    def _follow(self, steps: IntArray) -> tuple[IntArray, int, NDArray[np.bool_]]:
        """Return the sequence after `steps`, how many frames were lost, and which are no repetitions."""
        if not self._continuous:
            steps[0] = max(1, int(steps[0]))
        moved, sequence = steps != 0, self.number + np.cumsum(steps)
        left_out = 0 if self._continuous else int(steps[0]) - 1
        lost = int(sequence[-1]) - self.number - int(np.count_nonzero(moved)) - left_out
        self.number, self._continuous = int(sequence[-1]), True
        return sequence, lost, moved

    def _moved(self, values: NDArray[Any], step: int, modulus: int | None) -> NDArray[Any]:
        """Return by how much each value is ahead of the one before; the very first is one step ahead of nothing."""
        before = values[0] - step if self.last is None else self.last
        moved = values.copy()
        moved[1:] -= values[:-1]
        moved[0] -= before
        if modulus is not None:
            moved %= modulus
        return moved
