"""Decoding the MFS frame from memory: the decoder against a struct loop with the compiled CRC of zlib.

    pytest benchmarks/test_decode.py --benchmark-only

Both verify sync and CRC, scale every field into its unit, account for gaps in the counter, and end with one column per
field. The decoder also resynchronises, which the loop does not.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.frames import StreamDecoder, encode, load_description

_MFS = Path(__file__).resolve().parents[1] / "configs" / "imus" / "mfs.yaml"
_FRAMES = 100_000
_RECORD = struct.Struct("<3sBHB8i3hH2II")


@pytest.fixture(scope="module")
def stream() -> bytes:
    """Return a clean stream of samples."""
    rng = np.random.default_rng(1)
    numbers = np.arange(_FRAMES)
    rates = {name: rng.normal(0.0, 5.0, _FRAMES) for name in ("rate_A1", "rate_B1", "rate_A2", "rate_B2")}
    return encode(load_description(_MFS), "sample", {"counter": numbers % 65536, **rates})


def struct_loop(data: bytes, scales: list[float], state: dict[str, int]) -> list[np.ndarray[Any, Any]]:
    """Decode frame by frame with struct and zlib; return the columns."""
    values = []
    for at in range(0, len(data), _RECORD.size):
        record = _RECORD.unpack_from(data, at)
        if record[0] != b"\xa5\x5a\x01" or zlib.crc32(data[at : at + _RECORD.size - 4]) != record[-1]:
            raise ValueError("a bad frame")
        state["lost"] += (record[2] - state["counter"] - 1) % 65536
        state["counter"] = record[2]
        values.append(record[1:-1])
    return [np.array(column) * scale for column, scale in zip(zip(*values, strict=True), scales, strict=True)]


@pytest.mark.parametrize("frames_per_feed", [1, 10, 100, 1000, 10_000, 100_000])
@pytest.mark.parametrize("method", ["decoder", "struct and zlib"])
def test_decoding_from_memory(benchmark: Any, stream: bytes, method: str, frames_per_feed: int) -> None:
    """Frames per second are `_FRAMES` (or the first 2000 for small feeds) divided by the time."""
    benchmark.group = f"{frames_per_feed} frames per feed"
    data = stream if frames_per_feed >= 1000 else stream[: 2000 * _RECORD.size]
    size = frames_per_feed * _RECORD.size
    pieces = [data[at : at + size] for at in range(0, len(data), size)]
    description = load_description(_MFS)
    scales = [field.scale for field in description.frames["sample"].fields.values()]
    frames = len(data) // _RECORD.size

    def decode() -> int:
        decoder = StreamDecoder(description)
        decoded = 0
        for piece in pieces:
            result = decoder.feed(piece)
            assert result.counts.lost == 0
            decoded += len(result["sample"].columns["rate_A2"])
        return decoded

    def loop() -> int:
        state = {"counter": 65535, "lost": 0}
        decoded = sum(len(struct_loop(piece, scales, state)[0]) for piece in pieces)
        assert state["lost"] == 0
        return decoded

    assert benchmark(decode if method == "decoder" else loop) == frames
    if benchmark.stats is not None:
        benchmark.extra_info["frames_per_s"] = frames / benchmark.stats.stats.median


@pytest.mark.parametrize("damage", [0.0, 1e-5, 1e-3])
def test_decoding_a_damaged_stream(benchmark: Any, stream: bytes, damage: float) -> None:
    """The same, with bytes flipped at the given rate; the good frames are all that come out."""
    benchmark.group = "100 000 frames with damage"
    rng = np.random.default_rng(2)
    data = np.frombuffer(stream, np.uint8).copy()
    flips = rng.random(len(data)) < damage
    data[flips] ^= 0x55
    whole = int((~flips.reshape(-1, _RECORD.size).any(axis=1)).sum())
    spoiled = data.tobytes()
    description = load_description(_MFS)
    assert benchmark(lambda: StreamDecoder(description).feed(spoiled).counts.ok) == whole
