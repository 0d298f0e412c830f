"""Whoever is killed while an archive takes something up leaves an entry, or none."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hil.archive.folder import read_entry, take_up
from hil.archive.places import found
from hil.archive.taking_in import update

_KILLED = """
import os, signal, sys
from pathlib import Path
from hil.archive.folder import take_up
from hil.files.durable import RealDisk
left = [0]
for name in ("write", "rename", "synchronise_folder"):
    def counted(self, *given, own=getattr(RealDisk, name)):
        left[0] -= 1
        if not left[0]:
            os.kill(os.getpid(), signal.SIGKILL)
        own(self, *given)
    setattr(RealDisk, name, counted)
for place in range(1, 60):
    left[0] = place
    child = os.fork()
    if not child:
        take_up(Path(sys.argv[1], str(place)), Path(sys.argv[2]))
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    print(code, flush=True)
    if code != -signal.SIGKILL:
        break
"""


@pytest.mark.slow
def test_whoever_is_killed_while_taking_up_leaves_an_entry_or_none(campaigns: list[Path], tmp_path: Path) -> None:
    """At every write, rename and synchronisation; the next one takes it up, and the index has it once."""
    command = [sys.executable, "-c", _KILLED, tmp_path, campaigns[0]]
    *killed, last = subprocess.run(command, check=True, capture_output=True).stdout.split()
    assert last == b"0", "it was never finished"
    assert len(killed) >= 5
    for place in range(1, len(killed) + 2):
        archive = tmp_path / f"{place}"
        there = found(archive)[0] if archive.is_dir() else []
        for name in there:
            read_entry(archive, name)
        take_up(archive, campaigns[0])
        done = update(archive)
        assert (len(done["read"]), done["cannot_be_read"]) == (1, {})
        assert found(archive)[0] == done["read"]
