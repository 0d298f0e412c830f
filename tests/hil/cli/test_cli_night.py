"""A night from the command line: what it writes, what it says, and with which status it ends."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

SELF_CALIBRATIONS = 4
STEPS_PER_SELF_CALIBRATION = 7  # restabilise, and index and collect at three positions


def test_a_complete_night_says_so_everywhere(hil: Any, night: Path) -> None:
    """Status, verify and exit statuses of a complete night agree, in the contract's keys."""
    status = hil("status", night, "--json")
    told = json.loads(status.stdout)
    assert status.returncode == 0
    assert told["schema"] == "hil.status/1"
    assert told["state"] == "complete"
    assert told["steps_done"] == told["steps_total"]
    assert told["self_calibrations_done"] == told["self_calibrations_total"] == SELF_CALIBRATIONS
    assert told["missing"] == []
    assert told["simulated"] is True
    verified = hil("verify", night, "--json")
    found = json.loads(verified.stdout)
    assert verified.returncode == 0
    assert found["complete"] is True
    assert found["problems"] == []
    assert found["blocks_checked"] >= 3 * SELF_CALIBRATIONS


def test_plan_and_run_have_the_same_steps(hil: Any, short_sweep: Path, night: Path) -> None:
    """The dry run lists exactly the steps that the run carried out."""
    plan = json.loads(hil("plan", short_sweep, "--bench", "simulated", "--json").stdout)
    assert plan["schema"] == "hil.plan/1"
    assert len(plan["steps"]) == json.loads(hil("status", night, "--json").stdout)["steps_total"]
    assert sum(step["kind"] == "collect" for step in plan["steps"]) == 3 * SELF_CALIBRATIONS
    last = plan["steps"][-1]
    assert plan["total_s"] == pytest.approx(last["starts_s"] + last["duration_s"])


@pytest.mark.slow
def test_progress_is_on_standard_error_only(hil_process: Any, hil: Any, short_sweep: Path, tmp_path: Path) -> None:
    """A run that nobody watches on a terminal leaves plain lines on standard error and nothing on standard output."""
    sweep = yaml.safe_load(short_sweep.read_text())
    sweep.update({"temperatures": ["23 degC"], "self_calibrations_per_temperature": 1})
    one = tmp_path / "one.yaml"
    one.write_text(yaml.safe_dump(sweep))
    ended = hil_process("run", one, "--bench", "simulated", "--out", tmp_path / "night")
    assert ended.returncode == 0
    assert ended.stdout == ""
    assert "Collect 3 at 23.0 °C: done" in ended.stderr
    assert "\x1b" not in ended.stderr
    silent = hil("run", one, "--bench", "simulated", "--out", tmp_path / "silent", "--quiet")
    assert "Collect" not in silent.stderr


def test_a_campaign_folder_and_its_night_solve_alike(hil: Any, night: Path, tmp_path: Path) -> None:
    """`hil solve` works from the exported folder alone and gives what it gives on the night."""
    assert hil("export", night, tmp_path / "campaign").returncode == 0
    from_night = json.loads(hil("solve", night, "--json").stdout)
    from_folder = json.loads(hil("solve", tmp_path / "campaign", "--json").stdout)
    assert len(from_folder["solutions"]) == 2 * SELF_CALIBRATIONS
    assert from_folder["simulated"] is True
    for ours, theirs in zip(from_night["solutions"], from_folder["solutions"], strict=True):
        assert set(theirs["parameters"]) == {"BA", "BB", "GSA", "GSB", "MUA", "MUB"}
        for name, estimate in theirs["parameters"].items():
            assert estimate["value"] == pytest.approx(ours["parameters"][name]["value"], abs=1e-3)
            assert estimate["se"] == pytest.approx(ours["parameters"][name]["se"], rel=1e-3)
        assert theirs["degrees_of_freedom"] == 0
        assert theirs["residual_rms_deg_per_hr"] is None
        assert theirs["condition_number"] == pytest.approx(1 + 2**0.5, rel=1e-3)


