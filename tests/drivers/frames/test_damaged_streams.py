"""Real captures and made streams under damage, and arbitrary bytes: what came through comes out, and nothing else."""

from __future__ import annotations

from collections import Counter
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.frames import scan as scan_module
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import StreamDescription, parse_description
from drivers.frames.layout import encode
from tests.drivers.frames.streams import frames_of
from tests.drivers.frames.test_shipped_descriptions import LAYOUTS, shipped
from tests.drivers.frames.test_stream_decoder import Outcome, cut

SEEDS = range(12)


def decode(description: StreamDescription, pieces: list[bytes]) -> Outcome:
    """Feed the pieces and return everything."""
    decoder, outcome = StreamDecoder(description), Outcome()
    for decoded in [*(decoder.feed(piece) for piece in pieces), decoder.finish()]:
        outcome.counts += decoded.counts
        for name, batch in decoded.frames.items():
            outcome.frames.setdefault(name, []).extend(frames_of(batch))
            outcome.starts.setdefault(name, []).extend(batch.starts.tolist())
            outcome.sequence.setdefault(name, []).extend(batch.sequence.tolist())
    return outcome


def all_frames(outcome: Outcome) -> list[bytes]:
    """Return the frames of all types in the order of arrival."""
    pairs = [pair for name in outcome.frames for pair in zip(outcome.starts[name], outcome.frames[name], strict=True)]
    return [frame for _, frame in sorted(pairs)]


def damage(frames: list[bytes], seed: int, rate: float) -> tuple[bytes, list[bytes]]:
    """Flip and drop bytes at `rate` each; return the stream and the frames that came through undamaged."""
    rng = np.random.default_rng(seed)
    pieces, whole = [], []
    for frame in frames:
        row = np.frombuffer(frame, np.uint8).copy()
        flips, kept = rng.random(len(row)) < rate, rng.random(len(row)) >= rate
        row[flips] ^= rng.integers(1, 256, int(flips.sum()), dtype=np.uint8)
        pieces.append(row[kept].tobytes())
        if kept.all() and not flips.any():
            whole.append(frame)
    return b"".join(pieces), whole


CAPTURES = {
    "stim300": ["stim300-125hz"],
    "vectornav-binary": ["vectornav-binary-and-ascii"],
    "vectornav-ascii": ["vectornav-binary-and-ascii"],
    "xsens-mtdata2": ["xsens-mtdata2-1", "xsens-mtdata2-2"],
}


@pytest.mark.parametrize("name", CAPTURES)
def test_under_damage_the_undamaged_frames_of_a_capture_come_out_and_no_damaged_one(
    name: str, reference_data: Path
) -> None:
    """Byte flips and drops at 1e-3 each: at least 99 % of what came through; with a CRC, nothing else at all."""
    came_through = recovered = false = 0
    for stem in CAPTURES[name]:
        clean = decode(shipped(name), [(reference_data / "captures" / f"{stem}.bin").read_bytes()])
        frames = all_frames(clean)
        assert len(frames) >= 6
        for seed in SEEDS:
            stream, whole = damage(frames, seed, 1e-3)
            outcome = decode(shipped(name), [stream])
            found, expected = Counter(all_frames(outcome)), Counter(whole)
            came_through += len(whole)
            recovered += sum((found & expected).values())
            false += sum((found - expected).values())
    assert recovered >= 0.99 * came_through
    if name in ("stim300", "vectornav-binary"):
        assert false == 0
    else:  # eight bits of check sum or exclusive or
        assert false <= 0.002 * came_through


WEAK = """
schema: hil.frames/1
name: weak
sample_rate_hz: 100
byte_order: big
sync: AA
frames:
  fixed:
    id: "01"
    length: 6
    checksum: {kind: sum, width: 8, confirm: true}
    fields: {count: {type: u8}}
    counter: {field: count, modulus: 256}
  long:
    id: "02"
    length: {at: 2, type: u8, plus: 4, most: 20}
    checksum: {kind: sum, width: 8, confirm: true}
    items: {begin: 3, known: {a: {id: 7, fields: {a: {type: u16}}}, b: {id: 8, fields: {b: {type: fp12.20}}}}}
  line:
    id: "24"
    delimiter: 0D
    text: {most: 24, checksums: [{kind: xor, mark: "*", first: 2, digits: 2}]}
    fields: {value: {type: decimal}}
"""


