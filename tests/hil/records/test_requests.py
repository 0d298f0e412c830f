"""Pause, continue, abort and answers through the journal, while a night runs; asked as a second shell would."""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import VirtualClock
from hil.config import load_bench, parse_bench, parse_sweep
from hil.errors import Damaged, InputError
from hil.night import NightOutcome, resume_night, start_night
from hil.records import SqliteJournal, open_readonly
from hil.records.journal import JOURNAL_NAME
from hil.records.ledger import HEAD_NAME
from hil.records.requests import request, standing_prompt, wait_for_answer
from hil.records.status import night_status
from hil.records.verify import verify_night
from procedures.journal_protocol import Outcome
from procedures.progress import Progress, Snapshot
from procedures.requests import RequestKind
from tests.hil.short_sweeps import short_sweep

SHORT = parse_sweep(short_sweep("settle: 5 s, duration: 20 s, index_timeout: 5 min"), "short.yaml")


class Shell(Progress):
    """Does `act()` once, at the first update for which `when` is true; then the next of the list."""

    def __init__(self, *acts: tuple[Callable[[Snapshot], bool], Callable[[], Any]]) -> None:
        self.acts = list(acts)
        self.answers: list[Any] = []
        self.failed: Exception | None = None

    def update(self, snapshot: Snapshot) -> None:
        """Act where it is time."""
        if self.acts and self.acts[0][0](snapshot):
            _, act = self.acts.pop(0)
            try:
                self.answers.append(act())
            except Exception as error:  # an onlooker that raises is dropped; a test must hear of it
                self.failed = error


def during(key: str, after_s: float = 0.0) -> Callable[[Snapshot], bool]:
    """In this step, so many seconds after it began."""
    return lambda now: now.step.key == key and now.step_elapsed_s >= after_s


def later(seconds: float) -> Callable[[Snapshot], bool]:
    """So many seconds after this condition was first asked for."""
    first: list[float] = []

    def due(now: Snapshot) -> bool:
        first.append(now.elapsed_s)
        return now.elapsed_s - first[0] >= seconds

    return due


def run(folder: Path, *acts: Any, bench: str = "", sweep: Any = SHORT) -> tuple[NightOutcome, Shell]:
    """Run a night while a shell acts."""
    shell = Shell(*acts)
    chosen = load_bench("simulated")
    if bench:
        chosen = parse_bench(chosen.text.replace("positioner: indexing", bench), chosen.source)
    outcome = start_night(folder, sweep, chosen, who="rk", onlookers=[shell])
    assert shell.failed is None, shell.failed
    assert not shell.acts
    return outcome, shell


def kinds(folder: Path) -> list[str]:
    """Return the kinds of the night's events."""
    with open_readonly(folder) as journal:
        return [event.kind for event in journal.events()]


def attempts(folder: Path, key: str) -> list[tuple[Outcome | None, str]]:
    """Return outcome and reason of each attempt at a step."""
    with open_readonly(folder) as journal:
        return [(each.outcome, each.reason) for each in journal.attempts() if each.step_key == key]


def test_an_abort_brings_the_safe_state_and_says_who_and_why(tmp_path: Path) -> None:
    """State aborted, exit status 1, the request answered, the chamber safe; a resume makes the night complete."""
    folder = tmp_path / "night"
    ask = partial(request, folder, RequestKind.ABORT, "ann@desk", "fire drill")
    outcome, shell = run(folder, (during("T1/S1/restabilise", 60.0), ask))
    assert (outcome.state, outcome.exit_status) == ("aborted", 1)
    assert outcome.reason == "aborted by ann@desk: fire drill"
    assert night_status(folder)["state"] == "aborted"
    assert kinds(folder)[-3:] == ["aborted", "safe-state", "verdict"]
    row = wait_for_answer(folder, shell.answers[0], 0.0)
    assert (row.accepted, row.who, row.why) == (True, "ann@desk", "fire drill")
    assert resume_night(folder).state == "complete"
    assert verify_night(folder)["problems"] == []


