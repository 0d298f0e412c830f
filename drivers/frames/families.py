"""Frame types made ready for work: which frame begins here, how long is it, is it good, and what form has it."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from drivers.frames.description import StreamDescription
from drivers.frames.items import Item, ItemsDescription
from drivers.frames.layout import FrameLayout, IntArray, TextLayout
from drivers.frames.lengths import LengthDescription
from drivers.frames.text_frames import TextDescription
from drivers.frames.wire import Rows

_MOST_FORMS = 1024  # forms of one type that are kept ready; a stream has a handful


class Flaw(IntEnum):
    """Why a candidate is not a good frame."""

    CHECKSUM = 0  # or a length, an item or a number that cannot be
    DELIMITER = 1


@dataclass(frozen=True)
class Verdict:
    """About n candidates of one length: which checksums and delimiters match, (n,), and the forms of the good ones."""

    sums_match: NDArray[np.bool_]
    ends_match: NDArray[np.bool_]
    forms: Sequence[tuple[FrameLayout, NDArray[np.bool_]]]


class FrameFamily:
    """One frame type of fixed length. `delimiter` is what follows each frame beyond what the description counts."""

    steady = True  # every frame has the same length

    def __init__(self, description: StreamDescription, name: str, delimiter: bytes = b"") -> None:
        self.name = name
        self.description = description.frames[name]
        self.headers = description.headers(name)
        self.confirm = self.description.checksum.confirm
        self.shortest = self.description.shortest + len(delimiter)
        self.longest = self.description.longest + len(delimiter)
        self.delimiter = delimiter or self.description.delimiter
        self._stream = description
        self._extra = len(delimiter)
        self._alike = lru_cache(_MOST_FORMS)(self._layout)
        self.shortest_layout = self._alike(self.shortest)

    def _layout(self, length: int) -> FrameLayout:
        """Return the layout of frames of this length, with the fields at fixed places."""
        return FrameLayout(self._stream, self.name, length=length, delimiter=self.delimiter)

    def length_of(self, data: bytes, start: int) -> int | None:
        """Return the length of the frame at `start`: 0 where it is none, None where it is not told yet."""
        del data, start
        return self.shortest

    def form(self, frame: bytes) -> FrameLayout | Flaw:
        """Return the layout of a whole frame, or what is wrong with it."""
        if not self.shortest_layout.checksum.matches(frame):
            return Flaw.CHECKSUM
        return self.shortest_layout if frame.endswith(self.delimiter) else Flaw.DELIMITER

    def forms(self, rows: Rows) -> Verdict:
        """Return the verdict about n whole frames of one length, shape (n, length)."""
        sums, ends = self.shortest_layout.checksum.matches_rows(rows), self.ends_match(rows)
        return Verdict(sums, ends, [(self.shortest_layout, sums & ends)])

    def lengths(self, piece: NDArray[np.uint8], places: IntArray) -> IntArray:
        """Return the lengths of the frames at `places`, (n,): 0 where there is none, −1 where it is not told yet."""
        del piece
        return np.full(len(places), self.shortest)

    def _told(self, piece: NDArray[np.uint8], places: IntArray) -> IntArray:
        """Return the same, one by one."""
        data = piece.tobytes()
        told = [self.length_of(data, int(place)) for place in places]
        return np.array([-1 if length is None else length for length in told], np.int64)

    def ends_match(self, rows: Rows) -> NDArray[np.bool_]:
        """Tell which of n frames end with their delimiter, shape (n,)."""
        size = len(self.delimiter)
        if not size:
            return np.ones(len(rows), np.bool_)
        return np.asarray((rows[:, -size:] == np.frombuffer(self.delimiter, np.uint8)).all(axis=1))


class VaryingFamily(FrameFamily):
    """A frame type whose length stands in the frame, perhaps with items."""

    steady = False

    def __init__(
        self, description: StreamDescription, name: str, length: LengthDescription | None, delimiter: bytes = b""
    ) -> None:
        super().__init__(description, name, delimiter)
        self._length = length
        self._filled = lru_cache(_MOST_FORMS)(self._layout_of_items)

    def length_of(self, data: bytes, start: int) -> int | None:
        """Return the length of the frame at `start`: 0 where it is none, None where it is not told yet."""
        if self._length is None:
            return self.shortest
        length = self._length.of(data, start)
        return length + self._extra if length else length

    def lengths(self, piece: NDArray[np.uint8], places: IntArray) -> IntArray:
        """Return the lengths of the frames at `places`, (n,): 0 where there is none, −1 where it is not told yet."""
        found = self._length
        if found is None:
            return np.full(len(places), self.shortest)
        if found.type != "u8" or (found.extended is not None and len(places) < 8):
            return self._told(piece, places)
        lengths = np.full(len(places), -1)
        there = places + found.at < len(piece)
        numbers = piece[places[there] + found.at].astype(np.int64)
        whole = numbers + found.plus
        whole = np.where((whole >= found.shortest) & (whole <= found.longest), whole + self._extra, 0)
        if found.extended is not None:
            data = b""
            for each in np.flatnonzero(numbers == found.extended.mark):
                data = data or piece.tobytes()
                told_length = self.length_of(data, int(places[there][each]))
                whole[each] = -1 if told_length is None else told_length
        lengths[there] = whole
        return lengths

    def form(self, frame: bytes) -> FrameLayout | Flaw:
        """Return the layout of a whole frame, or what is wrong with it."""
        base = self._alike(len(frame))
        if not base.checksum.matches(frame):
            return Flaw.CHECKSUM
        if not frame.endswith(self.delimiter):
            return Flaw.DELIMITER
        items = self.description.items
        return base if items is None else self._with_items(frame, base, items) or Flaw.CHECKSUM

    def forms(self, rows: Rows) -> Verdict:
        """Return the verdict about n whole frames of one length, shape (n, length)."""
        base = self._alike(rows.shape[1])
        sums, ends = base.checksum.matches_rows(rows), self.ends_match(rows)
        items = self.description.items
        if items is None:
            return Verdict(sums, ends, [(base, sums & ends)])
        forms, rest = [], sums & ends
        while rest.any():
            frame = rows[int(np.argmax(rest))].tobytes()
            layout = self._with_items(frame, base, items)
            walked = items.walk(frame, self._begin(frame, items), self._end(base)) or []
            at = np.array([byte for item in walked for byte in range(item.at, item.data)], np.int64)
            if layout is None:  # this frame alone is known to be wrong
                alike = np.zeros(len(rows), np.bool_)
                alike[int(np.argmax(rest))] = True
                sums = sums & ~alike
            else:
                model = np.frombuffer(frame, np.uint8)
                alike = rest & (rows[:, at] == model[at]).all(axis=1)
                if items.extended_begin is not None and isinstance(self._length, LengthDescription):
                    alike &= rows[:, self._length.at] == model[self._length.at]
                forms.append((layout, alike))
            rest = rest & ~alike
        return Verdict(sums, ends, forms)

    def _begin(self, frame: bytes, items: ItemsDescription) -> int:
        length = self._length
        if items.extended_begin is None or length is None or length.extended is None:
            return items.begin
        return items.extended_begin if frame[length.at] == length.extended.mark else items.begin

    def _end(self, base: FrameLayout) -> int:
        return self.description.checksum.content_end(base.length - len(base.delimiter))

    def _with_items(self, frame: bytes, base: FrameLayout, items: ItemsDescription) -> FrameLayout | None:
        """Return the layout of a frame with the items that it has; None where they do not fill it exactly."""
        walked = items.walk(frame, self._begin(frame, items), self._end(base))
        return None if walked is None else self._filled(len(frame), tuple(walked))

    def _layout_of_items(self, length: int, walked: tuple[Item, ...]) -> FrameLayout:
        base, items = self._alike(length), self.description.items
        fields, offsets = dict(base.fields), dict(base.offsets)
        for name, field, offset in items.placed(walked) if items is not None else ():
            fields[name], offsets[name] = field, offset
        return FrameLayout(
            self._stream, self.name, length=length, fields=fields, offsets=offsets, delimiter=self.delimiter
        )


class TextFamily(FrameFamily):
    """Lines of text. They are few, and looked at one by one."""

    steady = False

    def __init__(self, description: StreamDescription, name: str, text: TextDescription) -> None:
        self._text, self._tokens = text, text.tokens(description.frames[name].fields)
        super().__init__(description, name)

    def _layout(self, length: int) -> FrameLayout:
        return TextLayout(self._stream, self.name, self._tokens, length=length, offsets={}, delimiter=self.delimiter)

    def length_of(self, data: bytes, start: int) -> int | None:
        """Return the length of the line at `start`: 0 where it is none, None where its end is not there."""
        return self._text.length_of(data, start, len(self.headers[0]), self.delimiter)

    def lengths(self, piece: NDArray[np.uint8], places: IntArray) -> IntArray:
        """Return the lengths of the lines at `places`, (n,): 0 where there is none, −1 where it is not told yet."""
        return self._told(piece, places)

    def form(self, frame: bytes) -> FrameLayout | Flaw:
        """Return the layout of a whole line, or what is wrong with it."""
        text, header = self._text, len(self.headers[0])
        good = text.is_good(frame, self.delimiter)
        good = good and text.cells(frame, header, self.delimiter, self._tokens) is not None
        return self._alike(len(frame)) if good else Flaw.CHECKSUM

    def forms(self, rows: Rows) -> Verdict:
        """Return the verdict about n whole lines of one length, shape (n, length)."""
        good = np.array([isinstance(self.form(row.tobytes()), FrameLayout) for row in rows], np.bool_)
        return Verdict(good, np.ones(len(rows), np.bool_), [(self._alike(rows.shape[1]), good)])


def families_of(description: StreamDescription, delimiter: bytes = b"") -> list[FrameFamily]:
    """Return the frame types of a stream; `delimiter` is the optional one where the unit sends it."""
    families: list[FrameFamily] = []
    for name, frame in description.frames.items():
        if frame.parts:
            continue
        if frame.text is not None:
            families.append(TextFamily(description, name, frame.text))
        elif isinstance(frame.length, LengthDescription) or frame.items is not None:
            length = frame.length if isinstance(frame.length, LengthDescription) else None
            families.append(VaryingFamily(description, name, length, delimiter))
        else:
            families.append(FrameFamily(description, name, delimiter))
    return families
