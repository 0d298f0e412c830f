"""Every description that ships decodes every golden frame of its unit to the given values, and refuses the bad ones."""

from __future__ import annotations

import json
from binascii import crc_hqx
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.frames.batch import FrameBatch
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import StreamDescription, load_description, parse_description
from drivers.frames.layout import FrameLayout, encode
from tests.drivers.frames.foreign import FOREIGN, FROM_TABLES
from tests.drivers.frames.status_bits import bits
from tests.drivers.frames.streams import MFS_FILE

IMUS = MFS_FILE.parent
RAD_PER_S = 3600 * 57.29577951308232  # deg/hr
GRAVITY = 9.80665  # m/s²

LAYOUTS = {
    "stim300": ["stim300_0x93_rate_acc_incl_crlf", "stim300_0xAF_rate_acc_incl_temp_aux_crlf", "stim300_utility_ascii"],
    "kvh1750": ["kvh_format_A_36B", "kvh_extended_bit_11B", "kvh_extended_bit2_13B_AS_PRINTED"],
    "mip": ["mip_tlv"],
    "xsens-mtdata2": ["xbus_mtdata2", "xbus"],
    "vectornav-binary": ["vn_binary_FA"],
    "vectornav-ascii": ["vn_ascii_VNYMR"],
    "aceinna": ["aceinna_5555"],
    "hg4930": ["hg4930_01_20B", "hg4930_02_44B"],
    "dmu11": ["dmu11_68B"],
    "epson-g3xx": ["epson_burst16_F007_24B"],
}


@cache
def shipped(name: str, **parameters: object) -> StreamDescription:
    """Return a shipped description."""
    return load_description(IMUS / f"{name}.yaml", parameters=parameters)


def decode_all(
    description: StreamDescription, data: bytes, piece: int = 1 << 30
) -> tuple[dict[str, list[FrameBatch]], StreamCounts]:
    """Decode data in pieces; return the batches with frames, by type, and the counts."""
    decoder = StreamDecoder(description)
    results = [decoder.feed(data[at : at + piece]) for at in range(0, len(data), piece)] + [decoder.finish()]
    batches: dict[str, list[FrameBatch]] = {}
    for decoded in results:
        for name, batch in decoded.frames.items():
            if len(batch):
                batches.setdefault(name, []).append(batch)
    return batches, sum((decoded.counts for decoded in results), StreamCounts())


def golden(reference: Path, *layouts: str, good: bool = True) -> list[dict[str, Any]]:
    """Return the golden entries of some layouts; there must be some."""
    entries = json.loads((reference / "golden_frames.json").read_text())
    found = [e for e in entries if e["layout"] in layouts and e["checksum_ok"] == good]
    assert found or not good
    return found


def only(name: str, entry: dict[str, Any], frame: str) -> FrameBatch:
    """Decode one golden frame with a shipped description."""
    batches, counts = decode_all(shipped(name), bytes.fromhex(entry["hex"]))
    assert counts == StreamCounts(ok=1)
    return batches[frame][0]


def values(batch: FrameBatch, field: str, labels: str = "xyz") -> list[float]:
    """Return the first frame's elements of an array."""
    return [float(batch.column(f"{field}_{label}")[0]) for label in labels]


def test_there_is_a_description_for_every_unit_and_it_says_how_sure_it_is() -> None:
    """Each file names its source, and what is verified and what is known from manuals alone."""
    names = {path.stem for path in IMUS.glob("*.yaml")}
    assert names == {"mfs", *LAYOUTS, *FOREIGN, *FROM_TABLES}
    for name in names - {"mfs"}:
        description = shipped(name)
        assert description.source and description.verified and description.roles, name  # noqa: PT018 - one promise


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_good_golden_frame_is_taken_and_every_bad_one_is_refused_once(name: str, reference: Path) -> None:
    """Alone, and one after another; a bad one is one bad checksum, whatever its bytes look like."""
    good, bad = golden(reference, *LAYOUTS[name]), golden(reference, *LAYOUTS[name], good=False)
    for entry in good:
        assert decode_all(shipped(name), bytes.fromhex(entry["hex"]))[1] == StreamCounts(ok=1), entry["note"]
    for entry in bad:
        counts = decode_all(shipped(name), bytes.fromhex(entry["hex"]))[1]
        assert counts == StreamCounts(bad_checksum=1, skipped_bytes=entry["length"]), entry["note"]
    for entry in bad:
        around = bytes.fromhex(good[0]["hex"])
        counts = decode_all(shipped(name), around + bytes.fromhex(entry["hex"]) + around)[1]
        assert (counts.ok + counts.duplicate, counts.bad_checksum, counts.resyncs) == (2, 1, 1)