def weak() -> StreamDescription:
    """Return a stream of frames with weak checksums: fixed, of items, and lines of text."""
    return parse_description(WEAK)


def fixed(count: int) -> bytes:
    """Return a frame of fixed length."""
    body = bytes([0xAA, 1, count % 256, 0, 0])
    return body + bytes([sum(body) & 0xFF])


def long(items: bytes) -> bytes:
    """Return a frame of items."""
    body = bytes([0xAA, 2, len(items)]) + items
    return body + bytes([sum(body) & 0xFF])


def line(text: bytes) -> bytes:
    """Return a line."""
    return b"\xaa$" + text + b"*%02X\r" % reduce(xor, text, 0)


def test_a_weak_frame_after_damage_waits_for_the_next_header() -> None:
    """Right by chance is not good enough; in step, no confirmation is needed."""
    decoder = StreamDecoder(weak())
    assert decoder.feed(fixed(0)).counts == StreamCounts(ok=1)
    assert decoder.feed(b"\x00" + fixed(100)).counts.ok == 0
    assert decoder.feed(fixed(101)[:1]).counts.ok == 0
    assert decoder.feed(fixed(101)[1:]).counts.ok == 2
    chance = fixed(200) + b"\x55"
    assert decode(weak(), [fixed(0) + b"\x00" + chance + fixed(1)]).frames["fixed"] == [fixed(0), fixed(1)]
    assert decode(weak(), [fixed(0) + b"\x00" + chance]).counts.bad_checksum == 1


def test_a_counter_that_goes_on_confirms_a_weak_frame_too() -> None:
    """Damage before and behind it: its number is next in turn, as that of a frame by chance would hardly be."""
    assert decode(weak(), [fixed(254) + b"\x00" + fixed(0) + b"\x55" * 3]).frames["fixed"] == [fixed(254), fixed(0)]
    for stranger in (90, 254, 253):
        outcome = decode(weak(), [fixed(254) + b"\x00" + fixed(stranger) + b"\x55" * 3])
        assert outcome.frames["fixed"] == [fixed(254)]
        assert outcome.counts.duplicate == 0


def test_a_weak_frame_at_the_very_end_is_believed() -> None:
    """Nothing speaks against it, and nothing more will come: at the end of a file, and when the wait is over."""
    assert decode(weak(), [b"\x00" + fixed(7)]).frames["fixed"] == [fixed(7)]
    decoder = StreamDecoder(weak())
    decoder.feed(b"\x00" + fixed(7), 1.0)
    assert decoder.feed(b"", 1.1).counts.ok == 0
    assert decoder.feed(b"", 1.3).counts == StreamCounts(ok=1, resyncs=1)


def test_items_that_do_not_fill_their_frame_make_it_a_bad_one() -> None:
    """The sum is right, the inside is not; an item that is not known, or too short for its fields, is skipped."""
    good = long(b"\x09\x01\x00" + b"\x07\x02\x12\x34" + b"\x07\x02\x99\x99")
    decoded = StreamDecoder(weak()).feed(good + long(b"\x07\x01\x12") + long(b""))
    assert decoded["long"].column("a")[0] == 0x1234
    assert np.isnan(decoded["long"].column("a")[1:]).all()
    assert np.isnan(decoded["long"].column("b")).all()
    outcome = decode(weak(), [good + long(b"\x07\x05\x12\x34") + good])
    assert (outcome.counts.ok, outcome.counts.bad_checksum) == (2, 1)


