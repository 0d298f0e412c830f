"""A controller that dies or hangs, over pseudo-terminals: real processes, real signals, one real chamber protocol."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import ClassVar

import pytest
import yaml

from drivers.clock import SystemClock, VirtualClock
from hil.bench import open_chamber
from hil.bench.lock import bench_lock
from hil.cli.watchdog import WatchdogBeside
from hil.config import Bench, load_bench, load_sweep, parse_bench
from hil.errors import InputError
from hil.files.lock import LOCK_NAME, FolderLock, Owner
from hil.night import start_night
from hil.night.watchdog import Patience, Watchdog, Watched
from hil.records import JournalReader, SqliteJournal, open_readonly
from hil.records.journal import JOURNAL_NAME
from hil.records.live import HEARTBEAT_NAME, read_heartbeat
from hil.records.requests import request
from hil.records.rows import Night
from hil.records.status import night_status
from hil.twin.serve import Simulation
from procedures.plan import make_plan
from procedures.progress import Snapshot
from procedures.requests import RequestKind
from tests.hil.twin.serving import client_bench, served

SWEEP = """
title: A soak that outlasts the test
temperatures: [23 degC]
self_calibrations_per_temperature: 1
positions: [1, 3]
restabilisation: {at_least: 2 h}
"""
TIMEOUT_S = 2.0
STATED_S = Patience().after_death_s  # docs/how-to/overnight.md: a second to see the death, and a chamber's own pacing


def wait_until(
    true: Callable[[], object], process: subprocess.Popen[str] | None = None, within_s: float = 30.0
) -> None:
    """Wait until something is true; a process that ends meanwhile, or the time, fails the test."""
    clock = SystemClock()
    while not true():
        assert process is None or process.poll() is None, "the process ended"
        assert clock.now() < within_s, "it did not come true"
        clock.sleep(0.02)


@pytest.fixture
def simulation(tmp_path: Path) -> Iterator[Simulation]:
    """Unit and chamber, served on pseudo-terminals by a thread of this process."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["chamber"] |= {"driver": "simserv", "model": ""}  # of all chambers the one with the least pacing
    with served(parse_bench(yaml.safe_dump(document), str(tmp_path / "served.yaml"))) as simulation:
        yield simulation


@pytest.fixture
def bench(simulation: Simulation, tmp_path: Path) -> Bench:
    """A client's bench file for them."""
    client = yaml.safe_load(client_bench(simulation.bench, simulation.ports).text)
    client["polling"] = {"interval": "1 s", "read_interval": "0.25 s"}
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(client))
    return load_bench(path)


class Processes:
    """Starts hil commands; whatever still runs at the end of the test is killed."""

    def __init__(self, folder: Path) -> None:
        self.night = folder / "night"
        self.sweep = folder / "sweep.yaml"
        self.sweep.write_text(SWEEP)
        self._started: list[subprocess.Popen[str]] = []

    def start(self, *arguments: object) -> subprocess.Popen[str]:
        """Start a command."""
        return self._process(sys.executable, "-m", "hil", *arguments)

    def python(self, code: str, *arguments: object) -> subprocess.Popen[str]:
        """Start a small program."""
        return self._process(sys.executable, "-c", code, *arguments)

    def _process(self, *command: object) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [str(word) for word in command],
            stderr=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
            text=True,
        )
        self._started.append(process)
        return process

    def controller(self, bench: Bench, *options: str) -> subprocess.Popen[str]:
        """Start a night and return once it soaks."""
        process = self.start("run", self.sweep, "--bench", bench.source, "--out", self.night, "--yes", *options)
        wait_until((self.night / HEARTBEAT_NAME).exists, process)
        wait_until(lambda: night_status(self.night)["step"] == "T1/S1/restabilise", process)
        return process

    def close(self) -> None:
        """End what still runs."""
        for process in self._started:
            if process.poll() is None:
                process.kill()
            process.communicate(timeout=10)


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    """What a test starts."""
    started = Processes(tmp_path)
    yield started
    started.close()


def conditioning(simulation: Simulation) -> bool:
    """Tell whether the chamber heats or cools: asked of the chamber behind the protocol, not of its driver."""
    return simulation.devices.plant.commanded_degC is not None


def events(folder: Path) -> list[tuple[str, str]]:
    """Return kind and message of the night's events."""
    with open_readonly(folder) as journal:
        return [(event.kind, event.message) for event in journal.events()]


def watched(bench: Bench, folder: Path, *, kill: bool = True, hear: Callable[[str], None] = lambda _: None) -> Watched:
    """Watch from this process."""
    patience = Patience(TIMEOUT_S, look_s=0.2, term_s=0.5)
    return Watchdog(folder, bench, patience=patience, kill=kill, say=hear).run()


def dead_night(folder: Path) -> None:
    """Make a night whose controller was killed."""
    folder.mkdir()
    plan = make_plan(load_sweep("quick").procedure())
    SqliteJournal.create(folder, plan, Night("Dead", "rk", SystemClock().utc(), simulated=True, configuration=""))
    lock = FolderLock(folder).acquire()
    JournalReader.close(SqliteJournal.open(folder, clock=SystemClock(), lock=lock))  # without a word of how it ended
    lock.release()


