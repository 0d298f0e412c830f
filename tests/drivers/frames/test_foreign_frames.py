"""Bytes that nobody here made are read by the descriptions that ship: public frames and lines, each with its source."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from drivers.frames.counts import StreamCounts
from drivers.frames.description import load_description
from tests.drivers.frames.foreign import FOREIGN, GRAVITY, RAD_PER_S, Foreign
from tests.drivers.frames.test_shipped_descriptions import IMUS, decode_all

CASES = [(name, each) for name, frames in FOREIGN.items() for each in frames]


@pytest.mark.parametrize(("name", "foreign"), CASES, ids=[f"{name}-{each.frame}" for name, each in CASES])
def test_a_public_frame_has_the_values_that_its_source_gives(name: str, foreign: Foreign) -> None:
    """Whole and byte by byte; one flipped bit of it is not believed."""
    description = load_description(IMUS / f"{name}.yaml", parameters=foreign.settings)
    for piece in (1 << 20, 1):
        batches, counts = decode_all(description, foreign.sent, piece)
        assert counts == StreamCounts(ok=foreign.ok)
        for field, value in foreign.values.items():
            assert batches[foreign.frame][0].column(field)[0] == pytest.approx(value, rel=2e-3, abs=1e-9), field
    spoiled = bytearray(foreign.sent)
    spoiled[-6] ^= 0x10
    assert decode_all(description, bytes(spoiled))[1].ok < foreign.ok


def test_an_aceinna_whose_counter_is_a_clock_has_lost_nothing(reference_data: Path) -> None:
    """1002 recorded packets at 20 Hz: the clock of 1/65536 s moves by 3277 or 3276."""
    data = (reference_data / "captures" / "aceinna-s1.bin").read_bytes()
    for piece in (1 << 20, 100):
        assert decode_all(load_description(IMUS / "aceinna.yaml"), data, piece)[1] == StreamCounts(ok=1002)


def kermit(message: bytes) -> int:
    """Return sbgECom's CRC as its document has it: polynomial 8408, bit by bit."""
    register = 0
    for byte in message:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ 0x8408 * (register & 1)
    return register


def sbg(status: int) -> bytes:
    """Return an IMU_SHORT as the maker's document has it: 1 g along z, 1 rad/s about x, 25.5 degrees."""
    body = b"\x2c\x00" + struct.pack("<HIH", 32, 5000, status)
    body += struct.pack("<6ih", 0, 0, round(GRAVITY * 2**20), 1 << 26, 0, -(1 << 25), 6528)
    return b"\xff\x5a" + body + kermit(body).to_bytes(2, "little") + b"\x33"


def words(values: tuple[int, ...], form: str) -> bytes:
    """Return values, and behind them the sum of their 16-bit words."""
    content = struct.pack(form, *values)
    return content + (sum(struct.unpack(f">{len(content) // 2}H", content)) & 0xFFFF).to_bytes(2, "big")


ADIS = struct.pack(">H6hhH", 0, 10, -20, 30, 0, 0, 800, 251, 7)
BUILT = {
    "sbg": (sbg(2), "IMU_SHORT", {"acc_z": 1.0, "gyro_x": RAD_PER_S, "gyro_z": -RAD_PER_S / 2, "temperature": 25.5}),
    "adis16470": (
        b"\xaa\x55" + ADIS + (sum(ADIS) & 0xFFFF).to_bytes(2, "big"),
        "burst",
        {"gyro_y": -2.0 * 3600, "acc_z": 1.0, "temperature": 25.1, "data_counter": 7},
    ),
    "epson-g3xx-32": (
        b"\x80" + words((0, 2634 << 16, 66 << 16, 0, -33 << 16, 0, 0, 6250 << 16, 0, 9), ">H7iHH") + b"\x0d",
        "burst",
        {"gyro_x": 3600.0, "gyro_z": -1800.0, "acc_z": 1.0, "temperature": 25.0, "count": 9},
    ),
    "csv-logger": (
        b"1250, 0.01,-0.02,9.80665,\t0.5,-1,2e-1\r\n",
        "line",
        {"milliseconds": 1.25, "acc_z": 1.0, "gyro_x": 1800.0, "gyro_y": -3600.0, "gyro_z": 720.0},
    ),
}


@pytest.mark.parametrize("name", BUILT)
def test_what_is_built_by_hand_from_a_makers_table_is_read(name: str) -> None:
    """Of these units no bytes are public; the tables are in the descriptions' sources."""
    sent, frame, values = BUILT[name]
    batches, counts = decode_all(load_description(IMUS / f"{name}.yaml"), sent)
    assert counts == StreamCounts(ok=1)
    assert {field: float(batches[frame][0].column(field)[0]) for field in values} == pytest.approx(values, rel=1e-6)


def test_a_rate_in_another_scale_is_not_given() -> None:
    """SBG's bit 10 says that the rates have the high range's."""
    batches, _ = decode_all(load_description(IMUS / "sbg.yaml"), sbg(2 | 1 << 10))
    assert np.isnan(batches["IMU_SHORT"][0].column("gyro_x")).all()
    assert batches["IMU_SHORT"][0].column("acc_z")[0] == pytest.approx(1.0, rel=1e-6)
