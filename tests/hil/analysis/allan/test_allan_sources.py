"""Any series can be read: nights, campaigns, Parquet, CSV, plain columns, archives; what is missing is asked for."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.analysis.allan.document import AllanResult
from hil.analysis.allan.sources import Recording, read_recording
from hil.campaign import Series
from hil.campaign.writer import write_campaign
from hil.cli.app import run
from hil.errors import InputError
from tests.hil.analysis.allan.noise_series import rates
from tests.hil.solve.runs_of_a_unit import campaign


@pytest.fixture
def white() -> np.ndarray:
    """Return 4096 samples of white noise of 1 deg/hr."""
    return rates(np.random.default_rng(0), 4096)


def test_the_same_rates_come_from_every_kind_of_file(tmp_path: Path, white: np.ndarray) -> None:
    """CSV with and without names, blanks between columns, Parquet and NumPy: one result."""
    time_s = np.arange(len(white)) / 50.0
    np.savetxt(tmp_path / "named.csv", np.stack([time_s, white], -1), delimiter=",", header="t_s,gx", comments="")
    np.savetxt(tmp_path / "bare.csv", white[:, None], delimiter=",")
    np.savetxt(tmp_path / "blanks.txt", np.stack([white, 2 * white], -1), header="a comment")
    np.savez(tmp_path / "counts.npz", counts=np.stack([white, 2 * white], -1), rate=50.0)
    field = pa.field("gx", pa.float64(), metadata={"unit": "deg/hr"})
    table = pa.table([pa.array(time_s), pa.array(white)], schema=pa.schema([pa.field("time_s", pa.float64()), field]))
    pq.write_table(table, tmp_path / "block.parquet")
    told = {"rate_hz": 50.0, "unit": "deg/hr"}
    found = [
        read_recording(tmp_path / "named.csv", unit="deg/hr"),
        read_recording(tmp_path / "bare.csv", **told),
        read_recording(tmp_path / "blanks.txt", channel="1", **told),
        read_recording(tmp_path / "counts.npz", channel="counts[0]", **told),
        read_recording(tmp_path / "block.parquet"),
    ]
    for each in found:
        np.testing.assert_allclose(each.stretches[0], white, atol=1e-12)
        assert each.interval_s == pytest.approx(0.02)


def test_units_are_converted_with_their_factor(tmp_path: Path, white: np.ndarray) -> None:
    """Counts of 0.05 deg/s are 180 deg/hr each; rad/s is known."""
    np.save(tmp_path / "gx.npy", white)
    counts = read_recording(tmp_path / "gx.npy", rate_hz=1.0, unit="0.05 deg/s")
    radians = read_recording(tmp_path / "gx.npy", rate_hz=1.0, unit="rad/s")
    np.testing.assert_allclose(counts.stretches[0], 180.0 * white)
    np.testing.assert_allclose(radians.stretches[0], np.degrees(white) * 3600.0)


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({}, "choose a column with --channel; there are a, b"),
        ({"channel": "c"}, "there is no column c"),
        ({"channel": "a"}, "its unit is not stated; give it with --unit"),
        ({"channel": "a", "unit": "furlong"}, "furlong"),
        ({"channel": "a", "unit": "deg/s"}, "give the sample rate with --rate"),
        ({"channel": "a", "unit": "deg/s", "rate_hz": 1.0, "collect": 3}, "--collect is for"),
    ],
)
def test_what_is_missing_is_asked_for(tmp_path: Path, told: dict[str, object], words: str) -> None:
    """Column, unit and rate, each in one sentence."""
    (tmp_path / "two.csv").write_text("a,b\n" + "1.0,2.0\n" * 20)
    with pytest.raises(InputError, match=words):
        read_recording(tmp_path / "two.csv", **told)  # type: ignore[arg-type]


def test_a_rate_that_contradicts_the_times_is_refused(tmp_path: Path, white: np.ndarray) -> None:
    """Neither is believed."""
    table = np.stack([np.arange(len(white)) / 50.0, white], -1)
    np.savetxt(tmp_path / "x.csv", table, delimiter=",", header="t_s,gx", comments="")
    with pytest.raises(InputError, match="--rate says 100 Hz"):
        read_recording(tmp_path / "x.csv", unit="deg/s", rate_hz=100.0)


def test_a_gap_in_the_times_cuts_the_series(tmp_path: Path, white: np.ndarray) -> None:
    """Missing rows are gaps, and the result says how many stretches there are."""
    table = np.delete(np.stack([np.arange(len(white)) / 50.0, white], -1), slice(1000, 1050), axis=0)
    np.savetxt(tmp_path / "x.csv", table, delimiter=",", header="t_s,gx_deg_per_hr", comments="")
    found = read_recording(tmp_path / "x.csv")
    assert [len(piece) for piece in found.stretches] == [1000, 3046]
    assert any("2 stretches" in note for note in found.notes)


def test_rubbish_is_refused_in_one_sentence(tmp_path: Path) -> None:
    """No file, no numbers, no Parquet."""
    with pytest.raises(InputError, match="no such file"):
        read_recording(tmp_path / "none.csv")
    for name in ("x.parquet", "x.npz", "x.txt"):
        (tmp_path / name).write_bytes(b"\xff\xfenonsense, more\nand more\n")
        with pytest.raises(
            InputError, match=r"cannot be read as a table|no Parquet file that can be read|is not UTF-8"
        ):
            read_recording(tmp_path / name, rate_hz=1.0, unit="deg/s")


@pytest.mark.slow
def test_the_command_prints_one_document_and_draws(
    tmp_path: Path, white: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    """N in deg/sqrt(hr), averaging advice, and an SVG."""
    np.save(tmp_path / "gx.npy", white)
    plot = tmp_path / "gx.svg"
    options = ["--rate", "1 Hz", "--unit", "deg/hr", "--reach", "0.25 deg/hr", "--out", str(plot), "--json"]
    assert run(["allan", str(tmp_path / "gx.npy"), *options]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "hil.allan/1"
    assert document["fit"]["N"]["value"] == pytest.approx(1 / 60, rel=0.05)
    assert document["averaging"]["wanted_needs_s"] == pytest.approx(16.0, rel=0.1)
    assert document["averaging"]["collect_deg_per_hr"] == pytest.approx(1 / np.sqrt(60), rel=0.05)
    assert all(
        low < d < high for low, d, high in zip(*(document[k] for k in ("low", "deviation", "high")), strict=True)
    )
    assert plot.read_text().lstrip().startswith("<?xml")


def test_bad_usage_ends_with_2_and_writes_nothing(
    tmp_path: Path, white: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    """A plot that is neither SVG nor PNG, and a rate without sense."""
    np.save(tmp_path / "gx.npy", white)
    assert run(["allan", str(tmp_path / "gx.npy"), "--out", str(tmp_path / "gx.gif")]) == 2
    assert ".svg or .png" in capsys.readouterr().err
    assert run(["allan", str(tmp_path / "gx.npy"), "--rate", "-1", "--unit", "deg/s"]) == 2
    assert "--rate" in capsys.readouterr().err
    assert sorted(each.name for each in tmp_path.iterdir()) == ["gx.npy"]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("bad.npz", b"PK\x03\x04garbage", "cannot be read as a table of numbers"),
        ("nothing.txt", b"", "it is empty"),
        ("latin.csv", b"t_s,rate \xb0/h\n0,1\n", "is not UTF-8 text"),
        ("other.h5", b"\x89HDF\r\n\x1a\n", "what is read is .csv, .parquet"),
        ("cut.txt", b"# a log\nt rate\n0 1\n\n1 2\n2\n", "row 6: it should have 2 numbers, and has 2"),
        ("cut.csv", b"t_s,rate_deg_per_hr\n0,1\n1,2\n2", "row 4: 1 cell under 2 columns; it seems to be cut off"),
        ("wider.csv", b"t,rate\n0,1,3\n", "row 2: 3 cells under 2 columns"),
        ("wider.txt", b"t rate\n0 1 3\n1 2 3\n", "row 2: it should have 2 numbers, and has 0 1 3"),
        ("bad.npy", b"\x80\x04K\x01.", "holds other things than numbers"),
        ("empty.csv", b"t_s,rate_deg_per_hr\n", "no row stands under the names of its columns"),
        ("words.csv", b"t_s,rate_deg_per_hr\na,b\n", "it has no column of numbers"),
        ("huge.csv", b"t_s,rate_deg_per_hr\n0,1e300\n1,-1e300\n2,1e299\n3,1\n4,2\n", "is the unit"),
    ],
)
def test_what_cannot_be_a_recording_is_refused_in_a_sentence(
    tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    """A damaged archive, a table without numbers, rates that nothing turns at."""
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_recording(tmp_path / name, rate_hz=1.0 if name.endswith("z") else None)


def test_complex_numbers_are_no_rates(tmp_path: Path) -> None:
    """Their imaginary part is not thrown away: the column does not count."""
    np.save(tmp_path / "c.npy", np.array([1 + 2j, 3j, 4.0, 5.0]))
    with pytest.raises(InputError, match="no column of numbers"):
        read_recording(tmp_path / "c.npy", rate_hz=1.0, unit="deg/hr")


def test_a_spike_is_named_and_noise_has_none() -> None:
    """One sample far off: two steps, with the time of the first; a million ordinary samples give no word."""
    noise = np.random.default_rng(2).normal(0.0, 10.0, 1_000_000)
    assert Recording("r", [noise], 0.01).notes == ()
    noise[500] = 1e4
    (note,) = Recording("r", [noise], 0.01).notes
    assert note.startswith("2 steps from one sample to the next")
    assert "5 s into" in note


def test_ten_samples_do_not_say_how_long_to_average(tmp_path: Path) -> None:
    """They show no term: no claim about when longer stops helping, and a bound instead of no noise."""
    found = AllanResult(Recording("r", [np.random.default_rng(0).normal(0.0, 10.0, 10)], 0.01)).document(60.0)
    assert not any(term["seen"] for term in found["fit"].values())
    said = " ".join(found["summary"])
    assert "too short to tell how long to average" in said
    assert "scatters by less than" in said
    assert "stops helping" not in said


def test_temperatures_are_only_said_to_be_different_where_they_are(tmp_path: Path) -> None:
    """Series of two collects at one temperature, and at two."""
    for per_temperature, several in ((2, False), (1, True)):
        one, rates = campaign(2, per_temperature, seed=1), np.random.default_rng(1).normal(0.0, 1.0, (64, 2))
        rates -= rates.mean(axis=0)
        kept = {
            row + 1: partial(Series, np.arange(64.0), rates + one.sensors[2].rates_deg_per_hr[row]) for row in (0, 3)
        }
        write_campaign(replace(one, recorded=kept), folder := tmp_path / str(several))
        notes = read_recording(folder, channel="RA").notes
        assert any("different temperatures" in note for note in notes) is several
