"""A frame type made ready for work: where its fields lie, and frames of that type as columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.frames.checksums import FrameChecksum
from drivers.frames.description import ByteOrder, FieldDescription, StreamDescription
from drivers.frames.wire import Rows, native_type, read_column, write_column

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_BLOCK = 8192  # rows whose bytes stay in the processor's cache while all their columns are read


class FrameLayout:
    """One frame type of a stream, compiled: header, offsets, checksum, template."""

    def __init__(self, description: StreamDescription, name: str) -> None:
        frame = description.frames[name]
        self.name = name
        self.description = frame
        self.header = description.header(name)
        self.length = frame.length
        self.delimiter = frame.delimiter
        self.checksum = FrameChecksum(frame)
        self.offsets = description.offsets(name)
        self.numeric: Mapping[str, FieldDescription] = {k: f for k, f in frame.fields.items() if f.type != "text"}
        self._order: ByteOrder = description.byte_order
        self.record, self.assembled = self._native_record()

    def _native_record(self) -> tuple[np.dtype[np.void], Sequence[str]]:
        """Return a structured type over one frame with every field of a native width, and the names of the others."""
        native = {name: dtype for name, f in self.numeric.items() if (dtype := native_type(f.type, self.order(f)))}
        record = np.dtype(
            {
                "names": list(native),
                "formats": list(native.values()),
                "offsets": [self.offsets[name] for name in native],
                "itemsize": self.length,
            }
        )
        return record, [name for name in self.numeric if name not in native]

    def order(self, field: FieldDescription) -> ByteOrder:
        """Return the byte order of `field`: its own, or the stream's."""
        return field.byte_order or self._order

    def blank(self, n: int) -> Rows:
        """Return n frames with header and delimiter, everything else 0, shape (n, length)."""
        template = self.header + bytes(self.length - len(self.header) - len(self.delimiter)) + self.delimiter
        return np.tile(np.frombuffer(template, np.uint8), (n, 1))

    def wire_values(self, rows: Rows, field: str) -> NDArray[Any]:
        """Return a numeric field's values as they stand on the wire, shape (n,)."""
        if field in self.assembled:
            found = self.numeric[field]
            return read_column(rows, self.offsets[field], found.type, self.order(found))
        return np.ndarray(len(rows), self.record, rows if len(rows) else None)[field]

    def store(self, rows: Rows, field: str, values: ArrayLike) -> None:
        """Write a numeric field of n frames from values in its unit, shape (n,) or one for all.

        Integers are rounded to the nearest and held at the end of their range, as a converter saturates. NaN in an
        integer field raises `ValueError`.
        """
        found = self.numeric[field]
        wire = np.asarray(values)
        if found.offset != 0.0:
            wire = wire - found.offset
        if found.scale != 1.0:
            wire = wire / found.scale
        if found.type[0] != "f":
            wire = _to_integers(wire, found, field)
        write_column(rows, self.offsets[field], found.type, self.order(found), wire)

    def store_text(self, rows: Rows, field: str, text: str) -> None:
        """Write a text field, padded with NUL; raise `ValueError` where it does not fit or is not ASCII."""
        size = self.description.fields[field].width
        if not text.isascii() or len(text) > size:
            raise ValueError(f"{field}: {text!r} is not ASCII text of at most {size} characters")
        at = self.offsets[field]
        rows[:, at : at + size] = np.frombuffer(text.encode("ascii").ljust(size, b"\0"), np.uint8)


def _to_integers(values: NDArray[Any], field: FieldDescription, name: str) -> NDArray[Any]:
    """Round to the nearest integer and hold at the ends of the field's range; the result is ready to be stored."""
    bits = 8 * field.width
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if field.type[0] == "i" else (0, (1 << bits) - 1)
    dtype = np.dtype(np.int64 if field.type[0] == "i" else np.uint64)
    if not values.size:
        return values.astype(dtype)
    rounded = np.rint(values) if values.dtype.kind == "f" else values
    if rounded.dtype.kind == "b" or (rounded.min() >= low and rounded.max() < high):
        return rounded.astype(dtype)
    if np.isnan(rounded).any():
        raise ValueError(f"{name}: an integer field cannot hold NaN")
    # In floating point the end of a 64-bit range is beyond it, so that it is put in as an integer.
    inside = np.where(rounded < high, np.maximum(rounded, low), 0).astype(dtype)
    return np.asarray(np.where(rounded < high, inside, np.array(high, dtype)))


class FrameBatch:
    """n good frames of one type, in the order of their arrival. Columns are converted when they are asked for.

    `rows` are the frames' bytes, shape (n, length); `starts` the position of each frame's first byte in the stream,
    shape (n,); `sequence` the unwrapped counter, in frames, shape (n,): it goes on over wraps and counts lost frames
    (without a counter it counts the frames that arrived).
    """

    def __init__(self, layout: FrameLayout, rows: Rows, starts: IntArray, sequence: IntArray) -> None:
        self.layout = layout
        self.rows = rows
        self.starts = starts
        self.sequence = sequence

    def __len__(self) -> int:
        return len(self.rows)

    def wire(self, field: str) -> NDArray[Any]:
        """Return a numeric field as it stood on the wire (integers where it is an integer), shape (n,)."""
        return self.layout.wire_values(self.rows, field)

    def column(self, field: str) -> FloatArray:
        """Return a numeric field in its unit, shape (n,)."""
        return self.columns[field]

    def text(self, field: str) -> list[str]:
        """Return a text field of every frame, without its padding; bytes that are not ASCII become `?`."""
        at = self.layout.offsets[field]
        size = self.layout.description.fields[field].width
        cells = (bytes(row[at : at + size]) for row in self.rows)
        return [cell.split(b"\0")[0].decode("ascii", "replace").replace("�", "?").strip() for cell in cells]

    def bits(self, name: str) -> NDArray[np.bool_]:
        """Return whether status bit `name` is set, shape (n,); raise `KeyError` where the frame has no such bit."""
        for field, bits in self.layout.description.status.items():
            if name in bits:
                return ((self.wire(field).astype(np.uint64) >> np.uint64(bits[name].bit)) & np.uint64(1)).astype(bool)
        raise KeyError(name)

    @cached_property
    def columns(self) -> Mapping[str, FloatArray]:
        """All numeric fields in their units, each of shape (n,)."""
        n, layout = len(self.rows), self.layout
        values = np.empty((len(layout.numeric), n))
        for start in range(0, n, _BLOCK):
            rows = self.rows[start : start + _BLOCK]
            records = np.ndarray(len(rows), layout.record, rows)
            for part, (name, field) in zip(values[:, start : start + _BLOCK], layout.numeric.items(), strict=True):
                wire = layout.wire_values(rows, name) if name in layout.assembled else records[name]
                np.multiply(wire, field.scale, out=part)
                if field.offset != 0.0:
                    part += field.offset
        return dict(zip(layout.numeric, values, strict=True))


def join_rows(parts: Sequence[Rows], length: int) -> Rows:
    """Return the parts, each of shape (n, length), one after another."""
    if not parts:
        return np.empty((0, length), np.uint8)
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
