"""The quick path for a few frames at a time means what the careful one means: values, counts, and what comes after."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.frames import StreamDecoder, encode, parse_description
from drivers.frames.counts import StreamCounts
from tests.drivers.frames.streams import STIM300
from tests.drivers.frames.test_damaged_streams import decode
from tests.drivers.frames.test_shipped_descriptions import shipped


def test_frames_without_a_counter_are_numbered_as_they_arrive_one_by_one() -> None:
    """Nothing can be lost or repeated; one damaged frame is left out."""
    description = parse_description(STIM300.replace("    counter: {field: counter, modulus: 256, step: 16}\n", ""))
    sent = encode(description, "rate_acc_incl", {"gyro_x": np.arange(8.0)})
    frames = [sent[at : at + 40] for at in range(0, len(sent), 40)]
    frames[5] = frames[5][:7] + b"\xff" + frames[5][8:]
    outcome = decode(description, frames)
    assert outcome.counts == StreamCounts(ok=7, bad_checksum=1, skipped_bytes=40, resyncs=1)
    assert outcome.sequence["rate_acc_incl"] == list(range(7))


@pytest.mark.parametrize(
    ("name", "frame"), [("mfs", "sample"), ("kvh1750", "format_A"), ("stim300", "rate_acc"), ("aceinna", "scaled_1")]
)
@pytest.mark.parametrize("together", [1, 2, 5, 40])
def test_gaps_and_repetitions_between_good_frames_count_the_same_however_few_arrive_at_once(
    name: str, frame: str, together: int
) -> None:
    """Counters that stand still or skip now and then, over many turns, in feeds of whole frames and all at once."""
    description, rng = shipped(name), np.random.default_rng(together)
    counter = description.frames[frame].counter
    assert counter is not None
    steps = rng.choice([0, 1, 2, 3], 800, p=[0.02, 0.92, 0.03, 0.03])
    counters = (counter.modulus - 300 * counter.step + np.cumsum(steps) * counter.step) % counter.modulus
    sent = encode(description, frame, {counter.field: counters})
    size = together * len(sent) // 800
    outcome = decode(description, [sent[at : at + size] for at in range(0, len(sent), size)])
    assert outcome == decode(description, [sent])
    assert outcome.counts.lost == int((steps[1:] - 1).clip(0).sum())
    assert outcome.counts.duplicate == int((steps[1:] == 0).sum())


@pytest.mark.parametrize("together", [1, 2, 30])
def test_a_weak_frame_amid_noise_is_believed_for_its_counter_however_few_arrived_at_once(together: int) -> None:
    """The counter is that of the last good frame, not of the last that was looked at with care."""
    sent = encode(shipped("epson-g3xx"), "burst", {"count": np.arange(31)})
    size = len(sent) // 31
    fed = [sent[at : at + together * size] for at in range(0, 30 * size, together * size)]
    outcome = decode(shipped("epson-g3xx"), [*fed, b"\x00" + sent[30 * size :] + b"\x00"])
    assert (outcome.counts.ok, outcome.counts.skipped_bytes) == (31, 2)


@pytest.mark.parametrize(
    ("name", "frame"), [("mfs", "sample"), ("kvh1750", "format_A"), ("stim300", "rate_acc"), ("epson-g3xx", "burst")]
)
def test_a_byte_flipped_anywhere_in_a_frame_fed_by_itself_is_noticed(name: str, frame: str) -> None:
    """Each byte of a frame in its turn, alone in its feed and between two others: that frame is lost, and no other."""
    description = shipped(name)
    counter = description.frames[frame].counter
    assert counter is not None
    sent = encode(description, frame, {counter.field: np.arange(6) * counter.step % counter.modulus})
    size = len(sent) // 6
    frames = [sent[at : at + size] for at in range(0, len(sent), size)]
    for at in range(size):
        bad = bytearray(frames[4])
        bad[at] ^= 0x11
        spoiled = [*frames[:4], bytes(bad), *frames[5:]]
        for together in (1, 3):
            pieces = [b"".join(spoiled[first : first + together]) for first in range(0, 6, together)]
            outcome = decode(description, pieces)
            assert outcome.frames[frame] == frames[:4] + frames[5:], (at, together)
            assert (outcome.counts.lost, outcome.counts.skipped_bytes) == (1, size), (at, together)


@pytest.mark.parametrize(("name", "frame"), [("mfs", "sample"), ("kvh1750", "format_A"), ("stim300", "rate_acc")])
@pytest.mark.parametrize("together", [2, 40, 200])
@pytest.mark.parametrize("damage", [0.0, 2e-4])
def test_whoever_asks_for_tuples_at_every_read_gets_what_the_whole_stream_gives(
    name: str, frame: str, together: int, damage: float
) -> None:
    """Tuples at every read, then columns, then tuples again: each way is made ready for the next read."""
    description, rng, n = shipped(name), np.random.default_rng(together), 1200
    counter = description.frames[frame].counter
    assert counter is not None
    steps = rng.choice([0, 1, 2], n, p=[0.002, 0.996, 0.002]).cumsum()
    columns = {field: rng.normal(0.0, 300.0, n) * f.scale for field, f in description.frames[frame].fields.items()}
    sent = encode(description, frame, columns | {counter.field: steps * counter.step % counter.modulus})
    size = len(sent) // n
    stream = np.frombuffer(sent, np.uint8).copy()
    stream[rng.random(len(stream)) < damage] ^= 0x55
    data, decoder = stream.tobytes(), StreamDecoder(description)
    records: list[tuple[float, ...]] = []
    starts: list[int] = []
    sequence: list[int] = []
    counts = StreamCounts()
    for number, at in enumerate(range(0, len(data), together * size)):
        decoded = decoder.feed(data[at : at + together * size])
        if number % 6 < 4:
            records += decoded.records(frame)
        else:
            records += zip(*(column.tolist() for column in decoded[frame].columns.values()), strict=True)
        starts += decoded[frame].starts.tolist()
        sequence += decoded[frame].sequence.tolist()
        counts = counts + decoded.counts
    whole = StreamDecoder(description)
    expected = whole.feed(data)
    assert counts == expected.counts
    assert (records, starts) == (expected.records(frame), expected[frame].starts.tolist())
    assert sequence == expected[frame].sequence.tolist()
    assert decoder.pending == whole.pending


@pytest.mark.parametrize(
    ("name", "frame"),
    [
        ("mfs", "sample"),
        ("kvh1750", "format_A"),
        ("kvh1750", "format_C"),
        ("stim300", "rate_acc_incl_temp"),
        ("dmu11", "message"),
        ("epson-g3xx", "burst"),
        ("hg4930", "control"),
        ("vectornav-binary", "start_imu"),
        ("aceinna", "scaled_1"),
    ],
)
def test_few_frames_have_the_same_values_to_the_digit_as_many(name: str, frame: str) -> None:
    """Columns, records, wire values, places and numbers: one by one, three or thirty at a time, and all at once."""
    description, rng, n = shipped(name), np.random.default_rng(5), 120
    described = description.frames[frame]
    columns = {field: rng.normal(0.0, 300.0, n) * f.scale for field, f in described.fields.items()}
    if described.counter is not None:
        columns[described.counter.field] = np.arange(n) * described.counter.step % described.counter.modulus
    if described.time is not None:
        columns[described.time.field] = np.arange(n) / description.sample_rate_hz + 0.01
    sent = encode(description, frame, columns)
    size = len(sent) // n
    whole = StreamDecoder(description).feed(sent + b"\x00" * 40)[frame]
    assert len(whole) == n
    for together in (1, 3, 30):
        decoder = StreamDecoder(description)
        fed = [decoder.feed(sent[at : at + together * size]) for at in range(0, len(sent), together * size)]
        fed.append(decoder.finish())
        batches = [each[frame] for each in fed]
        for records in ([each.records(frame) for each in fed], [batch.records() for batch in batches]):
            values = np.array([values for part in records for values in part])
            assert np.array_equal(values.T, list(whole.columns.values()), equal_nan=True), together
        for field in whole.columns:
            parts = np.concatenate([batch.columns[field] for batch in batches])
            assert np.array_equal(parts, whole.columns[field], equal_nan=True), (together, field)
            assert np.array_equal(np.concatenate([b.wire(field) for b in batches]), whole.wire(field), equal_nan=True)
        for which in ("starts", "sequence"):
            parts = np.concatenate([getattr(batch, which) for batch in batches])
            assert parts.tolist() == getattr(whole, which).tolist()
