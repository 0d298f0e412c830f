"""What is wrong with a night stands first in its status, with since when; what is over says since when it has been."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.clock import VirtualClock
from hil.records import SqliteJournal
from hil.records.live import LiveFiles
from hil.records.status import night_status
from hil.records.troubles import to_do
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Plan, StepKind
from procedures.progress import Snapshot
from tests.hil.records.conftest import carry_out

LOST = "chamber-lost: the chamber does not answer: timeout (ends the sweep after 120 s)"


@pytest.fixture
def journal(new_night: Path, clock: VirtualClock) -> Any:
    """The journal of a night at work."""
    with SqliteJournal.open(new_night, clock=clock, who="rk") as opened:
        yield opened


def test_a_loss_stands_until_it_is_over_and_then_says_since_when(journal: SqliteJournal, clock: VirtualClock) -> None:
    """A lost chamber is a problem with its reason and how long; once it answers again it is none."""
    clock.sleep(600.0)
    journal.event("interlock-suspected", LOST)
    clock.sleep(90.0)
    journal.event("hold", "holding: chamber-lost")
    (problem,) = night_status(journal.folder)["problems"]
    since = f"{journal.night.utc(600.0):%H:%M:%S} UTC"
    assert problem.startswith("the chamber does not answer: timeout (ends the sweep after 120 s); ")
    assert problem.endswith(f"since {since}, 90 s ago")
    clock.sleep(10.0)
    journal.event("interlock-cleared", "chamber-lost cleared after 100 s")
    status = night_status(journal.folder)
    assert status["problems"] == []
    (over,) = status["over"]
    assert f"over since {journal.night.utc(700.0):%H:%M:%S} UTC" in over
    journal.event("interlock-cleared", "chamber-lost cleared after 100 s")  # twice, or of an earlier controller
    assert night_status(journal.folder)["over"] == [over]


def test_a_chamber_that_is_not_safe_yet_comes_before_anything_else(journal: SqliteJournal, plan: Plan) -> None:
    """While the safe state is tried for, nobody is told that the night is merely running."""
    journal.begin(plan.steps[0])
    journal.event("interlock-suspected", LOST)
    journal.event("retry", f"{plan.steps[0].key}: no answer; 2 more tries", step=plan.steps[0].key)
    journal.event("safe-state-retry", "the chamber could not be brought to its safe state: timeout; chamber-lost")
    first, second, third = night_status(journal.folder)["problems"]
    assert first.startswith("THE CHAMBER IS NOT SAFE YET")
    assert "go to it" in first
    assert second.startswith("the chamber does not answer")
    assert third.startswith("trying again since")
    journal.event("safe-state", "the chamber is in its safe state")
    assert night_status(journal.folder)["problems"] == []


def test_a_step_that_was_tried_again_is_a_problem_until_it_is_done(
    journal: SqliteJournal, plan: Plan, clock: VirtualClock
) -> None:
    """Trying again is told while it is not known whether it helps."""
    key = plan.steps[0].key
    journal.event("retry", f"{key}: no answer; 2 more tries", step=key)
    (attempt,) = journal.begin(plan.steps[0])
    assert "2 more tries" in night_status(journal.folder)["problems"][0]
    journal.end((plan.steps[0], attempt, StepResult(Outcome.DONE, "answered")))
    assert night_status(journal.folder)["problems"] == []


def test_a_disk_without_room_for_the_rest_is_told_before_it_is_full(
    journal: SqliteJournal, plan: Plan, clock: VirtualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what the collects took so far; a disk with room says nothing, and neither does a night that has ended."""
    collects = plan.of_kind(StepKind.COLLECT)
    for step in plan.steps[: plan.steps.index(collects[1])]:
        carry_out(journal, step, clock)
    taken = sum(row.block.size for row in journal.blocks())
    for free, problems in ((20e6 + 0.9 * taken, 1), (20e6 + 50 * taken, 0)):
        monkeypatch.setattr(shutil, "disk_usage", lambda _, free=free: SimpleNamespace(free=free))
        assert len(night_status(journal.folder)["problems"]) == problems


