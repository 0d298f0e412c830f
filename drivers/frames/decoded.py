"""What one feed of a decoder gives."""

from __future__ import annotations

from collections.abc import Mapping

from drivers.frames.batch import FrameBatch
from drivers.imu import StreamCounts


class Decoded:
    """The good frames of one feed by type, in the order of their arrival, and what became of all bytes decided."""

    __slots__ = ("counts", "frames")

    frames: Mapping[str, FrameBatch]
    counts: StreamCounts

    def __init__(self, frames: Mapping[str, FrameBatch], counts: StreamCounts) -> None:
        self.frames = frames
        self.counts = counts

    def __getitem__(self, frame: str) -> FrameBatch:
        return self.frames[frame]

    def records(self, frame: str) -> list[tuple[float, ...]]:
        """Return the frames of one type as tuples of plain floats (see `FrameBatch.records`)."""
        return self.frames[frame].records()
