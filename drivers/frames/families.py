"""Frame types made ready for work: which frame begins here, how long is it, is it good, and what form has it."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from drivers.frames.description import StreamDescription
from drivers.frames.fields import LengthDescription
from drivers.frames.items import Item, ItemsDescription
from drivers.frames.layout import Flaw, FrameLayout, TextLayout
from drivers.frames.text_frames import TextDescription
from drivers.frames.wire import Rows

_MOST_FORMS = 1024  # forms of one type that are kept ready; a stream has a handful


class FrameFamily:
    """One frame type, whose length is fixed or stands in the frame; what is `optional` may follow each frame."""

    def __init__(self, description: StreamDescription, name: str) -> None:
        self.name = name
        self.description = description.frames[name]
        self.headers = description.headers(name)
        self.confirm = self.description.checksum.confirm
        self.shortest, self.longest = self.description.shortest, self.description.longest
        self.delimiter = self.description.delimiter
        self.optional = b"" if self.description.text else description.optional_delimiter
        length = self.description.length
        self._told = length if isinstance(length, LengthDescription) else None
        self._stream = description
        self._layout_of = lru_cache(_MOST_FORMS)(self._layout)
        self.shortest_layout = self._layout_of(self.shortest)

    def _layout(self, length: int) -> FrameLayout:
        return FrameLayout(self._stream, self.name, length=length)

    def length_of(self, data: bytes, start: int) -> int | None:
        """Return the length of the frame at `start`: 0 where it is none, None where it is not told yet."""
        return self.shortest if self._told is None else self._told.of(data, start)

    def form(self, frame: bytes) -> FrameLayout | Flaw:
        """Return the layout of a whole frame, or what is wrong with it."""
        layout = self._layout_of(len(frame))
        flaw = layout.flaw(frame)
        return layout if flaw is None else flaw

    def alike(self, rows: Rows, layout: FrameLayout) -> NDArray[np.bool_]:
        """Tell which of n stretches as long as a good frame, the first, (n, length), are good frames of its form."""
        alike = layout.checksum.matches_rows(rows)
        if self.delimiter:
            ends = rows[:, rows.shape[1] - len(self.delimiter) :] == np.frombuffer(self.delimiter, np.uint8)
            alike &= ends.all(axis=1)
        if self._told is not None:
            alike &= (rows[:, self._told.places] == rows[0, self._told.places]).all(axis=1)
        return alike


class ItemsFamily(FrameFamily):
    """A frame type with items, of which each frame has its own."""

    def __init__(self, description: StreamDescription, name: str, items: ItemsDescription) -> None:
        super().__init__(description, name)
        self._items = items
        self._filled = lru_cache(_MOST_FORMS)(self._layout_of_items)

    def form(self, frame: bytes) -> FrameLayout | Flaw:
        base = super().form(frame)
        if isinstance(base, Flaw):
            return base
        walked = self._walked(frame, base)
        return Flaw.CHECKSUM if walked is None else self._filled(len(frame), tuple(walked))

    def alike(self, rows: Rows, layout: FrameLayout) -> NDArray[np.bool_]:
        walked = self._walked(rows[0].tobytes(), layout)
        same = [byte for item in walked or () for byte in range(item.at, item.data)]  # what tells the form
        return np.asarray(super().alike(rows, layout) & (rows[:, same] == rows[0, same]).all(axis=1))

    def _walked(self, frame: bytes, base: FrameLayout) -> list[Item] | None:
        begin, longer = self._items.begin, self._told and self._told.extended
        if self._told and longer and self._items.extended_begin and frame[self._told.at] == longer.mark:
            begin = self._items.extended_begin
        end = self.description.checksum.content_end(base.length - len(base.delimiter))
        return self._items.walk(frame, begin, end)

    def _layout_of_items(self, length: int, walked: tuple[Item, ...]) -> FrameLayout:
        base = self._layout_of(length)
        fields, offsets = dict(base.fields), dict(base.offsets)
        for name, field, offset in self._items.placed(walked):
            fields[name], offsets[name] = field, offset
        return FrameLayout(self._stream, self.name, length=length, fields=fields, offsets=offsets)


class TextFamily(FrameFamily):
    """Lines of text. They are few, and looked at one by one."""

    def __init__(self, description: StreamDescription, name: str, text: TextDescription) -> None:
        self._text = text
        super().__init__(description, name)

    def _layout(self, length: int) -> FrameLayout:
        return TextLayout(self._stream, self.name, self._text, length)

    def length_of(self, data: bytes, start: int) -> int | None:
        return self._text.length_of(data, start, len(self.headers[0]), self.delimiter)

    def alike(self, rows: Rows, layout: FrameLayout) -> NDArray[np.bool_]:
        """Tell that the first of n stretches, (n, length), is a line: of the others nothing is looked at."""
        return np.asarray(np.arange(len(rows)) == 0)


def families_of(description: StreamDescription) -> list[FrameFamily]:
    """Return the frame types of a stream."""
    families: list[FrameFamily] = []
    for name, frame in description.frames.items():
        if frame.text is not None:
            families.append(TextFamily(description, name, frame.text))
        elif frame.items is not None:
            families.append(ItemsFamily(description, name, frame.items))
        elif not frame.parts:
            families.append(FrameFamily(description, name))
    return families
