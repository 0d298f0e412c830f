"""A unit that nobody has seen, described with the reference of the language alone; its bytes are written by hand here.

Two binary frame types and a line of text in one stream; Fletcher's sums and a sum of little-endian words that leave out
the header, and an XOR in hex digits; both byte orders in one frame; fixed point; a counter that goes by fives up to a
hundred; a field that means one thing in every other frame; a length that stands in the frame.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from drivers.errors import InputError
from drivers.frames.batch import Decoded
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import parse_description
from tests.drivers.frames.streams import frames_of

KESTREL = """
schema: hil.frames/1
name: Kestrel 7
sample_rate_hz: 400
byte_order: big
sync: 7E C3
parameters:
  range: {meaning: full scale, unit: deg/s, choices: {200: {lsb: 0.01}, 1000: {lsb: 0.05}}, default: 200}
frames:
  fast:
    id: "01"
    length: 31
    checksum: {kind: fletcher, span: [3, null], confirm: true}
    fields:
      count: {type: u8}
      gyro: {type: i24, names: [x, y, z], scale: "3600*${lsb}", unit: deg/hr}
      acc: {type: fp12.20, names: [x, y, z], unit: g, byte_order: little}
      status: {type: u8}
      temperature:
        {type: i16, at: 27, scale: 0.01, unit: degC, byte_order: little, when: {field: count, mask: 1, equals: 1}}
      voltage: {type: u16, at: 27, scale: 0.001, unit: V, when: {field: count, mask: 1, equals: 0}}
    counter: {field: count, modulus: 100, step: 5}
    status: {status: {gyro_ok: {bit: 0, good: 1}, hot: {bit: 7, good: 0}}}
  slow:
    id: "02"
    length: {at: 3, type: u8, plus: 6, least: 10, most: 40}
    checksum: {kind: sum, width: 16, word: 2, word_order: little, span: [4, null], stored: little, confirm: true}
    fields:
      time: {type: u32, at: 4, unit: ms}
  text:
    id: "24"
    delimiter: 0D 0A
    text:
      checksums: [{kind: xor, mark: "*", first: 3, stored: hex, digits: 2}]
    fields: {pressure: {type: decimal, unit: hPa}, humidity: {type: decimal}}
roles:
  frame: fast
  sensors: {1: {rates: {GX: gyro_x}, accelerations: {X: acc_x}, temperature: temperature}}
"""


def fast(number: int) -> bytes:
    """Return the fast frame of a number, as its manual would say."""
    body = bytes([5 * number % 100])
    body += b"".join((number * sign).to_bytes(3, "big", signed=True) for sign in (1, -1, 7))
    body += struct.pack("<3i", number << 10, -number << 10, 1 << 20) + b"\x01\x00"
    body += struct.pack("<h", -number) if number % 2 else struct.pack(">H", 5000 + number)
    first = second = 0
    for byte in body:
        first = (first + byte) % 256
        second = (second + first) % 256
    return b"\x7e\xc3\x01" + body + bytes([first, second])


def slow(number: int) -> bytes:
    """Return a slow frame, of a length that changes."""
    body = struct.pack(">I", 100 * number) + bytes([number % 256, 0x7E]) * (number % 5)
    total = sum(struct.unpack(f"<{len(body) // 2}H", body)) % 65536
    return b"\x7e\xc3\x02" + bytes([len(body)]) + body + struct.pack("<H", total)


def text(number: int) -> bytes:
    """Return a line."""
    line = f"{1000 + number / 8:.3f},{number % 100}"
    check = 0
    for byte in line.encode():
        check ^= byte
    return b"\x7e\xc3\x24" + f"{line}*{check:02X}\r\n".encode()


def frames(n: int) -> Iterator[tuple[str, bytes]]:
    """Give n fast frames with the other two between them."""
    for number in range(n):
        yield "fast", fast(number)
        if number % 7 == 3:
            yield "slow", slow(number)
        if number % 11 == 5:
            yield "text", text(number)


def fed(pieces: list[bytes]) -> tuple[StreamCounts, dict[str, list[bytes]], list[Decoded]]:
    """Decode pieces; return the counts, the frames' bytes by type, and what each feed gave."""
    decoder = StreamDecoder(parse_description(KESTREL))
    given = [*(decoder.feed(piece) for piece in pieces), decoder.finish()]
    counts, found = StreamCounts(), {name: list[bytes]() for name in ("fast", "slow", "text")}
    for decoded in given:
        counts = counts + decoded.counts
        for name, batch in decoded.frames.items():
            found[name] += frames_of(batch)
    return counts, found, given


