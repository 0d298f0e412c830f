"""The incremental decoder: bytes as they arrive become columns of good frames, and every byte is accounted for."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.frames.batch import Decoded, FrameBatch, join
from drivers.frames.counts import StreamCounts
from drivers.frames.description import StreamDescription
from drivers.frames.families import families_of
from drivers.frames.joining import SampleJoiner
from drivers.frames.layout import FrameLayout
from drivers.frames.packets import LONGEST
from drivers.frames.scan import Group, PacketScanner, Scan, Scanner, Standing
from drivers.frames.sequence import FrameSequence

_FEW = 4096  # bytes below which looking at frames one by one is faster
_PIECE = 16384  # frames that are verified at once; their bytes stay in the processor's cache
_USUAL_LENGTH = 64  # bytes; a type whose frames may be much longer is not looked at in larger pieces
_OF_A_SCAN = ("bad_checksum", "bad_delimiter", "unknown_id", "resyncs")


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
        packets = description.packets
        self._packets = None if packets is None else PacketScanner(description.sync, plain, packets)
        self._scanner = Scanner(description.sync, [] if self._packets else plain, watch=self._delimiter)
        self._delimited_scanner = self._scanner
        if self._delimiter:
            self._delimited_scanner = Scanner(description.sync, families_of(description, self._delimiter))
        self._delimited: bool | None = None  # whether the unit sends the optional delimiter; the first frame tells
        self._names = [family.name for family in plain]
        rate_hz = description.sample_rate_hz
        self._sequences = [FrameSequence(family.description, rate_hz) for family in plain]
        self._nothing = [_no_frames(family.shortest_layout) for family in plain]
        self._joined = [
            SampleJoiner(description, name, self._names) for name, each in description.frames.items() if each.parts
        ]
        self._taken = {part for each in self._joined for part in each.parts}
        longest = max(family.longest for family in plain)
        self._piece_bytes = max(_PIECE * min(longest, _USUAL_LENGTH), 4 * (longest + len(self._delimiter)), 4 * LONGEST)
        self._least_bytes = max(_FEW, 4 * (longest + len(self._delimiter)))
        self._run_bytes = self._piece_bytes  # of the last frames without a flaw; the next ones probably go on as long
        self._runs, self._stretch_bytes = True, self._least_bytes  # whether, else how far not, runs are looked for
        self._rest = b""
        self._position = 0  # of the first byte of the rest, in the stream
        self._standing = Standing()
        self._last_arrival_s = 0.0

    def feed(self, data: bytes, arrival_s: float = 0.0) -> Decoded:
        """Take bytes that arrived at `arrival_s` (perhaps none: time passes) and return the frames they complete."""
        if not data:
            waited_s = arrival_s - self._last_arrival_s
            return self._decode(b"", give_up=waited_s >= self._description.partial_frame_wait_s)
        self._last_arrival_s = arrival_s
        return self._decode(data, give_up=False)

    def finish(self) -> Decoded:
        """Return what can still be had at the end of a file: what it cuts off is skipped, and has not timed out."""
        decoded = self._decode(b"", give_up=True)
        return Decoded(decoded.frames, replace(decoded.counts, timed_out=0))

    def reset(self) -> None:
        """Forget the bytes of an unfinished frame and the last counter: what follows is not continuous with it."""
        self._position += len(self._rest)
        self._rest = b""
        self._standing = Standing()
        self._delimited = None
        self._scanner.newest.clear()
        for sequence in self._sequences:
            sequence.interrupt()
        for joiner in self._joined:
            joiner.interrupt()

    def _decode(self, data: bytes, *, give_up: bool) -> Decoded:
        buffer = self._rest + data if self._rest else data
        scans: list[tuple[int, Scan]] = []  # with the place of its piece in the buffer
        at = timed_out = delimiters = 0
        while at < len(buffer):
            end = min(at + self._piece_bytes, len(buffer))
            if self._delimiter and self._delimited is None and not self._look_for_delimiter(buffer, at, end, give_up):
                break
            scan = self._scan(buffer, at, end, give_up=give_up)
            scans.append((at, scan))
            at += scan.stop
            self._standing = scan.standing
            if scan.delimited:
                at += len(self._delimiter)
                delimiters += len(self._delimiter)
                self._delimited = True
            elif scan.waits:  # for bytes that have not arrived
                if not give_up:
                    break
                reach = scan.waiting_end - scan.stop
                timed_out += self._standing.claimed == 0
                at += 1
                self._standing = Standing(False, max(self._standing.claimed, reach)).moved(1)
        decoded = self._account(scans, consumed=at - delimiters, timed_out=timed_out, last=give_up)
        self._rest = buffer[at:]
        self._position += at
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

    def _scan(self, buffer: bytes, at: int, end: int, *, give_up: bool) -> Scan:
        """Look at what lies between two places, or at a part of it; it waits only where more is to arrive."""
        if self._packets is not None:
            scan = self._packets.scan(buffer[at:end], self._standing, last=give_up and end == len(buffer))
        else:
            scanner = self._delimited_scanner if self._delimited else self._scanner
            clean = None
            if self._runs and end - at >= _FEW:
                clean = scanner.scan_clean(buffer[at : min(end, at + 2 * self._run_bytes)], self._standing)
            self._runs = clean is None or clean.stop >= _FEW
            if clean is not None:
                # Where runs are short, looking for them costs more than looking at frames one by one.
                longer = min(2 * self._stretch_bytes, self._piece_bytes)
                self._stretch_bytes = self._least_bytes if self._runs else longer
                self._run_bytes = max(clean.stop, self._least_bytes)
                return clean
            end = min(end, at + self._stretch_bytes)
            scan = scanner.scan_few(buffer[at:end], self._standing, last=give_up and end == len(buffer))
        scan.waits &= end == len(buffer)
        return scan

    def _account(self, scans: Sequence[tuple[int, Scan]], *, consumed: int, timed_out: int, last: bool) -> Decoded:
        frames: dict[str, FrameBatch] = {}
        ok = lost = duplicate = 0
        taken_bytes = sum(scan.stuffing for _, scan in scans)
        parts: dict[int, list[Group]] = {}
        for index, name in enumerate(self._names):
            groups = [
                (layout, rows, starts + (at + self._position))
                for at, scan in scans
                for layout, rows, starts in scan.found[index]
            ]
            if index in self._taken:
                parts[index] = groups
            elif not groups:
                frames[name] = self._nothing[index]
                continue
            else:
                frames[name], missing, repeated = _numbered(join(groups), self._sequences[index])
                ok, lost, duplicate = ok + len(frames[name]), lost + missing, duplicate + repeated
            taken_bytes += sum(rows.size for _, rows, _ in groups)
        for each in self._joined:
            samples, count, absent = each.take([parts[index] for index in each.parts], last=last)
            frames[each.name] = _no_frames(each.layout)
            if samples is not None:
                frames[each.name], missing, repeated = _numbered(samples, each.sequence)
                ok, lost, duplicate = ok + count - repeated, lost + missing + absent, duplicate + repeated
        seen = {name: sum(getattr(scan, name) for _, scan in scans) for name in _OF_A_SCAN}
        told = {"ok": ok, "lost": lost, "duplicate": duplicate, "timed_out": timed_out}
        counts = StreamCounts(skipped_bytes=consumed - taken_bytes, **seen, **told)
        return Decoded(frames, counts)


def _numbered(batch: FrameBatch, sequence: FrameSequence) -> tuple[FrameBatch, int, int]:
    """Return a batch without repetitions and with its numbers, how many frames were lost, and were repeated."""
    keep, numbers, missing = sequence.take(len(batch), batch.present, batch.wire)
    repeated = len(batch) - len(numbers)
    if repeated:
        return batch.select(keep, numbers), missing, repeated
    batch.sequence = numbers
    return batch, missing, 0


def _no_frames(layout: FrameLayout) -> FrameBatch:
    nothing = np.empty(0, np.int64)
    return FrameBatch(layout, np.empty((0, layout.length), np.uint8), nothing, nothing)
