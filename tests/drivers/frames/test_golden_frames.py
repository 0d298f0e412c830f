"""Frames captured from real units, and printed in their manuals, decode to the values given for them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from tests.drivers.frames.status_bits import bits
from tests.drivers.frames.streams import kvh, stim300


def golden(reference: Path, layout: str) -> list[dict[str, Any]]:
    """Return the entries of one layout; there must be some."""
    entries = [e for e in json.loads((reference / "golden_frames.json").read_text()) if e["layout"] == layout]
    assert entries
    return entries


def test_stim300_frames_decode_to_the_given_values(reference: Path) -> None:
    """Rates, accelerations, inclinations, status and counter, and the edited frame is refused."""
    accepted = 0
    for entry in golden(reference, "stim300_0x93_rate_acc_incl_crlf"):
        decoder = StreamDecoder(stim300())
        decoded = decoder.feed(bytes.fromhex(entry["hex"]))
        counts = decoded.counts + decoder.finish().counts
        assert (counts.ok, counts.bad_checksum) == ((1, 0) if entry["checksum_ok"] else (0, 1))
        if not entry["checksum_ok"]:
            continue
        accepted += 1
        batch, expected = decoded["rate_acc_incl"], entry["expected"]
        for axis, name in enumerate("xyz"):
            assert batch.wire(f"gyro_{name}")[0] == expected["gyro_raw"][axis]
            assert batch.column(f"gyro_{name}")[0] == expected["gyro_deg_s"][axis]
            assert batch.column(f"acc_{name}")[0] == expected["acc_g"][axis]
            assert batch.column(f"incl_{name}")[0] == expected["incl_g"][axis]
        for name in ("gyro_status", "acc_status", "incl_status", "counter", "latency_us"):
            assert batch.wire(name)[0] == expected[name]
    assert accepted >= 2


def test_kvh_frames_decode_to_the_given_values_and_its_bits_mean_valid(reference: Path) -> None:
    """Floats of format A, sequence, temperature; a bit of 1 is good; the bad CRC is refused."""
    for entry in golden(reference, "kvh_format_A_36B"):
        decoder = StreamDecoder(kvh())
        decoded = decoder.feed(bytes.fromhex(entry["hex"]))
        counts = decoded.counts + decoder.finish().counts
        assert (counts.ok, counts.bad_checksum) == ((1, 0) if entry["checksum_ok"] else (0, 1))
        if entry["checksum_ok"]:
            batch, expected = decoded["format_A"], entry["expected"]
            assert [batch.column(f"gyro_{axis}")[0] for axis in "xyz"] == expected["gyro"]
            assert [batch.column(f"acc_{axis}")[0] for axis in "xyz"] == expected["acc_g"]
            assert batch.wire("sequence")[0] == expected["seq"]
            assert batch.wire("temperature")[0] == expected["temp"]
            assert bits(batch, "gyro_x_valid")[0] == bool(expected["status"] & 1)
            assert bits(batch, "acc_z_valid")[0] == bool(expected["status"] & 64)


def test_kvh_built_in_test_frames_interleave_with_samples(reference: Path) -> None:
    """The 11-byte frame between two 36-byte frames, and the manual's misprinted one, which is refused."""
    samples = [bytes.fromhex(e["hex"]) for e in golden(reference, "kvh_format_A_36B") if e["checksum_ok"]]
    test = bytes.fromhex(golden(reference, "kvh_extended_bit_11B")[0]["hex"])
    misprint = bytes.fromhex(golden(reference, "kvh_extended_bit2_13B_AS_PRINTED")[0]["hex"])
    decoded = StreamDecoder(kvh()).feed(samples[0] + test + misprint + samples[0] + test)
    assert (len(decoded["extended_bit"]), decoded.counts.ok, decoded.counts.duplicate) == (2, 3, 1)
    assert decoded.counts.skipped_bytes == len(misprint)


@pytest.mark.parametrize("piece", [1 << 20, 1000, 41])
def test_a_captured_stim300_stream_decodes_completely(reference_data: Path, piece: int) -> None:
    """524 datagrams at 125/s, every checksum right, counter in steps of 16, nothing lost."""
    data = (reference_data / "captures" / "stim300-125hz.bin").read_bytes()
    decoder = StreamDecoder(stim300())
    results = [decoder.feed(data[at : at + piece]) for at in range(0, len(data), piece)] + [decoder.finish()]
    counts = sum((decoded.counts for decoded in results), StreamCounts())
    assert counts == StreamCounts(ok=524)
    counters = np.concatenate([decoded["rate_acc_incl"].wire("counter") for decoded in results]).astype(int)
    assert (np.diff(counters) % 256 == 16).all()