@pytest.mark.slow
def test_a_pause_in_a_soak_holds_the_chamber_and_the_soak_starts_over(tmp_path: Path) -> None:
    """Status says paused, by whom, since when and why; time passes; afterwards the whole soak is done again."""
    folder = tmp_path / "night"
    seen: list[dict[str, Any]] = []

    def look_and_go_on() -> None:
        seen.append(night_status(folder))
        request(folder, RequestKind.CONTINUE, "bob@desk")

    outcome, _ = run(
        folder,
        (during("T1/S1/restabilise", 300.0), lambda: request(folder, RequestKind.PAUSE, "ann@desk", "a cable")),
        (later(1800.0), look_and_go_on),
    )
    assert outcome.state == "complete"
    assert seen[0]["state"] == "paused"
    assert (seen[0]["paused"]["by"], seen[0]["paused"]["why"]) == ("ann@desk", "a cable")
    assert night_status(folder)["paused"] is None
    (first, _), (second, soaked) = attempts(folder, "T1/S1/restabilise")
    assert (first, second) == (Outcome.ABORTED, Outcome.DONE)
    assert float(soaked.split("after ")[1].split(" min")[0]) >= 10.0
    assert {"pause", "continue"} <= set(kinds(folder))


def test_a_pause_in_a_collect_lets_it_be_finished_and_keeps_a_soak_that_the_log_proves(tmp_path: Path) -> None:
    """The collect is good; the band was held, so only devices and position are checked again, not the soak."""
    folder = tmp_path / "night"
    outcome, shell = run(
        folder,
        (during("T1/S1/C1/collect"), lambda: request(folder, RequestKind.PAUSE, "ann@desk", "look")),
        (later(600.0), lambda: request(folder, RequestKind.CONTINUE, "ann@desk")),
    )
    assert outcome.state == "complete"
    assert "when this collect is finished" in wait_for_answer(folder, shell.answers[0], 0.0).answer
    assert attempts(folder, "T1/S1/C1/collect")[0][0] is Outcome.DONE
    assert len(attempts(folder, "T1/S1/restabilise")) == 1
    with open_readonly(folder) as journal:
        restored = [event.evidence["step"] for event in journal.events() if event.kind == "restored"]
        went_on = next(event for event in journal.events() if event.kind == "continue")
    assert restored == ["identify"]
    assert went_on.evidence["soak_kept"] is True
    assert went_on.evidence["paused_s"] > 500.0


def test_what_cannot_be_done_is_refused_with_the_reason(tmp_path: Path) -> None:
    """Continue what is not paused, pause twice, confirm what nobody asks."""
    folder = tmp_path / "night"

    def all_at_once() -> list[int]:
        return [
            request(folder, RequestKind.CONTINUE, "ann"),
            request(folder, RequestKind.CONFIRM, "ann", prompt=1),
            request(folder, RequestKind.PAUSE, "ann", "x"),
            request(folder, RequestKind.PAUSE, "bob", "y"),
            request(folder, RequestKind.CONTINUE, "bob"),
        ]

    outcome, shell = run(folder, (during("T1/S1/restabilise"), all_at_once))
    assert outcome.state == "complete"
    rows = [wait_for_answer(folder, number, 0.0) for number in shell.answers[0]]
    assert [row.accepted for row in rows] == [False, False, True, False, True]
    assert "not paused" in rows[0].answer
    assert "does not stand" in rows[1].answer
    assert "paused already, by ann: x" in rows[3].answer
    assert "pause" not in kinds(folder)  # it was taken back before it took effect


def test_an_operator_is_asked_through_the_journal_and_the_bench_is_looked_at_meanwhile(tmp_path: Path) -> None:
    """The question is in the status, an answer moves the night on, and heartbeats go on while it stands."""
    folder = tmp_path / "night"
    seen: list[dict[str, Any]] = []

    def say_yes() -> None:
        seen.append(night_status(folder))
        prompt = standing_prompt(folder)
        assert prompt is not None
        request(folder, RequestKind.CONFIRM, "ann@desk", prompt=prompt.evidence["prompt"])

    outcome, _ = run(
        folder,
        (during("T1/S1/C1/index", 120.0), say_yes),
        (during("T1/S1/C2/index", 120.0), say_yes),
        bench="positioner: operator",
    )
    assert outcome.state in {"complete", "incomplete"}, outcome.reason
    assert "position 1" in seen[0]["prompt"]["question"]
    assert [each["prompt"]["prompt"] for each in seen] == [1, 2]
    with open_readonly(folder) as journal:
        beats = [beat for beat in journal.heartbeats() if beat.step_key == "T1/S1/C1/index"]
        ended = [event for event in journal.events() if event.kind == "prompt-ended"]
    assert len(beats) >= 2
    assert [(event.evidence["how"], event.evidence["who"]) for event in ended] == [("confirmed", "ann@desk")] * 2


