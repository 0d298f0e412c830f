"""The journal: durable, without duplicates, readable while it is written."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import VirtualClock
from hil.errors import InputError
from hil.records import SqliteJournal, open_readonly
from hil.records import schema as journal_schema
from hil.records.journal import JOURNAL_NAME
from hil.records.ledger import read_head
from hil.records.rows import Night, to_json
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Plan, Step, StepKind

Do = Callable[[SqliteJournal, Step, VirtualClock], None]


def test_plan_and_night_come_back_as_they_were_given(journal: SqliteJournal, plan: Plan, clock: VirtualClock) -> None:
    """What was decided before the first step is in the journal, to the last digit."""
    assert journal.plan == plan
    assert journal.night.configuration == "bench: test"
    assert (journal.night.who, journal.night.seed, journal.night.simulated) == ("rk", 7, True)
    assert journal.night.began_utc == clock.utc()


def test_only_done_steps_are_completed(journal: SqliteJournal, plan: Plan) -> None:
    """A step that failed, or never ended, does not count as completed."""
    first, second, third = plan.steps[:3]
    journal.end((first, *journal.begin(first), StepResult(Outcome.DONE, "seen", {"model": "MFS"})))
    journal.end((second, *journal.begin(second), StepResult(Outcome.TIMEOUT, "never in band")))
    journal.begin(third)
    assert journal.completed() == {first.key: StepResult(Outcome.DONE, "seen", {"model": "MFS"})}
    assert [(each.step_key, each.outcome) for each in journal.attempts()] == [
        (first.key, Outcome.DONE),
        (second.key, Outcome.TIMEOUT),
        (third.key, None),
    ]


def test_attempts_are_counted_from_one_across_a_resume(new_night: Path, plan: Plan, clock: VirtualClock) -> None:
    """An attempt that was cut off stays visible, and the next one has the next number."""
    with SqliteJournal.open(new_night, clock=clock) as journal:
        assert journal.begin(plan.steps[0]) == [1]
    with SqliteJournal.open(new_night, clock=clock) as journal:
        assert journal.begin(plan.steps[0]) == [2]
        assert [each.outcome for each in journal.attempts()] == [None, None]


def test_a_step_that_is_done_cannot_begin_again(journal: SqliteJournal, plan: Plan) -> None:
    """There is at most one DONE per step."""
    step = plan.steps[0]
    journal.end((step, *journal.begin(step), StepResult(Outcome.DONE)))
    with pytest.raises(ValueError, match="is done"):
        journal.begin(step)


def test_an_attempt_ends_once(journal: SqliteJournal, plan: Plan) -> None:
    """A second result of the same attempt is refused, and the first one stays."""
    step = plan.steps[0]
    (attempt,) = journal.begin(step)
    journal.end((step, attempt, StepResult(Outcome.FAILED, "first")))
    with pytest.raises(ValueError, match="not going on"):
        journal.end((step, attempt, StepResult(Outcome.DONE, "second")))
    with pytest.raises(ValueError, match="not going on"):
        journal.end((step, attempt + 1, StepResult(Outcome.DONE, "never began")))
    assert [(each.outcome, each.reason) for each in journal.attempts()] == [(Outcome.FAILED, "first")]


def test_what_ends_together_is_committed_at_once_or_not_at_all(
    journal: SqliteJournal, plan: Plan, new_night: Path
) -> None:
    """One entry of the ledger for all that begin, one for all that end; where one cannot end, none has."""

    def entries() -> int:
        head = read_head(new_night)
        assert head is not None
        return head[0]

    first, second = plan.steps[:2]
    before = entries()
    assert journal.begin(first, second) == [1, 1]
    assert entries() == before + 1
    done = StepResult(Outcome.DONE)
    with pytest.raises(ValueError, match=r"attempt 2 of step .* is not going on"):
        journal.end((first, 1, done), (second, 2, done))
    assert not journal.completed()
    journal.end((first, 1, done), (second, 1, done))
    assert entries() == before + 2
    assert [*journal.completed()] == [first.key, second.key]
    third, last = plan.steps[2], replace(plan.steps[2], key="none of the plan")
    with pytest.raises(ValueError, match="is no step of this night's plan"):
        journal.begin(third, last)
    assert journal.begin(third) == [1]


def test_the_tables_themselves_refuse_duplicates(full_night: Path) -> None:
    """Not only the code: the keys of the database make a second DONE, attempt or block impossible."""
    connection = sqlite3.connect(full_night / JOURNAL_NAME)
    step, controller = connection.execute("SELECT step_key, controller FROM attempts LIMIT 1").fetchone()
    block = connection.execute("SELECT * FROM blocks LIMIT 1").fetchone()[1:]
    insert = "INSERT INTO attempts (step_key, attempt, controller, began_s, ended_s, outcome, digest) VALUES "
    with pytest.raises(sqlite3.IntegrityError, match="UNIQUE"):
        connection.execute(f"{insert} (?, 1, ?, 0, NULL, NULL, NULL)", (step, controller))
    with pytest.raises(sqlite3.IntegrityError, match="UNIQUE"):
        connection.execute(f"{insert} (?, 2, ?, 0, 1, 'DONE', '')", (step, controller))
    with pytest.raises(sqlite3.IntegrityError, match="UNIQUE"):
        connection.execute(
            "INSERT INTO blocks (step_key, attempt, kind, path, sha256, size, rows, content_sha256) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            block,
        )
    with pytest.raises(sqlite3.IntegrityError, match="never changed"):
        connection.execute("UPDATE attempts SET reason = 'better'")
    connection.close()


def test_a_step_of_another_plan_is_refused(journal: SqliteJournal) -> None:
    """Only what was planned can be done."""
    with pytest.raises(ValueError, match="no step of this night's plan"):
        journal.begin(Step(99, "T9/S1/collect", StepKind.COLLECT, 0.0, 1.0))
    assert journal.attempts() == ()


def test_events_and_heartbeats_keep_their_evidence(journal: SqliteJournal, plan: Plan, clock: VirtualClock) -> None:
    """Evidence of any kind is kept, with the campaign's time."""
    clock.sleep(90.0)
    journal.event("retry", "the chamber did not answer", port="/dev/ttyUSB1", tries=np.int64(2), air=float("nan"))
    journal.heartbeat(plan.steps[0], {"chamber_degC": 19.5})
    (event,) = journal.events()
    assert (event.at_s, event.kind, event.message) == (90.0, "retry", "the chamber did not answer")
    assert event.evidence == {"port": "/dev/ttyUSB1", "tries": 2, "air": None}
    beat = journal.last_heartbeat()
    assert beat is not None
    assert (beat.at_s, beat.step_key, beat.readings) == (90.0, plan.steps[0].key, {"chamber_degC": 19.5})
    assert journal.events(after=event.number) == ()


