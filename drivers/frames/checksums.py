"""The checksum of a frame: as it is described, verified in one frame or in thousands at once, and written."""

import zlib
from binascii import crc_hqx
from collections.abc import Callable
from functools import cached_property, lru_cache, partial
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from drivers.frames.notation import HexBytes
from drivers.frames.wire import Rows, read_column, write_column
from drivers.strict_yaml import Section

_IEEE = 0x04C11DB7
_CCITT = 0x1021
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))

_BITS = {"fletcher": 16, "xor": 8}  # of kinds that have no `width`
_FEW = 8  # messages below which one by one is faster than the tables
_POLL = 768  # messages of which all bytes are looked up at once: their places stay in the processor's cache

Part = tuple[int, int | None] | HexBytes
Words = NDArray[np.uint64]


def _one_or_several(span: Any) -> Any:
    one = isinstance(span, list | tuple) and not any(isinstance(part, list | tuple | str | bytes) for part in span)
    if one and len(span) != 2:
        raise ValueError("is [first, end], or a list of such parts and of constant bytes")
    return [span] if one else span


class _Checksum(Section):
    """What every kind has. Positions count from the frame's first byte.

    `span` is [first byte covered, first byte no longer covered], or a list of such parts and of constant bytes that are
    not sent, one after another; an end of null is the checksum, and behind that the delimiter. Without a span it covers
    all from the sync to the checksum. `at` is where the checksum stands; without it, right before the delimiter. With
    `confirm`, a frame that no good one precedes is believed only where the next header follows or its counter goes on.
    """

    span: Annotated[tuple[Part, ...] | None, BeforeValidator(_one_or_several)] = None
    at: int | None = Field(default=None, ge=0)
    stored: Literal["little", "big"] = "big"
    confirm: bool = False
    kind: str

    @property
    def size(self) -> int:
        return (int(getattr(self, "width", _BITS.get(self.kind, 0))) + 7) // 8

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
        if covered % (word := getattr(self, "word", 1)):
            raise ValueError(f"checksum.word: {covered} covered bytes are not whole words of {word} bytes")


class CrcParameters(Section):
    """The parameters of the Rocksoft model (as in the catalogue of CRC algorithms)."""

    width: int = Field(ge=8, le=64)
    poly: int = Field(gt=0)
    init: int = Field(default=0, ge=0)
    refin: bool = False
    refout: bool = False
    xorout: int = Field(default=0, ge=0)

    def _check(self) -> None:
        for key in ("poly", "init", "xorout"):
            if getattr(self, key) >> self.width:
                raise ValueError(f"{key} has more than {self.width} bits")


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


class PlainKind(_Checksum):
    """Fletcher's two running sums modulo 256, the first sum first on the wire; their xor; or no checksum at all."""

    kind: Literal["fletcher", "xor", "none"]


ChecksumDescription = Annotated[CrcKind | SumKind | PlainKind, Field(discriminator="kind")]


def _reflect(value: int, width: int) -> int:
    return int(f"{value:0{width}b}"[::-1], 2)


def _zero_byte(register: Words, kind: CrcParameters) -> Words:
    """Return the registers after one further zero byte, bit by bit (the CRC's definition)."""
    one, poly = np.uint64(1), np.uint64(_reflect(kind.poly, kind.width))
    for _ in range(8):
        register = (register >> one) ^ np.where(register & one, poly, np.uint64(0))
    return register


def _byte_table(kind: CrcParameters) -> Words:
    """Return the register that each byte leaves in a register of zeros, shape (256,)."""
    return _zero_byte(np.arange(256, dtype=np.uint64), kind)


def _output(register: int, kind: CrcParameters) -> int:
    return (register if kind.refout else _reflect(register, kind.width)) ^ kind.xorout


