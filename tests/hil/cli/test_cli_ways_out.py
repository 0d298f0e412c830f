"""Every way out of `hil run` that a terminal and a system have: a real process on a terminal of its own."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import yaml

from drivers.clock import SystemClock
from hil.errors import InputError
from hil.records import open_readonly
from hil.records.requests import request
from hil.records.status import night_status
from procedures.requests import RequestKind

LONG = {
    "title": "A soak that outlasts the test",
    "temperatures": ["23 degC"],
    "self_calibrations_per_temperature": 1,
    "positions": [1, 3],
    "restabilisation": {"at_least": "3 h", "ceiling": "4 h"},
}


class Terminal:
    """`hil run` as the foreground process of a new session on a pseudo-terminal."""

    def __init__(self, folder: Path, *, ignoring: tuple[signal.Signals, ...] = ()) -> None:
        sweep = folder / "sweep.yaml"
        sweep.write_text(yaml.safe_dump(LONG))
        self.night = folder / "night"
        self.master: int | None
        self.master, slave = pty.openpty()
        command = [
            sys.executable,
            "-m",
            "hil",
            "run",
            sweep,
            "--bench",
            "simulated",
            "--out",
            self.night,
            "--speed",
            "20",
        ]

        def take_terminal() -> None:
            os.setsid()
            os.close(os.open(os.ttyname(0), os.O_RDWR))  # the first terminal that is opened becomes the session's
            for number in ignoring:
                signal.signal(number, signal.SIG_IGN)

        buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
        self.process = subprocess.Popen(
            [str(word) for word in command],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env=buffered,  # as technicians have it: something is left to be printed when the terminal has gone
            preexec_fn=take_terminal,
        )
        os.close(slave)
        self.wait_until(lambda: night_status(self.night)["step"] == "T1/S1/restabilise")

    def wait_until(self, true: Callable[[], bool]) -> None:
        """Wait until something is true; the process must live meanwhile."""
        clock = SystemClock()
        while True:
            with suppress(InputError):
                if true():
                    return
            assert self.process.poll() is None, self.read()
            assert clock.now() < 40.0
            self.read()
            clock.sleep(0.02)

    def read(self) -> bytes:
        """Take what it wrote, so that it never waits for a reader."""
        if self.master is None:
            return b""
        os.set_blocking(self.master, False)
        with suppress(OSError):
            return os.read(self.master, 65536)
        return b""

    def close(self) -> None:
        """Close the terminal's window."""
        master, self.master = self.master, None
        if master is not None:
            os.close(master)

    def ended(self) -> int:
        """Return the exit status, reading meanwhile."""
        clock = SystemClock()
        while self.process.poll() is None:
            assert clock.now() < 40.0
            self.read()
            clock.sleep(0.02)
        return self.process.returncode


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Callable[..., Terminal]]:
    """Opens terminals; closes them and ends what runs."""
    opened: list[Terminal] = []

    def open_one(**more: tuple[signal.Signals, ...]) -> Terminal:
        opened.append(Terminal(tmp_path, **more))
        return opened[-1]

    yield open_one
    for each in opened:
        each.process.kill()
        each.process.wait(10)
        each.close()


def told(folder: Path) -> list[str]:
    """Return the kinds of the night's events."""
    with open_readonly(folder) as journal:
        return [event.kind for event in journal.events()]


def interrupt_twice(at: Terminal) -> None:
    """Press Ctrl-Z, which must do nothing, then Ctrl-C twice."""
    assert at.master is not None
    os.write(at.master, b"\x1a\x03\x03")


def terminate(at: Terminal) -> None:
    """Do what a service manager does."""
    at.process.send_signal(signal.SIGTERM)


@pytest.mark.parametrize(
    ("leave", "reason"),
    [
        (interrupt_twice, "stopped by Ctrl-C, SIGINT"),
        pytest.param(terminate, "stopped by SIGTERM", marks=pytest.mark.slow),
        pytest.param(Terminal.close, "stopped by SIGHUP", marks=pytest.mark.slow),
    ],
)
def test_the_chamber_is_safe_on_every_way_out(
    terminal: Callable[..., Terminal], leave: Callable[[Terminal], None], reason: str
) -> None:
    """Ctrl-C twice after Ctrl-Z, a termination, a closed window: aborted, safe, exit status 1, and the reason."""
    running = terminal()
    leave(running)
    assert running.ended() == 1
    status = night_status(running.night)
    assert (status["state"], status["reason"]) == ("aborted", reason)
    assert told(running.night)[-3:] == ["aborted", "safe-state", "verdict"]


@pytest.mark.slow
def test_a_night_that_was_told_to_outlive_its_terminal_does(terminal: Callable[..., Terminal]) -> None:
    """As with nohup: the window closes, every write to it fails, and the night goes on until it is aborted."""
    running = terminal(ignoring=(signal.SIGHUP,))
    running.close()
    running.wait_until(lambda: "onlooker-lost" in told(running.night) or heartbeats(running.night) > 2)
    assert night_status(running.night)["state"] == "running"
    request(running.night, RequestKind.ABORT, "ann", "enough")
    assert running.ended() == 1
    assert night_status(running.night)["reason"] == "aborted by ann: enough"
    assert told(running.night)[-3:] == ["aborted", "safe-state", "verdict"]


def heartbeats(folder: Path) -> int:
    """Count the signs of life."""
    with open_readonly(folder) as journal:
        return len(journal.heartbeats())