def test_another_reader_sees_what_was_committed_while_the_controller_writes(
    journal: SqliteJournal, plan: Plan, clock: VirtualClock, do: Do
) -> None:
    """Status from another shell works during a run, sees whole results only, and cannot write."""
    with open_readonly(journal.folder) as reader:
        for number, step in enumerate(plan.steps[:4], start=1):
            do(journal, step, clock)
            assert len(reader.completed()) == number
        with reader.snapshot():
            before = reader.completed()
            do(journal, plan.steps[4], clock)
            assert reader.completed() == before
        assert len(reader.completed()) == 5
        with pytest.raises(sqlite3.OperationalError, match="readonly"):
            reader._connection.execute("DELETE FROM attempts")


def test_a_second_controller_is_refused_and_names_the_first(journal: SqliteJournal, clock: VirtualClock) -> None:
    """One controller per folder, also within one process."""
    with pytest.raises(InputError, match=r"another controller is at work here \(process"):
        SqliteJournal.open(journal.folder, clock=clock)


def test_the_lock_of_a_dead_controller_is_taken_over_and_said(new_night: Path, clock: VirtualClock) -> None:
    """A lock text that nobody holds does not keep anybody out, and the journal says whose it was."""
    owner = {"pid": 4711, "host": "bench-pc", "since_utc": "2026-01-01T00:00:00+00:00"}
    (new_night / "controller.lock").write_text(to_json(owner))
    with SqliteJournal.open(new_night, clock=clock) as journal:
        (event,) = journal.events()
    assert event.kind == "lock_taken_over"
    assert "process 4711 on bench-pc" in event.message