def test_a_night_is_not_overwritten(hil: Any, short_sweep: Path, night: Path) -> None:
    """A folder that is there already is refused and stays as it was."""
    before = sorted(path.name for path in night.iterdir())
    ended = hil("run", short_sweep, "--bench", "simulated", "--out", night)
    assert ended.returncode == 2
    assert str(night) in ended.stderr
    assert sorted(path.name for path in night.iterdir()) == before


def test_a_damaged_night_is_found_out(hil: Any, night: Path, tmp_path: Path) -> None:
    """One flipped byte in one block: verify and status name it and end with status 4; nobody says PASS over it."""
    assert json.loads(hil("status", night, "--json").stdout)["verdict"]["verdict"] == "PASS"
    copy = tmp_path / "copy"
    shutil.copytree(night, copy)
    block = sorted((copy / "blocks").rglob("*.parquet"))[0]
    data = bytearray(block.read_bytes())
    data[len(data) // 2] ^= 0x01
    block.write_bytes(data)
    ended = hil("verify", copy, "--json")
    assert ended.returncode == 4
    assert any(block.name in problem for problem in json.loads(ended.stdout)["problems"])
    ended = hil("status", copy, "--json")
    assert ended.returncode == 4
    verdict = json.loads(ended.stdout)["verdict"]
    assert verdict["verdict"] == "ERROR"
    assert block.name in verdict["reason"]


def test_resuming_a_complete_night_changes_nothing(hil: Any, night: Path) -> None:
    """There is nothing to carry on with: status 0, and it says so."""
    ended = hil("resume", night)
    assert ended.returncode == 0
    assert "complete" in ended.stderr


def test_a_running_night_is_said_to_have_work_to_do_and_a_stopped_one_why(
    hil: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is missing yet while it runs; the finishing time is one that people read; a stop has its reason."""
    told: dict[str, Any] = {
        "schema": "hil.status/1",
        "state": "running",
        "reason": "",
        "simulated": False,
        "steps_done": 1,
        "steps_total": 9,
        "self_calibrations_done": 0,
        "self_calibrations_total": 1,
        "eta_utc": "2026-03-01T05:59:43.559+00:00",
        "missing": ["self-calibration 1 at 23.0 °C: all of it"],
        "problems": [],
        "over": [],
        "old": "",
        "prompt": None,
        "paused": None,
        "verdict": None,
        "in_spec": None,
        "identity": {"serial": "014"},
        "step_in_words": "soaking",
        "chamber_in_words": "",
        "to_do": "nothing",
    }
    monkeypatch.setattr("hil.cli.watch.look_at", lambda _folder: (told, None))
    running = hil("status", tmp_path)
    assert running.returncode == 0
    assert (
        "now: soaking\nexpected end 2026-03-01 05:59 UTC\nserial: 014\nstill to come: self-calibration 1"
        in running.stdout
    )
    safe = "THE CHAMBER IS SAFE: the air is at 23.0 °C"
    told |= {"state": "aborted", "reason": "stopped by SIGTERM", "eta_utc": None, "chamber_in_words": safe}
    told["to_do"] = "hil resume carries on"
    stopped = hil("status", tmp_path)
    assert stopped.returncode == 4
    first = f"{tmp_path}: aborted\nto do: hil resume carries on\n{safe}\naborted: stopped by SIGTERM\n"
    assert stopped.stdout.startswith(first)
    assert "missing: self-calibration 1" in stopped.stdout


def test_too_few_positions_are_said_before_the_night(hil: Any, tmp_path: Path, short_sweep: Path) -> None:
    """Two different positions cannot support bias, GS and MU: a warning, before anything is spent."""
    sweep = yaml.safe_load(short_sweep.read_text()) | {"positions": [1, 1, 3]}
    path = tmp_path / "two.yaml"
    path.write_text(yaml.safe_dump(sweep))
    ended = hil("plan", path, "--bench", "simulated")
    assert ended.returncode == 0
    assert "2 different positions" in ended.stderr
    assert "warning" not in hil("plan", short_sweep, "--bench", "simulated").stderr
