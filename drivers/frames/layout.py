"""A frame type made ready for work: where its fields lie, frames as columns, frames from columns, what a frame is."""

from collections.abc import Mapping
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.frames.checksums import FrameChecksum
from drivers.frames.description import StreamDescription
from drivers.frames.fields import FIXED_POINT, FieldDescription, LengthDescription
from drivers.frames.items import Item, ItemsDescription
from drivers.frames.text_frames import LINE_END, TextDescription, numbers
from drivers.frames.wire import ByteOrder, FloatArray, Rows, native_type, read_column, sign_extended, write_column

_MOST_FORMS = 1024  # forms of one type that are kept ready; a stream has a handful
_BLOCK = 8192  # rows whose bytes stay in the processor's cache while all their columns are read


class Flaw(IntEnum):
    """Why a candidate is not a good frame."""

    CHECKSUM = 0  # or a length, an item or a number that cannot be
    DELIMITER = 1


class FrameLayout:
    """Frames of one type that are alike: header, length, where each field lies, checksum, template.

    A type of fixed length has one layout. A type of varying length or of items has one for every form, given by
    `length`, `fields` and `offsets`; fields that this form lacks are `absent`. `record` is a structured type over one
    frame with every field of a native width, `assembled` the names of the others.
    """

    def __init__(
        self,
        description: StreamDescription,
        name: str,
        *,
        length: int | None = None,
        fields: Mapping[str, FieldDescription] | None = None,
        offsets: Mapping[str, int] | None = None,
    ) -> None:
        frame = description.frames[name]
        self.name = name
        self.description = frame
        self.in_packets = description.packets is not None
        self.header = description.headers(name)[0]
        self.delimiter = frame.delimiter
        self.length = frame.shortest if length is None else length
        self.checksum = FrameChecksum(frame.checksum, self.length - len(self.delimiter))
        self.fields = frame.fields if fields is None else fields
        self.offsets = description.offsets(name) if offsets is None else offsets
        self.numeric: Mapping[str, FieldDescription] = {k: f for k, f in self.fields.items() if not f.is_text}
        self.absent = [k for k, f in frame.all_fields.items() if not f.is_text and k not in self.numeric]
        self._order: ByteOrder = description.byte_order
        whole = frame.length.whole if isinstance(frame.length, LengthDescription) else None
        self._lacks = max(0, (whole or 0) - self.length)  # zeros that were not sent
        native = {
            name: dtype
            for name, f in self.numeric.items()
            if name in self.offsets and f.width and f.mask is None and (dtype := native_type(f.type, self.order(f)))
        }
        places = [self.offsets[name] for name in native]
        size = self.length + self._lacks
        form = {"names": [*native], "formats": [*native.values()], "offsets": places, "itemsize": size}
        self.record: np.dtype[np.void] = np.dtype(form)  # type: ignore[call-overload]
        self.assembled = [name for name in self.numeric if name not in native]
        self._factors = np.array([self.factor(name) for name in self.numeric])[:, None]
        self._added = np.array([field.offset for field in self.numeric.values()])[:, None]

    def factor(self, field: str) -> float:
        """Return what one wire count of a numeric field is worth, in its unit."""
        found = self.numeric[field]
        return found.scale * FIXED_POINT.get(found.type, 1.0)

    def order(self, field: FieldDescription) -> ByteOrder:
        """Return the byte order of `field`: its own, or the stream's."""
        return field.byte_order or self._order

    def flaw(self, frame: bytes) -> Flaw | None:
        """Return what is wrong with a whole frame of this form, if anything is."""
        if not self.checksum.matches(frame):
            return Flaw.CHECKSUM
        return None if frame.endswith(self.delimiter) else Flaw.DELIMITER

    def _whole(self, rows: Rows) -> Rows:
        """Return frames with the zeros that were not sent."""
        if not self._lacks or rows.shape[1] > self.length:
            return rows
        whole = np.zeros((len(rows), self.length + self._lacks), np.uint8)
        end = self.description.checksum.content_end(self.length - len(self.delimiter))
        whole[:, :end] = rows[:, :end]
        return whole

    def wire_values(self, rows: Rows, field: str) -> NDArray[Any]:
        """Return a numeric field's values as they stand on the wire, shape (n,)."""
        rows = self._whole(rows)
        if field in self.assembled:
            found = self.numeric[field]
            values = read_column(rows, self.offsets[field], found.type, self.order(found))
            if found.mask is None:
                return values
            if found.type[0] == "u":
                values = values & values.dtype.type(found.mask)
            values = values >> values.dtype.type(found.shift)
            return sign_extended(values, found.bits) if found.type[0] == "i" else values
        return np.ndarray(len(rows), self.record, rows if len(rows) else None)[field]

    def told(self, rows: Rows, field: str) -> NDArray[np.bool_]:
        """Return in which of n frames a field is there, shape (n,): it may take turns with others."""
        when = self.numeric[field].when
        if when is None:
            return np.ones(len(rows), np.bool_)
        told = self.wire_values(rows, when.field)
        mask = told.dtype.type(when.mask) if when.mask is not None else ~told.dtype.type(0)
        return np.asarray((told & mask) == when.equals)

    def columns(self, rows: Rows) -> dict[str, FloatArray]:
        """Return all numeric fields of n frames in their units, each of shape (n,); NaN where a field is not there."""
        n = len(rows)
        values = np.empty((len(self.numeric), n))
        for start in range(0, n, _BLOCK):
            block, part = self._whole(rows[start : start + _BLOCK]), values[:, start : start + _BLOCK]
            records = np.ndarray(len(block), self.record, block)
            for row, (name, field) in zip(part, self.numeric.items(), strict=True):
                row[:] = self.wire_values(block, name) if name in self.assembled else records[name]
                if field.when is not None:
                    row[~self.told(block, name)] = np.nan
            part *= self._factors
            if self._added.any():
                part += self._added
        columns = dict(zip(self.numeric, values, strict=True))
        for name in self.absent:
            columns[name] = np.full(n, np.nan)
        return columns

    def texts(self, rows: Rows, field: str) -> list[str]:
        """Return a text field of n frames, (n, length), without its padding; bytes that are not ASCII become `?`."""
        at = self.offsets[field]
        size = self.fields[field].width
        cells = (bytes(row[at : at + size]) for row in rows)
        return [cell.split(b"\0")[0].decode("ascii", "replace").replace("�", "?").strip() for cell in cells]

    def store(self, rows: Rows, field: str, values: ArrayLike | str) -> None:
        """Write a field of n frames, (n,) or one for all: numbers rounded and saturated, text padded with NUL.

        Raises `ValueError` for NaN in integers, and for text that is too long or not ASCII.
        """
        if isinstance(values, str):
            at, size = self.offsets[field], self.description.fields[field].width
            if not values.isascii() or len(values) > size:
                raise ValueError(f"{field}: {values!r} is not ASCII text of at most {size} characters")
            rows[:, at : at + size] = np.frombuffer(values.encode("ascii").ljust(size, b"\0"), np.uint8)
            return
        found = self.numeric[field]
        wire, factor, kind = np.asarray(values), self.factor(field), str(found.type)
        if found.offset != 0.0:
            wire = wire - found.offset
        if factor != 1.0:
            wire = wire / factor
        if kind not in ("f16", "f32", "f64"):
            wire = _to_integers(wire, found, field)
        if found.mask is not None:
            kind = f"u{kind[1:]}"
            whole = read_column(rows, self.offsets[field], kind, self.order(found))
            hidden = whole.dtype.type(found.mask)
            wire = (whole & ~hidden) | ((wire.astype(np.uint64) << np.uint64(found.shift)).astype(whole.dtype) & hidden)
        write_column(rows, self.offsets[field], kind, self.order(found), wire)


