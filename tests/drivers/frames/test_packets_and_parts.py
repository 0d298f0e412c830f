"""Packets with stuffed bytes, samples of several frames, frames whose checksum covers named parts, and free lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import StreamDescription, load_description, parse_description, whole_text
from drivers.frames.layout import encode
from drivers.frames.packets import PacketDescription
from tests.drivers.frames.foreign import FOREIGN
from tests.drivers.frames.test_shipped_descriptions import IMUS, decode_all

HEAD = "schema: hil.frames/1\nname: n\nsample_rate_hz: 100\nbyte_order: little\n"

# The kind, what is sent and what it holds, each from who defines it: RFC 1055 (SLIP, its escapes) and RFC 1662 (HDLC),
# the read-me of the package dlestxetx (PyPI), the cobs package (npm) and firechip/cobs-conformance.
PUBLISHED = [
    ("slip", "01 DB DC 02 DB DD 03 C0", "01 C0 02 DB 03"),
    ("hdlc", "7D 5E 7D 5D 41 7E", "7E 7D 41"),
    ("dle", "10 02 01 10 10 05 10 03", "02 01 10 05"),
    ("cobs", "03 11 22 02 33 00", "11 22 00 33"),
    ("cobs", "02 11 01 01 01 00", "11 00 00 00"),
    ("cobs", "FF" + bytes(range(1, 255)).hex() + "02 FF 00", bytes(range(1, 256)).hex()),
    ("cobs", "01 01 00", "00"),
]


@pytest.mark.parametrize(("kind", "sent", "held"), PUBLISHED)
def test_stuffing_is_taken_out_as_its_definition_says(kind: str, sent: str, held: str) -> None:
    """Byte for byte; two packets one after another are two."""
    packets = PacketDescription.model_validate({"kind": kind})
    data = bytes.fromhex(sent)
    found = list(packets.split(data * 2))
    assert found == [(0, len(data), bytes.fromhex(held)), (len(data), 2 * len(data), bytes.fromhex(held))]


def test_another_end_or_escape_replaces_the_usual_ones() -> None:
    """SLIP whose packets end with LF, as the x-IMU3 sends them, and DLE with another DLE."""
    slip = PacketDescription.model_validate({"kind": "slip", "end": "0A"})
    assert [each[2] for each in slip.split(bytes.fromhex("01 DB DC C0 0A"))] == [bytes.fromhex("01 0A C0")]
    dle = PacketDescription.model_validate({"kind": "dle", "end": "FE 03"})
    assert [each[2] for each in dle.split(bytes.fromhex("FE 02 10 FE FE FE 03"))] == [bytes.fromhex("02 10 FE")]


@pytest.mark.parametrize(("kind", "sent"), [("slip", "01 DB 41 C0"), ("cobs", "09 11 00"), ("dle", "41 10 10 10 03")])
def test_what_no_sender_can_mean_is_no_packet(kind: str, sent: str) -> None:
    """An escape before nothing, a length beyond the end, a packet without its beginning."""
    assert [each[2] for each in PacketDescription.model_validate({"kind": kind}).split(bytes.fromhex(sent))] == [None]


STUFFED = (
    HEAD
    + """
packets: {kind: slip}
frames:
  sample:
    id: "01"
    length: 6
    checksum: {kind: sum, width: 8}
    fields: {count: {type: u8}, rate: {type: i24, byte_order: big}}
    counter: {field: count, modulus: 256}
"""
)


def slip(number: int, rate: int) -> bytes:
    """Return a packet as RFC 1055 says."""
    content = bytes([1, number]) + rate.to_bytes(3, "big", signed=True)
    content += bytes([sum(content) & 0xFF])
    return content.replace(b"\xdb", b"\xdb\xdd").replace(b"\xc0", b"\xdb\xdc") + b"\xc0"


@pytest.mark.parametrize("piece", [1, 3, 7, 1 << 20])
def test_packets_are_frames_and_every_byte_is_accounted_for(piece: int) -> None:
    """However the stream is cut: empty packets, a damaged one, a lost one, one of another kind, and half a one."""
    packets = [slip(number, 1000 * number - 0x24C0) for number in range(256)]
    damaged = bytearray(packets[20])
    damaged[-3] ^= 1
    packets[20], packets[30], packets[40] = bytes(damaged), b"", b"\xc0" + packets[40]
    data = b"".join(packets) + b"\x05\x06\xc0" + packets[3][:-2]
    batches, counts = decode_all(parse_description(STUFFED), data, piece)
    skipped = len(damaged) + 3 + len(packets[3]) - 2
    assert counts == StreamCounts(ok=254, bad_checksum=2, lost=2, resyncs=1, skipped_bytes=skipped)
    numbers = np.concatenate([each.column("count") for each in batches["sample"]])
    assert np.array_equal(np.concatenate([each.column("rate") for each in batches["sample"]]), 1000 * numbers - 0x24C0)


MAVLINK_2 = (
    HEAD
    + """