@pytest.mark.parametrize("with_line_ends", [True, False])
def test_stim300_datagrams_have_their_values_with_and_without_line_ends(with_line_ends: bool, reference: Path) -> None:
    """Rates in deg/hr, accelerations for the unit's range, inclinations, temperatures, status, counter and latency."""
    for entry in golden(reference, *LAYOUTS["stim300"][:2]):
        sent = bytes.fromhex(entry["hex"])
        expected = entry["expected"]
        unit = shipped("stim300", acceleration_range=10 if sent[0] == 0xAF else 30)  # two units
        batches, counts = decode_all(unit, sent if with_line_ends else sent[:-2])
        assert counts == StreamCounts(ok=1)
        ((batch,),) = batches.values()
        assert values(batch, "gyro") == [3600 * value for value in expected["gyro_deg_s"]]
        assert values(batch, "acc") == expected["acc_g"]
        assert values(batch, "incl") == expected["incl_g"]
        names = {"gyro_status", "acc_status", "incl_status", "counter", "latency_us"} & set(expected)
        assert all(batch.wire(name)[0] == expected[name] for name in names)
        for kind in ("gyro_temp", "acc_temp", "incl_temp"):
            if f"{kind}_c" in expected:
                assert values(batch, kind) == expected[f"{kind}_c"]
                assert batch.wire(f"{kind}_status")[0] == expected[f"{kind}_status"]
        if "aux_raw" in expected:
            assert int(batch.wire("pps")[0]).to_bytes(3, "big") == bytes(expected["aux_raw"])
        assert bits(batch, "gyro_overload")[0] == bool(expected["gyro_status"] & 0x10)


@pytest.mark.slow
def test_a_stim300_that_begins_with_a_damaged_line_end_or_changes_its_mind_is_still_read(reference_data: Path) -> None:
    """The first frame tells whether lines end with CR LF; one that tells wrongly is corrected by the next."""
    capture = (reference_data / "captures" / "stim300-125hz.bin").read_bytes()
    spoiled = capture[:38] + b"\x00" + capture[39:]
    _, counts = decode_all(shipped("stim300"), spoiled)
    assert counts == StreamCounts(ok=524, skipped_bytes=2, resyncs=1)
    later = bytearray(capture)
    later[4000 - 1] = 0
    _, counts = decode_all(shipped("stim300"), bytes(later))
    assert counts == StreamCounts(ok=523, bad_delimiter=1, skipped_bytes=40, resyncs=1, lost=1)
    bare = b"".join(capture[at : at + 38] for at in range(0, len(capture), 40))
    for piece in (1 << 30, 1, 37, 38, 39, 1000):
        assert decode_all(shipped("stim300"), bare, piece)[1] == StreamCounts(ok=524)
        assert decode_all(shipped("stim300"), spoiled, piece)[1] == StreamCounts(ok=524, skipped_bytes=2, resyncs=1)


