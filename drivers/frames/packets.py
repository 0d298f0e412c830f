"""Packets: a stream whose bytes are stuffed, so that what ends a packet stands nowhere else.

    packets: {kind: slip}    # C0 ends, DB DC and DB DD stand for C0 and DB
    packets: {kind: hdlc}    # 7E ends, 7D is followed by the byte with bit 5 turned
    packets: {kind: dle}     # 10 (STX or an id) begins, 10 03 ends, 10 10 stands for 10
    packets: {kind: cobs}    # 00 ends, the rest tells how far it is to the next 00
    packets: {kind: lines}   # LF or CR LF ends: text whose lines begin with nothing in particular

A packet is one frame, whole. Its fields, length and checksum are described as they are once the stuffing is taken out.
"""

import re
from collections.abc import Iterator
from functools import cached_property
from typing import Literal

from pydantic import Field

from drivers.frames.notation import HexBytes
from drivers.strict_yaml import Section

_ENDS = {"slip": b"\xc0", "hdlc": b"\x7e", "dle": b"\x10\x03", "cobs": b"\x00", "lines": b"\n"}
_ESCAPES = {"slip": b"\xdb", "hdlc": b"\x7d"}
LONGEST = 8192


class PacketDescription(Section):
    """How packets are told apart. `end` and `escape` replace what is usual for the kind."""

    kind: Literal["slip", "hdlc", "dle", "cobs", "lines"]
    end: HexBytes = Field(default=b"", max_length=2)
    escape: HexBytes = Field(default=b"", max_length=1)

    def _check(self) -> None:
        if (self.escape and self.kind not in ("slip", "hdlc")) or len(self.end or _ENDS[self.kind]) != len(
            _ENDS[self.kind]
        ):
            raise ValueError(f"kind: {self.kind} has no such end or escape")

    @cached_property
    def _rules(self) -> tuple[re.Pattern[bytes], re.Pattern[bytes], dict[bytes, bytes]]:
        """What matches a packet, what an escape with the byte behind it, and what that byte stands for."""
        end = self.end or _ENDS[self.kind]
        escape = end[:1] if self.kind == "dle" else self.escape or _ESCAPES.get(self.kind, end)
        first, last = re.escape(end[:1]), re.escape(end[1:])
        packet = b"([^%b]*)%b" % (first, first)
        if self.kind == "dle":
            packet = b"((?:[^%b]|%b[^%b])*)%b%b" % (first, first, last, first, last)
        codes = {b"\xdc": end, b"\xdd": escape} if self.kind == "slip" else {escape: escape}
        codes = {bytes([byte ^ 0x20]): bytes([byte]) for byte in range(256)} if self.kind == "hdlc" else codes
        return re.compile(packet), re.compile(re.escape(escape) + b"(.?)", re.DOTALL), codes

    def split(self, data: bytes) -> Iterator[tuple[int, int, bytes | None]]:
        """Yield where each whole packet in `data` begins and ends, and what it holds; None where that cannot be."""
        for match in self._rules[0].finditer(data):
            yield match.start(), match.end(), self._content(match[0] if self.kind == "lines" else match[1])

    def _content(self, stuffed: bytes) -> bytes | None:
        _, escaped, codes = self._rules
        if self.kind == "lines":
            return stuffed if stuffed.strip() else b""
        if self.kind == "cobs":
            return _cobs(stuffed)
        if self.kind == "dle":
            if stuffed[:1] not in codes:
                return None
            stuffed = stuffed[1:]
        try:
            return escaped.sub(lambda match: codes[match[1]], stuffed)
        except KeyError:
            return None


def _cobs(stuffed: bytes) -> bytes | None:
    content, at = b"", 0
    while at < len(stuffed):
        code = stuffed[at]
        if at + code > len(stuffed):
            return None
        content += stuffed[at + 1 : at + code] + (b"\0" if code < 255 and at + code < len(stuffed) else b"")
        at += code
    return content
