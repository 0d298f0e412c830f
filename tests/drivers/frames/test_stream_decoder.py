"""The decoder passes every good frame, no bad one, and accounts for every byte, however the stream is cut."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.frames import scan as scan_module
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import StreamDescription, parse_description
from drivers.frames.layout import encode
from tests.drivers.frames.streams import frames_of, kvh, mfs, stim300
from tests.drivers.frames.test_frame_checksums import crc_by_definition

SPEEDS = {"frame by frame": 10**9, "many at once": 0}


@pytest.fixture(params=SPEEDS)
def speed(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Make the decoder look at frames one by one, or at many at once however few there are."""
    monkeypatch.setattr(scan_module, "_FEW", SPEEDS[request.param])
    return str(request.param)


@dataclass
class Outcome:
    """All frames of a stream with their places, and the counts."""

    frames: dict[str, list[bytes]] = field(default_factory=dict)
    starts: dict[str, list[int]] = field(default_factory=dict)
    sequence: dict[str, list[int]] = field(default_factory=dict)
    counts: StreamCounts = field(default_factory=StreamCounts)


def decode(description: StreamDescription, pieces: list[bytes], *, finish: bool = True) -> Outcome:
    """Feed the pieces and return everything."""
    decoder, outcome = StreamDecoder(description), Outcome()
    results = [decoder.feed(piece) for piece in pieces] + ([decoder.finish()] if finish else [])
    for decoded in results:
        outcome.counts += decoded.counts
        for name, batch in decoded.frames.items():
            outcome.frames.setdefault(name, []).extend(frames_of(batch))
            outcome.starts.setdefault(name, []).extend(batch.starts.tolist())
            outcome.sequence.setdefault(name, []).extend(batch.sequence.tolist())
    return outcome


def samples(n: int, first: int = 0) -> list[bytes]:
    """Return n sample frames of the MFS stream with consecutive counters."""
    numbers = np.arange(first, first + n)
    sent = encode(mfs(), "sample", {"counter": numbers % 65536, "rate_A2": numbers * 0.5})
    return [sent[at : at + 59] for at in range(0, len(sent), 59)]


def test_a_clean_stream_decodes_completely(speed: str) -> None:
    """Every frame, every value, nothing else counted."""
    decoded = StreamDecoder(mfs()).feed(b"".join(samples(300)))
    assert decoded.counts == StreamCounts(ok=300)
    assert decoded["sample"].column("rate_A2") == pytest.approx(np.arange(300) * 0.5)
    assert decoded["sample"].starts.tolist() == list(range(0, 300 * 59, 59))


def test_a_stream_longer_than_the_pieces_that_are_verified_at_once_decodes_completely() -> None:
    """Pieces join without a seam, with and without damage, identity frames among the samples."""
    identity = encode(mfs(), "identity", {"serial": "014"})
    frames = samples(40000)
    assert decode(mfs(), [b"".join(frames)]).counts == StreamCounts(ok=40000)
    frames[20000] = identity + frames[20000]
    frames[30000] = frames[30000][:-1]
    counts = decode(mfs(), [b"".join(frames)]).counts
    assert counts == StreamCounts(ok=40000, bad_checksum=1, skipped_bytes=58, resyncs=1, lost=1)


def test_a_damaged_frame_never_takes_a_good_neighbour_with_it(speed: str) -> None:
    """A frame that lost a byte runs into the next one; the next one is still found."""
    frames = samples(5)
    stream = frames[0] + frames[1][:30] + frames[1][31:] + frames[2] + frames[3] + frames[4]
    outcome = decode(mfs(), [stream])
    assert outcome.frames["sample"] == [frames[0], *frames[2:]]
    assert outcome.counts == StreamCounts(ok=4, bad_checksum=1, skipped_bytes=58, resyncs=1, lost=1)


def test_a_false_header_right_before_a_frame_does_not_hide_it(speed: str) -> None:
    """A repeated first byte, a repeated sync, whole false headers, right before a good frame."""
    frames = samples(3)
    for before in (b"\xa5", b"\xa5\x5a", b"\xa5\x5a\x01", b"\xa5\xa5\x5a\x02", b"\xa5\x5a\x07"):
        outcome = decode(mfs(), [frames[0] + before + frames[1] + frames[2]])
        assert outcome.frames["sample"] == frames, before
        assert outcome.counts.skipped_bytes == len(before)
        assert outcome.counts.unknown_id == (before in (b"\xa5\x5a", b"\xa5\x5a\x07"))