def test_frames_of_one_length_with_other_items_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that follow one another without a flaw are read at once only as far as their items are the same."""
    monkeypatch.setattr(scan_module, "_FEW", 0)
    frames = [long(bytes([known, 2, 0x12, 0x34])) for known in (7, 7, 9, 9, 7)]
    decoded = StreamDecoder(weak()).feed(b"".join(frames) + long(b"\x07\x05\x12\x34") + frames[0] + fixed(0))
    assert decoded["long"].column("a").tolist() == pytest.approx(
        [0x1234] * 2 + [np.nan] * 2 + [0x1234] * 2, nan_ok=True
    )
    assert decoded.counts == StreamCounts(ok=7, bad_checksum=1, skipped_bytes=8, resyncs=1)


def test_a_line_with_other_than_its_numbers_is_a_bad_one() -> None:
    """Too many, none, and what is not a number."""
    for text in (b"1,2", b"", b"x", b"1e", b"--1", b"1 2"):
        assert decode(weak(), [line(text)]).counts.bad_checksum == 1, text
    outcome = decode(weak(), [line(b"-1.5e3") + line(b".5")])
    assert outcome.counts == StreamCounts(ok=2)


@st.composite
def weak_streams(draw: st.DrawFn) -> bytes:
    """Draw a stream of good frames, pieces of them, noise and headers."""
    pieces = []
    for count in range(draw(st.integers(1, 10))):
        value = draw(st.integers(0, 65535))
        frame = draw(
            st.sampled_from(
                [
                    fixed(count),
                    fixed(count),
                    fixed(value),
                    long(b"\x07\x02" + value.to_bytes(2, "big")),
                    long(b"\x09\x00"),
                    long(b"\x07\x03\x01"),
                    long(b"\x08\x04" + bytes(4) + b"\x07\x02ab"),
                    line(b"%d" % value),
                    b"\xaa\x02\x05",
                    b"\xaa$12",
                    b"\xaa\x01",
                    b"\xaa",
                ]
            )
        )
        what = draw(st.sampled_from(["good", "good", "good", "flip", "cut", "noise"]))
        if what == "flip":
            at = draw(st.integers(0, len(frame) - 1))
            frame = frame[:at] + bytes([frame[at] ^ draw(st.integers(1, 255))]) + frame[at + 1 :]
        elif what == "cut":
            frame = frame[draw(st.integers(0, 3)) :]
        elif what == "noise":
            frame = draw(st.binary(max_size=12))
        pieces.append(frame)
    return b"".join(pieces)


def same_however_it_is_cut(description: StreamDescription, stream: bytes, places: list[int]) -> Outcome:
    """Assert that neither the cut nor the speed changes anything; return what was decoded."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scan_module, "_FEW", 10**9)
        slow = decode(description, [stream])
        assert decode(description, cut(stream, places)) == slow
        assert decode(description, [stream[at : at + 1] for at in range(len(stream))]) == slow
        patch.setattr(scan_module, "_FEW", 0)
        assert decode(description, [stream]) == slow
        patch.setattr(scan_module, "_MOST", 100)
        assert decode(description, [stream]) == slow
        assert decode(description, cut(stream, places)) == slow
    taken = sum(map(len, all_frames(slow)))
    assert taken + slow.counts.skipped_bytes <= len(stream)
    return slow


@settings(max_examples=40)
@given(weak_streams(), st.lists(st.integers(0, 10**6), max_size=12))
def test_weak_frames_items_and_lines_have_one_meaning(stream: bytes, places: list[int]) -> None:
    """Frame by frame, many at once, in one piece, in several, byte by byte: the same frames, places and counts."""
    same_however_it_is_cut(weak(), stream, places)


@pytest.mark.slow
@settings(max_examples=150)
@given(weak_streams(), st.lists(st.integers(0, 10**6), max_size=12))
def test_weak_frames_items_and_lines_have_one_meaning_in_many_streams(stream: bytes, places: list[int]) -> None:
    """The same, looked for longer."""
    same_however_it_is_cut(weak(), stream, places)