def test_a_controller_that_ended_properly_leaves_no_lock(new_night: Path, clock: VirtualClock) -> None:
    """After an orderly end nothing has to be taken over."""
    for _ in range(2):
        with SqliteJournal.open(new_night, clock=clock) as journal:
            assert journal.events() == ()


def test_campaign_time_goes_on_across_a_resume(new_night: Path, plan: Plan) -> None:
    """Times count from the beginning of the night, also with a clock that starts at zero again."""
    first = VirtualClock()
    with SqliteJournal.open(new_night, clock=first) as journal:
        first.sleep(100.0)
        journal.event("note", "before")
    second = VirtualClock(start=first.utc() + timedelta(hours=1))
    with SqliteJournal.open(new_night, clock=second) as journal:
        second.sleep(5.0)
        assert journal.now_s() == pytest.approx(100.0 + 3600.0 + 5.0)


def test_campaign_time_never_goes_backwards(new_night: Path) -> None:
    """A wall clock that was set back is noticed; the campaign goes on from its last record."""
    first = VirtualClock()
    with SqliteJournal.open(new_night, clock=first) as journal:
        first.sleep(5000.0)
        journal.event("note", "late")
    with SqliteJournal.open(new_night, clock=VirtualClock()) as journal:
        assert journal.now_s() == 5000.0
        assert journal.events()[-1].kind == "clock_went_back"


def test_every_write_is_synchronised_to_the_disk(journal: SqliteJournal, plan: Plan) -> None:
    """Write-ahead log with full synchronisation; a heartbeat does not lower it for what follows."""
    full = (2,)
    assert journal._connection.execute("PRAGMA synchronous").fetchone() == full
    journal.heartbeat(plan.steps[0], {})
    assert journal._connection.execute("PRAGMA synchronous").fetchone() == full
    with contextlib.closing(sqlite3.connect(journal.folder / JOURNAL_NAME)) as other:
        assert other.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_nothing_is_recorded_of_a_step_that_is_not_in_the_plan(journal: SqliteJournal, plan: Plan) -> None:
    """SQLite heeds foreign keys only where each connection asks for it."""
    with pytest.raises(sqlite3.IntegrityError, match="FOREIGN KEY"):
        journal.heartbeat(replace(plan.steps[0], key="T9/S9/collect"), {})
    assert journal.last_heartbeat() is None


def test_an_existing_night_is_never_overwritten(new_night: Path, plan: Plan, clock: VirtualClock) -> None:
    """Creating a journal where there is one is refused."""
    night = Night("Other", "rk", clock.utc(), simulated=True, configuration="")
    with pytest.raises(InputError, match="holds a night already"):
        SqliteJournal.create(new_night, plan, night)


def test_what_is_no_journal_is_refused_in_one_sentence(tmp_path: Path, clock: VirtualClock) -> None:
    """No journal, rubbish, another program's database, a later version: all are refused."""
    with pytest.raises(InputError, match="holds no night"):
        open_readonly(tmp_path)
    path = tmp_path / JOURNAL_NAME
    path.write_bytes(b"not a database at all" * 100)
    with pytest.raises(InputError, match="is not a journal, or is damaged"):
        open_readonly(tmp_path)
    path.unlink()
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE other (x)")
    with pytest.raises(InputError, match="not a journal of hil"):
        open_readonly(tmp_path)
    connection.execute(f"PRAGMA application_id = {journal_schema.APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {journal_schema.VERSION + 1}")
    connection.close()
    with pytest.raises(InputError, match="later hil"):
        SqliteJournal.open(tmp_path, clock=clock)


def test_the_log_hears_of_every_commit(new_night: Path, plan: Plan, clock: VirtualClock) -> None:
    """A listener is told after the commit, with the facts."""
    heard: list[tuple[str, str]] = []
    listen = lambda what, facts: heard.append((what, str(facts.get("outcome", ""))))  # noqa: E731
    with SqliteJournal.open(new_night, clock=clock) as journal:
        journal.listen(listen)
        step = plan.steps[0]
        journal.end((step, *journal.begin(step), StepResult(Outcome.DONE)))
        journal.event("note", "x")
    assert heard == [("step begins", ""), ("step ends", "DONE"), ("event", "")]
