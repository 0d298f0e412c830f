"""`hil pause`, `continue`, `abort` and `confirm` from another shell."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import SystemClock, VirtualClock
from hil.config import load_sweep
from hil.records import SqliteJournal
from hil.records.rows import Night
from procedures.plan import make_plan
from procedures.requests import RequestKind


@pytest.fixture
def running(tmp_path: Path) -> Any:
    """A night with a controller that answers as soon as somebody looks whether it has."""
    folder = tmp_path / "running"
    folder.mkdir()
    night = Night("Quick", "rk", SystemClock().utc(), simulated=True, configuration="")
    SqliteJournal.create(folder, make_plan(load_sweep("quick").procedure()), night)
    with SqliteJournal.open(folder, clock=VirtualClock(), who="rk") as journal:
        yield journal


@pytest.fixture
def answering(running: SqliteJournal, monkeypatch: pytest.MonkeyPatch) -> SqliteJournal:
    """The controller answers in the time in which the command would wait."""

    def answer(_clock: SystemClock, _seconds: float) -> None:
        for request in running.asked():
            accepted = request.kind is not RequestKind.CONTINUE
            running.answer(request, accepted, "pauses at once" if accepted else "it is not paused")

    monkeypatch.setattr(SystemClock, "sleep", answer)
    return running


def test_what_was_asked_is_answered_and_recorded_with_who_and_why(hil: Any, answering: SqliteJournal) -> None:
    """Accepted is status 0, refused is status 1."""
    paused = hil("pause", answering.folder, "--why", "a cable", "--json")
    document = json.loads(paused.stdout)
    assert (paused.returncode, document["schema"], document["accepted"]) == (0, "hil.request/1", True)
    assert "@" in document["who"]
    assert document["why"] == "a cable"
    refused = hil("continue", answering.folder)
    assert refused.returncode == 1
    assert "continue: refused: it is not paused" in refused.stdout
    assert hil("abort", answering.folder, "--why", "enough").returncode == 0
    assert [row.kind for row in answering.requests()] == ["pause", "continue", "abort"]


def test_a_controller_that_does_not_answer_is_said_to(hil: Any, running: SqliteJournal) -> None:
    """Status 4: it is asked for, and will be acted upon."""
    asked = hil("pause", running.folder, "--why", "x", "--wait", "0")
    assert asked.returncode == 4
    assert "not answered after 0 s" in asked.stdout
    assert len(running.asked()) == 1


def test_a_question_is_answered_with_its_number(hil: Any, answering: SqliteJournal) -> None:
    """Yes, and no; where nothing is asked the command says so."""
    nothing = hil("confirm", answering.folder)
    assert nothing.returncode == 2
    assert "no question waits for an answer" in nothing.stderr
    answering.event("prompt", "Bring the unit to position 1.", prompt=3, timeout_s=60.0)
    confirmed = hil("confirm", answering.folder)
    assert confirmed.returncode == 0
    assert "Bring the unit to position 1." in confirmed.stdout
    assert hil("confirm", answering.folder, "--no").returncode == 0
    assert [(row.kind, row.prompt) for row in answering.requests()] == [("confirm", 3), ("refuse", 3)]


@pytest.mark.slow
def test_nobody_is_there_to_ask(hil: Any, night: Path) -> None:
    """One sentence, status 2."""
    for command in (["pause", "--why", "x"], ["continue"], ["abort", "--why", "x"]):
        ended = hil(command[0], night, *command[1:])
        assert ended.returncode == 2
        assert "no controller is at work here" in ended.stderr
    watched = hil("watchdog", night)
    assert watched.returncode == 2
    assert "nothing to watch" in watched.stderr
