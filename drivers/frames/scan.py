"""Finding the good frames in a piece of a stream: three ways to look, one meaning.

The meaning is that of a reader who stands at one byte at a time. Where a header begins and the whole frame is there,
its checksum and delimiter are verified: a good frame is taken and the reader goes on behind it; otherwise he goes on
ONE byte, so that a damaged frame never takes a good neighbour with it. Where the frame (or the header) is not all
there yet, he stops and waits. `scan_few` does exactly that, frame by frame. `scan_clean` takes frames that follow one
another without a flaw, all at once. `scan_many` verifies every candidate of the piece at once and then walks over
them. Which one is used is a matter of speed only.

A candidate that fails is counted once: what looks like a header inside it is not counted again. Where a checksum asks
for confirmation, a frame that does not follow a good one directly is believed only where the next header follows it or
its counter goes on from the last good frame of its type; where neither is there yet, the reader waits.
"""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.frames.candidates import Candidates, covered, judge
from drivers.frames.families import Flaw, FrameFamily
from drivers.frames.layout import FrameLayout, IntArray
from drivers.frames.notation import Header
from drivers.frames.scan_result import Found, Group, Scan, Standing, grouped
from drivers.frames.wire import Rows

_GOES_ON = 8  # frames that may be missing before one that its counter confirms
_TELLING = 64  # frames after which a counter comes round, at least, for it to confirm anything


