"""A cyclic redundancy check in two speeds with one meaning: frame by frame, and over thousands of frames at once.

A CRC is affine over GF(2): for messages of one length, crc = C ⊕ T₀[b₀] ⊕ T₁[b₁] ⊕ …, where Tᵢ is the register left
by byte i followed by zeros, and C the CRC of the all-zero message. One table per position turns the check of n frames
into one gather per byte over all frames. Zero padding (STIM300) and unequal reflection of input and output are linear
too, so that they fold into the tables.
"""

import zlib
from binascii import crc_hqx
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frames.checksum_kinds import CrcKind, CrcParameters
from drivers.frames.wire import Rows

_IEEE = 0x04C11DB7
_CCITT = 0x1021
REVERSED_BITS = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))

_FEW_BYTEWISE = 8  # messages below which a loop that is not compiled is faster than the tables

Words = NDArray[np.uint64]


def _reflect(value: int, width: int) -> int:
    return int(f"{value:0{width}b}"[::-1], 2)


def _zero_byte(register: Words, kind: CrcParameters) -> Words:
    """Return the registers after one further zero byte, bit by bit (the CRC's definition)."""
    one = np.uint64(1)
    if kind.refin:
        poly = np.uint64(_reflect(kind.poly, kind.width))
        for _ in range(8):
            register = (register >> one) ^ np.where(register & one, poly, np.uint64(0))
        return register
    mask, poly, top = np.uint64((1 << kind.width) - 1), np.uint64(kind.poly), np.uint64(kind.width - 1)
    for _ in range(8):
        register = ((register << one) & mask) ^ np.where(register >> top, poly, np.uint64(0))
    return register


def _byte_table(kind: CrcParameters) -> Words:
    """Return the register that each byte leaves in a register of zeros, shape (256,)."""
    values = np.arange(256, dtype=np.uint64)
    return _zero_byte(values if kind.refin else values << np.uint64(kind.width - 8), kind)


def _output(register: int, kind: CrcParameters) -> int:
    """Return the CRC for a final register."""
    return (_reflect(register, kind.width) if kind.refin != kind.refout else register) ^ kind.xorout


class Crc:
    """The CRC of messages of `length` bytes (those it covers, without padding)."""

    def __init__(self, kind: CrcKind, length: int) -> None:
        self._kind = kind
        self._length = length
        self._padding = bytes(-length % kind.pad_to)
        compiled = _compiled_register(kind)
        self._register = compiled or _table_register(kind)
        # A compiled loop costs about as much for a message as a table does for a byte of all of them.
        self._few = length if compiled is not None else _FEW_BYTEWISE

    @cached_property
    def _affine(self) -> tuple[NDArray[Any], Any]:
        """The tables by position, shape (length, 256), and the constant."""
        return _position_tables(self._kind, self._length, len(self._padding))

    def of_bytes(self, message: bytes) -> int:
        """Return the CRC of one message."""
        return _output(self._register(message + self._padding), self._kind)

    def of_rows(self, rows: Rows) -> NDArray[Any]:
        """Return the CRCs of n messages, shape (n,), given as `rows` of shape (n, length)."""
        if len(rows) < self._few:
            return np.fromiter(map(self.of_bytes, map(bytes, rows)), np.uint64, len(rows))
        tables, constant = self._affine
        columns = np.ascontiguousarray(rows.T)
        crc: NDArray[Any] = tables[0].take(columns[0], mode="clip")
        crc ^= constant
        part = np.empty_like(crc)
        for table, column in zip(tables[1:], columns[1:], strict=True):
            table.take(column, mode="clip", out=part)
            crc ^= part
        return crc


def message_crc(kind: CrcParameters, message: bytes) -> int:
    """Return the CRC of one message of any length."""
    return _output(_any_register(kind)(message), kind)


@lru_cache(maxsize=64)
def _any_register(kind: CrcParameters) -> Callable[[bytes], int]:
    return _compiled_register(kind) or _table_register(kind)


