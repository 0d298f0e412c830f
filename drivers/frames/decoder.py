"""The incremental decoder: bytes as they arrive become columns of good frames, and every byte is accounted for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from drivers.frames.batch import FrameBatch, join
from drivers.frames.counts import StreamCounts
from drivers.frames.decoded import Decoded
from drivers.frames.description import StreamDescription
from drivers.frames.families import families_of
from drivers.frames.few import FewDecoded, FewFrames
from drivers.frames.layout import FrameLayout
from drivers.frames.record import Taking
from drivers.frames.scan import Scanner
from drivers.frames.scan_result import Scan, Standing
from drivers.frames.sequence import FrameSequence

_FEW = 1024  # bytes below which, and as many more for every frame type, looking at frames one by one is faster
_QUICK = 384  # frames below which those of the expected type are verified one by one
_PIECE = 16384  # frames that are verified at once; their bytes stay in the processor's cache
_USUAL_LENGTH = 64  # bytes; a type whose frames may be much longer is not looked at in larger pieces


class StreamDecoder:
    """Decodes one stream. How the stream is cut into feeds changes neither the frames nor the counts.

    An incomplete frame is kept for the next feed. Where nothing more arrives for `partial_frame_wait_s` it is given up,
    byte by byte, so that a false header cannot hold back the good frames behind it. A frame that waits for confirmation
    is then taken: nothing speaks against it.
    """

    def __init__(self, description: StreamDescription) -> None:
        self._description = description
        self._delimiter = description.optional_delimiter
        plain = families_of(description)
        self._scanner = Scanner(description.sync, plain, watch=self._delimiter)
        self._delimited_scanner = self._scanner
        if self._delimiter:
            self._delimited_scanner = Scanner(description.sync, families_of(description, self._delimiter))
        self._delimited: bool | None = None  # whether the unit sends the optional delimiter; the first frame tells
        self._names = [family.name for family in plain]
        rate_hz = description.sample_rate_hz
        self._sequences = [FrameSequence(family.description, rate_hz) for family in plain]
        self._nothing = [_no_frames(family.nothing()) for family in plain]
        longest = max(family.longest for family in plain)
        self._few_bytes = _FEW * (4 + len(plain))
        self._clean_bytes = self._few_bytes // 8
        self._piece_bytes = max(_PIECE * min(longest, _USUAL_LENGTH), 4 * (longest + len(self._delimiter)))
        self._rest = b""
        self._position = 0  # of the first byte of the rest, in the stream
        self._standing = Standing()
        self._flawless = True  # the last piece was; the next one probably is
        self._last_arrival_s = 0.0
        self._families = plain
        self._confirms = any(family.confirm for family in plain)
        self._no_frames: dict[str, FrameBatch] = dict(zip(self._names, self._nothing, strict=True))
        self._few: FewFrames | None = None  # the type of the last frame, for the quick path
        self._few_frames: dict[int, FewFrames] = {}
        self._takers: Mapping[int, Taking] = {}  # what can be taken in one go, where the next frame begins with a feed
        self._quick_bytes = 0

    @property
    def pending(self) -> bytes:
        """The bytes that wait for the rest of their frame."""
        return self._rest

    def feed(self, data: bytes, arrival_s: float = 0.0) -> Decoded:
        """Take bytes that arrived at `arrival_s` (perhaps none: time passes) and return the frames they complete."""
        few, take = self._few, self._takers.get(len(data))
        if few is not None and take is not None:
            # The usual read of a slow stream: nothing here is done twice, or for nobody.
            records = take(data, few.sequence)
            if records is not None:
                self._last_arrival_s = arrival_s
                self._position = end = self._position + len(data)
                decoded: FewDecoded = FewDecoded()
                decoded.few = few
                decoded.data = data
                decoded.end = end
                decoded.number = few.sequence.number
                decoded.known = records
                return decoded
        if not data:
            waited_s = arrival_s - self._last_arrival_s
            return self._decode(b"", give_up=waited_s >= self._description.partial_frame_wait_s)
        self._last_arrival_s = arrival_s
        if few is not None and len(data) < self._quick_bytes:
            waited_for = self._decode_few(data, few)
            if waited_for is not None:
                return waited_for
        return self._decode(data, give_up=False)

    def finish(self) -> Decoded:
        """Return what can still be had at the end of a file: nothing more will arrive.

        What the end cuts off is skipped; it has not timed out, for nobody waited for it.
        """
        decoded = self._decode(b"", give_up=True)
        return Decoded(decoded.frames, replace(decoded.counts, timed_out=0))

    def reset(self) -> None:
        """Forget the bytes of an unfinished frame and the last counter: what follows is not continuous with it."""
        self._position += len(self._rest)
        self._rest = b""
        self._standing = Standing()
        self._delimited = None
        self._few, self._takers = None, {}
        self._scanner.newest.clear()
        for sequence in self._sequences:
            sequence.interrupt()

    def _decode_few(self, data: bytes, few: FewFrames) -> Decoded | None:
        """Decode frames like the one before, in step with it and with their counter; None where they are not so."""
        buffer = self._rest + data if self._rest else data
        n, over = divmod(len(buffer), few.length)
        whole, rest = (buffer[:-over], buffer[-over:]) if over else (buffer, b"")
        if (over and not few.may_begin(rest)) or not few.good(whole, n):
            return None
        if not n:
            self._rest, self._takers = buffer, {}
            return Decoded(self._no_frames, StreamCounts())
        if not few.sequence.advance(whole, n):
            return None
        self._rest, self._takers = rest, {} if rest else few.takers
        self._position += len(whole)
        decoded: FewDecoded = FewDecoded()
        decoded.few, decoded.data, decoded.end, decoded.number = few, whole, self._position, few.sequence.number
        decoded.known = None
        if self._confirms:
            self._scanner.newest[few.index] = (few.layout, whole[-few.length :])
        return decoded

    def _expect_more(self, scans: Sequence[tuple[int, Scan]]) -> None:
        """Remember the type of the last frame, if the next ones can be taken on the quick path."""
        self._few, self._takers = None, {}
        if not self._standing.in_step or not scans or (self._delimiter and self._delimited is None):
            return
        newest = [(int(s[-1]), i, layout) for i, found in enumerate(scans[-1][1].found) for layout, _, s in found]
        if newest:
            _, index, layout = max(newest, key=lambda each: each[0])
            if self._families[index].steady is not None and self._sequences[index].steady(layout):
                known = self._few_frames.get(id(layout))
                if known is None:
                    known = FewFrames(layout, index, self._names[index], self._sequences[index], self._no_frames)
                    self._few_frames[id(layout)] = known
                self._few, self._quick_bytes = known, _QUICK * layout.length
                self._takers = {} if self._rest else known.takers

    def _decode(self, data: bytes, *, give_up: bool) -> Decoded:
        buffer = self._rest + data if self._rest else data
        scans: list[tuple[int, Scan]] = []  # with the place of its piece in the buffer
        at = timed_out = delimiters = 0
        while at < len(buffer):
            end = min(at + self._piece_bytes, len(buffer))
            if self._delimiter and self._delimited is None and not self._look_for_delimiter(buffer, at, end, give_up):
                break
            last = give_up and end == len(buffer)
            scan = self._scan(buffer, at, end, last=last)
            scans.append((at, scan))
            at += scan.stop
            self._standing = scan.standing
            if scan.delimited:
                at += len(self._delimiter)
                delimiters += len(self._delimiter)
                self._delimited = True
            elif scan.waits and end == len(buffer):  # for bytes that have not arrived
                if not give_up:
                    break
                reach = scan.waiting_end - scan.stop
                timed_out += self._standing.claimed == 0
                at += 1
                self._standing = Standing(False, max(self._standing.claimed, reach)).moved(1)
        decoded = self._account(scans, consumed=at - delimiters, timed_out=timed_out)
        self._rest = buffer[at:]
        self._position += at
        self._expect_more(scans)
        return decoded

    def _look_for_delimiter(self, buffer: bytes, at: int, end: int, give_up: bool) -> bool:
        """Let the first good frame tell whether the unit sends the delimiter; False where it does not tell yet."""
        scan = self._scanner.scan_few(buffer[at:end], self._standing, last=give_up, first_only=True)
        if not scan.frames:
            return True
        behind = buffer[at + scan.stop : at + scan.stop + len(self._delimiter)]
        if len(behind) < len(self._delimiter) and self._delimiter.startswith(behind) and not give_up:
            return False
        self._delimited = behind == self._delimiter
        return True

    def _scan(self, buffer: bytes, at: int, end: int, *, last: bool) -> Scan:
        scanner = self._delimited_scanner if self._delimited else self._scanner
        size = end - at
        piece = np.frombuffer(buffer, np.uint8, size, at)
        if self._flawless and size >= self._clean_bytes:
            clean = scanner.scan_clean(piece, self._standing)
            if clean is not None:
                return clean
        if size < self._few_bytes:
            scan = scanner.scan_few(buffer[at:end], self._standing, last=last)
        else:
            scan = scanner.scan_many(piece, self._standing, last=last)
        forms = sum(map(len, scan.found))
        if forms:  # the beginning of a frame tells nothing
            self._flawless = forms == 1 and scan.resyncs == 0
        return scan

    def _account(self, scans: Sequence[tuple[int, Scan]], *, consumed: int, timed_out: int) -> Decoded:
        frames: dict[str, FrameBatch] = {}
        taken_bytes = ok = lost = duplicate = 0
        for index, name in enumerate(self._names):
            groups = [
                (layout, rows, starts + (at + self._position))
                for at, scan in scans
                for layout, rows, starts in scan.found[index]
            ]
            if not groups:
                frames[name] = self._nothing[index]
                continue
            taken_bytes += sum(rows.size for _, rows, _ in groups)
            batch, missing, repeated = self._sequences[index].take(join(groups))
            frames[name] = batch
            ok += len(batch)
            lost += missing
            duplicate += repeated
        counts = StreamCounts(
            ok=ok,
            bad_checksum=sum(scan.bad_checksum for _, scan in scans),
            bad_delimiter=sum(scan.bad_delimiter for _, scan in scans),
            unknown_id=sum(scan.unknown_id for _, scan in scans),
            skipped_bytes=consumed - taken_bytes,
            resyncs=sum(scan.resyncs for _, scan in scans),
            lost=lost,
            duplicate=duplicate,
            timed_out=timed_out,
        )
        return Decoded(frames, counts)


def _no_frames(layout: FrameLayout) -> FrameBatch:
    nothing = np.empty(0, np.int64)
    return FrameBatch(layout, np.empty((0, layout.length), np.uint8), nothing, nothing)
