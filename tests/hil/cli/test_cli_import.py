"""`hil import`: a table as before and by its name, a log to a campaign that every other command works on, bytes too."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.frames.layout import encode
from hil.bench.decode import load_frames_named
from hil.campaign.reader import read_campaign
from tests.hil.analysis.log.simulated import BIAS_DEG_PER_HR, SENSITIVITY, simulate
from tests.hil.cli.conftest import Run
from tests.hil.cli.test_cli_bad_input import refused


def test_a_table_is_imported_with_and_without_its_word(hil: Run, tmp_path: Path) -> None:
    """What people's scripts say goes on to work."""
    for words in (("import",), ("import", "table")):
        out = tmp_path / str(len(words))
        ended = hil(*words, "rd-gc-86-1-table-1", out)
        assert ended.returncode == 0, ended.stderr
        assert (out / "collects.csv").is_file()


@pytest.mark.slow
def test_a_log_becomes_a_campaign_that_is_usable_at_once(hil: Run, tmp_path: Path) -> None:
    """One document; solve and allan take the folder."""
    log = simulate(14).write(tmp_path / "poses.csv")
    ended = hil("import", "log", log, tmp_path / "unit", "--latitude", "48.1 deg", "--json")
    assert ended.returncode == 0, ended.stderr
    document = json.loads(ended.stdout)
    assert document["schema"] == "hil.import-log/1"
    assert len(document["stretches"]) == 14
    solved = json.loads(hil("solve", tmp_path / "unit", "--json").stdout)
    assert {each["model"] for each in solved["solutions"]} == {"triad-12"}
    assert solved["solutions"][0]["verdict"] != "FAIL"
    assert hil("allan", tmp_path / "unit", "--channel", "GX", "--collect", "1").returncode == 0


@pytest.mark.slow
def test_a_sound_log_lacks_nothing_in_the_model_of_a_triad(hil: Run, tmp_path: Path) -> None:
    """Poses by hand, of which no two are alike, are data like any other to reconcile."""
    assert hil("import", "log", simulate(14).write(tmp_path / "poses.csv"), tmp_path / "unit").returncode == 0
    found = hil("reconcile", tmp_path / "unit", "--model", "triad-12", "--out", tmp_path / "found")
    assert found.returncode == 0, found.stderr
    assert "verdict: none" in found.stdout


def test_what_a_person_reads_says_why_stretches_end_and_what_was_found(hil: Run, tmp_path: Path) -> None:
    """A table of stretches, one of parameters; what was assumed beside it."""
    ended = hil("import", "log", simulate(6).write(tmp_path / "poses.csv"), tmp_path / "unit")
    assert ended.returncode == 0, ended.stderr
    assert "times as much as in the quietest tenth" in ended.stdout
    assert "not told by this log" in ended.stdout
    assert "note: rates: columns GX_deg_per_hr" in ended.stderr
    assert "note: w is given as 0" in " ".join(ended.stderr.split())


def test_an_option_that_makes_no_sense_changes_nothing(hil: Run, tmp_path: Path) -> None:
    """One sentence with the option, and no folder."""
    log, out = simulate(6).write(tmp_path / "poses.csv"), tmp_path / "unit"
    for options, words in {
        ("--window", "0.5"): "--window: '0.5' has no unit",
        ("--times", "0.5"): "--times must be more than 1",
        ("--latitude", "95 deg"): "it must be from -90 to +90",
        ("--labels", "where"): "there is no column where",
        ("--gyro", "a,b"): "--gyro a,b: 3 columns are needed",
        ("--gyro-scale", "5 kg"): "is not a rotation rate",
        ("--shortest", "1 hr"): "nowhere at rest",
    }.items():
        refused(hil("import", "log", log, out, *options), words)
    assert not out.exists()


def test_raw_bytes_are_a_log_by_their_description(hil: Run, tmp_path: Path) -> None:
    """ADIS1647x bursts at 100 Hz; twenty frames that were lost are a gap that no stretch goes over."""
    one = simulate(14)
    frames = load_frames_named("adis16470", parameters={"model": "ADIS16477-1"})
    n = len(one.t_s)
    columns: dict[str, Any] = {f"gyro_{axis}": one.rates[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"acc_{axis}": one.acc[:, k] for k, axis in enumerate("xyz")}
    columns |= {"data_counter": np.arange(n), "temperature": np.full(n, 25.0)}
    kept = np.delete(np.arange(n), slice(150, 170))
    columns = {name: np.clip(values, -4.5e5, 4.5e5)[kept] for name, values in columns.items()}
    path = tmp_path / "raw.bin"
    path.write_bytes(encode(frames, "burst", columns))
    options = ("--frames", "adis16470", "--set", "model=ADIS16477-1", "--rate", "100")
    ended = hil("import", "log", path, tmp_path / "unit", *options, "--json")
    assert ended.returncode == 0, ended.stderr
    document = json.loads(ended.stdout)
    assert [each["ends"] for each in document["stretches"][:1]] == ["a gap in time"]
    assert len(document["stretches"]) == 14
    campaign = read_campaign(tmp_path / "unit").sensors[1]
    assert campaign.conditions.columns["temperature_degC"] == pytest.approx(25.0)
    assert np.abs(campaign.rates_deg_per_hr - (BIAS_DEG_PER_HR + one.f_g @ SENSITIVITY.T)).max() < 80.0
    # Accelerations of half a step of 1.25 mg in each pose: some hundredths of a degree.
    assert np.abs(campaign.conditions.f_g[1:] - one.f_g[1:]).max() < 0.003


def test_bytes_of_another_unit_are_told(hil: Run, tmp_path: Path) -> None:
    """No frame is found, or the description has no accelerations: what to do stands with it."""
    path = tmp_path / "raw.bin"
    path.write_bytes(bytes(range(256)) * 40)
    refused(hil("import", "log", path, tmp_path / "unit", "--frames", "adis16470"), "finds no burst frame in it")
    refused(hil("import", "log", path, tmp_path / "unit", "--frames", "mfs"), "roles: a log needs one sensor of")
