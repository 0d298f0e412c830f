"""`hil decode` and `hil frames check`: the document, the table, and a description in words."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from drivers.frames.description import StreamDescription, parse_description
from drivers.frames.layout import encode
from hil.bench import decode as decode_module
from hil.bench.decode import decode_file, explain_frames, load_frames_named
from hil.errors import InputError
from hil.files.strict import config_folders


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a file with 100 samples of which one is damaged and two are missing, an identity and half a frame."""
    mfs = load_frames_named("mfs")
    sent = encode(mfs, "sample", {"counter": np.arange(100), "rate_A2": np.arange(100) * 0.5, "status": 2})
    frames = [sent[at : at + 59] for at in range(0, len(sent), 59)]
    frames[10] = frames[10][:20] + bytes([frames[10][20] ^ 1]) + frames[10][21:]
    identity = encode(mfs, "identity", {"model": "MFS", "serial": "014"})
    path = tmp_path / "night.bin"
    path.write_bytes(b"".join(frames[:50]) + identity + b"".join(frames[52:]) + frames[0][:30])
    return path


@pytest.mark.parametrize("chunk", [1 << 22, 100])
def test_the_document_counts_every_byte_and_gives_the_first_and_last_frame(
    recording: Path, chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The contract's keys, whole numbers as such, and it is JSON."""
    monkeypatch.setattr(decode_module, "_CHUNK", chunk)
    document = json.loads(json.dumps(decode_file(recording, load_frames_named("mfs")), allow_nan=False))
    assert document["schema"] == "hil.decode/1"
    assert document["frames"] == {"sample": 97, "identity": 1}
    counts = ("ok", "bad_checksum", "bad_delimiter", "unknown_id", "skipped_bytes", "resyncs", "lost", "duplicate")
    assert [document[name] for name in counts] == [98, 1, 0, 0, 59 + 30, 1, 3, 0]
    assert document["timed_out"] == 0
    assert (document["first"]["counter"], document["first"]["rate_A2"], document["first"]["status"]) == (0, 0.0, 2)
    assert (document["last"]["counter"], document["last"]["rate_A2"]) == (99, 49.5)
    assert document["first_frame"] == "sample"


@pytest.mark.parametrize("name", ["table.parquet", "table.csv"])
def test_the_table_holds_every_good_frame_in_order(recording: Path, tmp_path: Path, name: str) -> None:
    """Type, place in the file, number, and the fields that occur; what a frame does not have is empty."""
    out = tmp_path / name
    document = decode_file(recording, load_frames_named("mfs"), out=out)
    table = pq.read_table(out) if name.endswith("parquet") else pyarrow.csv.read_csv(out)
    assert document["out"] == str(out)
    assert table.num_rows == 98
    assert table.column_names[:3] == ["frame", "position", "sequence"]
    positions = table["position"].to_numpy()
    assert (np.diff(positions) > 0).all()
    assert table["frame"].to_pylist()[49] == "identity"
    rates = table["rate_A2"].to_pylist()
    assert rates[49] is None
    assert [rates[0], rates[-1]] == [0.0, 49.5]
    assert str(table["serial"].to_pylist()[49]).rjust(3, "0") == "014"
    assert table["sequence"].to_pylist()[-1] == 99
    assert not list(tmp_path.glob(".partial-*"))


def test_a_file_that_cannot_be_read_or_written_is_bad_input(recording: Path, tmp_path: Path) -> None:
    """One sentence with the file; nothing is left behind."""
    mfs = load_frames_named("mfs")
    with pytest.raises(InputError, match=r"absent\.bin: there is no such file"):
        decode_file(tmp_path / "absent.bin", mfs)
    with pytest.raises(InputError, match=r"table\.xlsx: the table is written as \.parquet or \.csv"):
        decode_file(recording, mfs, out=tmp_path / "table.xlsx")
    with pytest.raises(InputError, match=r"nowhere.*: cannot be made \(No such file"):
        decode_file(recording, mfs, out=tmp_path / "nowhere" / "table.csv")
    with pytest.raises(InputError, match="no IMU description"):
        load_frames_named("stim200")
    with pytest.raises(InputError, match=r"stim300\.yaml: parameters\.acceleration_range: 7 is none of 5, 10, 30, 80"):
        load_frames_named("stim300", parameters={"acceleration_range": 7})


def test_the_table_never_replaces_the_raw_bytes(recording: Path, tmp_path: Path) -> None:
    """A recording that is called .csv, named again for the table, directly or through a link, stays what it is."""
    raw, link = recording.rename(tmp_path / "raw.csv"), tmp_path / "link.csv"
    link.symlink_to(raw)
    before = raw.read_bytes()
    for out in (raw, link):
        with pytest.raises(InputError, match=rf"{out.name}: is the file of raw bytes itself"):
            decode_file(raw, load_frames_named("mfs"), out=out)
    assert raw.read_bytes() == before


def test_an_empty_file_and_noise_have_no_first_frame(tmp_path: Path) -> None:
    """Nothing is made up."""
    path, out = tmp_path / "noise.bin", tmp_path / "noise.parquet"
    path.write_bytes(b"")
    assert decode_file(path, load_frames_named("mfs"), out=out)["first"] is None
    assert pq.read_table(out).num_rows == 0
    path.write_bytes(b"\x00" * 1000)
    document = decode_file(path, load_frames_named("mfs"))
    assert (document["ok"], document["skipped_bytes"], document["frames"], document["last"]) == (0, 1000, {}, None)


def test_items_that_a_message_lacks_are_null(reference_data: Path, tmp_path: Path) -> None:
    """Xsens messages differ; only fields that occur are columns."""
    out = tmp_path / "xsens.parquet"
    capture = reference_data / "captures" / "xsens-mtdata2-1.bin"
    document = decode_file(capture, load_frames_named("xsens-mtdata2"), out=out)
    assert document["frames"] == {"mtdata2": 100}
    assert document["first"]["packet_counter"] == 43398
    assert document["first"]["temperature"] is None
    table = pq.read_table(out)
    assert "temperature" not in table.column_names
    assert table["packet_counter"].null_count == 0
    assert table["euler_roll"].null_count > 0


SHIPPED = sorted(path.stem for path in config_folders("imus")[-1].glob("*.yaml"))


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_description_explains_itself(name: str) -> None:
    """Every frame and field is named, with no line left unfilled."""
    description = load_frames_named(name)
    text = explain_frames(description)
    for frame, described in description.frames.items():
        assert f"\n{frame}" in text
        for field in described.all_fields:
            assert f"{field}, " in text
    for weak in ("None", "nan", "  ,"):
        assert weak not in text


def test_the_words_say_what_the_file_says() -> None:
    """Checksum, counter, scale, parameter, turns and weaknesses."""
    text = explain_frames(load_frames_named("stim300"))
    crc = "CRC-32/MPEG-2 (polynomial 0x4c11db7, initially 0xffffffff, not reflected, no XOR at the end)"
    assert f"rate_acc_incl: begins with 93, 38 bytes\n  {crc}, zeros added up to a multiple of 4" in text
    assert "byte 1: gyro_x, 24-bit signed, × 0.2197265625 deg/hr" in text
    assert "counter counts by 16 from frame to frame and comes round at 256" in text
    assert "acceleration_range (full scale of the accelerometers, as ordered): 5, 10, 30, 80 g; else 30 g" in text
    assert "rate_acc_incl: the counter comes round in 0.128 s" in text
    assert "0D 0A may follow every frame" in text
    text = explain_frames(load_frames_named("kvh1750"))
    assert "byte 28: mag_y, single precision, where sequence & 0x3 is 0x2" in text
    assert "gyro_x_valid (good is 1)" in text
    assert "believed after damage only where the next frame" in text
    text = explain_frames(load_frames_named("vectornav-ascii"))
    assert "XOR, in hex digits after '*' or CRC-16/XMODEM (polynomial 0x1021, initially 0x0, " in text
    assert "VNYMR has neither counter nor time" in text
    text = explain_frames(load_frames_named("xsens-mtdata2"))
    assert "item 0x4020 (seen through 0xfff0): acc_x, in the item's number format" in text
    assert "5 to 2060 bytes: the number at byte 3 and 5 more, or further on where it is 255" in text


def test_a_crc_outside_the_catalogue_is_said_in_full() -> None:
    """Every parameter that can be wrong is there to be compared with a manual."""
    kind = "kind: crc, width: 16, poly: 0x8005, init: 0x1234, refin: true, refout: true, xorout: 0xFFFF"
    assert "CRC-16 (polynomial 0x8005, initially 0x1234, reflected, XOR 0xffff at the end)" in explained(kind)
    kind = "kind: crc, width: 16, poly: 0x8005, refin: true"
    assert "initially 0x0, only its input reflected, no XOR at the end)" in explained(kind)


def explained(checksum: str) -> str:
    """Return the words for a frame with this checksum."""
    return explain_frames(
        parse_description(
            "schema: hil.frames/1\nname: X\nsample_rate_hz: 100\nbyte_order: big\nsync: AA 55\n"
            f"frames: {{f: {{length: 8, checksum: {{{checksum}}}, fields: {{n: {{type: u8}}}}}}}}"
        )
    )


@pytest.mark.slow
def test_a_recording_of_another_unit_is_told_by_what_reads_it(tmp_path: Path) -> None:
    """What was looked for and not found, and the name of the description that fits; of noise, that none does."""
    path = tmp_path / "other.bin"
    numbers = np.arange(400)
    sent = encode(load_frames_named("stim300"), "rate_acc", {"counter": numbers * 16 % 256, "gyro_x": numbers % 7})
    path.write_bytes(sent[5:])
    first, second = decode_file(path, load_frames_named("kvh1750"))["warnings"]
    assert first.startswith(f"no good frame is in {len(sent) - 5} bytes: in the first")
    assert second == "stim300 reads 99.8% of the first 11195 bytes as 399 good frames: try --frames stim300"
    assert decode_file(path, load_frames_named("stim300"))["warnings"] == []
    path.write_bytes(np.random.default_rng(1).integers(0, 256, 30_000, np.uint8).tobytes())
    warnings = decode_file(path, load_frames_named("stim300"))["warnings"]
    assert [each.split(":")[0] for each in warnings] == [
        "no good frame is in 30000 bytes",
        "no shipped description reads it",
    ]
    path.write_bytes(b"")
    assert decode_file(path, load_frames_named("stim300"))["warnings"] == []


def test_frames_that_begin_as_described_with_a_wrong_checksum_point_at_the_checksum(tmp_path: Path) -> None:
    """A description of one's own, wrong in its CRC: the counts and the sentence say where to look."""
    path = tmp_path / "mine.bin"
    path.write_bytes(framed("init: 0", 0, 1, 256, 300))
    warnings = decode_file(path, counted("init: 1", step=1, modulus=256))["warnings"]
    assert warnings[1].startswith("frames begin as described, but their checksums do not match")


def counted(crc: str, *, step: int, modulus: int) -> StreamDescription:
    """Return a description whose counter is as given."""
    return parse_description(
        "schema: hil.frames/1\nname: X\nsample_rate_hz: 100\nbyte_order: big\nsync: AA 55\n"
        f"frames: {{f: {{length: 7, checksum: {{kind: crc, width: 32, poly: 0x04C11DB7, {crc}}}, "
        f"fields: {{n: {{type: u8}}}}, counter: {{field: n, step: {step}, modulus: {modulus}}}}}}}"
    )


def framed(crc: str, first: int, step: int, modulus: int, n: int) -> bytes:
    """Return n frames of such a unit whose counter really moves so."""
    values = (first + np.arange(n) * step) % modulus
    return encode(counted(crc, step=1, modulus=256), "f", {"n": values})


@pytest.mark.parametrize(
    ("truth", "said", "expected"),
    [
        ((5, 100), (5, 100), None),
        ((1, 256), (1, 256), None),
        ((5, 100), (1, 100), "frames.f.counter.step: is 1, but n moves by 5 from frame to frame; lost"),
        ((1, 256), (16, 256), "frames.f.counter.step: is 16, but n moves by 1 from frame to frame; lost"),
        ((1, 128), (1, 256), "frames.f.counter.modulus: is 256, but n comes round at 128; lost"),
        ((5, 100), (5, 255), "frames.f.counter.modulus: is 255, but n comes round at 100; lost"),
        ((1, 256), (1, 128), "frames.f.counter.modulus: is 128, but n goes up to 255; lost"),
        ((16, 256), (1, 16), "most frames repeat the counter of the one before and are left out"),
    ],
)
def test_a_counter_that_is_described_wrongly_is_told(
    tmp_path: Path, truth: tuple[int, int], said: tuple[int, int], expected: str | None
) -> None:
    """Frames that are really lost, and one that comes twice, do not disturb it."""
    path = tmp_path / "counted.bin"
    sent = framed("init: 0", 0, *truth, 1000)
    path.write_bytes(sent[: 7 * 100] + sent[7 * 103 : 7 * 500] + sent[7 * 499 : 7 * 700] + sent[7 * 720 :])
    warnings = decode_file(path, counted("init: 0", step=said[0], modulus=said[1]))["warnings"]
    if expected is None:
        assert warnings == []
    else:
        assert any(each.startswith(expected) for each in warnings), warnings


def test_numbers_are_printed_with_the_decimals_that_they_can_have(tmp_path: Path) -> None:
    """In the document and in a table of text; what cannot be said in a few decimals is as it was computed."""
    mfs = load_frames_named("mfs")
    temperature = next(name for name, field in mfs.frames["sample"].fields.items() if field.scale == 0.01)
    path, out = tmp_path / "warm.bin", tmp_path / "warm.csv"
    path.write_bytes(encode(mfs, "sample", {"counter": np.arange(3), temperature: 0.57}))
    assert 57 * 0.01 != 0.57
    document = decode_file(path, mfs, out=out)
    assert document["first"][temperature] == 0.57
    assert "0.57," in out.read_text()
    assert "0.5700" not in out.read_text()
    stim = load_frames_named("stim300")
    path.write_bytes(encode(stim, "rate_acc", {"counter": np.arange(3) * 16, "gyro_x": 3 * 3600 / 2**14}))
    assert decode_file(path, stim)["first"]["gyro_x"] == 3 * 3600 / 2**14