def test_stim300_scales_follow_what_the_bench_file_says(reference: Path) -> None:
    """Range 10 g halves the acceleration; increments of angle become rates by the sample rate; the step follows too."""
    entry = golden(reference, LAYOUTS["stim300"][0])[0]
    description = load_description(
        IMUS / "stim300.yaml",
        parameters={"acceleration_range": "10 g", "gyro_output": "increment"},
        sample_rate_hz=500,
    )
    batch = decode_all(description, bytes.fromhex(entry["hex"]))[0]["rate_acc_incl"][0]
    assert values(batch, "acc") == [value / 2 for value in entry["expected"]["acc_g"]]
    assert values(batch, "gyro") == pytest.approx([3600 * 500 * raw / 2**21 for raw in entry["expected"]["gyro_raw"]])
    counter = description.frames["rate_acc_incl"].counter
    assert counter is not None
    assert counter.step == 4


def test_stim300_utility_lines_are_given_as_text(reference: Path) -> None:
    """The line with its checksum, without its end."""
    for entry in golden(reference, "stim300_utility_ascii"):
        batches, _ = decode_all(shipped("stim300"), bytes.fromhex(entry["hex"]))
        ((batch,),) = batches.values()
        assert batch.text("line") == [entry["expected"]["body"] + str(entry["expected"]["crc8"])]


def test_kvh_frames_have_their_values_in_the_configured_units(reference: Path) -> None:
    """Increments in radians at 1 kHz by default, rates in degrees where the bench file says so; bits mean valid."""
    for entry in golden(reference, "kvh_format_A_36B"):
        batch, expected = only("kvh1750", entry, "format_A"), entry["expected"]
        assert values(batch, "gyro") == pytest.approx(
            [1000 * RAD_PER_S * value for value in expected["gyro"]], rel=1e-12
        )
        assert values(batch, "acc") == expected["acc_g"]
        assert batch.column("temperature")[0] == expected["temp"]
        assert bits(batch, "gyro_x_valid")[0] == bool(expected["status"] & 1)
        rates = shipped("kvh1750", gyro_output="degrees per second", temperature_unit="degF")
        batch = decode_all(rates, bytes.fromhex(entry["hex"]))[0]["format_A"][0]
        assert values(batch, "gyro") == pytest.approx([3600 * value for value in expected["gyro"]], rel=1e-15)
        assert batch.column("temperature")[0] == pytest.approx((expected["temp"] - 32) / 1.8)
    bit = only("kvh1750", golden(reference, "kvh_extended_bit_11B")[0], "extended_bit")
    assert values(bit, "bit", "012345") == [127.0] * 6


def test_kvh_format_c_takes_turns() -> None:
    """The same four bytes are temperature or one axis of the magnetic field, as the sequence says; else NaN."""
    description = shipped("kvh1750", format="format_C")
    columns: dict[str, Any] = {"sequence": np.arange(8), "acc_z": 1.0}
    sent = bytearray(encode(description, "format_C", columns))
    for number in range(8):
        sent[38 * number + 28 : 38 * number + 32] = np.array(10.0 + number, ">f4").tobytes()
    rows = np.frombuffer(sent, np.uint8).reshape(8, 38).copy()
    FrameLayout(description, "format_C").checksum.write(rows)
    batch = decode_all(description, rows.tobytes())[0]["format_C"][0]
    assert batch.column("temperature")[[0, 4]].tolist() == [10.0, 14.0]
    assert np.isnan(batch.column("temperature")[[1, 2, 3, 5, 6, 7]]).all()
    assert batch.column("mag_y")[[2, 6]].tolist() == [12.0, 16.0]
    assert np.isnan(batch.column("mag_y")[[0, 1, 3]]).all()


def test_mip_packets_have_the_fields_that_they_carry(reference: Path) -> None:
    """Each by its descriptor; what a packet lacks is NaN, what is not known is skipped."""
    fields = {
        "scaled_accel_g": ("acc", 1.0),
        "scaled_gyro_rad_s": ("gyro", RAD_PER_S),
        "scaled_mag_gauss": ("mag", 1.0),
    }
    for entry in golden(reference, "mip_tlv"):
        batches, _ = decode_all(shipped("mip"), bytes.fromhex(entry["hex"]))
        (((frame, (batch,)),)) = batches.items()
        expected = {"sensor": 0x80, "system": 0xA0}.get(frame)
        assert expected in (None, entry["expected"]["desc_set"])
        given = {each.get("name"): each for each in entry["expected"]["fields"]}
        for name, (field, factor) in fields.items():
            if frame == "sensor":
                wanted = [factor * value for value in given[name]["f32"]] if name in given else [np.nan] * 3
                assert values(batch, field) == pytest.approx(wanted, rel=1e-12, nan_ok=True)
        if "reference_timestamp_ns" in given:
            assert batch.wire("reference_time")[0] == given["reference_timestamp_ns"]["u64_ns"]
            assert batch.wire("reference_step")[0] == given["reference_time_delta_ns"]["u64_ns"]


