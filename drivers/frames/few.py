"""The few frames of a live read: the same meaning as in thousands, without the cost of starting an array operation.

Frames of one type that follow one another, each in step with the one before, are verified one by one in compiled calls
and handed out as their bytes. Arrays are made of them when somebody asks. Whatever is not as expected (another type, a
flaw, a gap) is left to the scanner, which finds the same frames where both can.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from drivers.frames.batch import FrameBatch
from drivers.frames.fields import FIXED_POINT
from drivers.frames.layout import FloatArray, FrameLayout, TextLayout

_CODES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "u64": "Q", "i64": "q"}
_CODES |= {"f32": "f", "f64": "d", "fp12.20": "i"}
_FEWER_TUPLES = 24  # frames from which on a column at a time is faster than a frame at a time


class FewFrames:
    """Frames of one layout of fixed length, ready to be verified and converted a few at a time."""

    def __init__(self, layout: FrameLayout) -> None:
        self.layout = layout
        self.length = layout.length
        self.header = layout.header
        self.delimiter = layout.delimiter
        self.maker = None if isinstance(layout, TextLayout) else _column_maker(layout)

    def good(self, data: bytes) -> bool:
        """Tell whether `data` is good frames one after another, and nothing else."""
        length, header, delimiter = self.length, self.header, self.delimiter
        for at in range(0, len(data), length):
            if not data.startswith(header, at):
                return False
        if delimiter:
            for at in range(length, len(data) + 1, length):
                if not data.endswith(delimiter, 0, at):
                    return False
        return self.layout.checksum.all_match(data, length)

    def may_begin(self, rest: bytes) -> bool:
        """Tell whether `rest`, shorter than a frame, may be the beginning of one."""
        return rest.startswith(self.header) or self.header.startswith(rest)


class FewBatch(FrameBatch):
    """n good frames, kept as their bytes until arrays of them are asked for."""

    def __init__(self, few: FewFrames, data: bytes, n: int, start: int, sequence: int) -> None:
        self.layout = few.layout
        self._few = few
        self._data = data
        self._n = n
        self._start = start
        self._first = sequence
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

    @property
    def columns(self) -> Mapping[str, FloatArray]:
        """All numeric fields in their units, each of shape (n,)."""
        # Not a cached_property: that of Python 3.11 takes a lock, which costs as much as a frame.
        if self._made is None:
            maker = self._few.maker if self._n < _FEWER_TUPLES else None
            self._made = self.layout.columns(self.rows) if maker is None else maker(self._data)
        return self._made


def _column_maker(layout: FrameLayout) -> Callable[[bytes], Mapping[str, FloatArray]] | None:
    """Return a function from the bytes of frames to their columns, None where struct cannot read them all."""
    order = {layout.order(field) for field in layout.numeric.values()}
    if len(order) > 1 or layout.absent or not layout.numeric:
        return None
    little = order == {"little"}
    text, at = "<" if little else ">", 0
    pairs: list[int] = []  # columns of the first halves of 24-bit integers
    names = sorted(layout.numeric, key=lambda name: layout.offsets[name])
    for number, name in enumerate(names):
        field, offset = layout.numeric[name], layout.offsets[name]
        if offset < at or field.mask is not None or field.when is not None:
            return None
        if field.type in ("u24", "i24"):
            high = "B" if field.type == "u24" else "b"
            code = f"H{high}" if little else f"{high}H"
            pairs.append(number + len(pairs))
        elif field.type in _CODES:
            code = _CODES[field.type]
        else:
            return None
        text += "x" * (offset - at) + code
        at = offset + field.width
    text += "x" * (layout.length - at)
    reads = [struct.Struct(text[0] + text[1:] * n).unpack for n in range(_FEWER_TUPLES)]
    length, width = layout.length, len(names) + len(pairs)
    fields = [layout.numeric[name] for name in names]
    scales = np.array([field.scale * FIXED_POINT.get(field.type, 1.0) for field in fields])
    offsets = np.array([field.offset for field in fields])
    shifted = bool(offsets.any())
    low, high_at = (0, 1) if little else (1, 0)
    firsts = np.array(pairs, np.int64)
    kept = np.delete(np.arange(len(fields) + len(pairs)), firsts + 1)

    def columns(data: bytes) -> Mapping[str, FloatArray]:
        values: FloatArray = np.array(reads[len(data) // length](data), np.float64).reshape(-1, width)
        if len(firsts):
            values[:, firsts] = values[:, firsts + high_at] * 65536.0 + values[:, firsts + low]
            values = values[:, kept]
        values *= scales
        if shifted:
            values += offsets
        return dict(zip(names, values.T, strict=True))

    return columns