@pytest.mark.parametrize("size", [1, 2, 3, 31, 100, 1 << 20])
def test_every_frame_and_every_value_is_what_was_written(size: int) -> None:
    """Byte by byte, by threes, and all at once: numbers, turns of the multiplexed field, units, lengths, text."""
    sent = list(frames(300))
    data = b"".join(frame for _, frame in sent)
    counts, found, given = fed([data[at : at + size] for at in range(0, len(data), size)])
    assert counts == StreamCounts(ok=len(sent))
    assert found == {name: [frame for kind, frame in sent if kind == name] for name in found}
    columns = {
        name: np.concatenate([each["fast"].columns[name] for each in given]) for name in given[0]["fast"].columns
    }
    number = np.arange(300.0)
    assert np.array_equal(columns["gyro_y"], -number * 36.0)
    assert np.array_equal(columns["acc_x"], number / 1024)
    assert np.array_equal(columns["acc_z"], np.ones(300))
    odd = number % 2 == 1
    assert np.array_equal(columns["temperature"][odd], -number[odd] * 0.01)
    assert np.array_equal(columns["voltage"][~odd], (5000 + number[~odd]) * 0.001)
    assert np.isnan(columns["temperature"][~odd]).all()
    assert np.isnan(columns["voltage"][odd]).all()
    assert np.array_equal(np.concatenate([each["fast"].sequence for each in given]), number)
    assert np.concatenate([each["slow"].columns["time"] for each in given])[:2].tolist() == [300.0, 1000.0]
    assert np.concatenate([each["text"].columns["pressure"] for each in given])[0] == 1000.625


@pytest.mark.parametrize("seed", range(6))
def test_a_byte_in_a_thousand_takes_no_frame_but_its_own(seed: int) -> None:
    """However it is cut. A frame with damage on both sides may be confirmed by nothing: at most one in a hundred."""
    rng, sent = np.random.default_rng(seed), list(frames(2000))
    data = np.frombuffer(b"".join(frame for _, frame in sent), np.uint8).copy()
    hit = rng.random(len(data)) < 1e-3
    data[hit] ^= rng.integers(1, 256, int(hit.sum()), np.uint8)
    ends = np.cumsum([len(frame) for _, frame in sent])
    whole = [frame for (_, frame), end in zip(sent, ends, strict=True) if not hit[end - len(frame) : end].any()]
    damaged = data.tobytes()
    counts, found, _ = fed([damaged])
    good = [frame for each in found.values() for frame in each]
    assert len(set(good) - {frame for _, frame in sent}) <= 2  # eight and sixteen bits match by chance now and then
    assert len(good) >= 0.99 * len(whole)
    cuts = [0, *np.sort(rng.choice(len(damaged), 500, replace=False)).tolist(), len(damaged)]
    again, found_again, _ = fed([damaged[a:b] for a, b in pairwise(cuts)])
    assert (again, found_again) == (counts, found)
    assert counts.skipped_bytes == len(damaged) - sum(map(len, good)) - 31 * counts.duplicate


MISTAKES = {
    "id of a number": ('id: "01"', "id: 1", "frames.fast.id"),
    "odd length": ("length: 31", "length: thirty", "frames.fast.length"),
    "span too long": ("span: [3, null], confirm", "span: [3, 40], confirm", "frames.fast.checksum.span"),
    "unknown sum": ("kind: fletcher", "kind: fletcher16", "frames.fast.checksum.kind"),
    "step": ("step: 5", "step: 7", "frames.fast.counter.step"),
    "modulus": ("modulus: 100", "modulus: 300", "frames.fast.counter.modulus"),
    "counter": ("field: count, modulus", "field: cuont, modulus", "frames.fast.counter.field"),
    "turn": ("mask: 1, equals: 0", "mask: 1, equals: 2", "frames.fast.fields.voltage.when.equals"),
    "turn of nothing": (
        "field: count, mask: 1, equals: 0",
        "field: slot, equals: 0",
        "frames.fast.fields.voltage.when",
    ),
    "overlap": ("at: 27, scale: 0.001", "at: 25, scale: 0.001", "frames.fast.fields.voltage"),
    "overlap of one's turn": ("mask: 1, equals: 0", "mask: 2, equals: 0", "frames.fast.fields.voltage: byte 27"),
    "parameter": ("3600*${lsb}", "3600*${lbs}", "frames.fast.fields.gyro"),
    "scale": ('scale: "3600*${lsb}"', "scale: 3600x", "frames.fast.fields.gyro"),
    "choice": ("default: 200", "default: 300", "parameters.range.default"),
    "status bit": ("bit: 7", "bit: 8", "frames.fast.status.status.hot"),
    "digits": ("digits: 2", "digits: none", "frames.text.text.checksums.0.digits"),
    "field of text": ("pressure: {type: decimal", "pressure: {type: f32", "frames.text.fields.pressure"),
    "length in the frame": ("plus: 6, least", "plus: six, least", "frames.slow.length.plus"),
    "role": ("GX: gyro_x", "GX: gyro_q", "roles.sensors.1.rates.GX"),
    "role in another unit": ("X: acc_x", "X: gyro_x", "roles.sensors.1"),
    "byte order": ("byte_order: big", "byte_order: network", "byte_order"),
    "sync": ("sync: 7E C3", "sync: 7E C", "sync"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_every_mistake_is_told_with_its_key(case: str) -> None:
    """As it stands in the file, in one sentence."""
    old, new, key = MISTAKES[case]
    assert old in KESTREL
    with pytest.raises(InputError) as refusal:
        parse_description(KESTREL.replace(old, new, 1), "kestrel.yaml")
    assert f"kestrel.yaml: {key}" in str(refusal.value), str(refusal.value)
    assert "\n" not in str(refusal.value)
