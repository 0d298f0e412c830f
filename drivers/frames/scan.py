"""Finding the good frames in a piece of a stream: three ways to look, one meaning.

The meaning is that of a reader who stands at one byte at a time. Where a header begins and the whole frame is there,
its checksum and delimiter are verified: a good frame is taken and the reader goes on behind it; otherwise he goes on
ONE byte, so that a damaged frame never takes a good neighbour with it. Where the frame (or the header) is not all
there yet, he stops and waits. `scan_few` does exactly that, frame by frame. `scan_clean` takes frames that follow one
another without a flaw, all at once. `scan_many` verifies every candidate of the piece at once and then walks over
them. Which one is used is a matter of speed only.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from drivers.frames.layout import FrameLayout, IntArray
from drivers.frames.wire import Rows


@dataclass
class Scan:
    """What was found in a piece. Positions count from the piece's first byte.

    `stop` is the first byte that is not decided yet; `waits` says that a frame may begin there whose end is beyond the
    piece (otherwise what follows `stop`, if anything, has not been looked at).
    `rows` and `starts` hold, per frame type, the good frames. `in_step` says whether the byte before `stop` was the
    last of a good frame.
    """

    stop: int
    rows: list[Rows]
    starts: list[IntArray]
    in_step: bool
    waits: bool = False
    bad_checksum: int = 0
    bad_delimiter: int = 0
    unknown_id: int = 0
    resyncs: int = 0


@dataclass
class _Candidates:
    """All places of one frame type in a piece: whole frames with their verdict, and those that go beyond its end."""

    starts: IntArray
    rows: Rows
    sums_match: NDArray[np.bool_]
    ends_match: NDArray[np.bool_]
    incomplete: IntArray = field(default_factory=lambda: np.empty(0, np.int64))

    @property
    def valid(self) -> NDArray[np.bool_]:
        return np.asarray(self.sums_match & self.ends_match)


class Scanner:
    """Looks for the frames of one stream, given its sync and its frame types."""

    def __init__(self, sync: bytes, layouts: Sequence[FrameLayout]) -> None:
        self._sync = sync
        self._layouts = layouts
        self._header_size = len(layouts[0].header)
        self._by_header = {layout.header: index for index, layout in enumerate(layouts)}
        any_id = b"[\\x00-\\xff]" * (self._header_size - len(sync))
        known = b"|".join(re.escape(layout.header) for layout in layouts)
        self._header = re.compile(re.escape(sync) + any_id if sync else known)

    def waits(self, data: bytes, at: int) -> bool:
        """Tell whether `data[at:]`, shorter than a header, may be the beginning of one."""
        rest = data[at : at + self._header_size]
        if self._sync:
            return self._sync.startswith(rest) or rest.startswith(self._sync)
        return any(header.startswith(rest) for header in self._by_header)

    def _tail(self, data: bytes, at: int) -> list[int]:
        """Return where, from `at` on, a header may have begun whose end is not there yet."""
        first = max(at, len(data) - self._header_size + 1)
        return [position for position in range(first, len(data)) if self.waits(data, position)]

    def scan_few(self, data: bytes, *, in_step: bool) -> Scan:
        """Scan frame by frame: cheapest for a few frames, and the meaning of the other two."""
        found: list[list[bytes]] = [[] for _ in self._layouts]
        starts: list[list[int]] = [[] for _ in self._layouts]
        result = Scan(len(data), [], [], in_step)
        at = end = 0  # the byte that is looked at; the end of the last good frame
        size = len(data)
        while True:
            match = self._header.search(data, at)
            if match is None:
                tail = self._tail(data, at)
                result.stop = tail[0] if tail else size
                break
            start = match.start()
            index = self._by_header.get(match[0])
            at = start + 1
            if index is None:
                result.unknown_id += 1
                continue
            layout = self._layouts[index]
            if start + layout.length > size:
                result.stop = start
                break
            frame = data[start : start + layout.length]
            if not layout.checksum.matches(frame):
                result.bad_checksum += 1
            elif not frame.endswith(layout.delimiter):
                result.bad_delimiter += 1
            else:
                found[index].append(frame)
                starts[index].append(start)
                result.resyncs += start != end or not result.in_step
                result.in_step = True
                at = end = start + layout.length
        result.in_step = result.in_step and end == result.stop
        result.waits = result.stop < size
        for layout, frames, places in zip(self._layouts, found, starts, strict=True):
            result.rows.append(np.frombuffer(b"".join(frames), np.uint8).reshape(-1, layout.length))
            result.starts.append(np.array(places, np.int64))
        return result

    def scan_clean(self, piece: NDArray[np.uint8], *, in_step: bool) -> Scan | None:
        """Take the piece as frames of one type without a flaw between them; None where it is not that."""
        index = self._by_header.get(piece[: self._header_size].tobytes())
        if index is None:
            return None
        layout = self._layouts[index]
        n = len(piece) // layout.length
        rows = piece[: n * layout.length].reshape(n, layout.length)
        header = np.frombuffer(layout.header, np.uint8)
        if n == 0 or not (rows[:, : len(header)] == header).all():
            return None
        if not layout.checksum.matches_rows(rows).all() or not _ends_match(rows, layout).all():
            return None
        result = Scan(n * layout.length, [], [], in_step=True, resyncs=int(not in_step))
        for other in self._layouts:
            result.rows.append(rows if other is layout else np.empty((0, other.length), np.uint8))
            mine = n if other is layout else 0
            result.starts.append(np.arange(mine, dtype=np.int64) * other.length)
        return result

    def scan_many(self, piece: NDArray[np.uint8], *, in_step: bool) -> Scan:
        """Verify every candidate at once, then walk over them."""
        unknown, candidates = self._candidates(piece)
        starts = np.concatenate([c.starts[c.valid] for c in candidates])
        lengths = [np.full(int(c.valid.sum()), x.length) for c, x in zip(candidates, self._layouts, strict=True)]
        order = np.argsort(starts, kind="stable")
        starts, ends = starts[order], (starts + np.concatenate(lengths))[order]
        taken = _not_overlapping(starts, ends)
        starts, ends = starts[taken], ends[taken]

        tail = piece[max(0, len(piece) - self._header_size + 1) :].tobytes()
        beyond = [int(place) for c in candidates for place in c.incomplete]
        beyond += [len(piece) - len(tail) + place for place in self._tail(tail, 0)]
        waiting = [place for place in sorted(beyond) if not _covered(np.array([place]), starts, ends)[0]]
        stop = waiting[0] if waiting else len(piece)
        before = starts < stop
        starts, ends = starts[before], ends[before]

        def count(places: IntArray) -> int:
            places = places[places < stop]
            return int((~_covered(places, starts, ends)).sum())

        breaks = starts[1:] != ends[:-1]
        first_break = bool(len(starts)) and (int(starts[0]) > 0 or not in_step)
        last_end = int(ends[-1]) if len(ends) else 0
        result = Scan(stop, [], [], in_step=(in_step or bool(len(ends))) and last_end == stop)
        result.waits = bool(waiting)
        result.resyncs = int(breaks.sum()) + first_break
        result.unknown_id = count(unknown)
        for found in candidates:
            result.bad_checksum += count(found.starts[~found.sums_match])
            result.bad_delimiter += count(found.starts[found.sums_match & ~found.ends_match])
            mine = found.valid & np.isin(found.starts, starts, assume_unique=True)
            result.rows.append(found.rows[mine])
            result.starts.append(found.starts[mine])
        return result

    def _candidates(self, piece: NDArray[np.uint8]) -> tuple[IntArray, list[_Candidates]]:
        """Return the places with a sync but an unknown id, and the candidates of every frame type."""
        searched = piece[: max(0, len(piece) - self._header_size + 1)]
        if self._sync:
            places = np.flatnonzero(searched == self._sync[0])
            for depth, byte in enumerate(self._sync[1:], start=1):
                places = places[piece[places + depth] == byte]
        else:
            firsts = np.zeros(256, np.bool_)
            firsts[[layout.header[0] for layout in self._layouts]] = True
            places = np.flatnonzero(firsts[searched])
        known = np.zeros(len(places), np.bool_)
        candidates = []
        for layout in self._layouts:
            mine = np.ones(len(places), np.bool_)
            for depth in range(len(self._sync), self._header_size):
                mine &= piece[places + depth] == layout.header[depth]
            known |= mine
            candidates.append(_verify(piece, places[mine], layout))
        return (places[~known] if self._sync else places[:0]), candidates


def _verify(piece: NDArray[np.uint8], places: IntArray, layout: FrameLayout) -> _Candidates:
    whole = places[places + layout.length <= len(piece)]
    rows = np.empty((0, layout.length), np.uint8)
    if len(whole):
        rows = np.ascontiguousarray(sliding_window_view(piece, layout.length)[whole])
    return _Candidates(
        whole, rows, layout.checksum.matches_rows(rows), _ends_match(rows, layout), incomplete=places[len(whole) :]
    )


def _ends_match(rows: Rows, layout: FrameLayout) -> NDArray[np.bool_]:
    size = len(layout.delimiter)
    if not size:
        return np.ones(len(rows), np.bool_)
    return np.asarray((rows[:, layout.length - size :] == np.frombuffer(layout.delimiter, np.uint8)).all(axis=1))


def _not_overlapping(starts: IntArray, ends: IntArray) -> NDArray[np.bool_]:
    """Return which of the good frames, sorted by start, a reader meets who goes on behind each frame he takes."""
    taken = np.ones(len(starts), np.bool_)
    if len(starts) and (starts[1:] < ends[:-1]).any():
        reached = 0
        for index, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
            taken[index] = start >= reached
            reached = end if taken[index] else reached
    return taken


def _covered(places: IntArray, starts: IntArray, ends: IntArray) -> NDArray[np.bool_]:
    """Return which places lie in one of the frames [start, end), sorted and without overlap."""
    if not len(starts):
        return np.zeros(len(places), np.bool_)
    before = np.searchsorted(starts, places, side="right") - 1
    return np.asarray((before >= 0) & (places < ends[before]))
