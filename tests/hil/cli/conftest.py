"""A short night on the simulated bench, made once, and the command line, in this process or in one of its own."""

from __future__ import annotations

import fcntl
import io
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from hil.cli.app import run

SHORT_SWEEP: dict[str, Any] = {
    "title": "Two temperatures",
    "temperatures": ["23 degC", "30 degC"],
    "self_calibrations_per_temperature": 2,
    "positions": [1, 2, 3],
    "restabilisation": {"at_least": "20 min", "ceiling": "4 h"},
    "collect": {"settle": "30 s", "duration": "60 s"},
}


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    returncode: int
    stdout: str
    stderr: str


Run = Callable[..., Ended]


@pytest.fixture(scope="session")
def hil() -> Run:
    """The command line in this process: arguments in, two outputs and an exit status out."""

    def carry_out(*arguments: object) -> Ended:
        out, err = io.StringIO(), io.StringIO()
        with redirect_stdout(out), redirect_stderr(err):
            status = run([str(each) for each in arguments])
        return Ended(status, out.getvalue(), err.getvalue())

    return carry_out


@pytest.fixture(scope="session")
def hil_process() -> Run:
    """The command line as a technician has it: a process."""

    def carry_out(*arguments: object) -> Ended:
        command = [sys.executable, "-m", "hil", *map(str, arguments)]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=150, check=False)
        return Ended(ended.returncode, ended.stdout, ended.stderr)

    return carry_out


@pytest.fixture(scope="session")
def short_sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep file with two temperatures close to each other."""
    path = tmp_path_factory.mktemp("sweep") / "two-temperatures.yaml"
    path.write_text(yaml.safe_dump(SHORT_SWEEP))
    return path


@pytest.fixture
def one_run(tmp_path: Path) -> Path:
    """A sweep file with one self-calibration."""
    path = tmp_path / "one.yaml"
    one = {**SHORT_SWEEP, "temperatures": ["23 degC"], "self_calibrations_per_temperature": 1}
    path.write_text(yaml.safe_dump(one))
    return path


@pytest.fixture(scope="session")
def night(hil: Run, short_sweep: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete short night. Tests must not change it."""
    folder = tmp_path_factory.mktemp("night") / "night"
    ended = hil("run", short_sweep, "--bench", "simulated", "--out", folder)
    assert ended.returncode == 0, ended.stderr
    return folder


@pytest.fixture(scope="session")
def demo(hil: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The published night as `hil demo` leaves it, made once for all workers. Tests must not change it."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "demo"
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "report.html").exists():  # written last
            ended = hil("demo", "--out", folder, "--quiet")
            assert ended.returncode == 0, ended.stderr
    return folder
