"""Frames of text: a line of tokens between separators, perhaps with labels and a checksum in digits.

id: "24 56 4E 59 4D 52 2C"   # $VNYMR,
delimiter: 0D 0A
text:
  checksums: [{kind: xor, mark: "*", first: 1, stored: hex, digits: 2}]
fields: {yaw: {type: decimal, unit: deg}, pitch: {type: decimal, unit: deg}}
"""

import re
from collections.abc import Iterable, Mapping
from functools import reduce
from operator import xor
from typing import Annotated, Literal

from pydantic import Field

from drivers.frames.checksums import CrcParameters, message_crc
from drivers.frames.fields import FieldDescription
from drivers.strict_yaml import Section

LINE_END = b"\r\n"
_NUMBER = rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_PRINTABLE = re.compile(rb"[\t\x20-\x7e]*")


class _InDigits(Section):
    """Digits after the last `mark`. `first` is the first covered byte; the mark itself may be covered too."""

    mark: str = Field(min_length=1, max_length=1)
    first: int = Field(default=0, ge=0)
    covers_mark: bool = False
    stored: Literal["hex", "decimal"] = "hex"
    digits: int | None = Field(default=None, ge=1)

    def matches(self, line: bytes) -> bool:
        """Tell whether a line without its delimiter carries the right checksum in this form."""
        at = line.rfind(self.mark.encode())
        digits, covered = line[at + 1 :], line[self.first : at + self.covers_mark]
        if at < self.first or not digits.isalnum() or (self.digits is not None and len(digits) != self.digits):
            return False
        try:
            stored = int(digits, 16 if self.stored == "hex" else 10)
        except ValueError:
            return False
        return stored == (message_crc(self, covered) if isinstance(self, TextCrc) else reduce(xor, covered, 0))


class TextXor(_InDigits):
    """The exclusive or of the covered characters."""

    kind: Literal["xor"]


class TextCrc(_InDigits, CrcParameters):
    """A cyclic redundancy check of the covered characters."""

    kind: Literal["crc"]


class TextDescription(Section):
    """How a line is put together. One of the `checksums` must match, where there are any; `most` bytes are the longest.

    Any of the characters of `separator` parts two tokens; blanks around them do not count.
    """

    separator: str = Field(default=",", min_length=1)
    most: int = Field(default=256, ge=4, le=4096)
    checksums: list[Annotated[TextXor | TextCrc, Field(discriminator="kind")]] = Field(default_factory=list)

    def _check(self) -> None:
        for key, text in [("separator", self.separator), *[("checksums.mark", each.mark) for each in self.checksums]]:
            if not _PRINTABLE.fullmatch(text.encode()):
                raise ValueError(f"{key}: {text!r} is not printable ASCII")

    def length_of(self, data: bytes, start: int, header_size: int, delimiter: bytes) -> int | None:
        """Return the length of the line at `start`: 0 where it is none, None where its end is not there."""
        match = _PRINTABLE.match(data, start + header_size)
        end = start if match is None else match.end()
        for ending in [delimiter] if delimiter else [b"\n", b"\r\n"]:
            if data.startswith(ending, end):
                length = end + len(ending) - start
                return length if length <= self.most else 0
            if ending.startswith(data[end : end + len(ending)]) and end + len(ending) > len(data):
                return None if end - start < self.most else 0
        return 0

    def cells(
        self, line: bytes, header_size: int, delimiter: bytes, tokens: re.Pattern[bytes]
    ) -> dict[str, bytes] | None:
        """Return the `tokens` of a line by field, None where it has others, or checksums of which none matches."""
        line = line.removesuffix(delimiter) if delimiter else line.rstrip(LINE_END)
        body = line[header_size:]
        if self.checksums:
            if not any(each.matches(line) for each in self.checksums):
                return None
            body = body[: body.rfind(self.checksums[0].mark.encode())]
        match = tokens.fullmatch(body)
        return None if match is None else match.groupdict()

    def tokens(self, fields: Mapping[str, FieldDescription]) -> re.Pattern[bytes]:
        """Return what matches the tokens of a line, one group for each field."""
        separator = re.escape(self.separator.encode())
        if not fields or any(field.type == "line" for field in fields.values()):
            return re.compile(b".*", re.DOTALL)
        cells = []
        for name, field in fields.items():
            what = {"decimal": _NUMBER, "word": b"[^" + separator + b"]*?"}.get(field.type)
            what = what or b"[0-9A-Fa-f]{1,%d}" % (2 * field.width)
            label = re.escape(field.label.encode()) + rb"\s*" if field.label else b""
            cells.append(rb"\s*" + label + b"(?P<" + name.encode() + b">" + what + rb")\s*")
        return re.compile((b"[" + separator + b"]").join(cells) + b"[" + separator + b"]?")


def numbers(cells: Iterable[bytes], field: FieldDescription) -> list[float]:
    """Return what tokens are worth on the wire: decimal numbers, or hexadecimal digits of an integer's width."""
    if not field.is_integer:
        return list(map(float, cells))
    sign = 1 << (field.bits - 1) if field.type[0] == "i" else 0
    return [(int(cell, 16) ^ sign) - sign for cell in cells]
