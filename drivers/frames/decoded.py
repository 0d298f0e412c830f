"""What one feed of a decoder gives."""

from __future__ import annotations

from collections.abc import Mapping

from drivers.frames.batch import FrameBatch
from drivers.frames.counts import StreamCounts


class Decoded:
    """The good frames of one feed by type, in the order of their arrival, and what became of all bytes decided."""

    __slots__ = ("_counts", "_frames")

    _frames: Mapping[str, FrameBatch]

    def __init__(self, frames: Mapping[str, FrameBatch], counts: StreamCounts) -> None:
        self._frames = frames
        self._counts = counts

    @property
    def frames(self) -> Mapping[str, FrameBatch]:
        """The good frames by type."""
        return self._frames

    @property
    def counts(self) -> StreamCounts:
        """What became of the bytes that were decided."""
        return self._counts

    def __getitem__(self, frame: str) -> FrameBatch:
        return self.frames[frame]

    def records(self, frame: str) -> list[tuple[float, ...]]:
        """Return the frames of one type as tuples of plain floats (see `FrameBatch.records`)."""
        return self.frames[frame].records()