frames:
  heartbeat:
    id: FD 09 00 00 xx xx xx 00 00 00
    length: 21
    checksum: &crc {kind: crc, width: 16, poly: 0x1021, init: 0xFFFF, refin: true, refout: true, stored: little,
                    span: [[1, null], "32"]}
    fields: {type: {type: u8, at: 14}, component: {type: u8, at: 6}}
  gps_raw_int:
    id: FD xx 00 00 xx xx xx 18 00 00
    length: {at: 1, type: u8, plus: 12, least: 13, most: 64, whole: 64}
    checksum: {<<: *crc, span: [[1, null], "18"]}
    fields: {satellites: {type: u8, at: 39}, altitude: {type: i32, at: 40}, heading_error: {type: u32, at: 56},
             yaw: {type: u16}}
"""
)


def test_a_checksum_may_cover_bytes_that_are_not_sent_and_zeros_may_be_left_out() -> None:
    """Two frames of a public test suite of MAVLink 2 (mavlink.ts): the last field's zeros are not there."""
    heartbeat = bytes.fromhex("fd090000807bd4000000040000000102030501c723")
    position = bytes.fromhex(
        "fd2f0000807bd418000001000000000000000300000004000000050000000600070008000900020a0b0000000c0000000d0000000e0000"
        "000f9c48"
    )
    for n in (1, 2000):
        batches, counts = decode_all(parse_description(MAVLINK_2), (heartbeat + position) * n)
        assert counts == StreamCounts(ok=2 * n)
        gps, beat = batches["gps_raw_int"][0].columns, batches["heartbeat"][0].columns
        assert [float(gps[name][-1]) for name in ("satellites", "altitude", "heading_error", "yaw")] == [10, 11, 15, 0]
        assert [float(beat[name][-1]) for name in ("type", "component")] == [1, 0xD4]


def witmotion() -> tuple[StreamDescription, bytes, bytes, bytes]:
    """Return the description, and three public frames: acceleration, rate, angle."""
    sent = FOREIGN["witmotion"][1].sent
    return load_description(IMUS / "witmotion.yaml"), sent[:11], sent[11:22], sent[22:33]


@pytest.mark.parametrize("piece", [1, 13, 1 << 20])
def test_a_sample_of_two_frames_lacks_what_did_not_arrive(piece: int) -> None:
    """The part that is missing is not a number and counts as lost; the others are whole. However the stream is cut."""
    description, acceleration, rate, angle = witmotion()
    spoiled = bytearray(rate)
    spoiled[4] ^= 1
    sample = acceleration + rate + angle
    stream = rate + sample + acceleration + bytes(spoiled) + angle + sample + rate + sample + acceleration
    batches, counts = decode_all(description, stream, piece)
    columns = {name: np.concatenate([each.columns[name] for each in batches["sample"]]) for name in ("acc_z", "gyro_x")}
    missing = [[True, False, False, False, True, False, False], [False, False, True, False, False, False, True]]
    assert [np.isnan(columns[name]).tolist() for name in columns] == missing
    assert (counts.bad_checksum, counts.lost, counts.skipped_bytes) == (1, 2, 11)
    assert counts.ok == 14
    assert "rate" not in batches


BY_COUNT = (
    HEAD
    + """
sync: AA
frames:
  sample: {parts: [acc, gyro], by: count, counter: {field: count, modulus: 256}}
  acc: {id: "01", length: 5, checksum: &sum {kind: xor}, fields: {count: {type: u8}, a: {type: i8}}}
  gyro: {id: "02", length: 5, checksum: *sum, fields: {count: {type: u8}, g: {type: i8}}}
"""
)


def test_parts_of_one_count_belong_together_in_any_order() -> None:
    """A count that is missing is lost."""

    def part(kind: int, count: int, value: int) -> bytes:
        return bytes([0xAA, kind, count, value, 0xAA ^ kind ^ count ^ value])

    sent = part(1, 0, 5) + part(2, 0, 6) + part(2, 1, 7) + part(1, 1, 8) + part(2, 3, 9) + part(1, 3, 10)
    batches, counts = decode_all(parse_description(BY_COUNT), sent)
    assert batches["sample"][0].column("a").tolist() == [5, 8, 10]
    assert batches["sample"][0].column("g").tolist() == [6, 7, 9]
    assert (counts.ok, counts.lost) == (6, 1)
    assert batches["sample"][0].sequence.tolist() == [0, 1, 3]


LINES = (
    HEAD
    + """
packets: {kind: lines}
frames:
  razor:
    id: 23 59 50 52 3D   # #YPR=
    text: {}
    fields: {ypr: {type: decimal, names: [yaw, pitch, roll], unit: deg}}
  labelled:
    id: "21"
    text: {separator: ", "}
    fields: {x: {type: decimal, label: "X="}, y: {type: decimal, label: "Y="}, counts: {type: i16, label: "H:"},
             state: {type: word}}
  bare:
    text: {separator: ",;"}
    fields: {t: {type: decimal}, v: {type: decimal}}
    time: {field: t, resolution: 0.01}
"""
)


