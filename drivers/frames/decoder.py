"""The incremental decoder: bytes as they arrive become columns of good frames, and every byte is accounted for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.frames.description import StreamDescription
from drivers.frames.layout import FrameBatch, FrameLayout, join_rows
from drivers.frames.scan import Scan, Scanner
from drivers.frames.sequence import FrameSequence
from drivers.imu import StreamCounts

_FEW = 16  # below so many frames, looking at them one by one is faster
_PIECE = 16384  # frames that are verified at once; their bytes stay in the processor's cache


@dataclass(frozen=True)
class Decoded:
    """The good frames of one feed by type, in the order of their arrival, and what became of all bytes decided."""

    frames: Mapping[str, FrameBatch]
    counts: StreamCounts

    def __getitem__(self, frame: str) -> FrameBatch:
        return self.frames[frame]


class StreamDecoder:
    """Decodes one stream. How the stream is cut into feeds changes neither the frames nor the counts.

    An incomplete frame is kept for the next feed. Where nothing more arrives for `partial_frame_wait_s` it is given up,
    byte by byte, so that a false header cannot hold back the good frames behind it.
    """

    def __init__(self, description: StreamDescription) -> None:
        self._description = description
        self._layouts = [FrameLayout(description, name) for name in description.frames]
        self._scanner = Scanner(description.sync, self._layouts)
        self._sequences = [FrameSequence(layout) for layout in self._layouts]
        no_rows = [np.empty((0, layout.length), np.uint8) for layout in self._layouts]
        self._nothing = [s.take(r, np.empty(0, np.int64))[0] for s, r in zip(self._sequences, no_rows, strict=True)]
        shortest, longest = (pick(layout.length for layout in self._layouts) for pick in (min, max))
        self._few_bytes = _FEW * shortest
        self._piece_bytes = _PIECE * longest
        self._rest = b""
        self._position = 0  # of the first byte of the rest, in the stream
        self._in_step = True
        self._flawless = True  # the last piece was; the next one probably is
        self._last_arrival_s = 0.0

    @property
    def pending(self) -> bytes:
        """The bytes that wait for the rest of their frame."""
        return self._rest

    def feed(self, data: bytes, arrival_s: float = 0.0) -> Decoded:
        """Take bytes that arrived at `arrival_s` (perhaps none: time passes) and return the frames they complete."""
        if not data:
            waited_s = arrival_s - self._last_arrival_s
            return self._decode(b"", give_up=waited_s >= self._description.partial_frame_wait_s)
        self._last_arrival_s = arrival_s
        return self._decode(data, give_up=False)

    def finish(self) -> Decoded:
        """Return what can still be had at the end of a file: nothing more will arrive."""
        return self._decode(b"", give_up=True)

    def reset(self) -> None:
        """Forget the bytes of an unfinished frame and the last counter: what follows is not continuous with it."""
        self._position += len(self._rest)
        self._rest = b""
        self._in_step = True
        for sequence in self._sequences:
            sequence.interrupt()

    def _decode(self, data: bytes, *, give_up: bool) -> Decoded:
        buffer = self._rest + data if self._rest else data
        scans: list[tuple[int, Scan]] = []  # with the place of its piece in the buffer
        at = timed_out = 0
        while at < len(buffer):
            end = min(at + self._piece_bytes, len(buffer))
            scan = self._scan(buffer, at, end)
            scans.append((at, scan))
            at += scan.stop
            self._in_step = scan.in_step
            if scan.waits and end == len(buffer):  # for bytes that have not arrived
                if not give_up:
                    break
                timed_out += 1
                at += 1
                self._in_step = False
        decoded = self._account(scans, consumed=at, timed_out=timed_out)
        self._rest = buffer[at:]
        self._position += at
        return decoded

    def _scan(self, buffer: bytes, at: int, end: int) -> Scan:
        if end - at < self._few_bytes:
            return self._scanner.scan_few(buffer[at:end], in_step=self._in_step)
        piece = np.frombuffer(buffer, np.uint8, end - at, at)
        scan = self._scanner.scan_clean(piece, in_step=self._in_step) if self._flawless else None
        if scan is None:
            scan = self._scanner.scan_many(piece, in_step=self._in_step)
            only_one_type = sum(len(starts) > 0 for starts in scan.starts) == 1
            self._flawless = only_one_type and scan.resyncs == 0
        return scan

    def _account(self, scans: Sequence[tuple[int, Scan]], *, consumed: int, timed_out: int) -> Decoded:
        frames: dict[str, FrameBatch] = {}
        taken_bytes = ok = lost = duplicate = 0
        for index, layout in enumerate(self._layouts):
            if not any(len(scan.starts[index]) for _, scan in scans):
                frames[layout.name] = self._nothing[index]
                continue
            rows = join_rows([scan.rows[index] for _, scan in scans if len(scan.rows[index])], layout.length)
            starts = np.concatenate([scan.starts[index] + at for at, scan in scans]) + self._position
            taken_bytes += rows.size
            batch, missing, repeated = self._sequences[index].take(rows, starts)
            frames[layout.name] = batch
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
