"""The parts of the frame language beyond plain fields: parameters, arrays, bit fields, turns, lengths, items."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import load_description, parse_description
from drivers.frames.layout import encode
from tests.drivers.frames.streams import MFS_FILE
from tests.drivers.frames.test_damaged_streams import WEAK

HEAD = "schema: hil.frames/1\nname: n\nsample_rate_hz: 100\nbyte_order: big\n"
FRAME = "frames:\n  f:\n    id: AA\n    length: 20\n    checksum: {kind: none}\n    fields:\n"
PARAMETERS = """
parameters:
  range:
    meaning: full scale
    unit: g
    choices: {5: {acc: 2^-20, label: g}, 10: {acc: 2^-19, label: g}}
    default: 5
  gain: {meaning: of the amplifier, default: 2}
"""


def fields(text: str, head: str = HEAD) -> str:
    """Return a description of one frame with these fields."""
    return head + FRAME + "".join(f"      {line}\n" for line in text.splitlines())


def test_a_parameter_is_put_in_wherever_its_name_stands() -> None:
    """A choice gives values to names; a number is itself; the rate is always there."""
    text = fields('a: {type: i16, scale: "8*${acc}*${gain}", unit: "${label}"}', HEAD + PARAMETERS)
    text += '    counter: {field: n, modulus: 100, step: "2000/${rate}"}\n'
    text = text.replace("    fields:\n", "    fields:\n      n: {type: u8}\n")
    for given_range, scale in [(None, 2.0**-16), (10, 2.0**-15), ("10", 2.0**-15), ("10 g", 2.0**-15), (5.0, 2.0**-16)]:
        parameters = {} if given_range is None else {"range": given_range}
        frame = parse_description(text, parameters=parameters).frames["f"]
        assert (frame.fields["a"].scale, frame.fields["a"].unit) == (scale, "g")
    faster = parse_description(text, parameters={"gain": "1/2"}, sample_rate_hz=500)
    assert faster.frames["f"].fields["a"].scale == 2.0**-18
    assert faster.frames["f"].counter is not None
    assert faster.frames["f"].counter.step == 4
    assert faster.sample_rate_hz == 500


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"ranges": 5}, r"parameters\.ranges: there is no such parameter; there are: range, gain"),
        ({"range": 7}, r"parameters\.range: 7 is none of 5, 10"),
        ({"range": "5 m"}, r"parameters\.range: '5 m' is none of 5, 10"),
        ({"gain": "much"}, r"parameters\.gain: 'much' is not a number"),
    ],
)
def test_a_parameter_that_the_unit_does_not_have_is_refused_with_its_key(
    parameters: dict[str, object], message: str
) -> None:
    """And with what there is."""
    with pytest.raises(InputError, match="^unit: " + message):
        parse_description(fields("a: {type: u8}", HEAD + PARAMETERS), "unit", parameters=parameters)


LENGTH = "{at: 1, type: u8, plus: 4}"
BROKEN = {
    "a name that is no parameter": (
        fields('a: {type: u8, scale: "${b}"}'),
        r"f\.fields\.a\.scale: \$\{b\} is not a par",
    ),
    "a step that is no whole number": (
        fields("a: {type: u8}") + '    counter: {field: a, modulus: 256, step: "2000/${rate}/3"}\n',
        r"counter\.step: '2000/100.0/3' is 6\.66667, not a whole",
    ),
    "a default that is no choice": (
        fields("a: {type: u8}", HEAD + PARAMETERS.replace("default: 5", "default: 6")),
        r"parameters\.range.default: 6 is none of 5, 10",
    ),
    "choices that give other names": (
        fields("a: {type: u8}", HEAD + PARAMETERS.replace("acc: 2^-19, ", "")),
        r"parameters\.range.choices: every choice gives values to the same names",
    ),
    "an unknown key of a parameter": (
        fields("a: {type: u8}", HEAD + PARAMETERS.replace("default: 2", "defaults: 2")),
        r"parameters\.gain: unknown key 'defaults'; did you mean 'default'",
    ),
    "an array with both names and count": (fields("a: {type: u8, names: [x], count: 1}"), r"fields.a: an array has"),
    "an array whose elements overlap": (
        fields("a: {type: u16, count: 2, stride: 1}"),
        r"a\.stride: must be a number of",
    ),
    "an array of no elements": (fields("a: {type: u16, names: []}"), r"a\.names: must be a list"),
    "a mask of a float": (fields("a: {type: f32, mask: 3}"), r"fields\.a\.mask: 0x3 is not a part"),
    "a mask that is too wide": (fields("a: {type: u8, mask: 0x100}"), r"fields\.a\.mask: 0x100 is not a part"),
    "a turn told by no field": (
        fields("a: {type: u8, when: {field: b, equals: 1}}"),
        r"fields\.a\.when\.field: 'b' is not an unsigned field",
    ),
    "a turn that never comes": (
        fields("a: {type: u8, when: {field: b, mask: 1, equals: 2}}"),
        r"fields\.a\.when.equals: 0x2 has bits that the mask 0x1 hides",
    ),
    "a length and text": (fields("a: {type: u8}") + "    text: {checksums: []}\n", r"frames\.f\.length: is given for"),
    "no checksum at all": (
        fields("a: {type: u8}").replace("    checksum: {kind: none}\n", ""),
        r"f.checksum: this key is missing",
    ),
    "a length that lies behind the frame": (
        WEAK.replace("{at: 2, type: u8, plus: 4, most: 20}", "{at: 9, type: u8, plus: 4}"),
        r"frames\.long\.length.least: a frame of 4 bytes ends before its length at 9",
    ),
    "more at least than at most": (
        WEAK.replace("most: 20", "least: 30, most: 20"),
        r"frames\.long\.length.least: 30 is more than the most, 20",
    ),
    "a field in the checksum": (
        fields("a: {type: u16, at: 1}").replace("{kind: none}", "{kind: sum, width: 8, at: 2, span: [3, null]}"),
        r"frames\.f\.fields\.a: lies in the checksum",
    ),
    "a span over the checksum": (
        fields("a: {type: u8}").replace("{kind: none}", "{kind: sum, width: 8, at: 2, span: [0, 4]}"),
        r"frames\.f\.checksum\.span: \[0, 4\] is not a part of the bytes before the checksum",
    ),
    "items with the same field": (
        WEAK.replace("fields: {b: {", "fields: {a: {"),
        r"known\.b\.fields\.a: the name is alr",
    ),
    "an item type without formats": (
        WEAK.replace("{a: {type: u16}}", "{a: {type: item}}"),
        r"known\.a\.fields\.a\.type: formats are missing",
    ),
    "an item mask that hides its id": (WEAK.replace("{id: 7,", "{id: 7, mask: 6,"), r"known\.a\.mask: hides a part of"),
    "items that begin behind their frame": (
        WEAK.replace("begin: 3", "begin: 9"),
        r"frames\.long\.items\.begin: byte 9",
    ),
    "a line with a binary field": (
        WEAK.replace("{type: decimal}", "{type: f32}"),
        r"frames\.line\.fields\.value\.type: in a",
    ),
    "a decimal in a binary frame": (fields("a: {type: decimal}"), r"f\.fields\.a\.type: decimal has no fixed place"),
    "an optional delimiter that looks like a frame": (
        fields("a: {type: u8}", HEAD + "optional_delimiter: AA 0A\n"),
        r"optional_delimiter: begins like a frame",
    ),
    "ids of unequal length for one frame": (
        fields("a: {type: u8}") + "    more_ids: [AB CD]\n",
        r"frames\.f\.more_ids: have as many",
    ),
    "a time that is no field": (
        fields("a: {type: u8}") + "    time: {field: t, resolution: 1e-6}\n",
        r"frames\.f\.time\.field: 't' is not",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_wrong_is_said_in_one_sentence_with_its_key(case: str) -> None:
    """For every part of the language."""
    text, message = BROKEN[case]
    with pytest.raises(InputError, match=message) as caught:
        parse_description(text, "unit.yaml")
    assert str(caught.value).startswith("unit.yaml: ")
    assert "\n" not in str(caught.value)


def test_array_elements_stand_a_stride_apart_and_others_may_stand_between() -> None:
    """By place, one after another, and by count."""
    lines = [f"{name}: {{type: i16, names: [x, y], at: {at}, stride: 4}}" for name, at in [("rate", 1), ("acc", 3)]]
    description = parse_description(fields("\n".join([*lines, "t: {type: u8, count: 2, stride: 3}"])))
    expected = {"rate_x": 1, "rate_y": 5, "acc_x": 3, "acc_y": 7, "t_0": 9, "t_1": 12}
    assert description.offsets("f") == expected
    batch = StreamDecoder(description).feed(b"\xaa" + bytes(range(1, 20)))["f"]
    assert batch.column("rate_y")[0] == 0x0506
    assert batch.column("t_1")[0] == 12


@given(st.integers(0, 7), st.integers(0, 31), st.integers(0, 255))
def test_bit_fields_share_a_byte_and_come_back(high: int, low: int, other: int) -> None:
    """Each counts from its lowest bit, and writing one leaves the other."""
    text = "high: {type: u8, at: 3, mask: 0xE0}\nlow: {type: u8, at: 3, mask: 0x1F}\nother: {type: u8, at: 4}"
    description = parse_description(fields(text))
    sent = encode(description, "f", {"high": high, "other": other, "low": low})
    assert sent[3:5] == bytes([high << 5 | low, other])
    batch = StreamDecoder(description).feed(sent)["f"]
    assert [batch.column(name)[0] for name in ("high", "low", "other")] == [high, low, other]


@pytest.mark.parametrize("order", ["big", "little"])
@given(value=st.floats(-30000, 30000))
def test_fixed_point_comes_back_within_half_a_step(order: str, value: float) -> None:
    """12.20 saturates at 2048; 16.32 has its fraction first."""
    text = f"a: {{type: fp12.20, byte_order: {order}}}\nb: {{type: fp16.32, byte_order: {order}, scale: 1}}"
    description = parse_description(fields(text))
    sent = encode(description, "f", {"a": value, "b": value})
    batch = StreamDecoder(description).feed(sent)["f"]
    assert batch.column("a")[0] == pytest.approx(np.clip(value, -2048, 2048 - 2**-20), abs=2**-21)
    assert batch.column("b")[0] == pytest.approx(value, abs=2**-33)
    whole, fraction = int(batch.wire("b")[0]) >> 32, int(batch.wire("b")[0]) & 0xFFFFFFFF
    assert sent[5:11] == fraction.to_bytes(4, order) + whole.to_bytes(2, order, signed=True)  # type: ignore[arg-type]


def test_a_single_precision_field_is_scaled_in_double_precision() -> None:
    """A scale that single precision cannot hold is not rounded to it."""
    description = parse_description(fields("a: {type: f32, scale: 3600*57.29577951308232}"))
    batch = StreamDecoder(description).feed(encode(description, "f", {"a": 1e5}))["f"]
    assert batch.column("a")[0] == float(batch.wire("a")[0]) * (3600 * 57.29577951308232)


def test_an_extended_length_moves_the_items() -> None:
    """As in Xbus: a length of 255 means that the true one follows in two bytes."""
    description = load_description(MFS_FILE.parent / "xsens-mtdata2.yaml")
    items = b"\x10\x20\x02\x12\x34" + b"\x99\x90\xff" + bytes(255) + b"\xe0\x20\x04\x00\x00\x00\x01"

    def message(content: bytes) -> bytes:
        size = bytes([len(content)]) if len(content) < 255 else b"\xff" + len(content).to_bytes(2, "big")
        body = b"\xff\x36" + size + content
        return b"\xfa" + body + bytes([-sum(body) & 0xFF])

    for n in (1, 40):
        stream = message(items) * n + message(b"\x10\x20\x02\x12\x35")
        decoder = StreamDecoder(description)
        decoded = decoder.feed(stream)
        assert decoded.counts.ok == 2
        assert decoded.counts.duplicate == n - 1
        assert decoded["mtdata2"].column("status_word")[0] == 1.0
        assert np.isnan(decoded["mtdata2"].column("status_word")[-1])
        assert decoded["mtdata2"].wire("packet_counter").tolist() == [0x1234, 0x1235]


def test_a_units_own_time_tells_what_is_missing_where_there_is_no_counter() -> None:
    """At 20 Hz, 50 ms are one frame; a clock that begins anew is no loss."""
    description = load_description(MFS_FILE.parent / "vectornav-binary.yaml")
    times = np.array([1000, 1050, 1101, 1250, 1300, 50, 100]) * 1e-3
    sent = encode(description, "start_imu", {"time_startup": times})
    decoded = StreamDecoder(description).feed(sent)
    assert (decoded.counts.ok, decoded.counts.lost, decoded.counts.duplicate) == (7, 2, 0)
    assert decoded["start_imu"].sequence.tolist() == [0, 1, 2, 5, 6, 7, 8]


def test_a_frame_that_cannot_be_encoded_says_so(tmp_path: Path) -> None:
    """What varies has no one form to write."""
    with pytest.raises(ValueError, match=r"frames\.long: .* can be read, not made"):
        encode(parse_description(WEAK), "long", {})
