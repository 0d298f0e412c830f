"""A night that is killed at every place where it can be killed, at random instants, and by a power failure.

The nights run in a process of their own (`benchmarks.reliability.kill`), which forks one for every kill. What a
power failure leaves is quick, the nights are slow; `make reliability` has most of all.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks.reliability.mutations import MUTATIONS
from benchmarks.reliability.power import everything, renamed_before_safe, survivors
from benchmarks.reliability.tracing import Operation, traceable

_ROOT = Path(__file__).resolve().parents[3]
_QUIET = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}

pytestmark = [
    pytest.mark.skipif(not traceable(), reason="this system does not let a process trace its child"),
    pytest.mark.timeout(600),  # many nights in one test
]


def campaign(*arguments: str) -> dict[str, Any]:
    """Return what a campaign of kills found."""
    command = [sys.executable, "-m", "benchmarks.reliability.kill", *arguments]
    ended = subprocess.run(command, cwd=_ROOT, env=_QUIET, stdout=subprocess.PIPE, check=False)
    assert ended.returncode in (0, 1)
    return dict(json.loads(ended.stdout))


@pytest.mark.slow(seconds=11)
def test_a_night_killed_before_any_change_of_a_file_is_carried_on_as_if_nothing_had_happened() -> None:
    """SIGKILL before every 32nd call that changes a file (`make reliability`: all); each state is carried on."""
    found = campaign("points", "--only-new", "--part", "3/32")
    assert found["problems"] == []
    assert found["kills"] + found["outlived"] >= found["operations"] // 33 > 15
    assert found["outlived"] < found["operations"] // 50
    assert found["resumed"] > 0


@pytest.mark.slow
def test_a_resume_that_is_killed_as_well_is_carried_on_too() -> None:
    """Killed twice, at places that the seed draws."""
    found = campaign("twice", "--take", "6", "--seed", "3")
    assert found["problems"] == []
    assert found["kills"] + found["outlived"] == 6


@pytest.mark.slow
def test_a_night_killed_at_random_instants_is_carried_on() -> None:
    """By the wall clock, so in the middle of anything."""
    found = campaign("instants", "--take", "6", "--seed", "5")
    assert found["problems"] == []
    assert found["kills"] == 6


@pytest.mark.slow
def test_a_power_failure_loses_nothing_that_was_reported() -> None:
    """What was not synchronised is lost, torn or has its former name: what the log reported is there.

    Eight failures, of which the defects below need no more.
    """
    found = campaign("power", "--take", "8", "--seed", "1")
    assert found["problems"] == []
    assert found["kills"] == 8


DEFECTS = {
    "no-fsync": (("power", "--take", "1"), "before its bytes were synchronised"),
    "no-folder-fsync": (("power", "--take", "8", "--seed", "1"), "it was lost"),
    "rename-before-fsync": (("power", "--take", "1"), "before its bytes were synchronised"),
    "rename-after-commit": (("points", "--before", "rename"), "the block is missing"),
    "double-commit": (("power", "--take", "1"), "is done 2 times"),
    "head-before-commit": (("points", "--take", "30", "--seed", "1", "--only-new"), "the newest were lost"),
    "not-synchronous": (("power", "--take", "5", "--seed", "1"), "damaged|malformed|lost|journal"),
}


@pytest.mark.slow(seconds=10)
@pytest.mark.parametrize("mutation", list(DEFECTS))
def test_a_defect_on_purpose_is_found(mutation: str) -> None:
    """A removed fsync, a swapped rename, a double commit: the same campaign says that something was lost."""
    arguments, words = DEFECTS[mutation]
    problems = campaign(*arguments, "--mutation", mutation, "--until", words)["problems"]
    assert any(re.search(words, problem) for problem in problems), problems


def test_every_defect_is_tried() -> None:
    """No mutation without its test."""
    assert set(DEFECTS) == set(MUTATIONS) - {"none"}


_DURABLE = [
    Operation("create", ".partial-x", inode=1),
    Operation("write", ".partial-x", data=b"a" * 2000, inode=1),
    Operation("sync", ".partial-x", inode=1),
    Operation("rename", ".partial-x", target="x", inode=1),
    Operation("sync", ".", inode=0),
]


def states(operations: list[Operation]) -> set[tuple[tuple[str, bytes | None], ...]]:
    """Return the states that a power failure after `operations` may leave."""
    import random

    return {tuple(survivors(operations, random.Random(seed)).items()) for seed in range(60)}


def test_what_was_synchronised_survives_a_power_failure_and_nothing_else_is_sure() -> None:
    """The model of the disk: whole after both synchronisations; before them absent, torn, or under its old name."""
    whole = (("x", b"a" * 2000),)
    assert states(_DURABLE) == {whole}
    assert states(_DURABLE[:-1]) == {(), ((".partial-x", b"a" * 2000),), whole}
    torn = {dict(state).get(".partial-x") for state in states(_DURABLE[:2])}
    assert {None, b"", b"a" * 2000} < torn
    assert any(data and b"\0" in data for data in torn)
    assert everything(_DURABLE) == dict(whole)


def test_a_name_given_too_early_is_seen() -> None:
    """The order of synchronising and renaming, whether or not anything was lost."""
    assert list(renamed_before_safe(_DURABLE)) == []
    assert list(renamed_before_safe([_DURABLE[0], _DURABLE[1], _DURABLE[3]])) != []
