"""What the live page is told of a night: what its journal says, at once, at any length, and never in the way."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from drivers.clock import SystemClock
from hil.dashboard.facts import NightFacts
from hil.dashboard.watcher import Watcher
from hil.files.lock import FolderLock
from hil.records.export import campaign_of_night
from hil.records.ledger import HEAD_NAME
from hil.records.live import LIVE_NAME, HeartbeatFile
from hil.records.reader import JOURNAL_NAME
from hil.solve import solve_campaign
from hil.solve.document import solution_document
from tests.hil.dashboard.watched_night import Watched


def test_a_report_that_is_older_than_the_records_is_not_shown(night: Watched, tmp_path: Path) -> None:
    """What was recorded since, by a resume say, may say otherwise."""
    folder = tmp_path / "night"
    shutil.copytree(night[0], folder)
    facts, report = NightFacts(folder, "night"), folder / "report.html"
    assert facts.report is None
    report.write_text("PASS")
    assert facts.report == report
    (folder / HEAD_NAME).touch()
    os.utime(report, (0.0, 0.0))
    assert facts.report is None


def test_a_running_night_is_told_with_what_its_controller_shows(night: Watched) -> None:
    """State, step, temperatures, stream and the first results, while it runs; and that it is simulated."""
    _, seen, _ = night
    head = seen["head"]
    assert (head["state"], head["working"], head["killed"], head["old"]) == ("running", True, False, False)
    assert head["simulated"] is True
    assert head["title"] == "Two at 30 degrees"
    assert "restabilising at 30.0 °C" in head["step"]
    assert head["now"]["setpoint_degC"] == 30.0
    assert head["now"]["stream"]["lost"] == 0
    assert set(head["now"]["rates"]) == {"1.RA", "1.RB", "2.RA", "2.RB"}
    assert [row["done"] for row in seen["results"]] == [True]
    assert seen["events"][0]["kind"] == "night-begins"
    assert seen["plan"]["corners"][0][1] == 30.0
    assert seen["temperatures"]["columns"][:2] == ["chamber_degC", "setpoint_degC"]


def test_the_parameters_on_the_page_are_those_of_hil_solve_to_the_digit(night: Watched) -> None:
    """One equation, one solver: the page computes nothing of its own."""
    folder, _, facts = night
    facts.look()  # for the second time: it has seen the first results only
    told = facts.whole()["results"]
    campaign = campaign_of_night(folder)
    solved = solution_document(campaign, solve_campaign(campaign))["solutions"]
    assert len(told) == 2
    for row in told:
        expected = [each for each in solved if each["run"] == row["number"]]
        for shown, each in zip(row["solutions"], expected, strict=True):
            assert shown["parameters"] == each["parameters"]
        assert [each["verdict"] for each in row["solutions"]] == [each["verdict"] for each in expected]


def test_nothing_is_told_where_nothing_changed(night: Watched) -> None:
    """A finished night costs a look at three files a second."""
    facts = NightFacts(night[0], "night")
    assert {"head", "events", "results", "plan", "temperatures"} <= set(facts.look())
    assert facts.look() == {}


def test_looking_leaves_no_lock_and_holds_no_transaction(night: Watched) -> None:
    """A controller that would not wait a millisecond can write, and the write-ahead log can be emptied."""
    watcher = Watcher(night[0])
    watcher.look()
    connection = sqlite3.connect(night[0] / JOURNAL_NAME, isolation_level=None, timeout=0.0)
    connection.execute("BEGIN EXCLUSIVE")
    connection.execute("ROLLBACK")
    assert connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0] == 0
    connection.close()


def test_a_controller_that_ended_without_a_word_is_called_dead(killed: Path) -> None:
    """The kernel's lock says whether it lives, within one look; no time-out is waited for."""
    facts = NightFacts(killed, "night")
    head = facts.look()["head"]
    assert (head["killed"], head["verdict"]) == (True, None)  # nobody judged it, as hil status says
    with FolderLock(killed).acquire():
        assert facts.look()["head"]["killed"] is False
    assert facts.look()["head"]["killed"] is True


def test_data_of_a_living_controller_are_called_old_after_four_seconds(
    killed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody who hangs, or whose disk hangs, is not taken for one who works."""
    facts = NightFacts(killed, "night")
    seen = datetime.fromisoformat(json.loads((killed / LIVE_NAME).read_text())["written_utc"])
    with FolderLock(killed).acquire():
        for later_s, old in ((1.0, False), (4.5, True)):
            monkeypatch.setattr(SystemClock, "utc", lambda _, later_s=later_s: seen + timedelta(seconds=later_s))
            facts.look()
            assert facts.whole()["head"]["old"] is old


def test_a_controller_that_said_it_waits_for_a_device_is_given_that_time(
    killed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A chamber that answers slowly is no reason for alarm; who is silent for longer than announced is."""
    facts = NightFacts(killed, "night")
    seen = datetime.fromisoformat(json.loads((killed / LIVE_NAME).read_text())["written_utc"])
    beats = HeartbeatFile(killed)
    live = json.loads((killed / LIVE_NAME).read_text())
    with FolderLock(killed).acquire():
        # A poll announces the time to the next: that is waited for anyhow, however long it is on a clock that jumps.
        for announced_s, times in ((19.0, ((20.0, False), (24.5, True))), (20.0, ((3.0, False), (4.5, True)))):
            (killed / LIVE_NAME).write_text(json.dumps(live | {"announced_s": announced_s}))
            beats.alive(silent_s=20.0)
            for later_s, old in times:
                monkeypatch.setattr(SystemClock, "utc", lambda _, later_s=later_s: seen + timedelta(seconds=later_s))
                facts.look()
                assert facts.whole()["head"]["old"] is old
    beats.close()
