"""A frame description says what it means, and what is wrong with one is said with its key."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from drivers.errors import InputError
from drivers.frames.description import load_description, parse_description
from drivers.frames.notation import parse_factor
from tests.drivers.frames.streams import KVH, MFS_FILE, STIM300, mfs


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2^-14", 2.0**-14),
        ("3600*2^-14", 3600 / 16384),
        ("600 * 0.3048*2^-14", 600 * 0.3048 / 16384),
        ("1/6.25", 0.16),
        ("-2^14", -16384.0),
    ],
)
def test_a_scale_factor_is_written_as_the_data_sheet_prints_it(text: str, value: float) -> None:
    """Products, quotients and powers of numbers, left to right."""
    assert parse_factor(text) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("text", ["", "*2", "2+3", "2^", "two", "1/0", "(-8)^0.5", "1e999", True, None, [1]])
def test_a_scale_factor_that_is_not_a_number_is_refused(text: object) -> None:
    """Nothing is evaluated that is not a product of numbers."""
    with pytest.raises(ValueError, match=r".+"):
        parse_factor(text)


def test_the_shipped_mfs_frame_is_as_long_as_agreed_and_has_its_fields_one_after_another() -> None:
    """A frame has 36 to 64 bytes, no gap and no overlap."""
    description = mfs()
    offsets = description.offsets("sample")
    sample = description.frames["sample"]
    assert 36 <= sample.length <= 64
    assert [offsets[name] + field.width for name, field in sample.fields.items()][:-1] == list(offsets.values())[1:]
    assert list(offsets.values())[-1] + 4 == sample.length - 4


def test_a_field_stands_where_it_is_said_to_stand() -> None:
    """`at` moves a field, and those after it follow."""
    text = KVH.replace("sequence: {type: u8}", "sequence: {type: u8, at: 29}")
    assert parse_description(text).offsets("format_A")["temperature"] == 30


BROKEN = {
    "unknown key": ("baud: 9600\n" + STIM300, "unknown key 'baud'; did you mean 'baudrate'"),
    "unknown type": (STIM300.replace("latency_us: {type: u16", "latency_us: {type: u17"), "latency_us.type: "),
    "unknown key in a field": (
        STIM300.replace("unit: us", "units: us"),
        "latency_us: unknown key 'units'; did you mean 'unit'",
    ),
    "field beyond the checksum": (STIM300.replace("length: 40", "length: 39"), "fields.latency_us: bytes 32 to 33"),
    "overlapping fields": (
        STIM300.replace("latency_us: {type: u16", "latency_us: {at: 30, type: u16"),
        "fields.latency_us: byte 30 already belongs to incl_status",
    ),
    "id as a number": (STIM300.replace('id: "93"', "id: 93"), "rate_acc_incl.id: write bytes as quoted hex"),
    "odd hex": (STIM300.replace('id: "93"', 'id: "9"'), "rate_acc_incl.id: '9' are not hex digits"),
    "counter of no field": (STIM300.replace("field: counter", "field: count"), "counter.field: 'count' is not"),
    "modulus too large": (STIM300.replace("modulus: 256", "modulus: 65536"), "counter.modulus: 65536 does not fit"),
    "step that does not divide": (STIM300.replace("step: 16", "step: 15"), "counter.step: does not divide"),
    "polynomial too wide": (STIM300.replace("width: 32", "width: 16"), "poly has more than 16 bits"),
    "unknown checksum": (STIM300.replace("kind: crc", "kind: md5"), "checksum.kind: 'md5' is not allowed; .* 'crc'"),
    "width of a checksum": (STIM300.replace("width: 32", "width: 4"), "incl.checksum.width: must be at least 8, not 4"),
    "width that is a word": (
        STIM300.replace("width: 32", "width: wide"),
        "incl.checksum.width: must be a whole number, not 'wide'",
    ),
    "checksum without a kind": (STIM300.replace("kind: crc, ", ""), "checksum.kind: this key is missing"),
    "span of one number": (
        STIM300.replace("pad_to: 4", "span: [0]"),
        r"incl.checksum.span: is \[first, end\], or a list",
    ),
    "no frames": (STIM300.split("frames:")[0] + "frames: {}\n", "yaml: frames: must have at least 1 entry"),
    "a frame that is nothing": (
        STIM300.split("frames:")[0] + "frames: {a: }\n",
        "frames.a: must be a mapping with the keys id, .*, not nothing",
    ),
    "a name with a blank": (KVH.replace("format_A:", "format A:"), "frames.format A: 'format A' is not a name"),
    "an array's element": (
        KVH.replace("gyro_x: {type: f32}", "rate: {type: f32, names: [x, y], scale: 1^}"),
        r"format_A.fields.rate.scale: '1\^' is not a number",
    ),
    "an array's element out of place": (
        KVH.replace("gyro_x: {type: f32}", "rate: {type: f32, names: [x, y], at: 30}"),
        r"format_A.fields.rate \(its element rate_x\): bytes 30 to 33",
    ),
    "a field named like an element": (
        KVH.replace("gyro_x: {type: f32}", "gyro: {type: f32, names: [x]}\n      gyro_x: {type: f32}"),
        "format_A.fields.gyro: its element gyro_x has the name of another field",
    ),
    "an element named like a field before": (
        KVH.replace("gyro_y: {type: f32}", "gyro: {type: f32, names: [x, y]}"),
        "format_A.fields.gyro: its element gyro_x has the name of another field",
    ),
    "an element of two arrays": (
        KVH.replace("gyro_x: {type: f32}", "a: {type: f32, names: [b_c]}\n      a_b: {type: f32, names: [c]}"),
        "format_A.fields.a_b: its element a_b_c has the name of another field",
    ),
    "span outside": (STIM300.replace("pad_to: 4", "span: [0, 39]"), r"checksum.span: \[0, 39\] is not a part"),
    "bit that is not there": (KVH.replace("{bit: 0, good: 1}", "{bit: 8, good: 1}"), "gyro_x_valid: a u8 has no bit 8"),
    "same id twice": (KVH.replace("id: 00 AA", "id: FF 55"), "frames: two frames have the same id"),
    "an id that begins another": (KVH.replace("id: 00 AA", 'id: "FF"'), "frames: the header FE 81 FF is the beginning"),
    "no header at all": (STIM300.replace('    id: "93"\n', ""), "sync: a stream without a sync"),
    "zero scale": (STIM300.replace("scale: 2^-22", "scale: 0"), "incl_x: scale must not be 0"),
    "bad scale": (STIM300.replace("scale: 2^-22", "scale: 2^^2"), "incl_x.scale: '2\\^\\^2' is not a number"),
    "no schema": (STIM300.replace("schema: hil.frames/1", ""), "schema: this key is missing"),
    "not a mapping": ("- 1", "must be a mapping"),
    "not YAML": ("a: [", "not valid YAML"),
    "nothing but brackets": ("[" * 9999, "nested too deeply"),
    "key given twice": (STIM300.replace("gyro_y:", "gyro_x:"), "key 'gyro_x' is given twice"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", BROKEN)
def test_what_is_wrong_with_a_description_is_said_with_its_key(case: str) -> None:
    """One sentence, beginning with the file, naming the key."""
    text, message = BROKEN[case]
    assert text != STIM300
    assert text != KVH
    with pytest.raises(InputError, match=message) as caught:
        parse_description(text, "unit.yaml")
    assert re.match(r"unit\.yaml(, line \d+, column \d+)?: ", str(caught.value))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("roles", "sensors", 2, "rates", "RA"), "rate_A3", "roles.sensors.2.rates.RA: there is no numeric field"),
        (("roles", "sensors", 2, "rates", "RA"), "accel_A2", "roles.sensors.2.rates.RA: field 'accel_A2' has g; scale"),
        (("roles", "sensors", 1, "accelerations", "A"), "supply_V", "roles.sensors.1.accelerations.A: .* has V"),
        (("roles", "sensors", 1, "temperature"), "counter", "roles.sensors.1.temperature: .* has no unit"),
        (("roles", "conditions", "supply_V"), "volts", "roles.conditions.supply_V: there is no numeric field 'volts'"),
        (("roles", "index", "moving"), "turning", "roles.index.moving: there is no status bit 'turning'"),
        (("roles", "frame"), "samples", "roles.frame: there is no frame 'samples'"),
        (("roles", "identity", "frame"), "who", "roles.identity.frame: there is no frame 'who'"),
        (("roles", "identity", "serial"), "number", "roles.identity.serial: there is no text field 'number'"),
        (("frames", "identity", "fields", "model"), {"type": "text"}, "model: size is given for a text field"),
    ],
)
def test_a_role_without_its_field_is_said_with_its_key(path: tuple[str, ...], value: object, message: str) -> None:
    """A role that points to nothing, or to a field in the wrong unit, is refused."""
    content = yaml.safe_load(MFS_FILE.read_text())
    place = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(InputError, match=message):
        parse_description(yaml.safe_dump(content))


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    """A missing file and a file that is not text are refused with their name."""
    with pytest.raises(InputError, match=r"absent\.yaml: there is no such file"):
        load_description(tmp_path / "absent.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"binary\.yaml: is not UTF-8"):
        load_description(tmp_path / "binary.yaml")
