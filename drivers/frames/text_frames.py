"""Frames of text: a line of numbers between separators, with a checksum in digits.

id: "24 56 4E 59 4D 52 2C"   # $VNYMR,
delimiter: 0D 0A
text:
  checksums: [{kind: xor, mark: "*", first: 1, stored: hex, digits: 2}]
fields: {yaw: {type: decimal, unit: deg}, pitch: {type: decimal, unit: deg}}
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from functools import reduce
from operator import xor
from typing import Annotated, Literal

from pydantic import Field, model_validator

from drivers.frames.checksum_kinds import CrcParameters
from drivers.frames.crc import message_crc
from drivers.frames.notation import Described

_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_PRINTABLE = re.compile(rb"[\x20-\x7e]*")


class _TextChecksum(Described, ABC):
    """Digits after the last `mark`. `first` is the first covered byte; the mark itself may be covered too."""

    mark: str = Field(min_length=1, max_length=1)
    first: int = Field(default=0, ge=0)
    covers_mark: bool = False
    stored: Literal["hex", "decimal"] = "hex"
    digits: int | None = Field(default=None, ge=1)

    @abstractmethod
    def of(self, message: bytes) -> int:
        """Return the checksum of the covered bytes."""

    def matches(self, line: bytes) -> bool:
        """Tell whether a line without its delimiter carries the right checksum in this form."""
        at = line.rfind(self.mark.encode())
        digits = line[at + 1 :]
        if at < self.first or not digits.isalnum() or (self.digits is not None and len(digits) != self.digits):
            return False
        try:
            stored = int(digits, 16 if self.stored == "hex" else 10)
        except ValueError:
            return False
        return self.of(line[self.first : at + self.covers_mark]) == stored


class TextXor(_TextChecksum):
    """The exclusive or of the covered characters."""

    kind: Literal["xor"]

    def of(self, message: bytes) -> int:
        """Return the checksum of the covered bytes."""
        return reduce(xor, message, 0)


class TextCrc(_TextChecksum, CrcParameters):
    """A cyclic redundancy check of the covered characters."""

    kind: Literal["crc"]

    def of(self, message: bytes) -> int:
        """Return the checksum of the covered bytes."""
        return message_crc(self, message)


class TextDescription(Described):
    """How a line is put together. One of the `checksums` must match; `most` bytes are the longest line."""

    separator: str = Field(default=",", min_length=1, max_length=1)
    most: int = Field(default=256, ge=4, le=4096)
    checksums: list[Annotated[TextXor | TextCrc, Field(discriminator="kind")]] = Field(min_length=1)

    @model_validator(mode="after")
    def _ascii(self) -> TextDescription:
        for key, text in [("separator", self.separator), *[("checksums.mark", each.mark) for each in self.checksums]]:
            if not " " < text <= "~":
                raise ValueError(f"{key}: {text!r} is not a printable ASCII character")
        return self

    def length_of(self, data: bytes, start: int, header_size: int, delimiter: bytes) -> int | None:
        """Return the length of the line at `start`: 0 where it is none, None where its end is not there."""
        match = _PRINTABLE.match(data, start + header_size)
        end = start if match is None else match.end()
        if data.startswith(delimiter, end):
            length = end + len(delimiter) - start
            return length if length <= self.most else 0
        unfinished = delimiter.startswith(data[end : end + len(delimiter)]) and end + len(delimiter) > len(data)
        return None if unfinished and end - start < self.most else 0

    def values(self, line: bytes, header_size: int, count: int) -> tuple[float, ...] | None:
        """Return the `count` numbers of a line without its delimiter; None where it has others than so many numbers."""
        if not count:
            return ()
        body = line[header_size : line.rfind(self.checksums[0].mark.encode())]
        cells = body.split(self.separator.encode())
        if len(cells) != count or not all(map(_NUMBER.fullmatch, cells)):
            return None
        return tuple(map(float, cells))
