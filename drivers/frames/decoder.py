"""The incremental decoder: bytes as they arrive become columns of good frames, and every byte is accounted for.

A unit may spread a sample over several frames: acceleration in one, rates in the next.

    frames:
      acceleration: {id: "51", …}
      rate: {id: "52", …}
      sample: {parts: [acceleration, rate]}           # in this order; or, with `by: count`, those of one count

A sample begins with a frame that does not come behind the one before it in the list (or whose `by` is another). A part
that did not arrive is NaN, and counts as lost. The sample whose parts may still come is kept for the next feed.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frames.batch import Decoded, FrameBatch, Part, join
from drivers.frames.counts import StreamCounts
from drivers.frames.description import FrameDescription, StreamDescription
from drivers.frames.layout import FrameFamily, FrameLayout
from drivers.frames.roles import CounterDescription, TimeDescription
from drivers.frames.scan import Group, PacketScanner, Scan, Scanner
from drivers.frames.wire import IntArray

_OF_A_SCAN = ("bad_checksum", "bad_delimiter", "unknown_id", "resyncs")

Mask = NDArray[np.bool_]


class FrameSequence:
    """Follows the counter of one frame type over any number of feeds.

    A frame whose counter did not move repeats the one before it: it is counted and left out. A counter that moved by
    more than one step means lost frames; outages of a whole turn of the counter and more cannot be seen in it, and are
    resolved by arrival time elsewhere. Without a counter the unit's own time tells; without either, frames count on.
    """

    def __init__(self, frame: FrameDescription, rate_hz: float) -> None:
        self._told_by = frame.counter or frame.time
        self._rate_hz = rate_hz
        self.last: float | None = None  # counter (or time) of the last frame
        self.number = -1  # its unwrapped number, in frames
        self._continuous = True

    def interrupt(self) -> None:
        """Frames are left out on purpose from here to the next one: they are not lost, and it repeats nothing."""
        self._continuous = False

    def take(self, batch: FrameBatch) -> tuple[Mask, IntArray, int]:
        """Make n ≥ 1 frames a part of the sequence.

        Return which of them are no repetitions, shape (n,), their numbers, shape (kept,), and how many frames were lost
        between them. Frames that lack the counter (it may be an item) do not move it: they get that of the one before.
        """
        told_by, left_out = self._told_by, 0
        there = np.ones(len(batch), np.bool_) if told_by is None else batch.told(told_by.field)
        steps = there.astype(np.int64)
        if told_by is not None and there.any():
            steps[there] = self._steps(told_by, batch.wire(told_by.field)[there])
        if not self._continuous and there.any():
            first = int(np.argmax(there))
            steps[first] = max(1, int(steps[first]))
            left_out, self._continuous = int(steps[first]) - 1, True
        moved, numbers = steps != 0, self.number + np.cumsum(steps)
        lost = int(numbers[-1]) - self.number - int(np.count_nonzero(moved)) - left_out
        self.number = int(numbers[-1])
        kept = moved | ~there
        return kept, numbers[kept], lost

    def _steps(self, told_by: CounterDescription | TimeDescription, values: NDArray[Any]) -> IntArray:
        """Return by how many frames each is ahead of the one before; the very first is one step ahead of nothing."""
        # Decimals of a line of text stay what they are.
        values = values if values.dtype.kind == "f" else values.astype(np.int64)
        step = told_by.step if isinstance(told_by, CounterDescription) else 0
        moved = np.diff(values, prepend=values[0] - step if self.last is None else self.last)
        if told_by.modulus is not None:
            moved %= told_by.modulus
        self.last = values[-1].item()
        if isinstance(told_by, TimeDescription):  # no time is twice the same by mistake, nor goes back
            return np.maximum(1, np.rint(moved * (self._rate_hz * told_by.resolution))).astype(np.int64)
        # A counter between two steps belongs to the nearer; one that moved at all is no repetition.
        return np.where(moved == 0, 0, np.maximum(1, (moved + step // 2) // step)).astype(np.int64)


class SampleJoiner:
    """Puts the samples `name` of one stream together; `parts` are the numbers of their frame types in `names`."""

    def __init__(self, description: StreamDescription, name: str, names: Sequence[str]) -> None:
        self.name, self.layout = name, FrameLayout(description, name, fields={}, offsets={})
        frame = self.layout.description
        self.parts, self._by = [names.index(part) for part in frame.parts], frame.by
        self.sequence = FrameSequence(frame, description.sample_rate_hz)
        self.interrupt()

    def interrupt(self) -> None:
        """Forget the unfinished sample; the next may have begun before."""
        self._held: list[list[Group]] = [[] for _ in self.parts]
        self._begun = False
        self.sequence.interrupt()

    def take(self, groups: Sequence[list[Group]], *, last: bool) -> tuple[FrameBatch | None, int, int]:
        """Return samples that groups of bytes, (n, length), complete (with `last` all), and frames in them and lost."""
        groups = [held + new for held, new in zip(self._held, groups, strict=True)]
        there = [(number, join(each)) for number, each in enumerate(groups) if each]
        if not there:
            return None, 0, 0
        starts = np.concatenate([batch.starts for _, batch in there])
        part = np.repeat([number for number, _ in there], [len(batch) for _, batch in there])
        order = np.argsort(starts, kind="stable")
        part = part[order]
        begins = np.ones(len(part), np.bool_)
        if self._by is None:
            begins[1:] = part[1:] <= part[:-1]
        else:
            count = np.concatenate([batch.wire(self._by) for _, batch in there])[order]
            begins[1:] = count[1:] != count[:-1]
        sample = np.cumsum(begins) - 1
        first = int(np.flatnonzero(begins)[-1])
        whole = len(part) - first == len(self.parts) if self._by else part[-1] == len(self.parts) - 1
        cut = np.inf if whole or last else starts[order[first]]
        self._held = [
            [(layout, rows[at >= cut], at[at >= cut]) for layout, rows, at in each if (at >= cut).any()]
            for each in groups
        ]
        n = int(sample[-1]) + int(cut == np.inf)
        if not n:
            return None, 0, 0
        numbers = np.empty(len(order), np.int64)
        numbers[order] = sample
        edges = np.cumsum([0, *(len(batch) for _, batch in there)])
        parts, places, begun = list[Part](), list[IntArray](), np.empty(n, np.int64)
        for edge, (_, batch) in reversed(list(zip(edges, there, strict=False))):
            place = numbers[edge : edge + len(batch)]
            keep = place < n
            parts[:0] = [(layout, rows[keep[at]], place[at][keep[at]]) for layout, rows, at in batch.parts]
            places.append(place[keep])
            begun[place[keep]] = batch.starts[keep]  # a sample begins with its first part
        frames = sum(map(len, places))
        missing = n * len(self.parts) - sum(len(np.unique(place)) for place in places)
        if self._by is None:
            missing -= 0 if self._begun else int(part[0])
            missing -= len(self.parts) - 1 - int(part[-1]) if last and not whole else 0
        self._begun = True
        return FrameBatch(self.layout, parts, begun, np.arange(n)), frames, missing


class StreamDecoder:
    """Decodes one stream. How the stream is cut into feeds changes neither the frames nor the counts.

    An incomplete frame is kept for the next feed. Where nothing more arrives for `partial_frame_wait_s` it is given up,
    byte by byte, lest a false header hold back good frames behind it; one that waits for confirmation is taken.
    """

    def __init__(self, description: StreamDescription) -> None:
        self._description = description
        plain = [FrameFamily(description, name) for name, frame in description.frames.items() if not frame.parts]
        packets = description.packets
        self._scanner = PacketScanner(description.sync, plain, packets) if packets else Scanner(description.sync, plain)
        self._names = [family.name for family in plain]
        rate_hz = description.sample_rate_hz
        self._sequences = [FrameSequence(family.description, rate_hz) for family in plain]
        self._joined = [
            SampleJoiner(description, name, self._names) for name, each in description.frames.items() if each.parts
        ]
        self._taken = {part for each in self._joined for part in each.parts}
        own = {each.name: each.shortest_layout for index, each in enumerate(plain) if index not in self._taken}
        layouts = own | {each.name: each.layout for each in self._joined}
        self._nothing = {name: _no_frames(layout) for name, layout in layouts.items()}
        self._rest = b""
        self._position = 0  # of the first byte of the rest, in the stream
        self._last_arrival_s = 0.0

    def feed(self, data: bytes, arrival_s: float = 0.0) -> Decoded:
        """Take bytes that arrived at `arrival_s` (perhaps none: time passes) and return the frames they complete."""
        if data:
            self._last_arrival_s = arrival_s
        waited_s = arrival_s - self._last_arrival_s
        return self._decode(data, give_up=not data and waited_s >= self._description.partial_frame_wait_s)

    def finish(self) -> Decoded:
        """Return what can still be had at the end of a file: what it cuts off is skipped, and has not timed out."""
        decoded = self._decode(b"", give_up=True)
        return Decoded(decoded.frames, replace(decoded.counts, timed_out=0))

    def reset(self) -> None:
        """Forget the bytes of an unfinished frame and the last counter: what follows is not continuous with it."""
        self._position += len(self._rest)
        self._rest = b""
        self._scanner.interrupt()
        for sequence in self._sequences:
            sequence.interrupt()
        for joiner in self._joined:
            joiner.interrupt()

    def _decode(self, data: bytes, *, give_up: bool) -> Decoded:
        buffer = self._rest + data if self._rest else data
        scans: list[tuple[int, Scan]] = []  # with where in the buffer it began
        at = timed_out = 0
        while at < len(buffer):
            scan = self._scanner.scan(buffer[at:], last=give_up)
            scans.append((at, scan))
            at += scan.stop
            if scan.reach:  # to bytes that have not arrived
                if not give_up:
                    break
                timed_out += self._scanner.give_up(scan.reach)
                at += 1
        decoded = self._account(scans, consumed=at, timed_out=timed_out, last=give_up)
        self._rest = buffer[at:]
        self._position += at
        return decoded

    def _account(self, scans: Sequence[tuple[int, Scan]], *, consumed: int, timed_out: int, last: bool) -> Decoded:
        frames = dict(self._nothing)
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
            elif groups:
                frames[name], missing, repeated = _numbered(join(groups), self._sequences[index])
                ok, lost, duplicate = ok + len(frames[name]), lost + missing, duplicate + repeated
            taken_bytes += sum(rows.size for _, rows, _ in groups)
        for each in self._joined:
            samples, count, absent = each.take([parts[index] for index in each.parts], last=last)
            if samples is not None:
                frames[each.name], missing, repeated = _numbered(samples, each.sequence)
                ok, lost, duplicate = ok + count - repeated, lost + missing + absent, duplicate + repeated
        seen = {name: sum(getattr(scan, name) for _, scan in scans) for name in _OF_A_SCAN}
        told = {"ok": ok, "lost": lost, "duplicate": duplicate, "timed_out": timed_out}
        counts = StreamCounts(skipped_bytes=consumed - taken_bytes, **seen, **told)
        return Decoded(frames, counts)


def _numbered(batch: FrameBatch, sequence: FrameSequence) -> tuple[FrameBatch, int, int]:
    """Return a batch without repetitions and with its numbers, how many frames were lost, and were repeated."""
    keep, numbers, missing = sequence.take(batch)
    repeated = len(batch) - len(numbers)
    if repeated:
        return batch.select(keep, numbers), missing, repeated
    batch.sequence = numbers
    return batch, missing, 0


def _no_frames(layout: FrameLayout) -> FrameBatch:
    nothing = np.empty(0, np.int64)
    return FrameBatch(layout, [(layout, np.empty((0, layout.length), np.uint8), slice(None))], nothing, nothing)
