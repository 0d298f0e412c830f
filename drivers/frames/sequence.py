"""Gap accounting: from the counters of good frames to lost frames, repeated frames and an unwrapped sequence."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from drivers.frames.batch import FrameBatch
from drivers.frames.description import FrameDescription
from drivers.frames.layout import FrameLayout, IntArray

_CODES = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q"}


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
        self.last: int | None = None  # counter (or time) of the last frame
        self.number = -1  # its unwrapped number, in frames
        self._continuous = True
        self._record: tuple[str, str] | None = None  # byte order and struct codes of a frame whose counter is read
        self.step, self.modulus = (0, 1) if frame.counter is None else (frame.counter.step, frame.counter.modulus)

    def interrupt(self) -> None:
        """Frames are left out on purpose from here to the next one: they are not lost, and it repeats nothing."""
        self._continuous = False

    def take(self, batch: FrameBatch) -> tuple[FrameBatch, int, int]:
        """Return the frames that are not repetitions, how many were lost between them, and how many were repeated.

        `batch` becomes a part of the sequence. Frames that lack the counter (it may be an item) do not move it.
        """
        told_by = self._counter or self._time
        n = len(batch)
        if told_by is None or not n:
            batch.sequence = self.number + 1 + np.arange(n, dtype=np.int64)
            self.number += n
            return batch, 0, 0
        told = batch.told(told_by.field)
        if not told.all():
            return self._take_told(batch, told, told_by.field)
        steps = self._steps(batch.wire(told_by.field).astype(np.int64))
        sequence, lost, repeated = self._follow(steps)
        if not repeated.any():
            batch.sequence = sequence
            return batch, lost, 0
        return batch.select(~repeated, sequence[~repeated]), lost, int(repeated.sum())

    def steady(self, layout: FrameLayout) -> bool:
        """Tell whether `advance` can follow frames of this layout: by a plain counter, or by none at all.

        Then the next frame is one step ahead where `(counter - last) % modulus == step`, with 0 for a counter that
        there is not. Whoever finds it so may set `last` to it and add 1 to `number` himself.
        """
        self._record = None
        if self._counter is None:
            self.last = 0 if self._time is None else self.last
            return self._time is None
        field = layout.numeric.get(self._counter.field)
        if field is None or field.type not in _CODES or field.mask is not None:
            return False
        at, order = layout.offsets[self._counter.field], "<" if layout.order(field) == "little" else ">"
        self._record = (order, f"{at}x{_CODES[field.type]}{layout.length - at - field.width}x")
        return True

    def advance(self, data: bytes, n: int) -> bool:
        """Follow the n frames in `data` that are each one step ahead of the one before.

        Return False, and change nothing, where they are not so: then `take` must decide.
        """
        last, step, modulus = self.last, self.step, self.modulus
        if self._record is not None:
            if last is None:
                return False
            values = _reader(*self._record, n)(data)
            expected = range(last + step, last + step * n + 1, step)
            if values != tuple(expected if expected[-1] < modulus else (value % modulus for value in expected)):
                return False
            self.last = values[-1]
        self.number += n
        self._continuous = True
        return True

    def _take_told(self, batch: FrameBatch, told: NDArray[np.bool_], field: str) -> tuple[FrameBatch, int, int]:
        """Follow the frames that tell their counter; the others get the number of the one before."""
        sequence, lost, repeated = np.full(len(batch), self.number), 0, np.zeros(len(batch), np.bool_)
        if told.any():
            first = self.number
            sequence[told], lost, repeated[told] = self._follow(self._steps(batch.wire(field).astype(np.int64)[told]))
            before = np.maximum.accumulate(np.where(told, np.arange(len(told)), -1))
            sequence = np.where(before >= 0, sequence[before], first)
        return batch.select(~repeated, sequence[~repeated]), lost, int(repeated.sum())

    def _steps(self, values: IntArray) -> IntArray:
        """Return by how many frames each frame is ahead of the one before."""
        if self._counter is not None:
            moved, step = self._moved(values, self._counter.step, self._counter.modulus), self._counter.step
            # A counter between two steps belongs to the nearer; one that moved at all is no repetition.
            steps = np.where(moved == 0, 0, np.maximum(1, (moved + step // 2) // step))
        else:
            time = self._time
            modulus = None if time is None else time.modulus
            moved = self._moved(values, 0, modulus)
            frames = np.rint(moved * (self._rate_hz * (1.0 if time is None else time.resolution)))
            steps = np.maximum(1, frames).astype(np.int64)  # no time is twice the same by mistake, nor goes back
        self.last = int(values[-1])
        return steps

    def _follow(self, steps: IntArray) -> tuple[IntArray, int, NDArray[np.bool_]]:
        """Return the sequence after `steps`, how many frames were lost, and which are repetitions."""
        repeated = steps == 0
        if not self._continuous:
            steps[0] = max(1, int(steps[0]))
            repeated[0] = False
        gaps = np.maximum(steps - 1, 0)
        lost = int(gaps.sum()) - (0 if self._continuous else int(gaps[0]))
        sequence = self.number + np.cumsum(steps)
        self.number, self._continuous = int(sequence[-1]), True
        return sequence, lost, repeated

    def _moved(self, values: IntArray, step: int, modulus: int | None) -> IntArray:
        """Return by how much each value is ahead of the one before; the very first is one step ahead of nothing."""
        before = values[0] - step if self.last is None else self.last
        moved = values.copy()
        moved[1:] -= values[:-1]
        moved[0] -= before
        if modulus is not None:
            moved %= modulus
        return moved


@lru_cache(maxsize=128)
def _reader(order: str, record: str, n: int) -> Callable[[bytes], tuple[int, ...]]:
    """Return a compiled function that reads the counters of n frames."""
    return struct.Struct(order + record * n).unpack
