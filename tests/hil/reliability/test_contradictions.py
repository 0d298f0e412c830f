"""Nights whose own records contradict them: none is called PASS, and what is said names the cause."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.reliability.contradictions import Case, cases, clean, told_of
from procedures.verdict import Verdict

_CASES = {case.name: case for case in cases()}
_UNNAMED = {"sign of accelerometer A turned"}  # a unit turned over would show the same at the collects that are taken
_QUICK = (
    "by hand, collect 3 of 1, 2, 3: laid wrong",
    "indexed, collect 3 of 1, 2, 3: not turned",
    "accelerometers in m/s²",
    "rates in rad/s",
    "RA a copy of RB",
    "RA spikes in 0.1 % of the samples",
)


def check(case: Case, folder: Path) -> None:
    """Carry the case out: caught, and named unless nobody could."""
    told = told_of(case, folder / "night")
    assert told.verdict != Verdict.PASS, told.said
    if case.name not in _UNNAMED:
        assert re.search(case.words, told.said), told.said


@pytest.mark.parametrize("name", _QUICK)
def test_a_night_that_contradicts_itself_is_no_pass(name: str, tmp_path: Path) -> None:
    """A few of the matrix; `benchmarks.reliability.contradictions` has all of it."""
    check(_CASES[name], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(_CASES.keys() - set(_QUICK)))
def test_every_contradiction_is_caught_and_named(name: str, tmp_path: Path) -> None:
    """Every case of the matrix."""
    check(_CASES[name], tmp_path)


def test_nothing_is_said_of_a_night_with_nothing_wrong() -> None:
    """Three of the shapes that the benchmark carries out by the thousand."""
    for told in clean(3, seed=77):
        assert told.verdict == Verdict.PASS, told.said
        assert "position" not in told.said
