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

Part = tuple[FrameLayout, Rows, IntArray | slice]
"""Frames of one form: their layout, bytes (k, length), and where in the batch they stand, (k,) or all of it."""


@dataclass(eq=False)
class FrameBatch:
    """n good frames of one type, in the order of their arrival. Columns are converted when they are asked for.

    `parts` are the frames of each form (of other lengths, or with other items), or of each type that samples are made
    of; `layout` is that of the first form, or the samples' own. `starts` is the position of each frame's first byte in
    the stream, shape (n,); `sequence` the unwrapped counter, in frames, shape (n,): it goes on over wraps and counts
    lost frames (without a counter it counts the frames that arrived).
    """

    layout: FrameLayout
    parts: Sequence[Part]
    starts: IntArray
    sequence: IntArray

    def __len__(self) -> int:
        return len(self.starts)

    def wire(self, field: str) -> NDArray[Any]:
        """Return a numeric field as it stood on the wire (integers where it is an integer), shape (n,).

        0 where a frame does not have it, `KeyError` where none has.
        """
        known = [(at, layout.wire_values(rows, field)) for layout, rows, at in self.parts if field in layout.numeric]
        if not known:
            raise KeyError(field)
        values = np.zeros(len(self), np.result_type(*[wire for _, wire in known]))
        for at, wire in known:
            values[at] = wire
        return values

    def column(self, field: str) -> FloatArray:
        """Return a numeric field in its unit, shape (n,)."""
        return self.columns[field]

    def text(self, field: str) -> list[str]:
        """Return a text field of every frame without its padding, empty where it has none; what is not ASCII is `?`."""
        texts, places = [""] * len(self), np.arange(len(self))
        for layout, rows, at in self.parts:
            own = layout.texts(rows, field) if field in layout.fields else []
            for place, text in zip(places[at].tolist(), own, strict=False):
                texts[place] += text
        return texts

    def told(self, field: str) -> NDArray[np.bool_]:
        """Return in which frames a numeric field is there, shape (n,)."""
        there = np.zeros(len(self), np.bool_)
        for layout, rows, at in self.parts:
            if field in layout.numeric:
                there[at] |= layout.told(rows, field)
        return there

    def select(self, keep: NDArray[np.bool_], sequence: IntArray) -> "FrameBatch":
        """Return the frames to keep, shape (n,) of bool, with their `sequence`, shape (kept,)."""
        renumbered, places = np.cumsum(keep) - 1, np.arange(len(self))
        parts = [(layout, rows[keep[at]], renumbered[places[at][keep[at]]]) for layout, rows, at in self.parts]
        return FrameBatch(self.layout, parts, self.starts[keep], sequence)

    @cached_property
    def columns(self) -> Mapping[str, FloatArray]:
        """All numeric fields in their units, each of shape (n,); NaN where a frame does not have the field."""
        if len(self.parts) == 1 and self.parts[0][0] is self.layout:  # nothing to put together
            return self.layout.columns(self.parts[0][1])
        columns = {name: np.full(len(self), np.nan) for name in (*self.layout.numeric, *self.layout.absent)}
        for layout, rows, at in self.parts:
            for name, values in layout.columns(rows).items():
                columns[name][at] = values
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
    starts = np.concatenate([each for *_, own in merged.values() for each in own])
    numbers, first = np.arange(len(starts)), groups[0][0]
    if len(merged) == 1:
        return FrameBatch(first, [(first, np.concatenate(all_rows), slice(None))], starts, numbers)
    order = np.argsort(starts, kind="stable")
    edges = np.cumsum([sum(map(len, own)) for *_, own in merged.values()])
    places = np.split(np.argsort(order, kind="stable"), edges[:-1])
    parts = [(layout, np.concatenate(own), at) for (layout, own, _), at in zip(merged.values(), places, strict=True)]
    return FrameBatch(first, parts, starts[order], numbers)