HUNG = """
import signal, sys
from pathlib import Path
from drivers.clock import SystemClock, VirtualClock
from hil.records.live import HeartbeatFile
from hil.records.journal import SqliteJournal
journal = SqliteJournal.open(Path(sys.argv[1]), clock=SystemClock())
HeartbeatFile(Path(sys.argv[1])).alive()
print("works", file=sys.stderr, flush=True)
signal.pause()
"""


@pytest.mark.slow(seconds=15)
def test_a_killed_controller_s_chamber_is_brought_to_its_safe_state_in_time(
    simulation: Simulation, bench: Bench, processes: Processes
) -> None:
    """SIGKILL: the watchdog that `hil run` started beside itself makes the chamber safe; the chamber itself says so."""
    controller = processes.controller(bench)
    log = processes.night / "watchdog.log"
    wait_until(lambda: log.exists() and "watching" in log.read_text(), controller)
    assert conditioning(simulation)
    clock = SystemClock()
    controller.kill()
    controller.wait(10)
    wait_until(lambda: night_status(processes.night)["state"] == "failed")
    took_s = clock.now()
    assert took_s < STATED_S
    assert not conditioning(simulation)
    assert "watchdog brought the chamber to its safe state" in night_status(processes.night)["reason"]
    happened = dict(events(processes.night))
    assert f"process {controller.pid}" in happened["watchdog"]
    assert "safe-state" in happened
    wait_until(lambda: "brought the chamber to its safe state" in log.read_text())  # its last words


@pytest.mark.slow(seconds=10)
def test_a_hung_controller_is_killed_and_its_chamber_made_safe(
    simulation: Simulation, bench: Bench, processes: Processes
) -> None:
    """It is asked to end first; then killed, because only one program can drive a chamber."""
    dead_night(processes.night)
    hung = processes.python(HUNG, processes.night)
    assert hung.stderr is not None
    assert "works" in hung.stderr.readline()
    os.kill(hung.pid, signal.SIGSTOP)
    with open_chamber(bench) as (driven, _):
        driven.prepare()
    said: list[str] = []
    ended = watched(bench, processes.night, hear=said.append)
    assert ended.exit_status == 3
    assert hung.wait(5) == -signal.SIGKILL
    assert not conditioning(simulation)
    assert [words for words in ("asked to end", "does not react", "safe state") if words in " ".join(said)] == [
        "asked to end",
        "does not react",
        "safe state",
    ]


@pytest.mark.slow(seconds=23)  # in real time, as the one above shows it with a process that only hangs
def test_a_real_controller_that_hangs_is_replaced_within_the_stated_time(
    simulation: Simulation, bench: Bench, processes: Processes
) -> None:
    """SIGSTOP in the middle of a soak, with the heartbeat, the polls and the port of a real night."""
    controller = processes.controller(bench, "--no-watchdog")
    watching = processes.start("watchdog", processes.night, "--timeout", TIMEOUT_S)
    assert watching.stderr is not None
    patience = Patience(TIMEOUT_S, look_s=TIMEOUT_S / 5.0, term_s=TIMEOUT_S)
    said = watching.stderr.readline()
    assert f"{patience.after_silence_s():.0f} s after the last heartbeat" in said
    beat = read_heartbeat(processes.night)
    assert beat is not None
    clock = SystemClock()
    os.kill(controller.pid, signal.SIGSTOP)
    assert conditioning(simulation)
    wait_until(lambda: not conditioning(simulation), within_s=60.0)
    took_s = clock.now()
    assert TIMEOUT_S < took_s < patience.after_silence_s(beat.silent_s)
    assert watching.wait(10) == 3
    assert controller.wait(5) == -signal.SIGKILL
    assert (
        "no sign of life" not in night_status(processes.night)["reason"]
    )  # it is dead by now, and that is what counts
    assert night_status(processes.night)["state"] == "failed"


def test_the_stated_times_are_those_of_the_how_to() -> None:
    """What docs/how-to/overnight.md promises is computed from what the watchdog waits for."""
    usual = Patience()
    assert (usual.after_death_s, usual.after_silence_s()) == (10.0, 81.0)
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "overnight.md").read_text()
    for stated in ("| 10 s |", "| 81 s"):
        assert stated in page


@pytest.mark.slow(seconds=19)
def test_a_controller_that_is_well_needs_no_watchdog(bench: Bench, processes: Processes, tmp_path: Path) -> None:
    """A second night on its ports is refused; a silence is reported where that was all; its end is its own."""
    controller = processes.controller(bench, "--no-watchdog")
    with pytest.raises(InputError, match=f"process {controller.pid} .*{processes.night}"):
        start_night(tmp_path / "second", load_sweep("quick"), bench)
    assert not (tmp_path / "second").exists()
    os.kill(controller.pid, signal.SIGSTOP)

    def go_on_and_end(what: str) -> None:
        if "left alone" in what:
            os.kill(controller.pid, signal.SIGCONT)
            request(processes.night, RequestKind.ABORT, "ann", "enough")

    ended = watched(bench, processes.night, kill=False, hear=go_on_and_end)
    assert ended.exit_status == 0
    assert "aborted by ann: enough" in ended.message
    assert controller.wait(10) == 1
    assert "watchdog" not in dict(events(processes.night))