def _to_integers(values: NDArray[Any], field: FieldDescription, name: str) -> NDArray[Any]:
    """Round to the nearest integer and hold at the ends of the field's range; the result is ready to be stored."""
    signed = field.type[0] != "u"
    high = (1 << field.bits - signed) - 1
    low, dtype = -signed * (high + 1), np.dtype(np.int64 if signed else np.uint64)
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


class TextLayout(FrameLayout):
    """Lines of text of one type and length."""

    def __init__(self, description: StreamDescription, name: str, text: TextDescription, length: int) -> None:
        super().__init__(description, name, length=length, offsets={})
        self._text, self._tokens = text, text.tokens(self.fields)

    def flaw(self, frame: bytes) -> Flaw | None:
        return None if self._cells(frame) is not None else Flaw.CHECKSUM

    def _cells(self, line: bytes) -> dict[str, bytes] | None:
        return self._text.cells(line, len(self.header), self.delimiter, self._tokens)

    def _lines(self, rows: Rows) -> list[dict[str, bytes]]:
        return [self._cells(bytes(row)) or {} for row in rows]

    def wire_values(self, rows: Rows, field: str) -> NDArray[Any]:
        return np.array(numbers((cells[field] for cells in self._lines(rows)), self.numeric[field]), np.float64)

    def columns(self, rows: Rows) -> dict[str, FloatArray]:
        lines = self._lines(rows)
        return {
            name: np.array(numbers([cells[name] for cells in lines], field), np.float64) * field.scale + field.offset
            for name, field in self.numeric.items()
        }

    def texts(self, rows: Rows, field: str) -> list[str]:
        """Return the words of n lines, (n, length), or the lines without their delimiters."""
        if self.fields[field].type == "word":
            return [cells[field].decode("ascii") for cells in self._lines(rows)]
        return [bytes(row).removesuffix(self.delimiter).rstrip(LINE_END).decode("ascii", "replace") for row in rows]


