"""Finding the good frames in a piece of a stream, or in its packets.

The meaning is that of a reader who stands at one byte at a time. Where a header begins and the whole frame is there,
its checksum and delimiter are verified: a good frame is taken and the reader goes on behind it; otherwise he goes on
ONE byte, so that a damaged frame never takes a good neighbour with it. Where the frame (or the header) is not all
there yet, he stops and waits. Frames of one form that go on following one another without a flaw are taken at once, as
many as have earned it by those before them. Whether they are is a matter of speed only.

A candidate that fails is counted once: what looks like a header inside it is not counted again. Where a checksum asks
for confirmation, a frame that does not follow a good one directly is believed only where the next header follows it or
its counter goes on from the last good frame of its type; where neither is there yet, the reader waits.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.frames.layout import Flaw, FrameFamily, FrameLayout
from drivers.frames.notation import Header
from drivers.frames.packets import LONGEST, PacketDescription
from drivers.frames.wire import IntArray, Rows

Group = tuple[FrameLayout, Rows, IntArray]  # frames of one form: their layout, bytes and places
Found = dict[int, tuple[FrameLayout, list[bytes], list[int]]]  # the same, one by one


@dataclass
class Scan:
    """What was found in a piece. Positions count from the piece's first byte.

    `stop` is the first byte that is not decided yet. Something may begin there that `reach` bytes, more than are there,
    would hold; where that is 0, what follows `stop`, if anything, has not been looked at. `found` holds, per frame
    type, the good frames: bytes (n, length) and places (n,) of each form. `stuffing` counts bytes around or within good
    frames that are no part of them.
    """

    stop: int
    found: list[list[Group]]
    reach: int = 0
    bad_checksum: int = 0
    bad_delimiter: int = 0
    unknown_id: int = 0
    stuffing: int = 0
    resyncs: int = 0


def grouped(found: Found) -> list[Group]:
    """Return frames that were found one by one as groups: bytes (n, length) and places (n,) of each form."""
    return [
        (layout, np.frombuffer(b"".join(frames), np.uint8).reshape(len(frames), -1), np.array(starts, np.int64))
        for layout, frames, starts in found.values()
    ]


_FEW = 4096  # bytes below which looking at frames one by one is faster
_NONE: Rows = np.empty((0, 0), np.uint8)
_TRUST = 4  # times as many frames are looked at at once as went before without a flaw …
_MOST = 1 << 20  # … in so many bytes, which stay in the processor's cache
_GOES_ON = 8  # frames that may be missing before one that its counter confirms
_TELLING = 64  # frames after which a counter comes round, at least, for it to confirm anything


class Scanner:
    """Looks for the frames of one stream, and for what may follow each of them: the first good one tells whether."""

    def __init__(self, sync: bytes, families: Sequence[FrameFamily]) -> None:
        self._sync = sync
        self._families = families
        headers = ((header, index) for index, family in enumerate(families) for header in family.headers)
        self._headers = sorted(headers, key=lambda each: -len(each[0]))  # of packets one may begin another
        self._longest_header = max((len(header) for header, _ in self._headers), default=0)
        known = b"|".join(b"(" + header.pattern + b")" for header, _ in self._headers)
        self._known = re.compile(known, re.DOTALL)
        self._header = re.compile(known + (b"|" + re.escape(sync) if sync else b""), re.DOTALL)
        begun = b"|".join(header.begun for header, _ in self._headers if header.begun)
        self._begun = re.compile(b"(?:" + (begun or b"(?!)") + rb")\Z", re.DOTALL)
        self._confirms = any(family.confirm for family in families)
        self._optional = max((family.optional for family in families), default=b"")
        self.interrupt()

    def interrupt(self) -> None:
        """Forget what was seen of the unit."""
        # Whether the reader stands right behind a good frame, and how far the last failed candidate reaches.
        self._in_step, self._claimed = True, 0
        self._newest: dict[int, tuple[FrameLayout, bytes]] = {}  # by frame type, for counters that confirm
        self._delimited: bool | None = None  # whether it sends the optional delimiter
        self._streak, self._form = 0, self._families[0].shortest_layout  # how many frames of it followed one another
        self._worth = _FEW  # bytes to look at at once: where runs were short, more

    def _which(self, match: re.Match[bytes] | None) -> tuple[Header, int] | None:
        """Return the header that was found with its frame type, None where it is the sync alone, or nothing."""
        return self._headers[match.lastindex - 1] if match is not None and match.lastindex else None

    def _unfinished(self, data: bytes, at: int) -> bool:
        return len(data) - at < self._longest_header and self._begun.match(data, at) is not None

    def _behind(self, optional: bytes, data: bytes, end: int, last: bool) -> bytes | Flaw | None:
        """Return what of the optional delimiter stands behind a good frame, or its flaw; None where more may come."""
        behind = data[end : end + len(optional)]
        if not optional.startswith(behind):
            self._delimited = bool(self._delimited)
            return Flaw.DELIMITER if self._delimited else b""
        if len(behind) < len(optional) and not last and (behind or self._delimited is not False):
            return None
        if behind and behind == optional:
            self._delimited = True
        return behind

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
        counter, before = layout.description.counter, self._newest.get(index)
        if counter is None or before is None or counter.modulus < _TELLING * counter.step:
            return False
        values = []
        for form, content in (before, (layout, frame)):
            if counter.field not in form.numeric:
                return False
            values.append(int(form.wire_values(np.frombuffer(content, np.uint8).reshape(1, -1), counter.field)[0]))
        moved = (values[1] - values[0]) % counter.modulus
        return moved % counter.step == 0 and 1 <= moved // counter.step <= _GOES_ON

    def give_up(self, reach: int) -> bool:
        """Go on one byte behind where something may begin that `reach` bytes would hold; tell whether that is new."""
        is_new = self._claimed == 0
        self._in_step, self._claimed = False, max(self._claimed, reach) - 1
        return is_new

    def scan(self, data: bytes, *, last: bool = False) -> Scan:
        """Scan a piece, which begins where the last scan stopped; `last`: nothing follows."""
        single: list[Found] = [{} for _ in self._families]
        result = Scan(len(data), [[] for _ in self._families])
        in_step, claimed = self._in_step, self._claimed
        # Of a unit that sent none, one may begin behind a frame that was not held back for it.
        begun = self._behind(self._optional, data, 0, last) if in_step and self._delimited is False else b""
        if not isinstance(begun, bytes):
            return Scan(0, result.found, reach=len(self._optional))
        at = end = result.stuffing = len(begun)  # the byte that is looked at; the end of the last good frame
        size = len(data)
        while True:
            match = self._header.search(data, at)
            start = size if match is None else match.start()
            tail = range(max(at, size - self._longest_header + 1), min(start + 1, size))
            early = next((place for place in tail if self._unfinished(data, place)), None)  # a header that has begun
            if early is not None:
                result.stop, result.reach = early, 1
                break
            if match is None:
                break
            at, which = start + 1, self._which(match)
            if which is None:
                result.unknown_id += start >= claimed
                continue
            index = which[1]
            family = self._families[index]
            length = family.length_of(data, start)
            if length is None or start + length > size:
                result.stop, result.reach = start, length or 1
                break
            frame = data[start : start + length]
            form = family.form(frame) if length else Flaw.CHECKSUM
            behind = b"" if isinstance(form, Flaw) else self._behind(family.optional, data, start + length, last)
            if behind is None:
                result.stop, result.reach = start, length + len(family.optional)
                break
            if isinstance(behind, Flaw):
                form, behind = behind, b""
            if not isinstance(form, Flaw) and family.confirm and not (in_step and start == end):
                confirmed = self._confirmed(index, form, frame, data, start + length + len(behind), last)
                if confirmed is None:
                    result.stop, result.reach = start, length
                    break
                form = form if confirmed else Flaw.CHECKSUM
            if isinstance(form, Flaw):
                if start >= claimed:
                    result.bad_checksum += form is Flaw.CHECKSUM
                    result.bad_delimiter += form is Flaw.DELIMITER
                    claimed = start + length
                continue
            follows = in_step and start == end
            result.resyncs += not follows
            self._streak, self._form = self._streak + 1 if follows and form is self._form else 1, form
            each, taken = length + len(behind), 1  # bytes, and frames
            most = min(_TRUST * self._streak, min(_MOST, size - start) // each)
            worth = most > 1 and most * each >= self._worth
            run = self._run(data, start, most, which[0], index, form, behind) if worth else _NONE
            if len(run):
                taken, frame = len(run), run[-1].tobytes()
                places = start + np.arange(taken, dtype=np.int64) * each
                result.found[index] += [*grouped(single[index]), (form, run, places)]
                single[index] = {}
            else:
                _, frames, starts = single[index].setdefault(id(form), (form, [], []))
                frames.append(frame)
                starts.append(start)
            in_step, claimed = True, 0
            at = end = start + taken * each
            result.stuffing += taken * len(behind)
            if self._confirms:
                self._newest[index] = (form, frame)
        self._in_step, self._claimed = in_step and end == result.stop, max(0, claimed - result.stop)
        result.found = [several + grouped(one) for several, one in zip(result.found, single, strict=True)]
        return result

    def _run(
        self, data: bytes, start: int, most: int, header: Header, index: int, form: FrameLayout, behind: bytes
    ) -> Rows:
        """Return the good frame at `start` and those like it, `most` in all, that follow it without a flaw."""
        family = self._families[index]
        whole = np.frombuffer(data, np.uint8, most * (form.length + len(behind)), start).reshape(most, -1)
        rows = np.ascontiguousarray(whole[:, : form.length])
        begins = rows[:, : len(header)] == np.frombuffer(header, np.uint8)
        if None in header.told:
            begins |= [byte is None for byte in header.told]
        run = family.alike(rows, form)
        if not begins.all():
            run &= begins.all(axis=1)
        if behind:
            run &= (whole[:, form.length :] == np.frombuffer(behind, np.uint8)).all(axis=1)
        n = most if run.all() else max(1, int(np.argmin(run)))  # the first is known to be good
        self._streak, self._worth = (self._streak + n, _FEW) if n == most else (0, 2 * self._worth)
        return rows[: n - (bool(family.optional) and not behind)]  # one may begin behind the last


class PacketScanner(Scanner):
    """Looks for the frames of one stream of packets."""

    def __init__(self, sync: bytes, families: Sequence[FrameFamily], packets: PacketDescription) -> None:
        super().__init__(sync, families)
        self._packets = packets

    def scan(self, data: bytes, *, last: bool = False) -> Scan:
        """Scan the packets that end in `data`; what follows them waits for its end, unless it is too long for one."""
        found: list[Found] = [{} for _ in self._families]
        result, in_step = Scan(0, []), self._in_step
        for start, result.stop, content in self._packets.split(data):
            if content == b"":
                result.stuffing += result.stop - start
                continue
            which = None if content is None else self._which(self._known.match(content))
            if content is None or which is None:
                unknown = content is not None and self._sync and content.startswith(self._sync)
                result.unknown_id += bool(unknown)
                result.bad_checksum += not unknown
                in_step = False
                continue
            index = which[1]
            family = self._families[index]
            form = family.form(content) if family.length_of(content, 0) == len(content) else Flaw.CHECKSUM
            if isinstance(form, Flaw):
                result.bad_checksum += form is Flaw.CHECKSUM
                result.bad_delimiter += form is Flaw.DELIMITER
            else:
                _, frames, starts = found[index].setdefault(id(form), (form, [], []))
                frames.append(content)
                starts.append(start)
                result.stuffing += result.stop - start - len(content)
                result.resyncs += not in_step
            in_step = not isinstance(form, Flaw)
        if last or len(data) - result.stop > 2 * LONGEST:
            result.stop, in_step = len(data), in_step and result.stop == len(data)
        result.reach = len(data) - result.stop
        self._in_step, self._claimed = in_step, 0
        result.found = [grouped(each) for each in found]
        return result
