"""Decoding a file of raw bytes, and explaining a description, from the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.frames.layout import encode
from hil.bench.decode import load_frames_named


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    """Ten of the project's own frames, with one bit of the fifth flipped."""
    description = load_frames_named("mfs")
    columns = {name: np.zeros(10) for name in description.frames["sample"].fields}
    columns["counter"] = np.arange(10.0)
    columns["rate_A2"] = np.linspace(-1.0, 1.0, 10)
    data = bytearray(encode(description, "sample", columns))
    data[4 * len(data) // 10 + 20] ^= 0x04
    path = tmp_path / "raw.bin"
    path.write_bytes(data)
    return path


def test_every_byte_is_accounted_for(hil: Any, raw: Path, tmp_path: Path) -> None:
    """Nine good frames, one bad checksum, one lost by the counter; the table holds the nine."""
    out = tmp_path / "frames.csv"
    ended = hil("decode", "--frames", "mfs", raw, "--json", "--out", out)
    told = json.loads(ended.stdout)
    assert ended.returncode == 0
    assert told["schema"] == "hil.decode/1"
    assert told["frames"]["sample"] == told["ok"] == 9
    assert told["bad_checksum"] >= 1
    assert told["lost"] == 1
    assert told["first"]["rate_A2"] == pytest.approx(-1.0)
    assert told["last"]["rate_A2"] == pytest.approx(1.0)
    assert len(out.read_text().splitlines()) == 10


def test_a_file_without_a_frame_is_no_success(hil: Any, tmp_path: Path) -> None:
    """Bytes of another unit: the count is told, and the exit status says that there is nothing."""
    (tmp_path / "other.bin").write_bytes(bytes(range(200)) * 3)
    ended = hil("decode", "--frames", "mfs", tmp_path / "other.bin")
    assert (ended.returncode, "no frames" in ended.stdout) == (4, True)


def test_a_description_is_told_in_words(hil: Any) -> None:
    """`hil frames check` names the frames of a description that ships."""
    ended = hil("frames", "check", "mfs")
    assert ended.returncode == 0
    assert "sample" in ended.stdout


def test_a_recording_of_an_unknown_unit_is_looked_at(hil: Any, raw: Path, tmp_path: Path) -> None:
    """Who reads it, and that ten frames are too few for more; nothing is written where nothing was found."""
    ended = hil("frames", "guess", raw, "--json", "--out", tmp_path / "first.yaml")
    told = json.loads(ended.stdout)
    assert (ended.returncode, told["schema"]) == (0, "hil.frames-guess/1")
    assert told["fits"][0]["description"] == "mfs"
    assert told["description"] is None
    assert not (tmp_path / "first.yaml").exists()


def test_a_guess_says_one_length_and_one_number_of_frames(hil: Any, reference_data: Path) -> None:
    """At which distance bytes come again says nothing more once frames are found."""
    told = hil("frames", "guess", reference_data / "captures" / "stim300-125hz.bin").stdout
    assert "length: 40 bytes, in 523 frames in a row" in told
    assert "checksum: CRC-32/MPEG-2 (polynomial 0x4c11db7, " in told
    assert "counter: u8 at byte 31, " in told
    assert "repeats every" not in told


def test_what_cannot_be_decoded_is_refused(hil: Any, raw: Path, tmp_path: Path) -> None:
    """An unknown description, a file that is not there, a table of an unknown kind, a setting without a value."""
    for arguments in (
        ("decode", "--frames", "nonsense", raw),
        ("decode", "--frames", "mfs", tmp_path / "nowhere.bin"),
        ("decode", "--frames", "mfs", raw, "--out", tmp_path / "x.xlsx"),
        ("decode", "--frames", "mfs", raw, "--set", "range"),
        ("decode", "--frames", "mfs", raw, "--set", "range=["),
        ("frames", "check", "nonsense"),
    ):
        ended = hil(*arguments)
        assert ended.returncode == 2
        assert len(ended.stderr.strip().splitlines()) == 1
