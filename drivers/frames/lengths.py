"""Lengths as they are written in a description: a number, or a byte of the frame that tells it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from drivers.frames.fields import SIZES
from drivers.frames.notation import ByteOrder, Described

LONGEST = 65536


class ExtendedLength(Described):
    """Where the length has the value `mark`, the true one stands at `at`, and the frame is `plus` longer than that."""

    mark: int = Field(ge=0)
    at: int = Field(ge=1)
    type: Literal["u8", "u16"] = "u16"
    byte_order: ByteOrder = "big"
    plus: int = Field(ge=0)


class LengthDescription(Described):
    """The frame's length stands in it: the number at `at`, and `plus` bytes more, between `least` and `most`.

    Where a frame is shorter than the `whole`, it was sent without the zeros at its content's end.
    """

    at: int = Field(ge=1)
    type: Literal["u8", "u16"] = "u8"
    byte_order: ByteOrder = "big"
    plus: int = Field(ge=0)
    least: int | None = Field(default=None, ge=2)
    most: int | None = Field(default=None, ge=2, le=LONGEST)
    whole: int | None = Field(default=None, ge=2, le=LONGEST)
    extended: ExtendedLength | None = None

    @model_validator(mode="after")
    def _possible(self) -> LengthDescription:
        if self.shortest > self.longest:
            raise ValueError(f"least: {self.shortest} is more than the most, {self.longest}")
        if self.shortest < self.at + SIZES[self.type]:
            raise ValueError(f"least: a frame of {self.shortest} bytes ends before its length at {self.at}")
        return self

    @property
    def shortest(self) -> int:
        """Bytes that a frame has at least."""
        return max(self.plus, 2) if self.least is None else self.least

    @property
    def longest(self) -> int:
        """Bytes that a frame has at most."""
        if self.most is not None:
            return self.most
        return min(LONGEST, (1 << 8 * SIZES[self.type]) - 1 + self.plus)

    @property
    def places(self) -> list[int]:
        """The bytes of a frame that tell its length."""
        places = list(range(self.at, self.at + SIZES[self.type]))
        longer = self.extended
        return places if longer is None else [*places, *range(longer.at, longer.at + SIZES[longer.type])]

    def of(self, data: bytes, start: int) -> int | None:
        """Return the length of the frame at `start`: 0 where it is none, None where it is not told yet."""
        end = start + self.at + SIZES[self.type]
        if end > len(data):
            return None
        told, plus = int.from_bytes(data[start + self.at : end], self.byte_order), self.plus
        longer = self.extended
        if longer is not None and told == longer.mark:
            end = start + longer.at + SIZES[longer.type]
            if end > len(data):
                return None
            told, plus = int.from_bytes(data[start + longer.at : end], longer.byte_order), longer.plus
        length = told + plus
        return length if self.shortest <= length <= self.longest else 0
