"""Good frames as columns: what a decoder hands out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frames.counts import StreamCounts
from drivers.frames.layout import FrameLayout
from drivers.frames.wire import FloatArray, IntArray, Rows


@dataclass(eq=False)
class FrameBatch:
    """n good frames of one type, in the order of their arrival. Columns are converted when they are asked for.

    `rows` are the frames' bytes, shape (n, length); `starts` the position of each frame's first byte in the stream,
    shape (n,); `sequence` the unwrapped counter, in frames, shape (n,): it goes on over wraps and counts lost frames
    (without a counter it counts the frames that arrived).
    """

    layout: FrameLayout
    rows: Rows
    starts: IntArray
    sequence: IntArray

    def __len__(self) -> int:
        return len(self.starts)

    def wire(self, field: str) -> NDArray[Any]:
        """Return a numeric field as it stood on the wire (integers where it is an integer), shape (n,)."""
        return self.layout.wire_values(self.rows, field)

    def column(self, field: str) -> FloatArray:
        """Return a numeric field in its unit, shape (n,)."""
        return self.columns[field]

    def text(self, field: str) -> list[str]:
        """Return a text field of every frame, without its padding; bytes that are not ASCII become `?`."""
        return self.layout.texts(self.rows, field)

    def told(self, field: str) -> NDArray[np.bool_]:
        """Return in which frames a numeric field is there, shape (n,)."""
        return self.layout.told(self.rows, field) if field in self.layout.numeric else np.zeros(len(self), np.bool_)

    def select(self, keep: NDArray[np.bool_], sequence: IntArray) -> "FrameBatch":
        """Return the frames to keep, shape (n,) of bool, with their `sequence`, shape (kept,)."""
        return FrameBatch(self.layout, np.ascontiguousarray(self.rows[keep]), self.starts[keep], sequence)

    @cached_property
    def columns(self) -> Mapping[str, FloatArray]:
        """All numeric fields in their units, each of shape (n,); NaN where a frame does not have the field."""
        return self.layout.columns(self.rows)


class VariedBatch(FrameBatch):
    """Good frames of one type in several forms, of other lengths or with other items; or samples of several frames.

    `parts` are the frames of each form (or part of a sample), `places` where they stand; `layout` is the samples' own.
    """

    def __init__(
        self,
        parts: Sequence[FrameBatch],
        places: Sequence[IntArray],
        sequence: IntArray,
        layout: FrameLayout | None = None,
    ) -> None:
        starts = np.empty(len(sequence), np.int64)
        for part, place in zip(reversed(parts), reversed(places), strict=True):  # a sample begins with its first part
            starts[place] = part.starts
        self._lacking = [] if layout is None else layout.absent
        layout = layout or parts[0].layout
        super().__init__(layout, np.empty((0, layout.length), np.uint8), starts, sequence)
        self.parts, self.places = parts, places

    def wire(self, field: str) -> NDArray[Any]:
        """Return a field as on the wire, shape (n,); 0 where a frame does not have it, `KeyError` where none has."""
        pairs = zip(self.places, self.parts, strict=True)
        known = [(place, part.wire(field)) for place, part in pairs if field in part.layout.numeric]
        if not known:
            raise KeyError(field)
        values = np.zeros(len(self), np.result_type(*[wire for _, wire in known]))
        for place, wire in known:
            values[place] = wire
        return values

    def told(self, field: str) -> NDArray[np.bool_]:
        there = np.zeros(len(self), np.bool_)
        for place, part in zip(self.places, self.parts, strict=True):
            there[place] |= part.told(field)
        return there

    def text(self, field: str) -> list[str]:
        """Return a text field of every frame; empty where a frame does not have it."""
        texts = [""] * len(self)
        for place, part in zip(self.places, self.parts, strict=True):
            for at, text in zip(place.tolist(), part.text(field) if field in part.layout.fields else [], strict=False):
                texts[at] += text
        return texts

    def select(self, keep: NDArray[np.bool_], sequence: IntArray) -> FrameBatch:
        renumbered = np.cumsum(keep) - 1
        parts = [part.select(keep[place], part.sequence) for part, place in zip(self.parts, self.places, strict=True)]
        places = [renumbered[place[keep[place]]] for place in self.places]
        return VariedBatch(parts, places, sequence, self.layout)

    @cached_property
    def columns(self) -> Mapping[str, FloatArray]:
        columns: dict[str, FloatArray] = {name: np.full(len(self), np.nan) for name in self._lacking}
        for place, part in zip(self.places, self.parts, strict=True):
            for name, values in part.columns.items():
                columns.setdefault(name, np.full(len(self), np.nan))[place] = values
        return columns


@dataclass(frozen=True, slots=True)
class Decoded:
    """The good frames of one feed by type, in the order of their arrival, and what became of all bytes decided."""

    frames: Mapping[str, FrameBatch]
    counts: StreamCounts

    def __getitem__(self, frame: str) -> FrameBatch:
        return self.frames[frame]


def join(groups: Sequence[tuple[FrameLayout, Rows, IntArray]]) -> FrameBatch:
    """Return groups of frames, bytes (n, length) and places (n,), as one batch in order of arrival, numbered from 0."""
    merged: dict[int, tuple[FrameLayout, list[Rows], list[IntArray]]] = {}
    for layout, rows, starts in groups:
        _, all_rows, all_starts = merged.setdefault(id(layout), (layout, [], []))
        all_rows.append(rows)
        all_starts.append(starts)
    parts = [
        FrameBatch(layout, np.concatenate(all_rows), np.concatenate(all_starts), np.arange(sum(map(len, all_starts))))
        for layout, all_rows, all_starts in merged.values()
    ]
    if len(parts) == 1:
        return parts[0]
    place = np.argsort(np.argsort(np.concatenate([part.starts for part in parts]), kind="stable"), kind="stable")
    edges = np.cumsum([len(part) for part in parts])
    return VariedBatch(parts, np.split(place, edges[:-1]), np.arange(len(place)))
