"""Out of memory, out of descriptors, two faults at a time, devices that lie: never silent, and carried on to an end."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.reliability.combined import lies, pairs
from hil.config.simulation import CATALOGUE
from procedures.sweep_outcome import SweepState, state_after, why

_ROOT = Path(__file__).resolve().parents[3]


def test_out_of_memory_is_said_in_words() -> None:
    """What Python says of it is nothing."""
    assert why(MemoryError()) == "the computer is out of memory: end other programs, then carry on"
    assert state_after(MemoryError()) is SweepState.ERROR


def test_every_two_faults_and_every_lie_are_tried() -> None:
    """Of all that a bench without an operator can have."""
    kinds = sum(len(each) for device, each in CATALOGUE.items() if device != "operator")
    assert len(list(pairs())) == kinds * (kinds + 1) // 2
    assert {fault.at for (fault,) in lies()} >= {"identify", "T1/setpoint", "T1/S1/C3/collect", "safe-state"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        "starved memory --steps T1/S1/C2/collect",
        "starved descriptors --every 8",
        "combined lies --take 3",
        "combined pairs --take 3",
    ],
)
def test_what_breaks_things_finds_nothing(command: str) -> None:
    """A little of each; `make reliability` tries all."""
    name, *options = command.split()
    asked = [sys.executable, "-m", f"benchmarks.reliability.{name}", *options]
    found = json.loads(subprocess.run(asked, cwd=_ROOT, stdout=subprocess.PIPE, check=False).stdout)
    assert found["problems"] == []
    assert found["tried"] >= 3
