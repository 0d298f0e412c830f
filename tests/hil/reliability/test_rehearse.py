"""Rehearsed nights: what is survived, and that a night which is not survived is called so."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from benchmarks.reliability.rehearsal import Witness, begun, rehearse, wrong_end, wrong_records
from benchmarks.reliability.rehearse import bench, sweep
from hil.config import load_bench, load_sweep
from hil.config.simulation import Fault
from hil.errors import InputError
from hil.night import start_night
from hil.records.status import night_status
from procedures.stop import StopRequest

_ROOT = Path(__file__).resolve().parents[3]
_QUIET = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}


def told(*arguments: object) -> tuple[int, dict[str, Any]]:
    """Return exit status and document of a program that prints one."""
    command = [sys.executable, "-m", *map(str, arguments)]
    ended = subprocess.run(command, cwd=_ROOT, env=_QUIET, stdout=subprocess.PIPE, check=False, timeout=280)
    return ended.returncode, dict(json.loads(ended.stdout))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_nights_of_random_faults_are_survived() -> None:
    """Complete, or incomplete for a true reason with a safe chamber; sound records; no wrong number called PASS."""
    status, found = told("benchmarks.reliability.rehearse", "--nights", 3, "--seed", 40)
    assert found["wrong"] == {}
    assert (status, found["nights"], found["survived"], found["safe_at_the_end"]) == (0, 3, 3, 3)
    assert found["faults"] >= 3
    assert found["self_calibrations"]["PASS"] > 0


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_night_that_is_not_survived_is_called_so(tmp_path: Path) -> None:
    """A chamber that is deaf for ever and has no timer of its own cannot be made safe: that is said, status 1."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["faults"] = [{"at": "T1/S1/restabilise", "device": "chamber", "kind": "silence"}]
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(document))
    kept = tmp_path / "kept"
    options = ("--nights", 1, "--faults", 0, 0, "--seed", 7, "--keep", kept)
    status, found = told("benchmarks.reliability.rehearse", "--sweep", "quick", "--bench", path, *options)
    assert (status, found["nights"], found["survived"], found["faults"]) == (1, 1, 0, 1)
    assert found["wrong"] == {"the chamber is not in its safe state": 1}
    assert found["reasons"] == {"chamber-lost": 1}
    ended = night_status(kept / "night-7" / "night")
    assert ended["state"] == "failed"
    assert "NOT KNOWN" in ended["reason"]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_killed_controller_is_carried_on(tmp_path: Path) -> None:
    """The night becomes complete; the fault that killed it does not come back."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["faults"] = [{"at": "T1/S1/C2/collect", "device": "controller", "kind": "killed"}]
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(document))
    options = ("--sweep", "quick", "--bench", path, "--nights", 1, "--faults", 0, 0)
    status, found = told("benchmarks.reliability.rehearse", *options)
    assert (status, found["states"], found["killed_and_carried_on"], found["survived"]) == (0, {"complete": 1}, 1, 1)


def test_a_real_bench_is_not_rehearsed(tmp_path: Path) -> None:
    """Nobody wants these faults on hardware."""
    with pytest.raises(InputError, match="simulated in process"):
        next(rehearse(load_sweep("quick"), load_bench("simulated-pty"), nights=1, seed=1, folder=tmp_path))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("state", "reason", "device", "kind", "true"),
    [
        ("failed", "chamber-alarm: the chamber reports 19", "chamber", "alarm", True),
        ("failed", "chamber-alarm: the chamber reports 19", "imu", "silence", False),
        ("failed", "stream-lost: no good frame", "imu", "unplugged", True),
        ("failed", "stream-lost: no good frame", "controller", "killed", False),
        ("failed", "the disk is full (No space left)", "disk", "full", True),
        ("failed", "ZeroDivisionError: float division", "chamber", "alarm", False),
        ("complete", "every step is done", "chamber", "alarm", True),
    ],
)
def test_a_reason_is_true_only_where_a_fault_explains_it(
    state: str, reason: str, device: str, kind: str, true: bool
) -> None:
    """What ended a night must have been done to it."""
    fault = Fault.model_validate({"at": "1 s", "device": device, "kind": kind})
    wrong = wrong_end({"state": state, "reason": reason, "safe": True}, [fault])
    assert (wrong == []) == true
    assert wrong_end({"state": state, "reason": reason, "safe": False}, [fault]) != []


def test_a_fault_that_had_not_begun_explains_nothing(tmp_path: Path) -> None:
    """Neither one of a later hour nor one of a step that was never reached."""
    stop = StopRequest()
    stop.request("at once")
    start_night(tmp_path / "night", load_sweep("quick"), load_bench("simulated"), stop=stop)
    faults = [
        Fault.model_validate({"at": at, "device": "chamber", "kind": "alarm"})
        for at in ("0 s", "1 h", "T1/S1/C1/collect")
    ]
    assert begun(tmp_path / "night", faults) == faults[:1]


@pytest.mark.slow
def test_a_wrong_number_called_pass_is_found(tmp_path: Path) -> None:
    """The same night beside a truth that is ten standard errors away."""
    witness = Witness(tmp_path)
    start_night(tmp_path / "night", sweep(), bench(), onlookers=[witness], opened=witness.look_at)
    wrong, verdicts = wrong_records(tmp_path / "night", "complete")
    assert wrong == []
    assert verdicts["PASS"] == 2
    lines = [json.loads(line) for line in (tmp_path / "truth.jsonl").read_text().splitlines()]
    for line in lines:
        line["parameters"]["BA"] += 20.0
    (tmp_path / "truth.jsonl").write_text("\n".join(map(json.dumps, lines)))
    wrong, _ = wrong_records(tmp_path / "night", "complete")
    assert len(wrong) == 4
    assert all("is called PASS, but BA of sensor" in each for each in wrong)
    shutil.rmtree(tmp_path / "night" / "blocks")
    assert any("missing" in each for each in wrong_records(tmp_path / "night", "complete")[0])


@pytest.mark.timeout(300)
@pytest.mark.slow
def test_a_long_night_needs_no_more_memory_than_a_short_one() -> None:
    """From its third tenth on memory stands still; the status of it is quick; what is kept is its collects."""
    _, found = told("benchmarks.reliability.long_night", "--hours", 2.5, "--rate", 100)
    assert found["state"] == "complete"
    assert found["verify_complete"]
    assert found["rss_at_end_mb"] < 300.0
    assert found["rss_mb"][-1] - found["rss_mb"][2] < 15.0
    assert found["status_s"] < 0.5
    assert found["disk_per_collect_mb"] < 1.0