def test_a_wrong_delimiter_is_told_from_a_wrong_checksum(speed: str) -> None:
    """STIM300's CR LF is outside its CRC."""
    good = encode(stim300(), "rate_acc_incl", {"counter": np.array([0, 16, 32])})
    bad = bytearray(good)
    bad[79] = 0x0B  # the second frame's LF
    outcome = decode(stim300(), [bytes(bad)])
    assert (outcome.counts.ok, outcome.counts.bad_delimiter, outcome.counts.bad_checksum) == (2, 1, 0)


def test_frames_inside_a_good_frame_are_its_payload(speed: str) -> None:
    """A whole good frame as the payload of another is not decoded a second time."""
    inner = encode(kvh(), "extended_bit", {"bit_0": 1})
    description = parse_description(
        "schema: hil.frames/1\nname: n\nsample_rate_hz: 1\nbyte_order: big\nsync: FE 81\nframes:\n"
        "  outer: {id: 01 01, length: 20, checksum: {kind: xor}, fields: {payload: {type: text, size: 15}}}\n"
        "  inner: {id: 00 AA, length: 11, checksum: {kind: sum, width: 8}}\n"
    )
    outer = bytearray(b"\xfe\x81\x01\x01" + inner + bytes(5))
    for byte in outer[:-1]:
        outer[-1] ^= byte
    outcome = decode(description, [inner + bytes(outer) * 3 + inner])
    assert (len(outcome.frames["outer"]), len(outcome.frames["inner"])) == (3, 2)
    assert outcome.counts == StreamCounts(ok=5)


def test_a_counter_that_wraps_loses_nothing_and_gaps_are_counted_across_the_wrap(speed: str) -> None:
    """65535 is followed by 0; a gap over the wrap has its true size."""
    frames = samples(20, first=65526)
    assert decode(mfs(), [b"".join(frames)]).counts == StreamCounts(ok=20)
    outcome = decode(mfs(), [b"".join(frames[:8] + frames[13:])])
    assert outcome.counts == StreamCounts(ok=15, lost=5)
    assert outcome.sequence["sample"] == [*range(8), *range(13, 20)]


def test_a_counter_with_steps_counts_frames_not_ticks(speed: str) -> None:
    """STIM300 at 125/s counts 16 from frame to frame."""
    counters = np.arange(60) * 16 % 256
    sent = encode(stim300(), "rate_acc_incl", {"counter": np.delete(counters, [20, 21, 40])})
    assert decode(stim300(), [sent]).counts == StreamCounts(ok=57, lost=3)


def test_a_repeated_frame_is_counted_and_left_out(speed: str) -> None:
    """Also where the repetition arrives in the next feed."""
    frames = samples(4)
    outcome = decode(mfs(), [frames[0] + frames[1] + frames[1] + frames[2], frames[2] + frames[3]])
    assert outcome.frames["sample"] == frames
    assert outcome.counts == StreamCounts(ok=4, duplicate=2)


def test_an_unfinished_frame_waits_and_is_given_up_when_nothing_more_arrives() -> None:
    """A false header at the end of the stream holds back the good frames behind it only for the bounded wait."""
    frames = samples(3)
    decoder = StreamDecoder(kvh())
    short = encode(kvh(), "extended_bit", {"bit_0": 1})
    stuck = b"\xfe\x81\xff\x55" + short  # the beginning of a 36-byte frame, never finished, then a good short one
    assert decoder.feed(stuck, 1.0).counts == StreamCounts()
    assert decoder.feed(b"", 1.2).counts == StreamCounts()
    assert decoder.feed(b"", 1.25).counts == StreamCounts(ok=1, skipped_bytes=4, resyncs=1, timed_out=1)
    patient = StreamDecoder(mfs())
    patient.feed(frames[0][:40], 1.0)
    assert patient.feed(b"", 1.24).counts.ok == 0
    assert patient.feed(frames[0][40:], 1.5).counts == StreamCounts(ok=1)


def test_after_a_reset_the_unfinished_frame_is_gone_and_the_gap_is_not_a_loss() -> None:
    """What was thrown away on purpose does not count; the sequence goes on."""
    frames = samples(10)
    decoder = StreamDecoder(mfs())
    assert decoder.feed(frames[0] + frames[1] + frames[2][:30]).counts.ok == 2
    decoder.reset()
    assert decoder._rest == b""
    decoded = decoder.feed(frames[2][30:] + b"".join(frames[6:]))
    assert decoded.counts == StreamCounts(ok=4, skipped_bytes=29, resyncs=1)
    assert decoded["sample"].sequence.tolist() == [6, 7, 8, 9]
    assert decoded["sample"].starts[0] == 3 * 59
    decoder.reset()
    assert decoder.feed(frames[9]).counts == StreamCounts(ok=1)
    decoder.reset()
    later = samples(4, first=10)
    assert [decoder.feed(later[number]).counts.lost for number in (0, 3)] == [0, 2], "a gap behind it is a loss again"


