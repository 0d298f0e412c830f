"""All places of one frame type in a piece of a stream, judged at once."""

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from drivers.frames.families import Flaw, FrameFamily
from drivers.frames.layout import FrameLayout, IntArray
from drivers.frames.wire import Rows


@dataclass
class Candidates:
    """All places of one frame type in a piece: whole frames in groups of one length, and what cannot be judged yet.

    A group has places (n,), bytes (n, length), which are good (n,), and the layout.
    """

    groups: list[tuple[IntArray, Rows, NDArray[np.bool_], FrameLayout]] = field(default_factory=list)
    failed: list[tuple[IntArray, int, Flaw]] = field(default_factory=list)  # places, length, flaw
    incomplete: list[tuple[int, int]] = field(default_factory=list)  # place, expected end


def judge(piece: NDArray[np.uint8], places: IntArray, family: FrameFamily) -> Candidates:
    """Judge the frames of one type that begin at `places` (n,), sorted, in a piece of a stream, bytes (m,)."""
    found = Candidates()
    if not len(places):
        return found
    lengths = family.lengths(piece, places)
    beyond = (lengths < 0) | (places + lengths > len(piece))
    found.incomplete = [
        (int(place), int(place + max(length, 1))) for place, length in zip(places[beyond], lengths[beyond], strict=True)
    ]
    impossible = lengths == 0
    if impossible.any():
        found.failed.append((places[impossible], 0, Flaw.CHECKSUM))
    judged = ~beyond & ~impossible
    for length in np.unique(lengths[judged]).tolist():
        whole = places[judged & (lengths == length)]
        rows = np.ascontiguousarray(sliding_window_view(piece, length)[whole])
        verdict = family.forms(rows)
        wrong_sum, wrong_end = ~verdict.sums_match, verdict.sums_match & ~verdict.ends_match
        for layout, good in verdict.forms:
            mine = slice(None) if len(verdict.forms) == 1 else np.flatnonzero(good)
            found.groups.append((whole[mine], rows[mine], good[mine], layout))
        for wrong, flaw in ((wrong_sum, Flaw.CHECKSUM), (wrong_end, Flaw.DELIMITER)):
            if wrong.any():
                found.failed.append((whole[wrong], length, flaw))
    return found


def covered(places: IntArray, starts: IntArray, ends: IntArray) -> NDArray[np.bool_]:
    """Return which places, (n,), lie in one of the frames [start, end), (k,) each, sorted and without overlap."""
    if not len(starts):
        return np.zeros(len(places), np.bool_)
    before = np.searchsorted(starts, places, side="right") - 1
    return np.asarray((before >= 0) & (places < ends[before]))
