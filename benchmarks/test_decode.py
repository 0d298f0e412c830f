"""Decoding from memory: the decoder against a struct loop with a compiled CRC, in one run.

    pytest benchmarks/test_decode.py --benchmark-only          # rates
    pytest benchmarks/test_decode.py -k every_chunk_size -s    # the comparison, frames per feed from 1 to 1 000 000

Both verify sync and CRC, scale every field into its unit, account for gaps in the counter, and end with one column per
field. The decoder also resynchronises, counts what it skips and keeps half frames, which the loop does not.
"""

from __future__ import annotations

import struct
import time
import zlib
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.frames import StreamDecoder, StreamDescription, encode, load_description

_IMUS = Path(__file__).resolve().parents[1] / "configs" / "imus"
_REVERSED_BITS = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_KVH = struct.Struct(">4s6fBBhI")  # format A, 36 bytes
_MFS = struct.Struct("<3sBHB8i3hH2II")  # the project's own frame, 59 bytes

Columns = Iterable[np.ndarray[Any, Any]]


@cache
def description(name: str) -> StreamDescription:
    """Return a shipped description."""
    return load_description(_IMUS / f"{name}.yaml")


@cache
def stream(name: str, frames: int) -> bytes:
    """Return a clean stream of so many samples of a unit."""
    rng, numbers = np.random.default_rng(1), np.arange(frames)
    if name == "mfs":
        rates = {f"rate_{channel}": rng.normal(0.0, 5.0, frames) for channel in ("A1", "B1", "A2", "B2")}
        return encode(description(name), "sample", {"counter": numbers % 65536, **rates})
    counter = {
        "kvh1750": ("format_A", "sequence", numbers % 128),
        "stim300": ("rate_acc_incl", "counter", numbers * 16 % 256),
    }
    frame, field, values = counter[name]
    rates = {f"gyro_{axis}": rng.normal(0.0, 5.0, frames) for axis in "xyz"}
    return encode(description(name), frame, {field: values, **rates})


def kvh_loop() -> Callable[[bytes], Columns]:
    """Return a decoder of KVH format A, frame by frame with struct and zlib, that ends with columns."""
    scales = [field.scale for field in description("kvh1750").frames["format_A"].fields.values()]
    state = {"sequence": 127, "lost": 0}

    def decode(data: bytes) -> Columns:
        values = []
        for at in range(0, len(data), 36):
            record = _KVH.unpack_from(data, at)
            # CRC-32/MPEG-2 by the compiled CRC-32 of the bytes with their bits reversed
            if (
                record[0] != b"\xfe\x81\xff\x55"
                or zlib.crc32(data[at : at + 36].translate(_REVERSED_BITS)) != 0xFFFFFFFF
            ):
                raise ValueError("a bad frame")
            state["lost"] += (record[8] - state["sequence"] - 1) % 128
            state["sequence"] = record[8]
            values.append(record[1:-1])
        return [np.array(column) * scale for column, scale in zip(zip(*values, strict=True), scales, strict=True)]

    return decode


def mfs_loop() -> Callable[[bytes], Columns]:
    """The same for the MFS frame; its CRC is zlib's own."""
    scales = [field.scale for field in description("mfs").frames["sample"].fields.values()]
    state = {"counter": 65535, "lost": 0}

    def decode(data: bytes) -> Columns:
        values = []
        for at in range(0, len(data), 59):
            record = _MFS.unpack_from(data, at)
            if record[0] != b"\xa5\x5a\x01" or zlib.crc32(data[at : at + 55]) != record[-1]:
                raise ValueError("a bad frame")
            state["lost"] += (record[2] - state["counter"] - 1) % 65536
            state["counter"] = record[2]
            values.append(record[1:-1])
        return [np.array(column) * scale for column, scale in zip(zip(*values, strict=True), scales, strict=True)]

    return decode


def decoder(name: str, frame: str) -> Callable[[bytes], Columns]:
    """Return the decoder, with its columns asked for."""
    stream_decoder = StreamDecoder(description(name))

    def decode(data: bytes) -> Columns:
        decoded = stream_decoder.feed(data)
        assert decoded.counts.lost == 0
        return decoded[frame].columns.values()

    return decode


UNITS = {"kvh1750": ("format_A", 36, kvh_loop), "mfs": ("sample", 59, mfs_loop)}


def pieces(name: str, size: int, frames_per_feed: int, frames: int) -> list[bytes]:
    """Cut a stream into feeds."""
    data, step = stream(name, frames), size * frames_per_feed
    return [data[at : at + step] for at in range(0, len(data), step)]