def damaged(frames: list[bytes], seed: int, rate: float) -> tuple[bytes, set[bytes]]:
    """Flip and drop bytes at `rate` each; return the stream and the frames that came through undamaged."""
    rng = np.random.default_rng(seed)
    pieces, whole = [], set()
    for frame in frames:
        row = np.frombuffer(frame, np.uint8).copy()
        flips = rng.random(len(row)) < rate
        row[flips] ^= rng.integers(1, 256, int(flips.sum()), dtype=np.uint8)
        kept = rng.random(len(row)) >= rate
        pieces.append(row[kept].tobytes())
        if kept.all() and not flips.any():
            whole.add(frame)
    return b"".join(pieces), whole


@pytest.mark.parametrize("seed", range(10))
def test_every_undamaged_frame_is_recovered_and_no_damaged_one_is_accepted(speed: str, seed: int) -> None:
    """With flips and drops at 1e-3 each, what comes out is exactly what came through."""
    frames = samples(600)
    stream, whole = damaged(frames, seed, 1e-3)
    outcome = decode(mfs(), [stream])
    assert set(outcome.frames["sample"]) == whole
    assert len(outcome.frames["sample"]) == len(whole) < 600
    assert outcome.counts.skipped_bytes == len(stream) - 59 * len(whole)
    last = max(frames.index(frame) for frame in whole)
    first = min(frames.index(frame) for frame in whole)
    assert outcome.counts.lost == last - first + 1 - len(whole)


def by_definition(description: StreamDescription, stream: bytes) -> list[bytes]:
    """Return the good frames as a reader finds them who looks at one byte at a time; nothing of the product's code."""
    at, found = 0, []
    while at < len(stream):
        for name, frame in description.frames.items():
            candidate = stream[at : at + frame.length]
            body = frame.length - len(frame.delimiter)
            if not (candidate.startswith(description.headers(name)[0]) and len(candidate) == frame.length):
                continue
            kind = frame.checksum
            covered = candidate[: body - kind.size]
            value = crc_by_definition(kind, covered) if kind.kind == "crc" else sum(covered) & 0xFF
            if candidate[body - kind.size : body] == value.to_bytes(kind.size, kind.stored) and candidate.endswith(
                frame.delimiter
            ):
                found.append(candidate)
                at += frame.length - 1
                break
        at += 1
    return found


@st.composite
def streams(draw: st.DrawFn) -> tuple[StreamDescription, bytes]:
    """Draw a stream of good frames of all types, damaged frames, pieces of frames, headers and noise."""
    description = draw(st.sampled_from([mfs(), stim300(), kvh()]))
    names = list(description.frames)

    def good(name: str, counter: int) -> bytes:
        described = description.frames[name].counter
        columns = {} if described is None else {described.field: counter * described.step % described.modulus}
        return encode(description, name, columns)

    pieces = []
    for counter in range(draw(st.integers(1, 12))):
        name = draw(st.sampled_from(names))
        frame = good(name, counter)
        what = draw(st.sampled_from(["good", "good", "good", "flip", "cut", "noise", "header", "twice"]))
        if what == "flip":
            at = draw(st.integers(0, len(frame) - 1))
            frame = frame[:at] + bytes([frame[at] ^ draw(st.integers(1, 255))]) + frame[at + 1 :]
        elif what == "cut":
            frame = frame[draw(st.integers(0, 5)) : draw(st.integers(5, len(frame)))]
        elif what == "noise":
            frame = draw(st.binary(max_size=20))
        elif what == "header":
            frame = description.headers(name)[0][: draw(st.integers(1, 4))]
        elif what == "twice":
            frame *= 2
        pieces.append(frame)
    return description, b"".join(pieces)


def cut(stream: bytes, places: list[int]) -> list[bytes]:
    """Cut a stream at places given as numbers of any size."""
    edges = sorted({place % (len(stream) + 1) for place in places} | {0, len(stream)})
    return [stream[start:end] for start, end in pairwise(edges)]