def _position_tables(kind: CrcKind, length: int, padding: int) -> tuple[NDArray[Any], Any]:
    """Return the tables of the affine form, shape (length, 256), and its constant."""
    total = length + padding
    tables = _tables_by_distance(kind, -(-total // 64) * 64)[padding:total][::-1]
    init = _reflect(kind.init, kind.width) if kind.refin else kind.init
    register = np.array([init], np.uint64)
    for _ in range(total):
        register = _zero_byte(register, kind)
    return tables, tables.dtype.type(_output(int(register[0]), kind))


@lru_cache(maxsize=16)
def _tables_by_distance(kind: CrcKind, count: int) -> NDArray[Any]:
    """Return what each byte leaves with 0, 1, 2 … bytes of zeros behind it, shape (count, 256).

    Frames of every length share them: the table of a position is that of its distance from the end.
    """
    table = _byte_table(kind)
    tables = np.empty((count, 256), np.uint64)
    for distance in range(count):
        tables[distance] = table
        table = _zero_byte(table, kind)
    if kind.refin != kind.refout:
        bits = np.arange(kind.width, dtype=np.uint64)
        tables = sum(
            (((tables >> bit) & np.uint64(1)) << (np.uint64(kind.width - 1) - bit) for bit in bits),
            start=np.zeros_like(tables),
        )
    return tables.astype(np.uint32 if kind.width <= 32 else np.uint64)


def _compiled_register(kind: CrcParameters) -> Callable[[bytes], int] | None:
    """Return the final register by the standard library's compiled loops, where one of them fits."""
    if kind.width == 16 and kind.poly == _CCITT and not kind.refin:
        return lambda message: crc_hqx(message, kind.init)
    if kind.width != 32 or kind.poly != _IEEE:
        return None
    ones = 0xFFFFFFFF
    if kind.refin:
        start = _reflect(kind.init, 32) ^ ones
        return lambda message: zlib.crc32(message, start) ^ ones
    # The unreflected CRC is the reflected one of the bytes with their bits reversed, with its own bits reversed.
    start = _reflect(kind.init, 32) ^ ones

    def unreflected(message: bytes) -> int:
        reflected = zlib.crc32(message.translate(REVERSED_BITS), start) ^ ones
        return int.from_bytes(reflected.to_bytes(4, "little").translate(REVERSED_BITS), "big")

    return unreflected


def residue_test(kind: CrcKind, start: int, end: int) -> Callable[[bytes], bool] | None:
    """Return a test of frames whose CRC over [start, end) stands right behind, in one compiled call; None without one.

    A CRC over a message and its own CRC leaves the same residue whatever the message is, where the CRC is stored in the
    order in which its bits leave the register.
    """
    natural = "little" if kind.refout else "big"
    register = _compiled_register(kind)
    if register is None or kind.refin != kind.refout or kind.stored != natural or -(end - start) % kind.pad_to:
        return None
    sample = bytes(end - start)
    residue = register(sample + message_crc(kind, sample).to_bytes(kind.size, natural))
    covered = slice(start, end + kind.size)
    return lambda frame: register(frame[covered]) == residue


def _table_register(kind: CrcParameters) -> Callable[[bytes], int]:
    """Return the final register by a byte table, for every CRC."""
    table = [int(entry) for entry in _byte_table(kind)]
    if kind.refin:
        start = _reflect(kind.init, kind.width)

        def reflected(message: bytes) -> int:
            register = start
            for byte in message:
                register = (register >> 8) ^ table[(register ^ byte) & 0xFF]
            return register

        return reflected
    top, mask = kind.width - 8, (1 << kind.width) - 1

    def direct(message: bytes) -> int:
        register = kind.init
        for byte in message:
            register = ((register << 8) & mask) ^ table[((register >> top) ^ byte) & 0xFF]
        return register

    return direct
