"""Who owns a night, its heartbeat, and a watchdog that is told to end."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from drivers.clock import VirtualClock
from drivers.errors import DeviceError
from hil.config import load_bench, parse_sweep
from hil.files.lock import FolderLock, Owner, process_start
from hil.night import start_night
from hil.night.watchdog import Patience, Watchdog
from hil.records import SqliteJournal
from hil.records.live import HEARTBEAT_NAME, HeartbeatFile, read_heartbeat
from procedures.stop import StopRequest
from tests.hil.night.test_watchdog import SWEEP


def test_an_owner_is_told_from_another_process_with_its_number() -> None:
    """A pid is used again; the kernel's start time tells."""
    here = os.uname().nodename
    me = Owner(os.getpid(), here, "", process_start(os.getpid()))
    assert me.is_that_process
    assert not Owner(os.getpid(), here, "", "1").is_that_process
    assert not Owner(os.getpid(), "elsewhere", "", me.started).is_that_process
    assert not Owner(2**22 + 1, here, "", "").is_that_process


def test_a_heartbeat_costs_next_to_nothing_and_says_for_how_long_it_will_be_silent(tmp_path: Path) -> None:
    """At most one write a second, unless more silence is announced."""
    heartbeat = HeartbeatFile(tmp_path)
    for _ in range(1000):
        heartbeat.alive()
    first = read_heartbeat(tmp_path)
    heartbeat.alive(60.0)
    second = read_heartbeat(tmp_path)
    heartbeat.close()
    assert first is not None
    assert second is not None
    assert (first.pid, first.count, first.silent_s) == (os.getpid(), 1, 0.0)
    assert (second.count, second.silent_s) == (2, 60.0)
    (tmp_path / HEARTBEAT_NAME).write_text(json.dumps({"pid": 1}))
    assert read_heartbeat(tmp_path) is None


@pytest.mark.slow
def test_a_watchdog_that_is_told_to_end_does_not_try_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A chamber that does not answer is tried once more at most, and the folder's lock is given back."""

    def deaf(*_arguments: object) -> None:
        raise DeviceError("no answer")

    monkeypatch.setattr("hil.night.watchdog.open_chamber", deaf)
    bench, clock, stop = load_bench("simulated"), VirtualClock(), StopRequest()
    night = start_night(tmp_path / "night", parse_sweep(SWEEP, "sweep.yaml"), bench, who="rk").folder
    with SqliteJournal.open(night, clock=clock) as journal:
        journal.event("safe-state-not-reached", "no answer")
        journal.finish("failed: chamber-lost: no answer")
    said: list[str] = []

    def say(words: str) -> None:
        said.append(words)
        if words.startswith("not yet"):
            stop.request("stopped by SIGTERM")

    began_s = clock.now()
    watched = Watchdog(night, bench, say=say, stop=stop, clock=clock).run()
    assert watched.exit_status == 6
    assert "GO TO THE CHAMBER" in watched.message
    assert clock.now() - began_s < Patience().retry_s
    assert [words for words in said if words.startswith("not yet")] == ["not yet: no answer"]
    FolderLock(night).acquire().release()