def same_at_every_cut_and_speed(description: StreamDescription, stream: bytes, places: list[int]) -> None:
    """Frame by frame, many at once, in one piece, in several, byte by byte: the same frames, places and counts."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scan_module, "_FEW", SPEEDS["frame by frame"])
        slow = decode(description, [stream])
        assert decode(description, cut(stream, places)) == slow
        assert decode(description, [stream[at : at + 1] for at in range(len(stream))]) == slow
        patch.setattr(scan_module, "_FEW", SPEEDS["many at once"])
        patch.setattr(scan_module, "_MOST", 100)
        assert decode(description, [stream]) == slow
        assert decode(description, cut(stream, places)) == slow
    taken = sum(len(frame) for frames in slow.frames.values() for frame in frames)
    repeated = slow.counts.duplicate * max(frame.length for frame in description.frames.values())
    assert taken + slow.counts.skipped_bytes <= len(stream) <= taken + slow.counts.skipped_bytes + repeated


@pytest.mark.slow
@settings(max_examples=25)
@given(streams(), st.lists(st.integers(0, 10**6), max_size=12))
def test_neither_the_cut_nor_the_speed_changes_what_is_decoded(
    drawn: tuple[StreamDescription, bytes], places: list[int]
) -> None:
    """Good frames, damaged ones, pieces, headers and noise."""
    same_at_every_cut_and_speed(*drawn, places)


@pytest.mark.slow
@settings(max_examples=100)
@given(streams(), st.lists(st.integers(0, 10**6), max_size=12))
def test_neither_the_cut_nor_the_speed_changes_what_is_decoded_of_many_streams(
    drawn: tuple[StreamDescription, bytes], places: list[int]
) -> None:
    """The same, looked for longer."""
    same_at_every_cut_and_speed(*drawn, places)


@pytest.mark.slow
@settings(max_examples=150)
@given(streams())
def test_what_is_decoded_is_what_the_definition_finds(drawn: tuple[StreamDescription, bytes]) -> None:
    """Against a reader who looks at one byte at a time, with a CRC bit by bit."""
    description, stream = drawn
    outcome = decode(description, [stream])
    expected = by_definition(description, stream)
    assert outcome.counts.ok + outcome.counts.duplicate == len(expected)
    for name, frames in outcome.frames.items():
        header = description.headers(name)[0]
        mine = [frame for frame in expected if frame.startswith(header)]
        distinct = [frame for number, frame in enumerate(mine) if number == 0 or frame != mine[number - 1]]
        counted = description.frames[name].counter is not None
        assert frames == (distinct if counted else mine)


@given(st.binary(max_size=400), st.lists(st.integers(0, 10**6), max_size=5))
def test_arbitrary_bytes_raise_nothing_and_every_byte_is_counted(data: bytes, places: list[int]) -> None:
    """Noise decodes to nothing and is skipped, byte for byte."""
    outcome = decode(mfs(), cut(data, places) if data else [])
    assert outcome.counts.ok == 0
    assert outcome.counts.skipped_bytes == len(data)


@pytest.mark.usefixtures("speed")
def test_a_frame_that_tells_another_length_is_none_of_the_run_before_it() -> None:
    """Without a checksum nothing else parts a long frame from a short one that begins like it."""
    description = parse_description(
        "schema: hil.frames/1\nname: two lengths\nbyte_order: big\nsync: FE 81\nsample_rate_hz: 10\nframes:\n"
        "  sample: {length: {at: 2, plus: 4, least: 4}, checksum: {kind: none}, fields: {value: {type: u8, at: 3}}}\n"
    )
    short, long = bytes.fromhex("FE 81 00 11"), bytes.fromhex("FE 81 04 22 FE 81 00 33")
    decoded = StreamDecoder(description).feed(short * 3 + long * 3)
    assert frames_of(decoded["sample"]) == [short] * 3 + [long] * 3


@pytest.mark.parametrize(("begins", "flaws"), [(58, 0), (59, 1)])
def test_what_begins_in_the_bytes_of_a_frame_that_timed_out_is_no_further_flaw(begins: int, flaws: int) -> None:
    """It is one frame of 59 bytes that was lost, of which 20 had arrived; the next byte may begin another."""
    (frame,), decoder = samples(1), StreamDecoder(mfs())
    bad = frame[:-1] + bytes([frame[-1] ^ 1])
    decoder.feed(frame[:20])
    assert decoder.feed(b"", 10.0).counts.timed_out == 1
    assert decoder.feed(bytes(begins - 20) + bad, 11.0).counts.bad_checksum == flaws
