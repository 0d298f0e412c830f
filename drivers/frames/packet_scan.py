"""Finding the good frames in a stream of packets: each packet is one frame, or none."""

import re
from collections.abc import Sequence

from drivers.frames.families import Flaw, FrameFamily
from drivers.frames.packets import LONGEST, PacketDescription
from drivers.frames.scan_result import Found, Scan, Standing, grouped


class PacketScanner:
    """Looks for the frames of one stream of packets."""

    def __init__(self, sync: bytes, families: Sequence[FrameFamily], packets: PacketDescription) -> None:
        headers = [(header, index) for index, family in enumerate(families) for header in family.headers]
        headers.sort(key=lambda each: -len(each[0]))
        self._known = re.compile(b"|".join(b"(" + header.pattern + b")" for header, _ in headers), re.DOTALL)
        self._of_group = [index for _, index in headers]
        self._sync, self._families, self._packets = sync, families, packets

    def scan(self, data: bytes, standing: Standing, *, last: bool) -> Scan:
        """Scan the packets that end in `data`; what follows them waits for its end, unless it is too long for one."""
        found: list[Found] = [{} for _ in self._families]
        result, in_step = Scan(0, standing, []), standing.in_step
        for start, result.stop, content in self._packets.split(data):
            if content == b"":
                result.stuffing += result.stop - start
                continue
            match = None if content is None else self._known.match(content)
            if content is None or match is None or match.lastindex is None:
                unknown = content is not None and self._sync and content.startswith(self._sync)
                result.unknown_id += bool(unknown)
                result.bad_checksum += not unknown
                in_step = False
                continue
            index = self._of_group[match.lastindex - 1]
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
        result.waits, result.waiting_end = result.stop < len(data), len(data)
        result.standing, result.found = Standing(in_step), grouped(found)
        return result
