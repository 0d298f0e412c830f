r"""What stands around a text on the wire: a terminator, a frame with a block check, or nothing but silence.

    >>> frame = Frame(("STX", "text", "check", "ETX"), BlockCheck("sum", ("STX", "text"), "hex", negated=True))
    >>> frame.packed(b"1?")
    b'\x021?8E\x03'
    >>> frame.cut(b"\x021?8E\x03...")
    (b'1?', b'...')

Both sides use it: a driver packs requests and receives replies, a simulator cuts requests and packs replies.
"""

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import reduce
from operator import xor
from typing import Literal

from drivers.errors import DeviceTimeout
from drivers.transports.transport import Transport

CONTROLS = {"SOH": 1, "STX": 2, "ETX": 3, "EOT": 4, "ENQ": 5, "ACK": 6, "LF": 10, "CR": 13, "NAK": 21, "ETB": 23}
"""The control characters that a frame may be made of, by their names."""


Terminator = Literal["CR", "LF", "CR LF"]


class Framing(ABC):
    """How a text is found among bytes."""

    @abstractmethod
    def packed(self, text: bytes) -> bytes:
        """Return the text as it is sent."""

    @abstractmethod
    def received(self, transport: Transport, timeout_s: float, length: int | None = None) -> bytes:
        """Return the next text (of `length` bytes); `DeviceTimeout` where late, `ValueError` for a wrong check."""

    @abstractmethod
    def cut(self, data: bytes) -> tuple[bytes, bytes] | None:
        """Return the first text in `data` and what follows it, None where there is no whole one; else `ValueError`."""


@dataclass(frozen=True)
class Line(Framing):
    """A text and its terminator; blanks around the text mean nothing."""

    terminator: bytes

    def packed(self, text: bytes) -> bytes:
        return text + self.terminator

    def received(self, transport: Transport, timeout_s: float, length: int | None = None) -> bytes:
        return transport.read_until(self.terminator, timeout_s)[: -len(self.terminator)].strip()

    def cut(self, data: bytes) -> tuple[bytes, bytes] | None:
        text, ended, rest = data.partition(self.terminator)
        return (text.strip(), rest) if ended else None


@dataclass(frozen=True)
class Silence(Framing):
    """A text that nothing ends: it has a known length, or is over when nothing has come for `gap_s`, seconds."""

    gap_s: float

    def packed(self, text: bytes) -> bytes:
        """Return the text as it is."""
        return text

    def received(self, transport: Transport, timeout_s: float, length: int | None = None) -> bytes:
        """Return `length` bytes, or what comes until the line is silent."""
        data = transport.read(length or 1, timeout_s)
        if len(data) < (length or 1):
            raise DeviceTimeout(f"{transport.name}: {len(data)} of {length or 'any'} bytes within {timeout_s:g} s")
        while not length and (more := transport.read(1, self.gap_s) + transport.read_available()):
            data += more
        return data

    def cut(self, data: bytes) -> tuple[bytes, bytes] | None:
        """Return everything: what arrived at once is one request."""
        return (data, b"") if data else None


@dataclass(frozen=True)
class BlockCheck:
    """A block check: exclusive or, or sum (`negated`: its two's complement), of the parts named, modulo 256."""

    by: Literal["xor", "sum"]
    over: tuple[str, ...]
    written: Literal["byte", "hex"] = "byte"  # hex: two characters, 0 to 9 and A to F
    negated: bool = False

    @property
    def size(self) -> int:
        """How many bytes it has on the wire."""
        return 1 if self.written == "byte" else 2

    def of(self, data: bytes) -> bytes:
        """Return the check of the bytes of its parts."""
        value = reduce(xor, data, 0) if self.by == "xor" else sum(data)
        value = (-value if self.negated else value) % 256
        return bytes([value]) if self.written == "byte" else f"{value:02X}".encode("ascii")


