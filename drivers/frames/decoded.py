"""What one feed of a decoder gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.frames.batch import FrameBatch
from drivers.frames.counts import StreamCounts


@dataclass(frozen=True, slots=True)
class Decoded:
    """The good frames of one feed by type, in the order of their arrival, and what became of all bytes decided."""

    frames: Mapping[str, FrameBatch]
    counts: StreamCounts

    def __getitem__(self, frame: str) -> FrameBatch:
        return self.frames[frame]