class Crc:
    """The CRC of messages of `length` bytes (those it covers, without padding), in two speeds with one meaning.

    A CRC is affine over GF(2): for messages of one length, crc = C ⊕ T₀[b₀] ⊕ T₁[b₁] ⊕ …, where Tᵢ is the register
    left by byte i followed by zeros, and C the CRC of the all-zero message. One table per position turns the check of n
    frames into one gather per byte over all frames, and of the few that a poll brings into one gather of all their
    bytes. Zero padding (STIM300) and unequal reflection of input and output are linear too, so that they fold into the
    tables. Registers are kept with their lowest bit first; where the CRC's input is not reflected, the bytes are.
    """

    def __init__(self, kind: CrcKind, length: int) -> None:
        self._kind = kind
        self._length = length
        self._padding = bytes(-length % kind.pad_to)
        self._register = _register(kind)

    @cached_property
    def _affine(self) -> tuple[NDArray[Any], NDArray[np.intp], Any]:
        """All tables one behind another, where that of each position begins, shape (length, 1), and the constant."""
        total = self._length + len(self._padding)
        tables = _tables_by_distance(self._kind, -(-total // 64) * 64).ravel()
        begins = 256 * np.arange(total - 1, len(self._padding) - 1, -1, dtype=np.intp)[:, None]
        return tables, begins, tables.dtype.type(_output(self._register(bytes(total)), self._kind))

    def of_bytes(self, message: bytes) -> int:
        """Return the CRC of one message."""
        return _output(self._register(message + self._padding), self._kind)

    def of_rows(self, rows: Rows) -> NDArray[Any]:
        """Return the CRCs of n messages, shape (n,), given as `rows` of shape (n, length)."""
        if len(rows) < _FEW:
            return np.fromiter(map(self.of_bytes, map(bytes, rows)), np.uint64, len(rows))
        tables, begins, constant = self._affine
        if len(rows) <= _POLL:
            return np.asarray(np.bitwise_xor.reduce(tables.take(rows.T + begins, mode="clip"), axis=0) ^ constant)
        crc = np.full(len(rows), constant)
        part = np.empty_like(crc)
        for begin, column in zip(begins[:, 0].tolist(), np.ascontiguousarray(rows.T), strict=True):
            tables[begin : begin + 256].take(column, mode="clip", out=part)
            crc ^= part
        return crc


def message_crc(kind: CrcParameters, message: bytes) -> int:
    """Return the CRC of one message of any length."""
    return _output(_register(kind)(message), kind)


@lru_cache(maxsize=16)
def _tables_by_distance(kind: CrcKind, count: int) -> NDArray[Any]:
    """Return what each byte leaves with 0, 1, 2 … zeros behind it, (count, 256): frames of every length share it."""
    table = _byte_table(kind) if kind.refin else _byte_table(kind)[list(_REVERSED)]
    tables = np.empty((count, 256), np.uint64)
    for distance in range(count):
        tables[distance] = table
        table = _zero_byte(table, kind)
    if not kind.refout:
        bits = np.arange(kind.width, dtype=np.uint64)
        tables = sum(
            (((tables >> bit) & np.uint64(1)) << (np.uint64(kind.width - 1) - bit) for bit in bits),
            start=np.zeros_like(tables),
        )
    return tables.astype(np.uint32 if kind.width <= 32 else np.uint64)


@lru_cache(maxsize=64)
def _register(kind: CrcParameters) -> Callable[[bytes], int]:
    """Return what gives the final register of a message: where there is one, a loop of the standard library."""
    start, ones = _reflect(kind.init, kind.width), 0xFFFFFFFF
    reflected = None if kind.refin else _REVERSED
    if (kind.width, kind.poly) == (32, _IEEE):
        return lambda message: zlib.crc32(message.translate(reflected), start ^ ones) ^ ones
    if (kind.width, kind.poly, kind.refin) == (16, _CCITT, False):
        return lambda message: _reflect(crc_hqx(message, kind.init), 16)
    table = _byte_table(kind).tolist()

    def looped(message: bytes) -> int:
        register = start
        for byte in message.translate(reflected):
            register = (register >> 8) ^ table[(register ^ byte) & 0xFF]
        return register

    return looped


def _sum(kind: SumKind, rows: Rows) -> NDArray[Any]:
    words = np.ascontiguousarray(rows).view(f"{'<' if kind.word_order == 'little' else '>'}u{kind.word}")
    total: NDArray[Any] = words.sum(axis=1, dtype=np.int64)
    return (-total if kind.negate else total) & ((1 << kind.width) - 1)


def _fletcher(rows: Rows) -> NDArray[Any]:
    """First sum Σb, second sum Σ of the first sums, both modulo 256."""
    second = rows.astype(np.int64) @ np.arange(rows.shape[1], 0, -1, dtype=np.int64)
    return np.asarray((rows.sum(axis=1, dtype=np.int64) & 0xFF) << 8 | (second & 0xFF))


class FrameChecksum:
    """The checksum of frames of one type and length, whose delimiter, if there is one, begins at `body_end`."""

    def __init__(self, kind: ChecksumDescription, body_end: int) -> None:
        self._at = kind.position(body_end)
        self._size = kind.size
        self._order = kind.stored
        self._parts = [slice(*part) if isinstance(part, tuple) else part for part in kind.covered(body_end)]
        self._of_rows: Callable[[Rows], NDArray[Any]]
        self._of_bytes: Callable[[bytes], int] = self._alone
        if isinstance(kind, CrcKind):
            crc = Crc(kind, len(self._covered(bytes(body_end))))
            self._of_rows, self._of_bytes = crc.of_rows, crc.of_bytes
        elif isinstance(kind, SumKind):
            self._of_rows = partial(_sum, kind)
        else:
            self._of_rows = _fletcher if kind.kind == "fletcher" else partial(np.bitwise_xor.reduce, axis=1)

    def _covered(self, frame: bytes) -> bytes:
        return b"".join([frame[part] if isinstance(part, slice) else part for part in self._parts])

    def _covered_rows(self, rows: Rows) -> Rows:
        parts = [
            rows[:, part] if isinstance(part, slice) else np.tile(np.frombuffer(part, np.uint8), (len(rows), 1))
            for part in self._parts
        ]
        return parts[0] if len(parts) == 1 else np.hstack(parts)

    def matches(self, frame: bytes) -> bool:
        """Tell whether one whole frame carries the right checksum."""
        stored = int.from_bytes(frame[self._at : self._at + self._size], self._order)
        return not self._size or self._of_bytes(self._covered(frame)) == stored

    def _alone(self, covered: bytes) -> int:
        return int(self._of_rows(np.frombuffer(covered, np.uint8).reshape(1, -1))[0])

    def matches_rows(self, rows: Rows) -> NDArray[np.bool_]:
        """Tell it for n whole frames, shape (n, length), contiguous; the result has shape (n,)."""
        if not self._size:
            return np.ones(len(rows), np.bool_)
        stored = read_column(rows, self._at, f"u{8 * self._size}", self._order)
        return np.asarray(self._of_rows(self._covered_rows(rows)) == stored, dtype=np.bool_)

    def write(self, rows: Rows) -> None:
        """Compute and store the checksums of n whole frames, (n, length), in place."""
        if self._size:
            values = self._of_rows(self._covered_rows(rows))
            write_column(rows, self._at, f"u{8 * self._size}", self._order, values)