def test_every_reading_has_its_age_and_a_chamber_that_is_silent_an_old_one(
    journal: SqliteJournal, plan: Plan, clock: VirtualClock
) -> None:
    """The state on disk is fresh; what it says of the chamber is a minute old, of the unit it is not."""
    journal.begin(plan.steps[1])
    journal.heartbeat(plan.steps[1], {"chamber_degC": 18.0, "case_degC": 21.0})
    files = LiveFiles(journal.folder, {}, every_s=0.0)
    unit, rates = {2: 20.5}, {"2.RA": -3.25}
    files.update(Snapshot(plan.steps[1], 1, 20.0, 10.0, 50.0, clock.utc(), 19.5, 20.0, unit, rates, chamber_age_s=61.0))
    files.close()
    status = night_status(journal.folder)
    assert status["readings"] == {"chamber_degC": 19.5, "setpoint_degC": 20.0, "unit_2_degC": 20.5, "case_degC": 21.0}
    assert status["rates_deg_per_hr"] == rates
    ages = status["ages_s"]
    assert ages.keys() == status["readings"].keys() | rates.keys()
    assert ages["chamber_degC"] - ages["unit_2_degC"] == pytest.approx(61.0, abs=0.1)
    assert 0.0 <= ages["2.RA"] < 60.0


def test_a_controller_that_was_killed_leaves_a_chamber_that_nobody_looks_after(journal: SqliteJournal) -> None:
    """Its status says so, and what to do."""
    journal._lock.release()
    status = night_status(journal.folder)
    assert status["killed"] is True
    assert status["problems"][0].startswith("THE CHAMBER MAY STILL BE CONDITIONING")
    assert status["chamber_in_words"] == status["problems"][0]
    assert to_do(journal.folder, status | {"verdict": None}).startswith(f"hil watchdog {journal.folder} brings it to")


# What stands of a night, and what is to be done: words that must be in it, and words that must not.
STANDING = [
    ({}, "nothing; hil report n", "resume"),
    (
        {"verdict": {"verdict": "FAIL"}},
        "hil report n names them, why, and what to do",
        "nothing",
    ),
    ({"verdict": {"verdict": "INCONCLUSIVE"}}, "measure again", "nothing"),
    ({"verdict": {"verdict": "MARGINAL"}}, "read the reasons", "nothing"),
    ({"verdict": None}, "hil report n judges it", "nothing"),
    ({"state": "aborted", "steps_done": 6}, "hil resume n carries on: 4 steps left", "mend"),
    ({"state": "failed", "steps_done": 9}, "mend what ended it; then hil resume n carries on: 1 step left", "chamber"),
    ({"state": "failed", "chamber": "NOT KNOWN", "steps_done": 9}, "go to the chamber and stop it there; then", "mend"),
    ({"state": "incomplete", "verdict": {"verdict": "ERROR"}}, "measures again what rests on the damage", "nothing"),
    ({"state": "incomplete", "reason": "ERROR: row 3"}, "use no number of it: hil repair n --out NEW", "resume"),
    ({"state": "incomplete", "working": True}, "wait until the chamber has been made safe", "resume"),
    (
        {"state": "incomplete", "killed": True, "chamber": None},
        "hil watchdog n brings it to its safe state, hil resume n",
        "report",
    ),
    ({"state": "incomplete", "killed": True}, "hil resume n carries on", "watchdog"),
    ({"state": "running", "working": True}, "nothing", "see to it"),
    ({"state": "running", "working": True, "problems": ["lost"]}, "see to it; the controller tries on", "nothing"),
    ({"state": "running", "prompt": {"wants_words": True}}, "answer it: hil confirm n --text …, or --no", "nothing"),
    ({"state": "paused", "working": True}, "hil continue n carries on", "nothing"),
]


@pytest.mark.parametrize(("standing", "said", "never"), STANDING, ids=str)
def test_whoever_asks_how_it_stands_is_told_what_to_do(standing: dict[str, Any], said: str, never: str) -> None:
    """Every state has its sentence, with the command that works there."""
    status = {"state": "complete", "reason": "", "verdict": {"verdict": "PASS"}, "steps_done": 10, "steps_total": 10}
    status |= {"prompt": None, "working": False, "killed": False, "chamber": "SAFE", "problems": [], "old": ""}
    told = to_do(Path("n"), status | standing)
    assert said in told
    assert never not in told


@pytest.mark.parametrize(
    "standing", [{}, {"state": "incomplete", "killed": True, "chamber": None}, {"state": "paused"}], ids=str
)
def test_what_is_to_be_typed_can_be_typed_as_it_stands(standing: dict[str, Any]) -> None:
    """A folder whose name has a space is one word of the command."""
    status = {"state": "complete", "reason": "", "verdict": {"verdict": "PASS"}, "steps_done": 10, "steps_total": 10}
    status |= {"prompt": None, "working": False, "killed": False, "chamber": "SAFE", "problems": [], "old": ""}
    assert "'my night'" in to_do(Path("my night"), status | standing)