def test_lines_may_be_bare_labelled_hexadecimal_and_end_as_they_like() -> None:
    """The Razor's line is the one that its firmware's description prints; what fits no frame is refused."""
    sent = b"17;-1.5\r\n18,2\n#YPR=-142.28,-5.38,33.52\r\n! X=1e-3, Y= -2,H:FFFE, ready\n\n21;3\nnonsense\n22;4;5\n"
    for piece in (1, 5, 1000):
        batches, counts = decode_all(parse_description(LINES), sent, piece)
        assert (counts.ok, counts.bad_checksum, counts.lost) == (5, 2, 2)
        assert batches["razor"][0].column("ypr_yaw").tolist() == [-142.28]
        labelled = batches["labelled"][0]
        assert [float(labelled.column(name)[0]) for name in ("x", "y", "counts")] == [0.001, -2, -2]
        assert labelled.text("state") == ["ready"]
        assert np.concatenate([each.column("v") for each in batches["bare"]]).tolist() == [-1.5, 2, 3]


PACKED = (
    HEAD
    + """
sync: AA
frames:
  f:
    length: 16
    checksum: {kind: none}
    fields:
      left: {type: i16, mask: 0xFFF0, byte_order: big}
      low: {type: u24, at: 3, mask: 0x000FFF}
      high: {type: i24, at: 3, mask: 0xFFF000}
      twenty: {type: i24, mask: 0x0FFFFF, byte_order: big}
      half: {type: f16, scale: 2}
      wide: {type: i40}
"""
)


def test_values_may_have_any_number_of_bits_across_bytes() -> None:
    """Twelve bits at the left, two twelves in three bytes, twenty with a sign, half precision (1.5 is 3E00), forty."""
    content = "FFE0" + "FE 1F 80" + "8F FF FE" + "00 3E" + "FE FF FF FF FF"
    batch = StreamDecoder(parse_description(PACKED)).feed(bytes.fromhex("AA" + content))["f"]
    expected = {"left": -2, "low": 0xFFE, "high": -2047, "twenty": -2, "half": 3.0, "wide": -2}
    assert {name: float(batch.column(name)[0]) for name in expected} == expected


def test_a_description_may_include_another_and_say_itself_what_differs(tmp_path: Path) -> None:
    """What it says comes first, key by key; a file that is not there, or a circle, is said with the file's name."""
    (tmp_path / "base.yaml").write_text(STUFFED)
    (tmp_path / "own.yaml").write_text(
        "include: base.yaml\nname: own\nframes: {sample: {fields: {rate: {scale: 2}}}}\n"
    )
    own = load_description(tmp_path / "own.yaml")
    assert (own.name, own.frames["sample"].fields["rate"].scale, own.frames["sample"].length) == ("own", 2.0, 6)
    assert parse_description(whole_text(tmp_path / "own.yaml"), "kept") == own
    assert whole_text(tmp_path / "base.yaml") == STUFFED
    (tmp_path / "circle.yaml").write_text("include: [circle.yaml]\n")
    for name, said in [("circle", r"circle\.yaml: include: circle\.yaml .* includes itself"), ("lost", "no such file")]:
        (tmp_path / "lost.yaml").write_text("include: nowhere.yaml\n")
        with pytest.raises(InputError, match=said):
            load_description(tmp_path / f"{name}.yaml")


def test_what_is_stuffed_or_put_together_is_not_made() -> None:
    """A simulated unit would send what nobody reads."""
    for text, frame in ((STUFFED, "sample"), (BY_COUNT, "sample"), (LINES, "bare")):
        with pytest.raises(ValueError, match=rf"frames\.{frame}: .* can be read, not made"):
            encode(parse_description(text), frame, {})


MISTAKES = {
    "a packet of another end": (
        STUFFED.replace("{kind: slip}", "{kind: slip, end: C0 C1}"),
        "packets.kind: slip has no",
    ),
    "a line with an escape": (
        LINES.replace("{kind: lines}", "{kind: lines, escape: DB}"),
        "packets.kind: lines has no",
    ),
    "packets and another end": (STUFFED + "optional_delimiter: 0D\n", "optional_delimiter: packets have ends"),
    "a part that is not there": (BY_COUNT.replace("[acc, gyro]", "[acc, mag]"), "sample.parts: 'mag' is not one of"),
    "a part with the same field": (
        BY_COUNT.replace("{g: {", "{a: {").replace("g: {type: i8}", "a: {type: i8}"),
        "sample",
    ),
    "a count that a part lacks": (BY_COUNT.replace("by: count", "by: a"), "sample.by: gyro has no field 'a'"),
    "a length of parts": (
        BY_COUNT.replace("by: count,", "by: count, length: 5,"),
        "frames.sample.length: is given for",
    ),
    "an id that another hides": (BY_COUNT.replace('gyro: {id: "02"', "gyro: {id: xx"), "two frames have the same id"),
    "a label in a frame": (
        STUFFED.replace("count: {type: u8}", "count: {type: u8, label: c}"),
        "fields.count.type: u8 has",
    ),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_what_cannot_be_is_said_with_its_key(case: str) -> None:
    """In one sentence."""
    text, said = MISTAKES[case]
    with pytest.raises(InputError) as refusal:
        parse_description(text, "unit.yaml")
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)
