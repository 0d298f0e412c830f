"""Nights whose own records contradict them: none is called PASS, and what is said names the cause."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.reliability.contradicted import BY_HAND, Case, cases
from benchmarks.reliability.contradictions import SAID, Yes, bench_of, clean, sweep_of, told_of
from hil.config import parse_sweep
from hil.night import start_night
from hil.records import open_readonly
from hil.records.rows import Attempt
from procedures.journal_protocol import Outcome
from procedures.verdict import Verdict

_CASES = {case.name: case for case in cases()}
_UNNAMED = {
    "sign of accelerometer A turned",  # a unit turned over would show the same at the collects that are taken
    "latitude wrong, collects at two headings",  # residuals alone
    "heading wrong, collects at two headings",
}
_ALIKE = "^by hand|^indexed"
_BUT = "by hand, 1, 2, 3: at [12] it lies as in 3|3, 2, 4: at 4 it lies as in 3|5, 6: at 6 it lies as in 5"
_QUICK = (
    "by hand, 1, 2, 3: at 3 it lies as in 1",
    "indexed, 1, 2, 3: at 3 it lies as in 2",
    "the clock jumps by two hours",
)


def check(case: Case, folder: Path) -> None:
    """Carry the case out: caught, and named unless nobody could."""
    told = told_of(case, folder / "night")
    assert told.verdict != Verdict.PASS, told.said
    if case.name not in _UNNAMED:
        assert re.search(case.words, told.said), told.said


@pytest.mark.slow
@pytest.mark.parametrize("name", _QUICK)
def test_a_night_that_contradicts_itself_is_no_pass(name: str, tmp_path: Path) -> None:
    """A few of the matrix; `benchmarks.reliability.contradictions` has all of it."""
    check(_CASES[name], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [each for each in _CASES if each not in _QUICK and (not re.search(_ALIKE, each) or re.search(_BUT, each))],
)
def test_every_contradiction_is_caught_and_named(name: str, tmp_path: Path) -> None:
    """Every case of the matrix, but only some of the pairs of positions; `make reliability` has all."""
    check(_CASES[name], tmp_path)


def by_hand(folder: Path, lasts: str, settle: str) -> tuple[str, list[Attempt], list[str]]:
    """Return state, attempts at collect 3 and questions of a night in which the unit is laid wrong for it at first."""
    fault = f"{{at: T1/S1/C3/index, device: operator, kind: wrong_position, duration: {lasts}}}"
    case = Case("", "", faults=(fault,), file=BY_HAND)
    sweep = parse_sweep(sweep_of(case).text.replace("settle: 60 s", f"settle: {settle}"), "sweep.yaml")
    outcome = start_night(folder, sweep, bench_of(case), terminal=Yes())
    with open_readonly(folder) as journal:
        asked = [event.message for event in journal.events() if event.kind == "prompt"]
        return outcome.state, [each for each in journal.attempts() if each.step_key == "T1/S1/C3/collect"], asked


@pytest.mark.slow
def test_an_operator_is_asked_again_with_the_reason_and_no_sample_is_taken_before(tmp_path: Path) -> None:
    """Laid wrong once: the first attempt has no samples, the second is good, and so is the night."""
    state, attempts, asked = by_hand(tmp_path / "n", "30 s", "60 s")
    assert state == "complete"
    assert [each.outcome for each in attempts] == [Outcome.FAILED, Outcome.DONE]
    assert "sensors" not in attempts[0].data
    assert attempts[1].data["verdict"] == "PASS"
    assert len(asked) == 4
    assert asked[3].startswith("Position 3 was asked for, but the unit lies as in position 5. Bring the unit to")


@pytest.mark.slow
def test_without_time_to_settle_the_collect_itself_is_contradicted(tmp_path: Path) -> None:
    """Nothing is looked at before; the means over the collect are."""
    _, attempts, _ = by_hand(tmp_path / "n", "10 min", "0 s")
    assert attempts[-1].data["verdict"] == "FAIL"
    assert "lies as in position 5" in attempts[-1].reason


@pytest.mark.slow
@pytest.mark.parametrize("nights", [1, 3])
def test_nothing_is_said_of_a_night_with_nothing_wrong(nights: int) -> None:
    """Of the shapes that the benchmark carries out by the thousand."""
    for told in clean(nights, seed=77):
        assert told.verdict == Verdict.PASS, told.said
        assert not re.search(SAID, told.said), told.said
