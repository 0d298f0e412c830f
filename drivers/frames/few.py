"""The few frames of a live read: the same meaning as in thousands, without the cost of starting an array operation.

Frames of one type that follow one another, each in step with the one before, are verified in compiled calls and handed
out as their bytes. Plain floats and arrays are made of them when somebody asks. Whatever is not as expected (another
type, a flaw, a gap) is left to the scanner, which finds the same frames where both can.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from drivers.frames.batch import FrameBatch
from drivers.frames.decoded import Decoded
from drivers.frames.layout import FloatArray, FrameLayout
from drivers.frames.record import Floats, RecordReader
from drivers.imu import StreamCounts

FEWER_TUPLES = 24  # frames from which on a column at a time is faster than a frame at a time


class FewFrames:
    """Frames of one layout of fixed length, ready to be verified and converted a few at a time.

    `name` is that of the type, `no_frames` what a feed without frames hands out. `reader` is None where the values
    cannot be read by one record.
    """

    def __init__(
        self, layout: FrameLayout, name: str, reader: RecordReader | None, no_frames: Mapping[str, FrameBatch]
    ) -> None:
        self.layout = layout
        self.name = name
        self.no_frames = no_frames
        self.length = layout.length
        self.reader = reader
        self._header = layout.header
        between = layout.length - len(layout.header) - len(layout.delimiter)
        self._ends = struct.Struct(f"{len(layout.header)}s{between}x{len(layout.delimiter)}s")
        self._each = (layout.header, layout.delimiter)

    def good(self, data: bytes, n: int) -> bool:
        """Tell whether `data` is n good frames one after another, and nothing else."""
        if n == 0:
            return True
        ends = list(self._ends.iter_unpack(data))
        return ends.count(self._each) == n and self.layout.checksum.all_match(data, self.length)

    def may_begin(self, rest: bytes) -> bool:
        """Tell whether `rest`, shorter than a frame, may be the beginning of one."""
        return rest.startswith(self._header) or self._header.startswith(rest)


class FewBatch(FrameBatch):
    """n good frames, kept as their bytes until arrays of them are asked for; `records` are their values, if known."""

    def __init__(self, few: FewFrames, data: bytes, start: int, sequence: int, records: list[Floats] | None) -> None:
        self.layout = few.layout
        self._few = few
        self._data = data
        self._n = len(data) // few.length
        self._start = start
        self._first = sequence
        self._records = records
        self._made: Mapping[str, FloatArray] | None = None

    def __getattr__(self, name: str) -> Any:
        # Called only for what is not there yet: the arrays.
        if name == "rows":
            self.rows = np.frombuffer(self._data, np.uint8).reshape(self._n, -1)
        elif name == "starts":
            self.starts = self._start + np.arange(self._n, dtype=np.int64) * self._few.length
        elif name == "sequence":
            self.sequence = self._first + np.arange(self._n, dtype=np.int64)
        else:
            raise AttributeError(name)
        return self.__dict__[name]

    def __len__(self) -> int:
        return self._n

    def records(self) -> list[Floats]:
        """Return every frame's numeric fields in their units, as a tuple of plain floats."""
        if self._records is None:
            reader = self._few.reader
            self._records = super().records() if reader is None else reader.records(self._data)
        return self._records

    @property
    def columns(self) -> Mapping[str, FloatArray]:
        """All numeric fields in their units, each of shape (n,)."""
        # Not a cached_property: that of Python 3.11 takes a lock, which costs as much as a frame.
        if self._made is None:
            if self._n < FEWER_TUPLES and self._few.reader is not None:
                self._made = dict(zip(self.layout.numeric, np.array(self.records(), np.float64).T, strict=True))
            else:
                self._made = self.layout.columns(self.rows)
        return self._made


class FewDecoded(Decoded):
    """What a feed of a few expected frames gave: nothing is made of their bytes until it is asked for.

    Whoever makes one sets what the frames are: `few`, their bytes, the place and number of the first, their values if
    they are known. One frame at a time, a constructor that did it would cost a tenth of everything.
    """

    __slots__ = ("data", "few", "known", "number", "start")
    __init__ = object.__init__

    few: FewFrames
    data: bytes
    start: int
    number: int
    known: list[Floats] | None

    def __getattr__(self, name: str) -> Any:
        few = self.few
        if name == "frames":
            batch = FewBatch(few, self.data, self.start, self.number, self.known)
            self.frames = {**few.no_frames, few.name: batch}
            return self.frames
        if name == "counts":
            self.counts = _ok(len(self.data) // few.length)
            return self.counts
        raise AttributeError(name)

    def records(self, frame: str) -> list[Floats]:
        """Return every frame's numeric fields in their units, as a tuple of plain floats."""
        known = self.known
        if known is not None and frame == self.few.name:
            return known
        return self.frames[frame].records()


@lru_cache(maxsize=256)
def _ok(n: int) -> StreamCounts:
    return StreamCounts(ok=n)
