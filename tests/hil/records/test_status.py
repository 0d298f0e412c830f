"""Status is derived: from the journal, the lock and the age of the last sign of life."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from drivers.clock import SystemClock, VirtualClock
from hil.config import load_sweep
from hil.errors import InputError
from hil.files.lock import FolderLock
from hil.records import SqliteJournal
from hil.records.journal import JOURNAL_NAME
from hil.records.ledger import Ledger
from hil.records.status import STALE_AFTER_S, missing_in_words, night_status
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Plan, make_plan

Do = Callable[[SqliteJournal, object, VirtualClock], None]


def test_a_night_in_which_everything_was_done_is_complete(full_night: Path, plan: Plan) -> None:
    """Complete means that every planned step is DONE."""
    status = night_status(full_night)
    assert (status["schema"], status["state"]) == ("hil.status/1", "complete")
    assert status["steps_done"] == status["steps_total"] == len(plan.steps)
    assert (status["self_calibrations_done"], status["self_calibrations_total"]) == (2, 2)
    assert (status["missing"], status["eta_utc"], status["simulated"]) == ([], None, True)


def test_a_night_that_stopped_at_the_last_step_is_not_complete(
    new_night: Path, plan: Plan, clock: VirtualClock, do: Do
) -> None:
    """All but one step is not all: nobody is told that a night is complete which is not."""
    with SqliteJournal.open(new_night, clock=clock) as journal:
        for step in plan.steps[:-1]:
            do(journal, step, clock)
        journal.finish("complete: or so somebody says")
    status = night_status(new_night)
    assert status["state"] == "incomplete"
    assert status["missing"] == ["the last step, which brings the chamber to its safe state"]


def test_while_a_controller_is_at_work_the_night_is_running(
    journal: SqliteJournal, plan: Plan, clock: VirtualClock, do: Do
) -> None:
    """The present step, and when the rest will be done if it takes as long as planned."""
    for step in plan.steps[:3]:
        do(journal, step, clock)
    journal.begin(plan.steps[3])
    clock.sleep(1.0)
    journal.heartbeat(plan.steps[3], {"chamber_degC": 20.5})
    status = night_status(journal.folder)
    assert (status["state"], status["step"]) == ("running", plan.steps[3].key)
    assert status["readings"] == {"chamber_degC": 20.5}
    rest_s = sum(step.duration_s for step in plan.steps[3:]) - 1.0
    expected = clock.utc() + timedelta(seconds=rest_s)
    assert abs(datetime.fromisoformat(status["eta_utc"]) - expected) < timedelta(seconds=1)


def test_a_pause_is_seen_and_ends(journal: SqliteJournal) -> None:
    """The newest of pause and continue counts."""
    journal.event("pause", "rk looks at the cable")
    assert night_status(journal.folder)["state"] == "paused"
    journal.event("continue", "rk is done")
    assert night_status(journal.folder)["state"] == "running"


def test_a_controller_that_is_there_but_silent_is_not_running(journal: SqliteJournal) -> None:
    """A process that hangs holds its lock, but it has written nothing for too long."""
    journal.event("note", "the last thing it said")
    long_ago = SystemClock().utc() - timedelta(seconds=STALE_AFTER_S + 10.0)
    other = sqlite3.connect(journal.folder / JOURNAL_NAME, isolation_level=None)
    with Ledger(other, journal.folder).transaction():
        other.execute("UPDATE controllers SET seen_utc = ?", (long_ago.isoformat(),))
    other.close()
    status = night_status(journal.folder)
    assert status["state"] == "incomplete"
    assert "has written nothing for 3 min" in status["reason"]


@pytest.mark.parametrize(
    ("ending", "state", "reason"),
    [
        ("aborted: stopped by SIGTERM", "aborted", "stopped by SIGTERM"),
        ("failed: chamber-lost: no answer", "failed", "chamber-lost: no answer"),
        ("incomplete: 3 steps are missing", "incomplete", "3 steps are missing"),
    ],
)
def test_how_the_last_controller_ended_is_the_state_of_an_unfinished_night(
    new_night: Path, clock: VirtualClock, ending: str, state: str, reason: str
) -> None:
    """Aborted and failed nights say so, with the reason."""
    with SqliteJournal.open(new_night, clock=clock) as journal:
        journal.finish(ending)
    status = night_status(new_night)
    assert (status["state"], status["reason"]) == (state, reason)


def test_a_watchdog_at_work_is_no_running_night(new_night: Path, clock: VirtualClock) -> None:
    """The controller failed and left its chamber unsafe; its watchdog holds the folder: failed, and not safe."""
    with SqliteJournal.open(new_night, clock=clock) as journal:
        journal.event("safe-state-not-reached", "the chamber does not answer")
        journal.finish("failed: chamber-lost: no answer")
    with FolderLock(new_night).acquire():
        status = night_status(new_night)
    assert status["state"] == "failed"
    assert status["reason"].startswith("chamber-lost: no answer; ")
    assert "is at work here" in status["reason"]
    assert status["problems"] == ["THE CHAMBER IS NOT SAFE: the chamber does not answer"]
    assert status["eta_utc"] is None


def test_a_night_that_nobody_began_is_incomplete(new_night: Path, plan: Plan) -> None:
    """A plan alone: all of it is missing."""
    status = night_status(new_night)
    assert (status["state"], status["steps_done"]) == ("incomplete", 0)
    assert "self-calibration 2 at 20.0 °C: all of it" in status["missing"]
    there_and_back = missing_in_words(make_plan(load_sweep("triad-six-positions").procedure()), {})
    assert [line for line in there_and_back if "setpoint 23.0 °C" in line] == ["setpoint 23.0 °C"]


def test_what_is_missing_comes_with_the_reason_of_its_last_attempt(
    journal: SqliteJournal, plan: Plan, clock: VirtualClock, do: Do
) -> None:
    """A soak that never settled is named as such."""
    for step in plan.steps[:2]:
        do(journal, step, clock)
    soak = plan.steps[2]
    journal.end((soak, *journal.begin(soak), StepResult(Outcome.TIMEOUT, "the unit still drifted after 4 h")))
    (first, *_) = night_status(journal.folder)["missing"]
    assert first.startswith(
        "self-calibration 1 at 20.0 °C: restabilisation (timeout: the unit still drifted after 4 h)"
    )


def test_a_folder_without_a_night_is_bad_input(tmp_path: Path) -> None:
    """There is nothing to have a status."""
    with pytest.raises(InputError, match="holds no night"):
        night_status(tmp_path)