def test_an_abort_is_heard_while_an_operator_is_asked(tmp_path: Path) -> None:
    """A question does not hold up the safe state; it is withdrawn."""
    folder = tmp_path / "night"
    outcome, _ = run(
        folder,
        (during("T1/S1/C1/index", 60.0), lambda: request(folder, RequestKind.ABORT, "ann", "enough")),
        bench="positioner: operator",
    )
    assert outcome.state == "aborted"
    with open_readonly(folder) as journal:
        ended = next(event for event in journal.events() if event.kind == "prompt-ended")
    assert ended.evidence["how"] == "withdrawn"
    assert night_status(folder)["prompt"] is None


def test_nobody_is_asked_where_no_controller_is_at_work(full_night: Path, tmp_path: Path) -> None:
    """The message says what to do instead, and nothing is recorded that a later controller would act upon."""
    with pytest.raises(InputError, match=r"no controller is at work here.*hil resume"):
        request(full_night, RequestKind.ABORT, "ann")
    with pytest.raises(InputError, match="holds no night"):
        request(tmp_path, RequestKind.PAUSE, "ann")


def test_a_killed_controller_s_chamber_is_named_to_whoever_asks(new_night: Path, clock: VirtualClock) -> None:
    """Nobody hears an abort; the message says that the chamber may still be conditioning."""
    SqliteJournal.open(new_night, clock=clock).close()
    connection = sqlite3.connect(new_night / JOURNAL_NAME, isolation_level=None)
    connection.execute("UPDATE controllers SET ended = NULL")
    connection.close()
    with pytest.raises(InputError, match=r"CHAMBER MAY STILL BE CONDITIONING.*hil watchdog"):
        request(new_night, RequestKind.ABORT, "ann")


def test_a_request_to_a_dead_controller_is_not_acted_upon_by_the_next(new_night: Path, clock: VirtualClock) -> None:
    """An abort that nobody heard at night must not end the resume in the morning."""
    with SqliteJournal.open(new_night, clock=clock):
        number = request(new_night, RequestKind.ABORT, "ann", "too late")
    assert wait_for_answer(new_night, number, 0.0).answer == "the controller has ended"
    with SqliteJournal.open(new_night, clock=clock) as journal:
        assert journal.asked() == ()
        request(new_night, RequestKind.PAUSE, "ann")
        (heard,) = journal.asked()
        assert (heard.kind, heard.who) == (RequestKind.PAUSE, "ann")


def test_a_journal_without_its_chain_proves_nothing(full_night: Path, clock: VirtualClock) -> None:
    """Nobody can take the chain out and call the rest an earlier version's."""
    with contextlib.closing(sqlite3.connect(full_night / JOURNAL_NAME, isolation_level=None)) as connection:
        connection.execute("DROP TABLE ledger")
        connection.execute("PRAGMA user_version = 2")
    (full_night / HEAD_NAME).unlink()
    with pytest.raises(Damaged, match="its rows are not chained"):
        open_readonly(full_night)
    with pytest.raises(Damaged, match="its rows are not chained"):
        SqliteJournal.open(full_night, clock=clock)
    assert not verify_night(full_night)["complete"]


def test_a_withdrawn_result_is_kept_and_counts_no_more(full_night: Path, plan: Any, clock: VirtualClock) -> None:
    """It can be done again; what was recorded before is not changed."""
    step = plan.steps[4]
    with SqliteJournal.open(full_night, clock=clock) as journal:
        journal.withdraw([step.key], "its samples are damaged")
        assert step.key not in journal.completed()
        assert journal.begin(step) == [2]
    assert attempts(full_night, step.key)[0] == (Outcome.FAILED, "its samples are damaged")
    assert not any("changed after" in problem for problem in verify_night(full_night)["problems"])
    assert json.dumps(night_status(full_night)["missing"]).count("samples are damaged") <= 1


@pytest.mark.slow
def test_a_night_that_a_watchdog_ended_is_carried_on(tmp_path: Path) -> None:
    """It has written into the journal as a controller of its own; the resume counts from there."""
    folder = tmp_path / "night"
    run(folder, (during("T1/S1/restabilise", 60.0), partial(request, folder, RequestKind.ABORT, "ann", "x")))
    later = VirtualClock(datetime(1985, 10, 1, 18, 0, tzinfo=UTC))
    with SqliteJournal.open(folder, clock=later, who="watchdog of hil@bench-pc") as journal:
        journal.event("watchdog", "the controller died; the watchdog brought the chamber to its safe state")
        journal.finish("failed: the controller died; the watchdog brought the chamber to its safe state")
    assert night_status(folder)["state"] == "failed"
    assert resume_night(folder).state == "complete"
    with open_readonly(folder) as journal:
        resumed = next(event for event in journal.events() if event.kind == "night-resumed")
    assert resumed.at_s > 3600.0
    assert verify_night(folder)["problems"] == []
