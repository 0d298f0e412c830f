"""Descriptions, physics and bytes that several tests of streams share."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np

from drivers.frames.batch import FrameBatch
from drivers.frames.description import StreamDescription, load_description, parse_description
from drivers.frames.wire import FloatArray

MFS_FILE = Path(__file__).resolve().parents[3] / "configs" / "imus" / "mfs.yaml"

# From the data sheet TS1524 rev 31: datagram 0x93 (rate, acceleration, inclination) with CR LF, 10 g range.
STIM300 = """
schema: hil.frames/1
name: STIM300
sample_rate_hz: 125
byte_order: big
frames:
  rate_acc_incl:
    id: "93"
    length: 40
    delimiter: 0D 0A
    checksum: {kind: crc, width: 32, poly: 0x04C11DB7, init: 0xFFFFFFFF, pad_to: 4}
    fields:
      gyro_x: {type: i24, scale: 2^-14, unit: deg/s}
      gyro_y: {type: i24, scale: 2^-14, unit: deg/s}
      gyro_z: {type: i24, scale: 2^-14, unit: deg/s}
      gyro_status: {type: u8}
      acc_x: {type: i24, scale: 2^-18, unit: g}
      acc_y: {type: i24, scale: 2^-18, unit: g}
      acc_z: {type: i24, scale: 2^-18, unit: g}
      acc_status: {type: u8}
      incl_x: {type: i24, scale: 2^-22, unit: g}
      incl_y: {type: i24, scale: 2^-22, unit: g}
      incl_z: {type: i24, scale: 2^-22, unit: g}
      incl_status: {type: u8}
      counter: {type: u8}
      latency_us: {type: u16, unit: us}
    counter: {field: counter, modulus: 256, step: 16}
"""

# From the KVH 1775 manual: format A and the extended built-in test, which interleaves.
KVH = """
schema: hil.frames/1
name: KVH 1750
sample_rate_hz: 1000
byte_order: big
sync: FE 81
frames:
  format_A:
    id: FF 55
    length: 36
    checksum: &crc {kind: crc, width: 32, poly: 0x04C11DB7, init: 0xFFFFFFFF}
    fields:
      gyro_x: {type: f32}
      gyro_y: {type: f32}
      gyro_z: {type: f32}
      acc_x: {type: f32, unit: g}
      acc_y: {type: f32, unit: g}
      acc_z: {type: f32, unit: g}
      status: {type: u8}
      sequence: {type: u8}
      temperature: {type: i16, unit: degC}
    counter: {field: sequence, modulus: 128}
    status:
      status:
        gyro_x_valid: {bit: 0, good: 1}
        acc_z_valid: {bit: 6, good: 1}
  extended_bit:
    id: 00 AA
    length: 11
    checksum: {kind: sum, width: 8}
    fields:
      bit_0: {type: u8}
"""


@cache
def mfs(rate_hz: float | None = None) -> StreamDescription:
    """Return the project's own frame description, of a unit that may be set to another rate."""
    return load_description(MFS_FILE, sample_rate_hz=rate_hz)


@cache
def stim300() -> StreamDescription:
    """Return STIM300's datagram 0x93."""
    return parse_description(STIM300, "stim300")


@cache
def kvh() -> StreamDescription:
    """Return KVH format A with its built-in test frame."""
    return parse_description(KVH, "kvh")


class SteadyPhysics:
    """Signals that a test can predict: rate_A2 is the time in deg/hr, everything else is constant."""

    def __init__(self) -> None:
        self.moves: list[tuple[str, float, float]] = []
        self.latest_s = -np.inf

    def start_move(self, position: str, begins_s: float, ends_s: float) -> None:
        """Remember the move."""
        assert begins_s >= self.latest_s - 1e-9, "time went backwards"
        self.moves.append((position, begins_s, ends_s))

    def signals(self, times_s: FloatArray) -> Mapping[str, FloatArray]:
        """Return the time as a rate, and constants."""
        assert times_s[0] > self.latest_s, "time went backwards"
        self.latest_s = float(times_s[-1])
        constants = {"rate_A1": -7.5, "accel_A1": -0.25, "case_degC": -29.72, "supply_V": 28.0, "spin_period_1_us": 4e3}
        return {"rate_A2": times_s} | {name: np.full(len(times_s), value) for name, value in constants.items()}


def frames_of(batch: FrameBatch) -> list[bytes]:
    """Return the bytes of every frame of a batch; of a sample, those of its parts."""
    found = [b""] * len(batch)
    for _, rows, at in batch.parts:
        for place, row in zip(np.arange(len(batch))[at].tolist(), rows, strict=True):
            found[place] += row.tobytes()
    return found
