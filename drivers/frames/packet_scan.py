"""Finding the good frames in a stream of packets: each packet is one frame, or none."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from drivers.frames.families import FrameFamily
from drivers.frames.layout import FrameLayout
from drivers.frames.packets import LONGEST, PacketDescription
from drivers.frames.scan_result import Group, Scan, Standing


class PacketScanner:
    """Looks for the frames of one stream of packets."""

    def __init__(self, sync: bytes, families: Sequence[FrameFamily], packets: PacketDescription) -> None:
        headers = [(header, index) for index, family in enumerate(families) for header in family.headers]
        headers.sort(key=lambda each: -len(each[0]))
        self._known = re.compile(b"|".join(b"(" + header.pattern + b")" for header, _ in headers), re.DOTALL)
        self._of_group = [index for _, index in headers]
        self._sync, self._families, self._packets = sync, families, packets
        self.newest: dict[int, tuple[FrameLayout, bytes]] = {}

    def scan(self, data: bytes, standing: Standing, *, last: bool) -> Scan:
        """Scan the packets that end in `data`; what follows them waits for its end, unless it is too long for one."""
        result = Scan(0, standing, [])
        alike: dict[tuple[int, int], tuple[list[bytes], list[int], list[int]]] = {}
        verdicts = []  # place and whether it is good, of every packet
        for start, end, content in self._packets.split(data):
            result.stop = end
            if content == b"":
                result.stuffing += end - start
                continue
            match = None if content is None else self._known.match(content)
            if content is None or match is None or match.lastindex is None:
                known = content is None or not self._sync or not content.startswith(self._sync)
                result.bad_checksum += known
                result.unknown_id += not known
                verdicts.append((start, False))
                continue
            index = self._of_group[match.lastindex - 1]
            if self._families[index].length_of(content, 0) != len(content):
                result.bad_checksum += 1
                verdicts.append((start, False))
                continue
            frames, starts, ends = alike.setdefault((index, len(content)), ([], [], []))
            frames.append(content)
            starts.append(start)
            ends.append(end)
        result.found = [[] for _ in self._families]
        for (index, length), (frames, begins, ends) in alike.items():
            rows = np.frombuffer(b"".join(frames), np.uint8).reshape(-1, length)
            places = np.array(begins, np.int64)
            verdict = self._families[index].forms(rows)
            good = verdict.sums_match & verdict.ends_match
            result.bad_checksum += int((~verdict.sums_match).sum())
            result.bad_delimiter += int((verdict.sums_match & ~verdict.ends_match).sum())
            result.stuffing += int((np.array(ends) - places - length)[good].sum())
            verdicts += zip(begins, good.tolist(), strict=True)
            groups: list[Group] = [(layout, rows[mine], places[mine]) for layout, mine in verdict.forms if mine.any()]
            result.found[index] += groups
        in_step = standing.in_step
        for _, each in sorted(verdicts):
            result.resyncs += each and not in_step
            in_step = each
        rest = len(data) - result.stop
        if rest and (last or rest > 2 * LONGEST):
            result.stop, in_step = len(data), False
        result.waits, result.waiting_end = result.stop < len(data), len(data)
        result.standing = Standing(in_step, 0)
        return result