class Scanner:
    """Looks for the frames of one stream, given its sync and its frame types.

    `watch` is an optional delimiter that the unit did not send so far: where it follows a good frame, a scan ends.
    """

    def __init__(self, sync: bytes, families: Sequence[FrameFamily], watch: bytes = b"") -> None:
        self._sync = sync
        self._families = families
        self._watch = watch
        self._headers = [(header, index) for index, family in enumerate(families) for header in family.headers]
        self._longest_header = max((len(header) for header, _ in self._headers), default=0)
        self._exact = {bytes(header): each for each in self._headers if None not in (header := each[0]).told}
        self._loose = [
            (re.compile(header.pattern, re.DOTALL), (header, index))
            for header, index in self._headers
            if None in header.told
        ]
        known = b"|".join(header.pattern for header, _ in self._headers)
        self._known = re.compile(known, re.DOTALL)
        self._header = re.compile(known + (b"|" + re.escape(sync) if sync else b""), re.DOTALL)
        begun = b"|".join(header.begun for header, _ in self._headers if header.begun)
        self._begun = re.compile(b"(?:" + (begun or b"(?!)") + rb")\Z", re.DOTALL)
        self._confirms = any(family.confirm for family in families)
        self.newest: dict[int, tuple[FrameLayout, bytes]] = {}  # by frame type, for counters that confirm

    def _which(self, found: bytes) -> tuple[Header, int] | None:
        """Return the header that was found with its frame type, None where it is the sync alone."""
        exact = self._exact.get(found)
        return exact or next((each for pattern, each in self._loose if pattern.fullmatch(found)), None)

    def _unfinished(self, data: bytes, at: int) -> bool:
        """Tell whether `data` ends within a header that may have begun at `at`."""
        return len(data) - at < self._longest_header and self._begun.match(data, at) is not None

    def _tail(self, data: bytes, at: int, end: int) -> int | None:
        """Return the first place from `at` on, before `end`, at which an unfinished header may begin."""
        for place in range(max(at, len(data) - self._longest_header + 1), end):
            if self._unfinished(data, place):
                return place
        return None

    def _watched(self, data: bytes, at: int) -> bool | None:
        """Tell whether the delimiter that is watched for stands at `at`; None where its rest is not there yet."""
        rest = data[at : at + len(self._watch)]
        if not self._watch or not rest or not self._watch.startswith(rest):
            return False
        return True if len(rest) == len(self._watch) else None

    def _confirmed(
        self, index: int, layout: FrameLayout, frame: bytes, data: bytes, end: int, last: bool
    ) -> bool | None:
        """Tell whether what follows a frame, or its counter, confirms it; None where that is not there yet."""
        if self._known.match(data, end) or self._goes_on(index, layout, frame):
            return True
        if len(data) == end or self._unfinished(data, end):
            return True if last else None
        return False

    def _goes_on(self, index: int, layout: FrameLayout, frame: bytes) -> bool:
        counter, before = layout.description.counter, self.newest.get(index)
        if counter is None or before is None or counter.modulus < _TELLING * counter.step:
            return False
        values = []
        for form, content in (before, (layout, frame)):
            if counter.field not in form.numeric:
                return False
            values.append(int(form.wire_values(np.frombuffer(content, np.uint8).reshape(1, -1), counter.field)[0]))
        moved = (values[1] - values[0]) % counter.modulus
        return moved % counter.step == 0 and 1 <= moved // counter.step <= _GOES_ON

    def scan_few(self, data: bytes, standing: Standing, *, last: bool = False, first_only: bool = False) -> Scan:
        """Scan frame by frame: cheapest for a few frames, and the meaning of the other two.

        `last` says that nothing will follow. With `first_only`, stop behind the first good frame and remember nothing.
        """
        found: list[Found] = [{} for _ in self._families]
        result = Scan(len(data), standing, [])
        in_step, claimed = standing.in_step, standing.claimed
        at = end = 0  # the byte that is looked at; the end of the last good frame
        size = len(data)
        while True:
            if self._watch and at == end and in_step:
                watched = self._watched(data, end)
                if watched is not False:
                    result.stop, result.waits, result.delimited = end, watched is None, bool(watched)
                    result.waiting_end = end + len(self._watch)
                    break
            match = self._header.search(data, at)
            start = size if match is None else match.start()
            early = self._tail(data, at, min(start + 1, size))
            if early is not None:
                result.stop, result.waits, result.waiting_end = early, True, early + 1
                break
            if match is None:
                break
            at, which = start + 1, self._which(match[0])
            if which is None:
                result.unknown_id += start >= claimed
                continue
            index = which[1]
            family = self._families[index]
            length = family.length_of(data, start)
            if length is None or start + length > size:
                result.stop, result.waits, result.waiting_end = start, True, start + (length or 1)
                break
            frame = data[start : start + length]
            form = family.form(frame) if length else Flaw.CHECKSUM
            if not isinstance(form, Flaw) and family.confirm and not (in_step and start == end):
                confirmed = self._confirmed(index, form, frame, data, start + length, last)
                if confirmed is None:
                    result.stop, result.waits, result.waiting_end = start, True, start + length
                    break
                form = form if confirmed else Flaw.CHECKSUM
            if isinstance(form, Flaw):
                if start >= claimed:
                    result.bad_checksum += form is Flaw.CHECKSUM
                    result.bad_delimiter += form is Flaw.DELIMITER
                    claimed = start + length
                continue
            _, frames, starts = found[index].setdefault(id(form), (form, [], []))
            frames.append(frame)
            starts.append(start)
            result.resyncs += start != end or not in_step
            in_step, claimed = True, 0
            at = end = start + length
            if first_only:
                result.stop = end
                break
            if self._confirms:
                self.newest[index] = (form, frame)
        result.standing = Standing(in_step and end == result.stop, claimed).moved(result.stop)
        result.found = grouped(found)
        return result

    def scan_clean(self, piece: NDArray[np.uint8], standing: Standing) -> Scan | None:
        """Take the piece, bytes (m,), as frames of one form without a flaw between them; None where it is not that."""
        match = self._known.match(piece[: self._longest_header].tobytes())
        which = None if match is None else self._which(match[0])
        if which is None:
            return None
        header, index = which
        family = self._families[index]
        length = family.length_of(piece[:512].tobytes(), 0)
        n = len(piece) // length if length else 0
        if not length or n == 0 or (family.confirm and not standing.in_step):
            return None
        rows = piece[: n * length].reshape(n, length)
        places = np.arange(n, dtype=np.int64) * length
        begins = rows[:, : len(header)] == np.frombuffer(header, np.uint8)
        if None in header.told:
            begins |= [byte is None for byte in header.told]
        if not begins.all():
            return None
        if not family.steady and not (family.lengths(piece, places) == length).all():
            return None
        verdict = family.forms(rows)
        if len(verdict.forms) != 1 or not verdict.forms[0][1].all():
            return None
        layout = verdict.forms[0][0]
        if self._confirms:
            self.newest[index] = (layout, rows[-1].tobytes())
        found: list[list[Group]] = [[(layout, rows, places)] if other is family else [] for other in self._families]
        return Scan(n * length, Standing(), found, resyncs=int(not standing.in_step))

    def scan_many(self, piece: NDArray[np.uint8], standing: Standing, *, last: bool = False) -> Scan:
        """Verify every candidate in the piece, bytes (m,), at once, then walk over them."""
        unknown, unfinished, candidates = self._candidates(piece)
        groups = [(index, *group) for index, found in enumerate(candidates) for group in found.groups]
        counts = [int(good.sum()) for _, _, _, good, _ in groups]
        starts = np.concatenate([np.empty(0, np.int64), *(places[good] for _, places, _, good, _ in groups)])
        lengths = np.repeat([rows.shape[1] for _, _, rows, _, _ in groups], counts).astype(np.int64)
        which = np.repeat(np.arange(len(groups)), counts)
        order = np.argsort(starts, kind="stable")
        ordered, ends = starts[order], (starts + lengths)[order]
        taken, refused, doubtful = self._walk(piece, groups, which[order], ordered, ends, standing, last)

        waiting = [*unfinished, *(each for found in candidates for each in found.incomplete)]
        good_starts, good_ends = ordered[taken], ends[taken]
        waiting = [each for each in waiting if not covered(np.array([each[0]]), good_starts, good_ends)[0]]
        waiting += [] if doubtful is None else [doubtful]
        stop, waiting_end = min(waiting, default=(len(piece), 0))
        delimited = self._first_watched(piece, good_ends[good_ends <= stop], standing)
        if delimited is not None and delimited[0] <= stop:
            stop, waiting_end = delimited[0], delimited[0] + len(self._watch)
        taken &= ordered < stop
        good_starts, good_ends = ordered[taken], ends[taken]

        result = Scan(stop, standing, [[] for _ in self._families])
        result.delimited = delimited is not None and delimited[0] == stop and delimited[1]
        result.waits, result.waiting_end = waiting_end > 0 and not result.delimited, waiting_end
        breaks = int((good_starts[1:] != good_ends[:-1]).sum())
        result.resyncs = breaks + (bool(len(good_starts)) and (int(good_starts[0]) > 0 or not standing.in_step))
        last_end = int(good_ends[-1]) if len(good_ends) else 0
        in_step = (standing.in_step or bool(len(good_ends))) and last_end == stop
        failures = [(p, np.full(len(p), n), flaw) for found in candidates for p, n, flaw in found.failed]
        failures.append((ordered[refused], (ends - ordered)[refused], Flaw.CHECKSUM))
        claimed = self._count(result, failures, unknown, good_starts, good_ends, standing.claimed)
        result.standing = Standing(in_step, claimed).moved(stop)

        accepted = np.zeros(len(starts), np.bool_)
        accepted[order] = taken
        edge = 0
        for count, (index, places, rows, good, layout) in zip(counts, groups, strict=True):
            mine = np.flatnonzero(good)[accepted[edge : edge + count]]
            edge += count
            if len(mine) == len(rows):
                result.found[index].append((layout, rows, places))
            elif len(mine):
                result.found[index].append((layout, rows[mine], places[mine]))
        if self._confirms:
            self._remember(result)
        return result

    def _remember(self, result: Scan) -> None:
        for index, groups in enumerate(result.found):
            if groups:
                layout, rows, _ = max(groups, key=lambda group: int(group[2][-1]))
                self.newest[index] = (layout, rows[-1].tobytes())

    def _count(
        self,
        result: Scan,
        failures: list[tuple[IntArray, IntArray, Flaw]],
        unknown: IntArray,
        good_starts: IntArray,
        good_ends: IntArray,
        claimed: int,
    ) -> int:
        """Count what failed, each candidate once; return how far the last of them reaches."""
        places = np.concatenate([unknown, *(places for places, _, _ in failures)])
        reach = np.concatenate([np.zeros(len(unknown), np.int64), *(lengths for _, lengths, _ in failures)])
        kinds = np.concatenate([np.full(len(unknown), -1), *(np.full(len(p), int(flaw)) for p, _, flaw in failures)])
        open_ = (places < result.stop) & ~covered(places, good_starts, good_ends)
        order = np.argsort(places[open_], kind="stable")
        places, reach, kinds = places[open_][order], reach[open_][order], kinds[open_][order]
        behind = np.searchsorted(good_starts, places, side="right")
        stretch = 0  # the number of good frames before; each ends the claims before it
        for place, length, kind, frames in zip(
            places.tolist(), reach.tolist(), kinds.tolist(), behind.tolist(), strict=True
        ):
            if frames != stretch:
                claimed, stretch = 0, frames
            if place < claimed:
                continue
            if kind < 0:
                result.unknown_id += 1
                continue
            claimed = place + length
            result.bad_checksum += kind == Flaw.CHECKSUM
            result.bad_delimiter += kind == Flaw.DELIMITER
        return claimed if stretch == len(good_starts) else 0

    def _walk(
        self,
        piece: NDArray[np.uint8],
        groups: Sequence[tuple[int, IntArray, Rows, NDArray[np.bool_], FrameLayout]],
        which: IntArray,
        starts: IntArray,
        ends: IntArray,
        standing: Standing,
        last: bool,
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], tuple[int, int] | None]:
        """Return which candidates, sorted by start, the reader takes, which he refuses, and where he is in doubt."""
        n = len(starts)
        taken, refused = np.ones(n, np.bool_), np.zeros(n, np.bool_)
        unsteady = n > 0 and (bool((starts[1:] != ends[:-1]).any()) or int(starts[0]) > 0 or not standing.in_step)
        if not unsteady:
            return taken, refused, None
        confirm = np.array([self._families[group[0]].confirm for group in groups], np.bool_)
        if not self._confirms or not confirm[which].any():
            if (starts[1:] < ends[:-1]).any():
                reached = 0
                for number, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
                    taken[number] = start >= reached
                    reached = end if taken[number] else reached
            return taken, refused, None
        reached, in_step = 0, standing.in_step
        data, newest = piece.tobytes(), self.newest
        self.newest = dict(newest)
        doubt = None
        for number, (start, end, group) in enumerate(zip(starts.tolist(), ends.tolist(), which.tolist(), strict=True)):
            if start < reached or doubt is not None:
                taken[number] = False
                continue
            index, layout, frame = groups[group][0], groups[group][4], data[start:end]
            if confirm[group] and not (in_step and start == reached):
                confirmed = self._confirmed(index, layout, frame, data, end, last)
                if confirmed is None:
                    doubt = (start, end)
                refused[number] = confirmed is False
                if not confirmed:
                    taken[number] = False
                    continue
            reached, in_step = end, True
            self.newest[index] = (layout, frame)
        self.newest = newest
        return taken, refused, doubt

    def _first_watched(self, piece: NDArray[np.uint8], ends: IntArray, standing: Standing) -> tuple[int, bool] | None:
        """Return the first end of a good frame that the watched delimiter follows, and whether it is all there."""
        if not self._watch:
            return None
        places = np.concatenate([np.zeros(int(standing.in_step), np.int64), ends])
        inside = places < len(piece)
        likely = places[inside][piece[places[inside]] == self._watch[0]]
        for place in likely.tolist():
            watched = self._watched(piece[place : place + len(self._watch)].tobytes(), 0)
            if watched is not False:
                return place, bool(watched)
        return None

    def _candidates(self, piece: NDArray[np.uint8]) -> tuple[IntArray, list[tuple[int, int]], list[Candidates]]:
        """Return the places with a sync but an unknown id, unfinished headers, and the candidates of every type."""
        if self._sync:
            places = np.flatnonzero(piece[: max(0, len(piece) - len(self._sync) + 1)] == self._sync[0])
            for depth, byte in enumerate(self._sync[1:], start=1):
                places = places[piece[places + depth] == byte]
        else:
            firsts = np.zeros(256, np.bool_)
            firsts[[header[0] for header, _ in self._headers]] = True
            places = np.flatnonzero(firsts[piece])
        size = self._longest_header
        tail = piece[max(0, len(piece) - size + 1) :].tobytes()
        shift = len(piece) - len(tail)
        unfinished = [(shift + at, shift + at + 1) for at in range(len(tail)) if self._unfinished(tail, at)]
        places = places[~np.isin(places, [place for place, _ in unfinished])] if unfinished else places

        known = np.zeros(len(places), np.bool_)
        of_family: list[list[IntArray]] = [[] for _ in self._families]
        for header, index in self._headers:
            mine = places + len(header) <= len(piece)
            for depth, told in enumerate(header.told[len(self._sync) :], start=len(self._sync)):
                if told is not None:
                    mine &= piece.take(places + depth, mode="clip") == told
            if mine.any():
                known |= mine
                of_family[index].append(places[mine])
        candidates = []
        for family, parts in zip(self._families, of_family, strict=True):
            mine_at = np.sort(np.concatenate([np.empty(0, np.int64), *parts]))
            candidates.append(judge(piece, mine_at, family))
        return (places[~known] if self._sync else places[:0]), unfinished, candidates
