"""Nights on disks that are too small, read-only or rotten, and under a limit of the file size."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from benchmarks.reliability import nights
from benchmarks.reliability.kill import _in_fork
from hil.errors import InputError
from hil.night import resume_night, start_night
from hil.records.verify import verify_night

_ROOT = Path(__file__).resolve().parents[3]
_QUIET = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
_OWN_MOUNTS = ("unshare", "--map-root-user", "--mount")


def may_mount() -> bool:
    """Tell whether this system lets anybody have mounts of their own."""
    if shutil.which("unshare") is None or not Path("/bin/mount").exists():
        return False
    tried = subprocess.run(
        [*_OWN_MOUNTS, "/bin/mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True, check=False
    )
    return tried.returncode == 0


@pytest.mark.slow
@pytest.mark.timeout(120)
@pytest.mark.skipif(not may_mount(), reason="this system lets nobody have mounts of their own")
def test_a_disk_that_is_really_full_read_only_or_rotten_costs_nothing() -> None:
    """Full at many places: safe, said, undamaged, carried on. Read-only: readable. A rotten block: seen, done again."""
    command = [*_OWN_MOUNTS, sys.executable, "-m", "benchmarks.reliability.disks", "--every", "2"]
    ended = subprocess.run(command, cwd=_ROOT, env=_QUIET, stdout=subprocess.PIPE, check=False)
    found = json.loads(ended.stdout)
    assert found["problems"] == []
    assert len(found["ended_full_kB"]) >= 3


def _limited(night: Path, limit: int) -> list[str] | None:
    """Return how a night ends where no file may be larger; None where it cannot begin."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        outcome = start_night(night, nights.sweep(), nights.bench())
    except InputError:
        return None
    return [outcome.state, outcome.reason]


@pytest.mark.slow
def test_a_limit_of_the_file_size_ends_a_night_safely_and_it_can_be_carried_on(tmp_path: Path) -> None:
    """Where nothing can be mounted: the journal meets a limit that it just began under; without it all is complete."""
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[1] == resource.RLIM_INFINITY
    for limit in range(90_000, 130_000, 2_000):
        night = tmp_path / str(limit)
        ended = _in_fork(partial(_limited, night, limit))
        if ended:  # below, not even the plan has room, and no folder is left
            break
        assert not night.exists()
    assert ended[0] == "failed"
    assert "NOT SAFE" not in ended[1]
    assert [each for each in verify_night(night)["problems"] if not each.startswith("missing: ")] == []
    assert resume_night(night).state == "complete"
    assert verify_night(night)["problems"] == []
