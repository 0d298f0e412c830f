"""The few frames of a live read: the same meaning as in thousands, without the cost of starting an array operation.

Frames of one type that follow one another, each in step with the one before, are verified in compiled calls and handed
out as their bytes. Plain floats and arrays are made of them when somebody asks. Whatever is not as expected (another
type, a flaw, a gap) is left to the scanner, which finds the same frames where both can.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from drivers.frames.batch import FrameBatch
from drivers.frames.counts import StreamCounts
from drivers.frames.decoded import Decoded
from drivers.frames.layout import FloatArray, FrameLayout
from drivers.frames.record import Floats, Taking, record_reader, record_takers
from drivers.frames.sequence import FrameSequence

FEWER_TUPLES = 24  # frames from which on columns are made of bytes faster than of tuples


class FewFrames:
    """Frames of one layout of fixed length, ready to be verified and converted a few at a time.

    `index` and `name` are the type's, `sequence` its numbers so far, `no_frames` what a feed without frames hands out.
    `takers` are the functions that verify and read so many bytes in one go, where there are such functions. More than a
    few frames are read in one go only for somebody who asks for their tuples, and not for columns.
    """

    def __init__(
        self,
        layout: FrameLayout,
        index: int,
        name: str,
        sequence: FrameSequence,
        no_frames: Mapping[str, FrameBatch],
    ) -> None:
        self.layout = layout
        self.index = index
        self.name = name
        self.sequence = sequence
        self.no_frames = no_frames
        self.length = layout.length
        counter = layout.description.counter
        all_takers: Mapping[int, Taking] = {}
        if not layout.description.checksum.confirm:
            counted = None if counter is None else counter.field
            all_takers = record_takers(layout, counted, sequence.step, sequence.modulus)
        few = FEWER_TUPLES * layout.length
        self.takers = {size: take for size, take in all_takers.items() if size < few}
        self._more = {size: take for size, take in all_takers.items() if size >= few}
        self._header = layout.header
        ending = layout.length - len(layout.delimiter)
        fixed = [*enumerate(layout.header), *enumerate(layout.delimiter, ending)]
        self._fixed = [(place, bytes([byte])) for place, byte in fixed]

    def good(self, data: bytes, n: int) -> bool:
        """Tell whether `data` is n good frames one after another, and nothing else."""
        return all(
            data[place :: self.length] == byte * n for place, byte in self._fixed
        ) and self.layout.checksum.all_match(data, self.length)

    def tuples_wanted(self) -> None:
        """Read more frames in one go from now on, unless somebody wants columns of them."""
        self.takers |= self._more

    def columns_wanted(self) -> None:
        """Read only a few frames in one go from now on."""
        for size in self._more:
            self.takers.pop(size, None)
        self._more = {}

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
            self._few.tuples_wanted()
            self._records = super().records()
        return self._records

    @property
    def columns(self) -> Mapping[str, FloatArray]:
        """All numeric fields in their units, each of shape (n,)."""
        # Not a cached_property: that of Python 3.11 takes a lock, which costs as much as a frame.
        if self._made is None:
            if self._n < FEWER_TUPLES and record_reader(self.layout) is not None:
                self._made = dict(zip(self.layout.numeric, np.array(self.records(), np.float64).T, strict=True))
            else:
                self._few.columns_wanted()
                self._made = self.layout.columns(self.rows)
        return self._made


class FewDecoded(Decoded):
    """What a feed of a few expected frames gave: nothing is made of their bytes until it is asked for.

    Whoever makes one sets what the frames are: `few`, their bytes, the place behind the last and its number, their
    values if they are known. One frame at a time, a constructor that did it would cost a tenth of everything.
    """

    __slots__ = ("data", "end", "few", "known", "number")
    __init__ = object.__init__

    few: FewFrames
    data: bytes
    end: int
    number: int
    known: list[Floats] | None

    @property
    def frames(self) -> Mapping[str, FrameBatch]:
        """The good frames by type."""
        try:
            return self._frames
        except AttributeError:
            few, size = self.few, len(self.data)
            first = self.number + 1 - size // few.length
            batch = FewBatch(few, self.data, self.end - size, first, self.known)
            self._frames = {**few.no_frames, few.name: batch}
            return self._frames

    @property
    def counts(self) -> StreamCounts:
        """What became of the bytes that were decided: all of them are good frames."""
        return _ok(len(self.data) // self.few.length)

    def records(self, frame: str) -> list[Floats]:
        """Return every frame's numeric fields in their units, as a tuple of plain floats."""
        known = self.known
        if known is not None and frame == self.few.name:
            return known
        return self.frames[frame].records()


@lru_cache(maxsize=256)
def _ok(n: int) -> StreamCounts:
    return StreamCounts(ok=n)
