"""A night that somebody edited, or lost files of: said, refused, and never called complete."""

from __future__ import annotations

import io
import sqlite3
from collections.abc import Callable
from contextlib import closing, redirect_stderr
from datetime import timedelta
from pathlib import Path

import pytest

from drivers.clock import SystemClock, VirtualClock
from hil.cli.app import run
from hil.config import load_bench, load_sweep
from hil.errors import Damaged
from hil.night import resume_night, start_night
from hil.records import SqliteJournal, open_readonly
from hil.records.damage import damaged_self_calibrations
from hil.records.journal import JOURNAL_NAME
from hil.records.ledger import HEAD_NAME
from hil.records.live import SILENCE_BORNE_S, HeartbeatFile
from hil.records.status import night_status
from hil.records.verify import verify_night
from procedures.stop import StopRequest


def edit(folder: Path, *statements: str) -> None:
    """Change rows of a journal, as somebody with the sqlite3 program does."""
    with closing(sqlite3.connect(folder / JOURNAL_NAME, isolation_level=None)) as connection:
        for statement in statements:
            connection.execute(statement)


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file of a night, but not SQLite's index of its log, which every reader makes anew."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.endswith(("-shm", "-wal"))
    }


def block_of(folder: Path, end: str) -> Path:
    """Return the first block whose name ends so."""
    return min((folder / "blocks").glob(f"*{end}"))


@pytest.fixture(scope="module")
def cut_off(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A night on the simulated bench that was stopped before it did anything."""
    stop = StopRequest()
    stop.request("later")
    folder = tmp_path_factory.mktemp("cut-off") / "night"
    start_night(folder, load_sweep("quick"), load_bench("simulated"), stop=stop)
    return folder


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("UPDATE steps SET temperature_degC = 70.0 WHERE kind = 'setpoint' AND number < 3", "of the table steps"),
        ("DELETE FROM steps WHERE kind = 'safe_state'", "of the table steps"),
        ("UPDATE steps SET parameters = '{'", "of the table steps"),
        ("UPDATE night SET configuration = replace(configuration, '23', '24')", "of the table night"),
        ("UPDATE night SET began_utc = 'yesterday'", "of the table night"),
    ],
)
def test_a_night_whose_plan_was_edited_is_not_carried_on(
    cut_off: Path, tmp_path: Path, statement: str, words: str
) -> None:
    """What it would do now nobody has checked: a sentence, status 4, and not a byte of the folder is another."""
    folder = tmp_path / "night"
    with closing(sqlite3.connect(cut_off / JOURNAL_NAME)) as source:
        folder.mkdir()
        with closing(sqlite3.connect(folder / JOURNAL_NAME)) as copy:
            source.backup(copy)
    (folder / HEAD_NAME).write_bytes((cut_off / HEAD_NAME).read_bytes())
    edit(folder, statement)
    before = contents(folder)
    said = io.StringIO()
    with redirect_stderr(said):
        assert run(["resume", str(folder), "--quiet"]) == 4
    assert words in said.getvalue()
    assert "hil repair" in said.getvalue()
    assert len(said.getvalue().strip().splitlines()) == 1
    assert contents(folder) == before
    assert verify_night(folder)["problems"]


@pytest.mark.parametrize(
    "changed", ["night SET began_utc = '9999-12-31T23:59:59+00:00'", "controllers SET seen_s = 1e300"]
)
def test_a_time_that_no_calendar_has_is_damage(full_night: Path, changed: str) -> None:
    """One flipped bit of a year makes it."""
    edit(full_night, f"UPDATE {changed}")
    with pytest.raises(Damaged, match=f"of the table {changed.split()[0]}"):
        night_status(full_night)


def test_a_plan_that_was_cut_short_does_not_make_a_night_complete(
    new_night: Path, clock: VirtualClock, do: Callable[..., None]
) -> None:
    """Who deletes the steps that are not done gets no complete night: neither from status nor from resume."""
    with SqliteJournal.open(new_night, clock=clock) as journal:
        do(journal, journal.plan.steps[0], clock)
    edit(new_night, "DELETE FROM steps WHERE number > 0")
    status = night_status(new_night)
    assert status["state"] == "incomplete"
    assert "of the table steps" in status["reason"]
    with pytest.raises(Damaged, match="of the table steps"):
        resume_night(new_night)


def test_lost_samples_are_said_and_make_a_night_incomplete(full_night: Path) -> None:
    """Which block, of which collect, and what to do."""
    block = block_of(full_night, ".parquet")
    block.unlink()
    status = night_status(full_night)
    assert status["state"] == "incomplete"
    assert "samples of 1 collect are lost" in status["reason"]
    (problem,) = status["problems"]
    assert block.name in problem
    assert "missing" in problem
    assert "hil resume does its self-calibration again" in problem


def test_lost_raw_bytes_are_said_and_cost_no_self_calibration(full_night: Path) -> None:
    """The samples prove the averages: the night stays complete, and whoever asks is told."""
    block = block_of(full_night, ".raw.zst")
    block.write_bytes(block.read_bytes()[:100])
    status = night_status(full_night)
    assert status["state"] == "complete"
    (problem,) = status["problems"]
    assert f"{block.name}: has 100 bytes" in problem
    assert "hil replay needs them" in problem
    assert run(["status", str(full_night)]) == 4
    with open_readonly(full_night) as journal:
        assert damaged_self_calibrations(journal) == {}


def test_a_sound_night_has_no_problems(full_night: Path) -> None:
    """Nothing lost, nothing said."""
    assert night_status(full_night)["problems"] == []
    assert run(["status", str(full_night)]) == 0


def test_a_collect_without_any_block_of_samples_is_done_again(full_night: Path) -> None:
    """A journal whose row of the block is gone: the average rests on nothing, its self-calibration counts no more."""
    edit(full_night, "DELETE FROM blocks WHERE kind = 'samples' AND step_key LIKE '%S2%' AND step_key LIKE '%C2%'")
    with open_readonly(full_night) as journal:
        damaged = damaged_self_calibrations(journal)
    assert list(damaged) == [2]
    assert "no samples are recorded with it" in damaged[2]


def test_a_silent_controller_is_seen_by_its_heartbeat(journal: SqliteJournal, monkeypatch: pytest.MonkeyPatch) -> None:
    """As soon as a watchdog would act, not when the journal has been quiet for minutes; what it asked for is borne."""
    beats = HeartbeatFile(journal.folder)
    beats.alive(20.0)
    beats.close()
    now = SystemClock().utc()

    def state_after(seconds: float) -> tuple[str, str]:
        monkeypatch.setattr(SystemClock, "utc", lambda _: now + timedelta(seconds=seconds))
        status = night_status(journal.folder)
        return status["state"], status["reason"]

    assert state_after(SILENCE_BORNE_S + 15.0) == ("running", "")
    state, reason = state_after(SILENCE_BORNE_S + 25.0)
    assert state == "incomplete"
    assert "has shown no sign of life for 85 s" in reason


def test_a_controller_that_beats_is_running_however_seldom_it_writes(
    journal: SqliteJournal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A journal may be quiet for long where `polling: heartbeat` says so."""
    journal.event("note", "the last thing it said")
    later = SystemClock().utc() + timedelta(minutes=10.0)
    monkeypatch.setattr(SystemClock, "utc", lambda _: later)
    beats = HeartbeatFile(journal.folder)
    beats.alive()
    beats.close()
    assert night_status(journal.folder)["state"] == "running"