XSENS = {
    "0x4020": ("acc", "xyz", 1 / GRAVITY),
    "0x8020": ("gyro", "xyz", RAD_PER_S),
    "0x2010": ("quaternion", "0123", 1),
}
XSENS |= {"0x8030": ("delta_q", "0123", 1), "0x4010": ("delta_v", "xyz", 1)}


def test_xsens_messages_have_their_values_in_every_number_format(reference: Path) -> None:
    """float32, 12.20 and 16.32 fixed point and float64 decode to the given values; other messages are checked only."""
    formats = set()
    for entry in golden(reference, "xbus_mtdata2"):
        batch = only("xsens-mtdata2", entry, "mtdata2")
        for item in entry["expected"]["items"]:
            if "values" in item:
                field, labels, factor = XSENS[f"0x{int(item['id'], 16) & 0xFFF0:04X}"]
                formats.add(item["fmt"])
                wanted = [factor * value for value in item["values"]]
                assert values(batch, field, labels) == pytest.approx(wanted, rel=1e-15), item
            elif "packet_counter" in item:
                assert batch.wire("packet_counter")[0] == item["packet_counter"]
            elif "status_word" in item:
                assert batch.wire("status_word")[0] == item["status_word"]
            elif "sample_time_fine" in item:
                assert batch.wire("sample_time")[0] == item["sample_time_fine"]
    assert {"f4", "fp1632", "f8"} <= formats
    for entry in golden(reference, "xbus"):
        assert only("xsens-mtdata2", entry, "message").wire("message_id")[0] == entry["expected"]["mid"]


def test_vectornav_messages_have_their_values(reference: Path) -> None:
    """Binary by its header, the line by its place between commas."""
    for entry in golden(reference, "vn_binary_FA"):
        expected = entry["expected"]
        frame = "start_ypr" if "time_startup_ns" in expected else "ypr"
        batch = only("vectornav-binary", entry, frame)
        assert values(batch, "ypr", ("yaw", "pitch", "roll")) == expected["ypr_deg"]  # type: ignore[arg-type]
        if frame == "start_ypr":
            assert batch.wire("time_startup")[0] == expected["time_startup_ns"]
    entry = golden(reference, "vn_ascii_VNYMR")[0]
    batch = only("vectornav-ascii", entry, "VNYMR")
    numbers = [*values(batch, "ypr", ("yaw", "pitch", "roll")), *values(batch, "mag")]  # type: ignore[arg-type]
    numbers += [*(GRAVITY * v for v in values(batch, "acc")), *(v / RAD_PER_S for v in values(batch, "gyro"))]
    assert numbers == pytest.approx(entry["expected"]["values"], rel=1e-14)


def test_the_crc_form_of_a_vectornav_line_is_checked_too(reference: Path) -> None:
    """Four digits are a CRC-16, and a wrong one is refused."""
    entry = golden(reference, "vn_ascii_VNYMR")[0]
    body = bytes.fromhex(entry["hex"])[1:].split(b"*")[0]
    line = b"$%b*%04X\r\n" % (body, crc_hqx(body, 0))
    assert decode_all(shipped("vectornav-ascii"), line)[1] == StreamCounts(ok=1)
    wrong = b"$%b*%04X\r\n" % (body, crc_hqx(body, 0) ^ 1)
    assert decode_all(shipped("vectornav-ascii"), wrong)[1].bad_checksum == 1


