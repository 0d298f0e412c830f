"""Frame types made ready for work: which frame begins here, how long is it, is it good, and what form has it."""

from enum import IntEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from drivers.frames.description import StreamDescription
from drivers.frames.items import Item, ItemsDescription
from drivers.frames.layout import FrameLayout, TextLayout
from drivers.frames.lengths import LengthDescription
from drivers.frames.text_frames import TextDescription
from drivers.frames.wire import Rows

_MOST_FORMS = 1024  # forms of one type that are kept ready; a stream has a handful


class Flaw(IntEnum):
    """Why a candidate is not a good frame."""

    CHECKSUM = 0  # or a length, an item or a number that cannot be
    DELIMITER = 1


class FrameFamily:
    """One frame type of fixed length. `delimiter` is what follows each frame beyond what the description counts."""

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
        self._layout_of = lru_cache(_MOST_FORMS)(self._layout)
        self.shortest_layout = self._layout_of(self.shortest)

    def _layout(self, length: int) -> FrameLayout:
        """Return the layout of frames of this length, with the fields at fixed places."""
        return FrameLayout(self._stream, self.name, length=length, delimiter=self.delimiter)

    def length_of(self, data: bytes, start: int) -> int | None:
        """Return the length of the frame at `start`: 0 where it is none, None where it is not told yet."""
        del data, start
        return self.shortest

    def form(self, frame: bytes) -> FrameLayout | Flaw:
        """Return the layout of a whole frame, or what is wrong with it."""
        layout = self._layout_of(len(frame))
        if not layout.checksum.matches(frame):
            return Flaw.CHECKSUM
        return layout if frame.endswith(self.delimiter) else Flaw.DELIMITER

    def alike(self, rows: Rows, layout: FrameLayout) -> NDArray[np.bool_]:
        """Tell which of n stretches as long as a good frame, the first, (n, length), are good frames of its form."""
        ends = rows[:, rows.shape[1] - len(self.delimiter) :] == np.frombuffer(self.delimiter, np.uint8)
        return np.asarray(layout.checksum.matches_rows(rows) & ends.all(axis=1))


class VaryingFamily(FrameFamily):
    """A frame type whose length stands in the frame, perhaps with items."""

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

    def form(self, frame: bytes) -> FrameLayout | Flaw:
        """Return the layout of a whole frame, or what is wrong with it."""
        base, items = super().form(frame), self.description.items
        if isinstance(base, Flaw) or items is None:
            return base
        return self._with_items(frame, base, items) or Flaw.CHECKSUM

    def alike(self, rows: Rows, layout: FrameLayout) -> NDArray[np.bool_]:
        """Tell which of n stretches as long as a good frame, the first, (n, length), are good frames of its form."""
        frame, items = rows[0].tobytes(), self.description.items
        walked = items.walk(frame, self._begin(frame, items), self._end(layout)) if items is not None else None
        same = [byte for item in walked or () for byte in range(item.at, item.data)]  # what tells the form
        same += self._length.places if self._length is not None else []
        return np.asarray(super().alike(rows, layout) & (rows[:, same] == rows[0, same]).all(axis=1))

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
        base, items = self._layout_of(length), self.description.items
        fields, offsets = dict(base.fields), dict(base.offsets)
        for name, field, offset in items.placed(walked) if items is not None else ():
            fields[name], offsets[name] = field, offset
        return FrameLayout(
            self._stream, self.name, length=length, fields=fields, offsets=offsets, delimiter=self.delimiter
        )


class TextFamily(FrameFamily):
    """Lines of text. They are few, and looked at one by one."""

    def __init__(self, description: StreamDescription, name: str, text: TextDescription) -> None:
        self._text, self._tokens = text, text.tokens(description.frames[name].fields)
        super().__init__(description, name)

    def _layout(self, length: int) -> FrameLayout:
        return TextLayout(self._stream, self.name, self._tokens, length=length, offsets={}, delimiter=self.delimiter)

    def length_of(self, data: bytes, start: int) -> int | None:
        """Return the length of the line at `start`: 0 where it is none, None where its end is not there."""
        return self._text.length_of(data, start, len(self.headers[0]), self.delimiter)

    def form(self, frame: bytes) -> FrameLayout | Flaw:
        """Return the layout of a whole line, or what is wrong with it."""
        text, header = self._text, len(self.headers[0])
        good = text.is_good(frame, self.delimiter)
        good = good and text.cells(frame, header, self.delimiter, self._tokens) is not None
        return self._layout_of(len(frame)) if good else Flaw.CHECKSUM

    def alike(self, rows: Rows, layout: FrameLayout) -> NDArray[np.bool_]:
        """Tell that the first of n stretches, (n, length), is a line: of the others nothing is looked at."""
        del layout
        return np.asarray(np.arange(len(rows)) == 0)


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