@st.composite
def stim300_streams(draw: st.DrawFn) -> bytes:
    """Draw a STIM300 stream: with or without line ends, now and then changing, with damage."""
    with_ends, pieces = draw(st.booleans()), []
    for count in range(draw(st.integers(1, 8))):
        name = draw(st.sampled_from(["rate_acc_incl", "rate_acc_incl", "rate", "rate_temp", "part_number"]))
        columns = {"counter": count * 16 % 256} if name != "part_number" else {}
        frame = encode(shipped("stim300"), name, columns)
        frame += b"\r\n" if with_ends else b""
        what = draw(st.sampled_from(["good", "good", "good", "good", "flip", "cut", "noise", "end", "line"]))
        if what == "flip":
            at = draw(st.integers(0, len(frame) - 1))
            frame = frame[:at] + bytes([frame[at] ^ draw(st.integers(1, 255))]) + frame[at + 1 :]
        elif what == "cut":
            frame = frame[draw(st.integers(0, 3)) : draw(st.integers(3, len(frame)))]
        elif what == "noise":
            frame = draw(st.binary(max_size=20))
        elif what == "end":
            frame += draw(st.sampled_from([b"\r", b"\n", b"\r\n", b"\r\r\n"]))
        elif what == "line":
            frame = b"$isn,28\r"
        pieces.append(frame)
    return b"".join(pieces)


@pytest.mark.slow
@settings(max_examples=20)
@given(stim300_streams(), st.lists(st.integers(0, 10**6), max_size=8))
def test_optional_line_ends_have_one_meaning(stream: bytes, places: list[int]) -> None:
    """Whether the unit ends its datagrams with CR LF is found out the same way however the stream is cut."""
    same_however_it_is_cut(shipped("stim300"), stream, places)


@pytest.mark.slow
@settings(max_examples=80)
@given(stim300_streams(), st.lists(st.integers(0, 10**6), max_size=8))
def test_optional_line_ends_have_one_meaning_in_many_streams(stream: bytes, places: list[int]) -> None:
    """The same, looked for longer."""
    same_however_it_is_cut(shipped("stim300"), stream, places)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYOUTS)
@settings(max_examples=15)
@given(data=st.data())
def test_arbitrary_bytes_mean_the_same_to_every_description_however_they_are_cut(
    name: str, data: st.DataObject
) -> None:
    """Never an exception; bytes likely to look like headers among them."""
    description = shipped(name)
    headers = [header for frame in description.frames for header in description.headers(frame)]
    some = st.one_of(st.binary(max_size=12), st.sampled_from(headers), st.sampled_from([b"\r\n", b"\r", b"\xff"]))
    stream = b"".join(data.draw(st.lists(some, max_size=12)))
    outcome = same_however_it_is_cut(description, stream, data.draw(st.lists(st.integers(0, 10**6), max_size=5)))
    assert outcome.counts.skipped_bytes <= len(stream)


def test_a_sync_that_no_checksum_covers_is_looked_at_in_every_frame() -> None:
    """Also on the quick path, where frames of the expected type follow one another."""
    sent = encode(shipped("aceinna"), "scaled_1", {"counter": np.arange(4) * 3277})
    frames = [sent[at : at + 31] for at in range(0, len(sent), 31)]
    frames[2] = b"\x54" + frames[2][1:]
    for pieces in (frames, [b"".join(frames)]):
        counts = decode(shipped("aceinna"), pieces).counts
        assert counts == StreamCounts(ok=3, skipped_bytes=31, resyncs=1, lost=1)


def test_a_delimiter_is_looked_at_in_every_frame() -> None:
    """Fixed or optional, however few frames arrive at once."""
    sent = encode(shipped("stim300"), "rate_acc_incl", {"counter": np.arange(4) * 16})
    frames = [sent[at : at + 38] + b"\r\n" for at in range(0, len(sent), 38)]
    frames[2] = frames[2][:-1] + b"\x0b"
    for pieces in (frames, [b"".join(frames)]):
        counts = decode(shipped("stim300"), pieces).counts
        assert counts == StreamCounts(ok=3, bad_delimiter=1, skipped_bytes=40, resyncs=1, lost=1)


def test_a_recording_that_ends_within_an_optional_delimiter_keeps_its_last_frame() -> None:
    """The frame is whole; only a part of what need not be there is missing."""
    sent = encode(shipped("stim300"), "rate_acc_incl", {"counter": np.arange(2) * 16})
    for end in (b"\r\n", b"\r", b""):
        decoder = StreamDecoder(shipped("stim300"))
        counts = decoder.feed(sent[:38] + b"\r\n" + sent[38:] + end).counts + decoder.finish().counts
        assert counts == StreamCounts(ok=2)
