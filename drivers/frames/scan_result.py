"""What a look at a piece of a stream found, and where the reader stands after it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from drivers.frames.layout import FrameLayout, IntArray
from drivers.frames.wire import Rows

Group = tuple[FrameLayout, Rows, IntArray]  # frames of one form: their layout, bytes and places
Found = dict[int, tuple[FrameLayout, list[bytes], list[int]]]  # the same, one by one


@dataclass(frozen=True)
class Standing:
    """Where the reader stands: right behind a good frame or not, and how far the last failed candidate reaches."""

    in_step: bool = True
    claimed: int = 0

    def moved(self, by: int) -> Standing:
        """Return the same place, seen from `by` bytes further on."""
        return Standing(self.in_step, max(0, self.claimed - by))


@dataclass
class Scan:
    """What was found in a piece. Positions count from the piece's first byte.

    `stop` is the first byte that is not decided yet; `waits` says that something may begin there whose end, expected at
    `waiting_end`, is beyond the piece (otherwise what follows `stop`, if anything, has not been looked at). `found`
    holds, per frame type, the good frames: bytes (n, length) and places (n,) of each form. `standing` is that of the
    reader at `stop`. `stuffing` counts bytes around or within good frames that are no part of them. `delimited` says
    that an optional delimiter follows there that was not expected.
    """

    stop: int
    standing: Standing
    found: list[list[Group]]
    waits: bool = False
    waiting_end: int = 0
    delimited: bool = False
    bad_checksum: int = 0
    bad_delimiter: int = 0
    unknown_id: int = 0
    stuffing: int = 0
    resyncs: int = 0

    @property
    def frames(self) -> int:
        """How many good frames were found."""
        return sum(len(starts) for groups in self.found for _, _, starts in groups)


def grouped(found: Iterable[Found]) -> list[list[Group]]:
    """Return frames that were found one by one as groups: bytes (n, length) and places (n,) of each form."""
    return [
        [
            (layout, np.frombuffer(b"".join(frames), np.uint8).reshape(len(frames), -1), np.array(starts, np.int64))
            for layout, frames, starts in forms.values()
        ]
        for forms in found
    ]