def test_frames_built_from_manuals_have_their_values(reference: Path) -> None:
    """Honeywell, Silicon Sensing, Epson and ACEINNA: no public capture exists."""
    control = golden(reference, "hg4930_01_20B")[0]
    batch = only("hg4930", control, "control")
    assert [v / RAD_PER_S for v in values(batch, "gyro")] == pytest.approx(control["expected"]["gyro_rad_s"], rel=1e-14)
    assert [v * GRAVITY for v in values(batch, "acc")] == pytest.approx(control["expected"]["acc_m_s2"], rel=1e-14)
    assert (batch.column("temperature")[0], batch.wire("sequence")[0]) == (25.0, 3)
    assert np.isnan(batch.column("software")[0])
    inertial = golden(reference, "hg4930_02_44B")[0]
    batch = only("hg4930", inertial, "inertial")
    assert values(batch, "delta_theta") == pytest.approx(inertial["expected"]["delta_theta_rad"], rel=1e-14)
    assert values(batch, "delta_v") == pytest.approx(inertial["expected"]["delta_v_m_s"], rel=1e-14)
    assert batch.column("software")[0] == inertial["expected"]["status2"]
    entry = golden(reference, "dmu11_68B")[0]
    batch, expected = only("dmu11", entry, "message"), entry["expected"]
    assert values(batch, "gyro") == pytest.approx([3600 * expected[f"r{axis}"] for axis in "xyz"])
    assert values(batch, "acc") == pytest.approx([expected[f"a{axis}"] for axis in "xyz"], rel=1e-6)
    assert values(batch, "delta_theta") == pytest.approx([expected[f"dt{axis}"] for axis in "xyz"], rel=1e-6)
    assert values(batch, "delta_v") == pytest.approx([expected[f"dv{axis}"] for axis in "xyz"], rel=1e-6)
    assert (batch.column("temperature")[0], batch.wire("count")[0]) == (25.5, 1234)
    entry = golden(reference, "epson_burst16_F007_24B")[0]
    batch, expected = only("epson-g3xx", entry, "burst"), entry["expected"]
    assert values(batch, "gyro") == pytest.approx([3600 * value for value in expected["gyro_deg_s"]])
    assert values(batch, "acc") == pytest.approx([value / 1000 for value in expected["acc_mg_G365"]])
    assert batch.column("temperature")[0] == pytest.approx(expected["temp_c"])
    assert batch.wire("count")[0] == expected["count"]


def test_a_burst_without_sync_can_be_described_by_its_first_word(reference: Path) -> None:
    """ADIS1647x through a bridge: the status word that is 0 while all is well serves as the header."""
    description = parse_description(
        "schema: hil.frames/1\nname: ADIS16470\nsample_rate_hz: 2000\nbyte_order: big\nsync: 00 00\nframes:\n"
        "  burst:\n    length: 20\n    checksum: {kind: sum, width: 16, confirm: true}\n    fields:\n"
        "      gyro: {type: i16, names: [x, y, z], scale: 0.1, unit: deg/s}\n"
        "      acc: {type: i16, names: [x, y, z], scale: 0.00125, unit: g}\n"
        "      temperature: {type: i16, scale: 0.1, unit: degC}\n      count: {type: u16}\n"
        "    counter: {field: count, modulus: 65536}\n"
    )
    entry = golden(reference, "adis1647x_burst16_20B")[0]
    batches, counts = decode_all(description, bytes.fromhex(entry["hex"]))
    batch, expected = batches["burst"][0], entry["expected"]
    assert counts == StreamCounts(ok=1)
    assert values(batch, "gyro") == pytest.approx(expected["gyro_deg_s_ADIS16470"])
    assert values(batch, "acc") == pytest.approx(expected["acc_g_ADIS16470"])
    assert (batch.column("temperature")[0], batch.wire("count")[0]) == (pytest.approx(25.0), expected["data_cntr"])


PIECES = [1 << 30, 1000, 41]