@pytest.mark.parametrize("frames_per_feed", [1, 10, 100, 1000, 10_000, 100_000, 1_000_000])
@pytest.mark.parametrize("method", ["decoder", "struct and zlib"])
def test_decoding_36_byte_frames(benchmark: Any, method: str, frames_per_feed: int) -> None:
    """KVH format A with CRC-32, scale and gap accounting; `frames_per_s` is in the extra information."""
    benchmark.group = f"KVH format A, {frames_per_feed} frames per feed"
    frames = 1_000_000 if frames_per_feed >= 1000 else 5000
    feeds = pieces("kvh1750", 36, frames_per_feed, frames)

    def work() -> None:
        decode = decoder("kvh1750", "format_A") if method == "decoder" else kvh_loop()
        for feed in feeds:
            decode(feed)

    benchmark.pedantic(work, rounds=3, warmup_rounds=1)
    if benchmark.stats is not None:
        benchmark.extra_info["frames_per_s"] = frames / benchmark.stats.stats.median


def best_times(works: list[Callable[[], None]], rounds: int) -> list[float]:
    """Return the shortest time of each, taken in turns, so that a busy machine is busy for all."""
    best = [np.inf] * len(works)
    for _ in range(rounds):
        for number, work in enumerate(works):
            begins = time.perf_counter()
            work()
            best[number] = min(best[number], time.perf_counter() - begins)
    return best


@pytest.mark.parametrize("name", UNITS)
@pytest.mark.timeout(300)
def test_the_decoder_is_as_fast_as_the_loop_at_every_chunk_size(name: str) -> None:
    """From one frame per feed to a million, both with columns at the end."""
    frame, size, loop = UNITS[name]
    print()
    for frames_per_feed in (1, 2, 5, 10, 20, 40, 80, 160, 320, 1000, 10_000, 100_000, 1_000_000):
        frames = max(min(2000 * frames_per_feed, 20_000), frames_per_feed)
        feeds = pieces(name, size, frames_per_feed, frames)

        def run(make: Callable[[], Callable[[bytes], Columns]], feeds: list[bytes] = feeds) -> None:
            decode = make()
            for feed in feeds:
                decode(feed)

        works = [lambda run=run: run(lambda: decoder(name, frame)), lambda run=run: run(loop)]  # type: ignore[misc]
        ours, theirs = best_times(works, 2 if frames_per_feed > 100_000 else 7)
        rates = [frames / seconds / 1e6 for seconds in (ours, theirs)]
        print(f"{name} {frames_per_feed:8d} per feed: {rates[0]:6.2f} M/s, loop {rates[1]:6.2f} M/s")
        assert ours <= theirs


@pytest.mark.parametrize(
    ("name", "frame", "size", "at_least"), [("kvh1750", "format_A", 36, 5e6), ("stim300", "rate_acc_incl", 38, 3e6)]
)
def test_a_file_is_decoded_at_millions_of_frames_per_second(name: str, frame: str, size: int, at_least: float) -> None:
    """In chunks of 4 MB, CRC, scale and gaps included: 36 bytes with CRC-32, and STIM300 with 24-bit integers."""
    data = stream(name, 1_000_000)

    def work() -> None:
        decode = decoder(name, frame)
        for at in range(0, len(data), 1 << 22):
            decode(data[at : at + (1 << 22)])

    rate = len(data) / size / best_times([work], 4)[0]
    print(f"\n{name}: {rate / 1e6:.2f} million frames/s")
    assert rate >= at_least


@pytest.mark.parametrize("damage", [0.0, 1e-5, 1e-3])
def test_decoding_a_damaged_stream(benchmark: Any, damage: float) -> None:
    """The same, with bytes flipped at the given rate; the good frames are all that come out."""
    benchmark.group = "100 000 MFS frames with damage"
    rng = np.random.default_rng(2)
    data = np.frombuffer(stream("mfs", 100_000), np.uint8).copy()
    flips = rng.random(len(data)) < damage
    data[flips] ^= 0x55
    whole = int((~flips.reshape(-1, _MFS.size).any(axis=1)).sum())
    spoiled = data.tobytes()
    assert benchmark(lambda: StreamDecoder(description("mfs")).feed(spoiled).counts.ok) == whole


@pytest.mark.parametrize("name", ["xsens-mtdata2-1", "stim300-125hz"])
def test_decoding_captures(benchmark: Any, reference_captures: Path, name: str) -> None:
    """Messages of items, and datagrams with line ends, a hundred times over; counters begin anew each time."""
    imu = {"xsens-mtdata2-1": "xsens-mtdata2"}.get(name, "stim300")
    data = (reference_captures / f"{name}.bin").read_bytes() * 100
    ok = benchmark(lambda: StreamDecoder(description(imu)).feed(data).counts.ok)
    if benchmark.stats is not None:
        benchmark.extra_info["frames_per_s"] = ok / benchmark.stats.stats.median


@pytest.fixture
def reference_captures() -> Path:
    """Folder of real captures; the benchmark is skipped where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data" / "captures"
    if not folder.is_dir():
        pytest.skip("the captures (../shared/data/captures) are not beside this checkout")
    return folder