def encode_rows(layout: FrameLayout, columns: Mapping[str, ArrayLike | str], n: int) -> Rows:
    """Return n frames, shape (n, length), with their checksums.

    `columns` holds numeric fields in their units, shape (n,) or one value for all frames, and text fields as text.
    Fields that are not given are 0. Raise `KeyError` for a field that the frame does not have, `ValueError` for a type
    of varying length, of items, parts or text, or in packets: what such a frame holds is not told by its description.
    """
    fixed = isinstance(layout.description.length, int) and layout.description.items is None
    if not fixed or layout.in_packets:
        raise ValueError(
            f"frames.{layout.name}: frames of varying length, items, parts or text, or in packets, can be read, "
            "not made; simulate a unit whose frames have a fixed length, such as mfs"
        )
    template = layout.header.ljust(layout.length - len(layout.delimiter), b"\0") + layout.delimiter
    rows = np.tile(np.frombuffer(template, np.uint8), (n, 1))
    for field, values in columns.items():
        layout.store(rows, field, values)
    layout.checksum.write(rows)
    return rows


def encode(description: StreamDescription, frame: str, columns: Mapping[str, ArrayLike | str]) -> bytes:
    """Return the bytes of frames with these columns (see `encode_rows`), as many as the longest column has values."""
    sizes = {np.size(values) for values in columns.values() if not isinstance(values, str)} | {1}
    n = 0 if 0 in sizes else max(sizes)
    return encode_rows(FrameLayout(description, frame), columns, n).tobytes()


class FrameFamily:
    """One frame type: its length is fixed or stands in the frame, and each frame may have items of its own.

    What is `optional` may follow each frame.
    """

    def __init__(self, description: StreamDescription, name: str) -> None:
        self.name = name
        self.description = description.frames[name]
        self.headers = description.headers(name)
        self.confirm = self.description.checksum.confirm
        self.shortest = self.description.shortest
        self.delimiter = self.description.delimiter
        self.optional = b"" if self.description.text else description.optional_delimiter
        length = self.description.length
        self._told = length if isinstance(length, LengthDescription) else None
        self._stream, self._text, self._items = description, self.description.text, self.description.items
        self._layout_of = lru_cache(_MOST_FORMS)(self._layout)
        self.shortest_layout = self._layout_of(self.shortest)

    def _layout(self, length: int, walked: tuple[Item, ...] = ()) -> FrameLayout:
        if self._text is not None:
            return TextLayout(self._stream, self.name, self._text, length)
        fields, offsets = dict(self.description.fields), self._stream.offsets(self.name)
        for name, field, offset in self._items.placed(walked) if self._items else ():
            fields[name], offsets[name] = field, offset
        return FrameLayout(self._stream, self.name, length=length, fields=fields, offsets=offsets)

    def length_of(self, data: bytes, start: int) -> int | None:
        """Return the length of the frame at `start`: 0 where it is none, None where it is not told yet."""
        if self._text is not None:
            return self._text.length_of(data, start, len(self.headers[0]), self.delimiter)
        return self.shortest if self._told is None else self._told.of(data, start)

    def form(self, frame: bytes) -> FrameLayout | Flaw:
        """Return the layout of a whole frame, or what is wrong with it."""
        layout = self._layout_of(len(frame))
        if (flaw := layout.flaw(frame)) is not None or self._items is None:
            return layout if flaw is None else flaw
        walked = self._walked(frame, self._items)
        return Flaw.CHECKSUM if walked is None else self._layout_of(len(frame), tuple(walked))

    def alike(self, rows: Rows, layout: FrameLayout) -> NDArray[np.bool_]:
        """Tell which of n stretches as long as a good frame, the first, (n, length), are good frames of its form."""
        if self._text is not None:  # lines are few, and looked at one by one
            return np.asarray(np.arange(len(rows)) == 0)
        alike = layout.checksum.matches_rows(rows)
        if self.delimiter:
            ends = rows[:, rows.shape[1] - len(self.delimiter) :] == np.frombuffer(self.delimiter, np.uint8)
            alike &= ends.all(axis=1)
        tells = [] if self._told is None else self._told.places  # the form
        if self._items is not None:
            walked = self._walked(rows[0].tobytes(), self._items) or ()
            tells = [*tells, *(byte for item in walked for byte in range(item.at, item.data))]
        return np.asarray(alike & (rows[:, tells] == rows[0, tells]).all(axis=1)) if tells else alike

    def _walked(self, frame: bytes, items: ItemsDescription) -> list[Item] | None:
        begin, longer = items.begin, self._told and self._told.extended
        if self._told and longer and items.extended_begin and frame[self._told.at] == longer.mark:
            begin = items.extended_begin
        return items.walk(frame, begin, self.description.checksum.content_end(len(frame) - len(self.delimiter)))