@pytest.mark.parametrize("piece", PIECES)
def test_the_stim300_capture_decodes_completely(reference_data: Path, piece: int) -> None:
    """524 datagrams, counter in steps of 16, nothing skipped."""
    data = (reference_data / "captures" / "stim300-125hz.bin").read_bytes()
    batches, counts = decode_all(shipped("stim300"), data, piece)
    assert counts == StreamCounts(ok=524)
    counters = np.concatenate([batch.wire("counter") for batch in batches["rate_acc_incl"]]).astype(int)
    assert (np.diff(counters) % 256 == 16).all()


@pytest.mark.parametrize("piece", PIECES)
def test_the_vectornav_capture_decodes_completely(reference_data: Path, piece: int) -> None:
    """54 binary messages and 6 lines interleaved, and a truncated tail."""
    data = (reference_data / "captures" / "vectornav-binary-and-ascii.bin").read_bytes()
    batches, counts = decode_all(shipped("vectornav-binary"), data, piece)
    assert {name: sum(map(len, found)) for name, found in batches.items()} == {"start_imu": 27, "start_ypr": 27}
    assert (counts.ok, counts.bad_checksum, counts.lost, counts.timed_out) == (54, 0, 0, 0)
    assert counts.skipped_bytes == len(data) - 27 * (52 + 40)
    batches, counts = decode_all(shipped("vectornav-ascii"), data, piece)
    assert (counts.ok, counts.bad_checksum, counts.duplicate) == (6, 0, 0)
    assert sum(map(len, batches["VNYMR"])) == 6


FIELDS = {"Acceleration": ("acc", 1 / GRAVITY), "RateOfTurn": ("gyro", RAD_PER_S), "DeltaV": ("delta_v", 1.0)}
FIELDS |= {"DeltaQ": ("delta_q", 1.0), "EulerAngles": ("euler", 1.0), "PacketCounter": ("packet_counter", 1.0)}
FIELDS |= {"SampleTimeFine": ("sample_time", 1e-4)}
LABELS = {"euler": {"X": "roll", "Y": "pitch", "Z": "yaw"}}


def decoded_text(path: Path) -> list[dict[str, float]]:
    """Return what the makers of a capture decoded from it, message by message, under this project's field names."""
    messages: list[dict[str, float]] = []
    for block in path.read_text().strip().split("\n\n"):
        message, name, factor = {}, "", 1.0
        for line in block.splitlines():
            if not line.startswith(" "):
                name, factor = FIELDS.get(line.split("(")[0].rstrip(":"), ("", 1.0))
            elif name:
                label, _, number = line.strip().rpartition(":")
                suffix = LABELS.get(name, {}).get(label, label.lower().removeprefix("q"))
                message[f"{name}_{suffix}" if label else name] = factor * float(number)
        messages.append(message)
    return messages


@pytest.mark.parametrize("piece", PIECES)
@pytest.mark.parametrize("number", [1, 2])
def test_the_xsens_captures_decode_to_their_decoded_text(reference_data: Path, number: int, piece: int) -> None:
    """100 messages each, every value; what a message lacks is NaN."""
    stem = reference_data / "captures" / f"xsens-mtdata2-{number}"
    batches, counts = decode_all(shipped("xsens-mtdata2"), stem.with_suffix(".bin").read_bytes(), piece)
    assert counts == StreamCounts(ok=100)
    expected = decoded_text(stem.with_suffix(".decoded.txt"))
    columns = {
        name: np.concatenate([batch.columns[name] for batch in batches["mtdata2"]])
        for name in batches["mtdata2"][0].columns
    }
    assert len(expected) == 100
    compared = 0
    for at, message in enumerate(expected):
        for name in [name for name in columns if name.split("_")[0] in ("acc", "gyro", "delta", "euler", "packet")]:
            if name in message:
                assert columns[name][at] == pytest.approx(message[name], rel=1e-15), (at, name)
                compared += 1
            else:
                assert np.isnan(columns[name][at]), (at, name)
    assert compared > 1300
