"""Every checksum has one meaning, frame by frame and over thousands of frames, and it is the catalogue's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.frames.checksums import Crc, CrcKind, FrameChecksum, PlainKind, SumKind

# Catalogue of parametrised CRC algorithms (reveng): name, width, poly, init, refin, refout, xorout, CRC of "123456789".
CATALOGUE = [
    ("CRC-8/SMBUS", 8, 0x07, 0x00, False, False, 0x00, 0xF4),
    ("CRC-8/MAXIM-DOW", 8, 0x31, 0x00, True, True, 0x00, 0xA1),
    ("CRC-12/UMTS", 12, 0x80F, 0x000, False, True, 0x000, 0xDAF),
    ("CRC-16/XMODEM", 16, 0x1021, 0x0000, False, False, 0x0000, 0x31C3),
    ("CRC-16/SPI-FUJITSU", 16, 0x1021, 0x1D0F, False, False, 0x0000, 0xE5CC),
    ("CRC-16/KERMIT", 16, 0x1021, 0x0000, True, True, 0x0000, 0x2189),
    ("CRC-16/MODBUS", 16, 0x8005, 0xFFFF, True, True, 0x0000, 0x4B37),
    ("CRC-24/OPENPGP", 24, 0x864CFB, 0xB704CE, False, False, 0x000000, 0x21CF02),
    ("CRC-32/ISO-HDLC", 32, 0x04C11DB7, 0xFFFFFFFF, True, True, 0xFFFFFFFF, 0xCBF43926),
    ("CRC-32/MPEG-2", 32, 0x04C11DB7, 0xFFFFFFFF, False, False, 0x00000000, 0x0376E6E7),
    ("CRC-32/BZIP2", 32, 0x04C11DB7, 0xFFFFFFFF, False, False, 0xFFFFFFFF, 0xFC891918),
    ("CRC-32/ISCSI", 32, 0x1EDC6F41, 0xFFFFFFFF, True, True, 0xFFFFFFFF, 0xE3069283),
    ("CRC-40/GSM", 40, 0x0004820009, 0x0000000000, False, False, 0xFFFFFFFFFF, 0xD4164FC646),
    ("CRC-64/XZ", 64, 0x42F0E1EBA9EA3693, 0xFFFFFFFFFFFFFFFF, True, True, 0xFFFFFFFFFFFFFFFF, 0x995DC9BBDF1939FA),
]


def kind_of(width: int, poly: int, init: int, refin: bool, refout: bool, xorout: int, pad_to: int = 1) -> CrcKind:
    """Return the description of a CRC."""
    return CrcKind(
        kind="crc", width=width, poly=poly, init=init, refin=refin, refout=refout, xorout=xorout, pad_to=pad_to
    )


def crc_by_definition(kind: CrcKind, message: bytes) -> int:
    """Return the CRC one bit at a time: the definition, and nothing of the product's code."""
    message += bytes(-len(message) % kind.pad_to)
    bits = "".join(f"{byte:08b}"[::-1] if kind.refin else f"{byte:08b}" for byte in message)
    register = kind.init
    for bit in bits:
        top = register >> (kind.width - 1) & 1
        register = (register << 1) & ((1 << kind.width) - 1)
        if top != int(bit):
            register ^= kind.poly
    if kind.refout:
        register = int(f"{register:0{kind.width}b}"[::-1], 2)
    return register ^ kind.xorout


def rows_of(messages: list[bytes]) -> np.ndarray:
    """Return messages of equal length as an array of shape (n, length)."""
    return np.frombuffer(b"".join(messages), np.uint8).reshape(len(messages), -1)


@pytest.mark.parametrize("entry", CATALOGUE, ids=lambda entry: entry[0])
def test_a_crc_gives_the_check_value_of_the_catalogue(entry: tuple) -> None:  # type: ignore[type-arg]
    """One message and many give the published value of `123456789`."""
    crc = Crc(kind_of(*entry[1:7]), 9)
    assert crc.of_bytes(b"123456789") == entry[7]
    assert crc.of_rows(rows_of([b"123456789"] * 3)).tolist() == [entry[7]] * 3


@st.composite
def crc_kinds(draw: st.DrawFn) -> CrcKind:
    """Draw any CRC, often the two for which the standard library has compiled loops."""
    width, poly = draw(
        st.sampled_from([(32, 0x04C11DB7), (16, 0x1021), (8, 0x07), (24, 0x864CFB), (64, 0x1B), (11, 5)])
    )
    register = st.integers(0, (1 << width) - 1)
    return kind_of(
        width, poly, draw(register), draw(st.booleans()), draw(st.booleans()), draw(register), draw(st.integers(1, 5))
    )


@pytest.mark.slow
@given(crc_kinds(), st.integers(1, 40).flatmap(lambda n: st.lists(st.binary(min_size=n, max_size=n), min_size=1)))
def test_one_message_and_many_give_the_crc_of_the_definition(kind: CrcKind, messages: list[bytes]) -> None:
    """The compiled loop, the byte table and the tables by position agree with the definition, bit by bit."""
    crc = Crc(kind, len(messages[0]))
    expected = [crc_by_definition(kind, message) for message in messages]
    assert [crc.of_bytes(message) for message in messages] == expected
    assert crc.of_rows(rows_of(messages)).tolist() == expected


OTHERS = {
    "sum8": SumKind(kind="sum", width=8),
    "sum16 of little-endian words": SumKind(kind="sum", width=16, word=2, word_order="little", stored="little"),
    "negated sum16 of big-endian words": SumKind(kind="sum", width=16, word=2, negate=True),
    "fletcher": PlainKind(kind="fletcher"),
    "xor": PlainKind(kind="xor"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
@given(payloads=st.lists(st.binary(min_size=10, max_size=10), min_size=1, max_size=5), flip=st.integers(0, 95))
def test_what_is_written_matches_and_a_flipped_bit_does_not(name: str, payloads: list[bytes], flip: int) -> None:
    """Writing and both ways of checking belong together, for every other kind of checksum."""
    kind = OTHERS[name]
    length = 10 + kind.size
    checksum = FrameChecksum(kind, length)
    rows = rows_of([payload + bytes(kind.size) for payload in payloads]).copy()
    checksum.write(rows)
    assert checksum.matches_rows(rows).all()
    assert all(checksum.matches(row.tobytes()) for row in rows)
    rows[0, flip // 8 % length] ^= 1 << flip % 8
    assert checksum.matches_rows(rows).tolist() == [False] + [True] * (len(rows) - 1)
    assert not checksum.matches(rows[0].tobytes())


def test_published_sums_are_reproduced() -> None:
    """KVH's built-in test frame (sum of bytes) and a MIP ping (Fletcher) carry what their manuals print."""
    kvh = FrameChecksum(OTHERS["sum8"], 11)
    assert kvh.matches(bytes.fromhex("FE8100AA7F7F7F7F7F7F23"))
    mip = FrameChecksum(OTHERS["fletcher"], 8)
    assert mip.matches(bytes.fromhex("756501020201E0C6"))
    dmu = FrameChecksum(OTHERS["negated sum16 of big-endian words"], 6)
    assert dmu.matches(bytes.fromhex("55AA 0001") + (0x10000 - 0x55AB).to_bytes(2, "big"))
