"""Checksums as they are written in a description: the kind, its parameters, what it covers and where it stands."""

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from drivers.frames.notation import HexBytes
from drivers.strict_yaml import Section

Part = tuple[int, int | None] | HexBytes


def _one_or_several(span: Any) -> Any:
    """Take `[first, end]` as the one part that is covered."""
    one = isinstance(span, list | tuple) and not any(isinstance(part, list | tuple | str | bytes) for part in span)
    if one and len(span) != 2:
        raise ValueError("is [first, end], or a list of such parts and of constant bytes")
    return [span] if one else span


class _Checksum(Section):
    """What every kind has. Positions count from the frame's first byte.

    `span` is [first byte covered, first byte no longer covered], or a list of such parts and of constant bytes that are
    not sent, covered one after another; an end of null is the checksum, and behind the checksum the delimiter. Without
    a span, everything from the sync to the checksum is covered.
    `at` is where the checksum stands; without it, right before the delimiter. With `confirm`, a frame that does not
    follow a good one directly is believed only where the next header follows it, or where its counter goes on: so weak
    a checksum matches by chance.
    """

    span: Annotated[tuple[Part, ...] | None, BeforeValidator(_one_or_several)] = None
    at: int | None = Field(default=None, ge=0)
    stored: Literal["little", "big"] = "big"
    confirm: bool = False
    _bits: ClassVar[int] = 0  # of a kind that has no `width`

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return (int(getattr(self, "width", self._bits)) + 7) // 8

    def position(self, body_end: int) -> int:
        """Return where the checksum stands in a frame whose delimiter begins at `body_end`."""
        return body_end - self.size if self.at is None else self.at

    def content_end(self, body_end: int) -> int:
        """Return where what the frame holds ends: at the checksum, where that comes last."""
        at = self.position(body_end)
        return at if at + self.size == body_end else body_end

    def covered(self, body_end: int) -> list[tuple[int, int] | bytes]:
        """Return the covered parts of such a frame: bytes [start, end), and constants."""
        at = self.position(body_end)
        return [
            part
            if isinstance(part, bytes)
            else (part[0], (at if part[0] <= at else body_end) if part[1] is None else part[1])
            for part in self.span or ((0, None),)
        ]

    def check_span(self, covered: int) -> None:
        """Raise `ValueError` where the kind cannot cover so many bytes."""


class CrcParameters(Section):
    """The parameters of the Rocksoft model (as in the catalogue of CRC algorithms)."""

    width: int = Field(ge=8, le=64)
    poly: int = Field(gt=0)
    init: int = Field(default=0, ge=0)
    refin: bool = False
    refout: bool = False
    xorout: int = Field(default=0, ge=0)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        for key in ("poly", "init", "xorout"):
            if getattr(self, key) >> self.width:
                raise ValueError(f"{key} has more than {self.width} bits")
        return self


class CrcKind(_Checksum, CrcParameters):
    """A cyclic redundancy check, as if zeros that are not sent came up to the next multiple of `pad_to` bytes."""

    kind: Literal["crc"]
    pad_to: int = Field(default=1, ge=1, le=64)


class SumKind(_Checksum):
    """The sum of the covered words (`word` bytes each, in `word_order`) modulo 2^width, negated with `negate`."""

    kind: Literal["sum"]
    width: Literal[8, 16, 32]
    word: Literal[1, 2, 4] = 1
    word_order: Literal["little", "big"] = "big"
    negate: bool = False

    def check_span(self, covered: int) -> None:
        if covered % self.word:
            raise ValueError(f"checksum.word: {covered} covered bytes are not whole words of {self.word} bytes")


class FletcherKind(_Checksum):
    """Fletcher's two running sums modulo 256 over the covered bytes, the first sum first on the wire."""

    kind: Literal["fletcher"]
    _bits: ClassVar[int] = 16


class XorKind(_Checksum):
    """The exclusive or of the covered bytes."""

    kind: Literal["xor"]
    _bits: ClassVar[int] = 8


class NoChecksum(_Checksum):
    """No checksum: damage goes unnoticed, unless it hits header, length or delimiter."""

    kind: Literal["none"]


ChecksumDescription = Annotated[CrcKind | SumKind | FletcherKind | XorKind | NoChecksum, Field(discriminator="kind")]