@dataclass(frozen=True)
class Frame(Framing):
    """Parts in their order: names of `CONTROLS`, `text` once, `address`, and `check` where there is one.

    It begins with a control character and ends with one, but for a check that may come last. `asked` and `told` are the
    parts of questions and of settings where they have others, as in EI-Bisynch; `alone` are control characters that
    come without a frame, and are the text of their name. Raises `ValueError` where it is none of this, and where a
    check that is a byte stands before the end, which it may look like.
    """

    parts: tuple[str, ...]
    check: BlockCheck | None = None
    address: str = ""
    asked: tuple[str, ...] | None = None
    told: tuple[str, ...] | None = None
    alone: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = ("text", "check", *CONTROLS, *(["address"] if self.address else []))
        if unknown := [part for part in (*self.parts, *self.alone) if part not in known]:
            raise ValueError(f"{unknown[0]!r} is no part of a frame; there are {', '.join(known)}")
        if self.parts.count("text") != 1 or self.parts.count("check") != (self.check is not None):
            raise ValueError("a frame has the part text once, and the part check where a check is described")
        if self.parts[0] not in CONTROLS or not self._end:
            raise ValueError("a frame begins with a control character, and has one behind its text")
        if self.check is not None and not set(self.check.over) <= set(self.parts) - {"check"}:
            raise ValueError("a check is over other parts of its frame")
        if self.check is not None and self.check.size == 1 and self.parts[-1] != "check":
            raise ValueError("a check that is a byte comes last: before the end it could look like it")
        self.of(self.asked), self.of(self.told)

    def of(self, parts: tuple[str, ...] | None) -> "Frame":
        """Return the frame of other parts, with the check where they have it; this one where there are none."""
        return self if parts is None else Frame(parts, self.check if "check" in parts else None, self.address)

    def packed(self, text: bytes) -> bytes:
        """Return the frame of a text, or the control character that comes alone under that name."""
        if (name := text.decode("latin-1")) in self.alone:
            return self._fixed(name)
        over = () if self.check is None else self.check.over
        checked = b"".join(text if part == "text" else self._fixed(part) for part in self.parts if part in over)
        whole = {"text": text, "check": b"" if self.check is None else self.check.of(checked)}
        return b"".join(whole.get(part) or self._fixed(part) for part in self.parts)

    def received(self, transport: Transport, timeout_s: float, length: int | None = None) -> bytes:
        data = transport.read(1, timeout_s) if self.alone else b""
        while (found := self.cut(data)) is None:
            data += transport.read_until(self._end, timeout_s)
            if self.parts[-1] == "check":
                data += transport.read(1 if self.check is None else self.check.size, timeout_s)
        return found[0]

    def cut(self, data: bytes) -> tuple[bytes, bytes] | None:
        """Return the text of the first whole frame and what follows it; `ValueError` where its check is wrong."""
        for name in self.alone:
            if data.startswith(self._fixed(name)):
                return name.encode(), data[1:]
        any_check = b".{%d}" % (0 if self.check is None else self.check.size)
        open_parts = {"text": b"(?P<text>.*?)", "check": any_check}
        pattern = b"".join(open_parts.get(part) or re.escape(self._fixed(part)) for part in self.parts)
        found = re.search(pattern, data, re.DOTALL)
        if found is not None and self.packed(found["text"]) != found[0]:
            raise ValueError("a frame with a wrong block check")
        return found and (found["text"], data[found.end() :])

    @property
    def _end(self) -> bytes:
        after = self.parts[self.parts.index("text") + 1 :]
        return b"".join(self._fixed(part) for part in after if part != "check")

    def _fixed(self, part: str) -> bytes:
        if part == "address":
            return self.address.encode("ascii")
        return bytes([CONTROLS[part]]) if part in CONTROLS else b""


@dataclass(frozen=True)
class Framings:
    """What stands around the texts of questions, of settings and of replies, and in what they are written."""

    asked: Framing
    told: Framing
    replied: Framing
    encoding: str = "ascii"


def lines(told: Terminator, replied: Terminator | None = None, encoding: str = "ascii") -> Framings:
    """Return the framings of a controller that speaks lines, by what ends what it is told and what it replies."""
    line, reply = (Line(bytes(CONTROLS[name] for name in each.split())) for each in (told, replied or told))
    return Framings(line, line, reply, encoding)
