"""Looking at the bytes of an unknown unit: what is found in captures, and a first description that reads them."""

from __future__ import annotations

from binascii import crc_hqx
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.frames.description import parse_description
from hil.bench import guess
from hil.bench.guess import guess_file
from hil.errors import InputError
from tests.drivers.frames.foreign import FOREIGN
from tests.drivers.frames.test_shipped_descriptions import decode_all

# Of each capture what is known of it: how its frames begin, their length, how many, and who reads them.
CAPTURES = [
    pytest.param(
        *("aceinna-s1", "55 55 53 31", 31, 1002, "aceinna", {"init": 0x1D0F, "span": [2, None]}), marks=pytest.mark.slow
    ),
    ("stim300-125hz", "93", 40, 524, "stim300", {"width": 32, "pad_to": 4}),
    pytest.param(
        *("xsens-mtdata2-2", "FA FF 36 8F", 148, 100, "xsens-mtdata2", {"kind": "sum", "negate": True}),
        marks=pytest.mark.slow,
    ),
]


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody reads it: trying all descriptions takes half a second."""
    monkeypatch.setattr(guess, "that_read", lambda *_, **__: [])


@pytest.mark.parametrize(
    ("name", "sync", "length", "frames", "reader", "checksum"), CAPTURES, ids=lambda each: str(each)
)
def test_a_capture_is_seen_through(
    reference_data: Path, name: str, sync: str, length: int, frames: int, reader: str, checksum: dict[str, Any]
) -> None:
    """Sync, length, checksum, and which description fits; the first description reads nearly all frames itself."""
    path = reference_data / "captures" / f"{name}.bin"
    document = guess_file(path)
    assert document["fits"][0]["description"] == reader
    assert (document["fits"][0]["frames"], document["sync"], document["length"]) == (frames, sync, length)
    assert {key: document["checksum"][key] for key in checksum} == checksum
    counts = decode_all(parse_description(document["description"]), path.read_bytes())[1]
    assert counts.ok > 0.85 * frames
    assert counts.lost + counts.duplicate <= 0.2 * frames


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize(("first", "kind"), [(0xA986, "u8"), (0xA9F0, "u16")])
def test_a_byte_that_never_counts_is_not_called_part_of_a_counter(first: int, kind: str, tmp_path: Path) -> None:
    """A big-endian count of 16 bits beside a byte that stands still: until its high byte steps it is one of 8."""
    rng = np.random.default_rng(2)
    frames = []
    for number in range(60):
        content = b"\xfa\xff\x36\x10" + (first + number).to_bytes(2, "big") + b"\x10" + rng.bytes(20)
        frames.append(content + bytes([-sum(content[1:]) % 256]))
    path = tmp_path / "unknown.bin"
    path.write_bytes(b"".join(frames))
    counter = guess_file(path)["counter"]
    assert (counter["type"], counter["at"] + int(counter["type"][1:]) // 8 - 1, counter["step"]) == (kind, 5, 1)


@pytest.mark.usefixtures("alone")
def test_a_counter_and_a_checksum_before_its_payload_are_found(tmp_path: Path) -> None:
    """The maker's HI91 with a time that goes on, as a unit of which nothing is known; its CRC stands at byte 4."""
    frames = []
    rng = np.random.default_rng(1)
    for number in range(200):
        frame = bytearray(FOREIGN["hipnuc"][0].sent)
        frame[14:18] = (8 * number).to_bytes(4, "little")
        frame[18:82] = rng.integers(0, 256, 64, np.uint8).tobytes()
        frame[4:6] = crc_hqx(bytes(frame[:4] + frame[6:]), 0).to_bytes(2, "little")
        frames.append(bytes(frame))
    path = tmp_path / "unknown.bin"
    path.write_bytes(b"".join(frames))
    document = guess_file(path)
    assert document["checksum"]["at"] == 4
    assert "sample_rate_hz: 100  # TO DO: no recording tells it" in document["description"]
    assert document["checksum"]["span"] == [[0, 4], [6, None]]
    assert (document["length"], document["repeats_every"], document["counter"]["step"]) == (82, 82, 8)
    assert decode_all(parse_description(document["description"]), path.read_bytes())[1].lost == 0


@pytest.mark.usefixtures("alone")
def test_lines_are_told_from_frames(tmp_path: Path) -> None:
    """Their separator, their number of tokens and their beginning; the first description reads them."""
    for sent, ok in [(FOREIGN["vectornav-ascii"][0].sent, 40), (b"12;0.5;-3\n", 40)]:
        path = tmp_path / "unknown.txt"
        path.write_bytes(sent * 40)
        document = guess_file(path)
        assert decode_all(parse_description(document["description"]), sent * 40)[1].ok == ok


def test_noise_is_called_nothing_and_too_little_is_refused(tmp_path: Path) -> None:
    """No description is made of nothing."""
    path = tmp_path / "noise.bin"
    path.write_bytes(np.random.default_rng(1).integers(0, 256, 20000, np.uint8).tobytes())
    document = guess_file(path)
    assert (document["fits"], document["description"]) == ([], None)
    path.write_bytes(b"123")
    with pytest.raises(InputError, match=r"too few bytes \(3\) to guess from"):
        guess_file(path)
