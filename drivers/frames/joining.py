"""Samples that a unit spreads over several frames: acceleration in one, rates in the next.

    frames:
      acceleration: {id: "51", …}
      rate: {id: "52", …}
      sample: {parts: [acceleration, rate]}           # in this order; or, with `by: count`, those of one count

A sample begins with a frame that does not come behind the one before it in the list (or whose `by` is another). A part
that did not arrive is NaN, and counts as lost. The sample whose parts may still come is kept for the next feed.
"""

from collections.abc import Sequence

import numpy as np

from drivers.frames.batch import FrameBatch, VariedBatch, join
from drivers.frames.description import StreamDescription
from drivers.frames.layout import FrameLayout
from drivers.frames.scan import Group
from drivers.frames.sequence import FrameSequence


class SampleJoiner:
    """Puts the samples `name` of one stream together; `parts` are the numbers of their frame types in `names`."""

    def __init__(self, description: StreamDescription, name: str, names: Sequence[str]) -> None:
        self.name, self.layout = name, FrameLayout(description, name, fields={}, offsets={})
        frame = self.layout.description
        self.parts, self._by = [names.index(part) for part in frame.parts], frame.by
        self.sequence = FrameSequence(frame, description.sample_rate_hz)
        self.interrupt()

    def interrupt(self) -> None:
        """Forget the unfinished sample; the next may have begun before."""
        self._held: list[list[Group]] = [[] for _ in self.parts]
        self._begun = False
        self.sequence.interrupt()

    def take(self, groups: Sequence[list[Group]], *, last: bool) -> tuple[FrameBatch | None, int, int]:
        """Return samples that groups of bytes, (n, length), complete (with `last` all), and frames in them and lost."""
        groups = [held + new for held, new in zip(self._held, groups, strict=True)]
        there = [(number, join(each)) for number, each in enumerate(groups) if each]
        if not there:
            return None, 0, 0
        starts = np.concatenate([batch.starts for _, batch in there])
        part = np.repeat([number for number, _ in there], [len(batch) for _, batch in there])
        order = np.argsort(starts, kind="stable")
        part = part[order]
        begins = np.ones(len(part), np.bool_)
        if self._by is None:
            begins[1:] = part[1:] <= part[:-1]
        else:
            count = np.concatenate([batch.wire(self._by) for _, batch in there])[order]
            begins[1:] = count[1:] != count[:-1]
        sample = np.cumsum(begins) - 1
        first = int(np.flatnonzero(begins)[-1])
        whole = len(part) - first == len(self.parts) if self._by else part[-1] == len(self.parts) - 1
        cut = np.inf if whole or last else starts[order[first]]
        self._held = [_from(each, cut) for each in groups]
        n = int(sample[-1]) + int(cut == np.inf)
        if not n:
            return None, 0, 0
        numbers = np.empty(len(order), np.int64)
        numbers[order] = sample
        edges = np.cumsum([0, *(len(batch) for _, batch in there)])
        parts, places = [], []
        for edge, (_, batch) in zip(edges, there, strict=False):
            place = numbers[edge : edge + len(batch)]
            keep = place < n
            parts.append(batch.select(keep, batch.sequence[keep]))
            places.append(place[keep])
        frames = sum(map(len, places))
        missing = n * len(self.parts) - sum(len(np.unique(place)) for place in places)
        if self._by is None:
            missing -= 0 if self._begun else int(part[0])
            missing -= len(self.parts) - 1 - int(part[-1]) if last and not whole else 0
        self._begun = True
        return VariedBatch(parts, places, np.arange(n), self.layout), frames, missing


def _from(groups: list[Group], cut: float) -> list[Group]:
    """Return the frames of `groups`, bytes (n, length) and places (n,), from place `cut` on."""
    return [(layout, rows[at >= cut], at[at >= cut]) for layout, rows, at in groups if (at >= cut).any()]