@pytest.mark.slow
def test_a_bench_that_another_night_has_taken_over_is_left_alone(
    simulation: Simulation, bench: Bench, tmp_path: Path
) -> None:
    """The watchdog of a dead night must not stop the chamber of a living one."""
    folder = tmp_path / "night"
    dead_night(folder)
    with open_chamber(bench) as (driven, _):
        driven.prepare()
    with bench_lock(bench, tmp_path / "another"):
        left = watched(bench, folder)
    assert left.exit_status == 0
    assert "left alone" in left.message
    assert conditioning(simulation)
    assert watched(bench, folder).exit_status == 3
    assert not conditioning(simulation)


@pytest.mark.slow
@pytest.mark.parametrize("journal", ["garbage", "gone"])
def test_a_disk_that_took_the_journal_does_not_take_the_chamber(
    simulation: Simulation, bench: Bench, tmp_path: Path, journal: str
) -> None:
    """The lock says that its owner died; what the journal would have said is not waited for."""
    folder = tmp_path / "night"
    dead_night(folder)
    if journal == "garbage":
        for path in folder.glob(f"{JOURNAL_NAME}*"):
            path.write_bytes(b"no database " * 1000)
    else:
        (folder / JOURNAL_NAME).unlink()
    with open_chamber(bench) as (driven, _):
        driven.prepare()
    with pytest.raises(InputError):
        watched(bench, folder)  # nobody was ever at work here, as far as it can tell
    assert conditioning(simulation)
    (folder / LOCK_NAME).write_text(json.dumps(asdict(Owner(os.getpid(), os.uname().nodename, "", "1"))))
    ended = watched(bench, folder)
    assert ended.exit_status == 3
    assert "its journal cannot be read" in ended.message
    assert not conditioning(simulation)


@pytest.mark.slow
def test_a_folder_that_became_read_only_does_not_take_the_chamber(
    simulation: Simulation, bench: Bench, tmp_path: Path
) -> None:
    """The lock cannot be taken and the journal not be written; nobody else can be at work there either."""
    folder = tmp_path / "night"
    dead_night(folder)
    (folder / LOCK_NAME).unlink()
    (folder / LOCK_NAME).mkdir()  # cannot be opened to write, as on a file system that is read-only
    with open_chamber(bench) as (driven, _):
        driven.prepare()
    said: list[str] = []
    assert watched(bench, folder, hear=said.append).exit_status == 3
    assert "the chamber comes first" in " ".join(said)
    assert not conditioning(simulation)


def test_one_adapter_is_one_port_whatever_its_name(bench: Bench, tmp_path: Path) -> None:
    """/dev/serial/by-id/… and /dev/ttyUSB0 are the same lock; other ports are other locks."""
    text = bench.text
    for port, name in ((bench.chamber.port, "by-id-chamber"), (bench.imu.port, "by-id-imu")):
        (tmp_path / name).symlink_to(port)
        text = text.replace(port, str(tmp_path / name))
    same = parse_bench(text, bench.source)
    (tmp_path / "port").touch()
    another = parse_bench(text.replace("by-id-chamber", "port").replace("by-id-imu", "port"), bench.source)
    refused = pytest.raises(InputError, match="another controller owns the bench")
    with bench_lock(bench, tmp_path), bench_lock(another, tmp_path), refused, bench_lock(same, tmp_path):
        pass


class Started:
    """A process that was started, and ends when a test says so."""

    every: ClassVar[list[Started]] = []

    def __init__(self, command: list[str], **_more: object) -> None:
        self.command = command
        self.returncode: int | None = None
        Started.every.append(self)

    def poll(self) -> int | None:
        """Return how it ended, if it did."""
        return self.returncode


def test_a_watchdog_that_died_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nobody else would miss it before it is needed; at once, but not every second: one that cannot start is cheap."""
    monkeypatch.setattr(Started, "every", [])
    monkeypatch.setattr(subprocess, "Popen", Started)
    clock, plan = VirtualClock(), make_plan(load_sweep("quick").procedure())
    snapshot = Snapshot(plan.steps[0], 1, 0.0, 0.0, 1.0, clock.utc(), None, None)
    beside = WatchdogBeside(tmp_path, clock)
    beside.update(snapshot)
    assert Started.every == []
    beside.sweep_began(plan, frozenset())
    clock.sleep(6.0)
    beside.update(snapshot)
    assert len(Started.every) == 1
    Started.every[0].returncode = -9
    beside.update(snapshot)
    beside.update(snapshot)
    assert [each.command[-2:] for each in Started.every] == [["watchdog", str(tmp_path)]] * 2
    assert "the watchdog has ended (status -9); another one is started" in capsys.readouterr().err
    Started.every[1].returncode = 1
    clock.sleep(4.0)
    beside.update(snapshot)
    assert len(Started.every) == 2
