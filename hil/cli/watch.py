"""`hil status --watch`: a night from another shell, live on a terminal, line by line where nobody looks at one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live

from drivers.clock import Clock, SystemClock
from hil.cli.panel import Panel
from hil.files.lock import living_owner
from hil.records import reading
from hil.records.heartbeat import read_heartbeat
from hil.records.live import age_s, read_live, snapshot_of
from hil.records.status import night_status
from procedures.plan import Step
from procedures.progress import Snapshot
from procedures.words import hours_minutes, step_in_words

EVERY_S = 1.0
_WORKING = ("running", "paused")


def watch(folder: Path, console: Console, clock: Clock | None = None) -> None:
    """Show a night until it ends, or until Ctrl-C. Raises `InputError` where the folder holds none."""
    clock = clock or SystemClock()
    with reading(folder) as journal:
        steps = journal.steps_by_key()
    drawn = console.is_terminal and not console.is_dumb_terminal
    with suppress(KeyboardInterrupt), _panel(console) if drawn else _lines(console) as show:
        while True:
            status = night_status(folder)
            step = steps.get(status["step"] or "")
            status["step"] = step_in_words(step) if step else ""
            now, status["old"] = _snapshot(folder, steps)
            show(folder, status, now)
            if status["state"] not in _WORKING:
                return
            clock.sleep(EVERY_S)


def _snapshot(folder: Path, steps: Mapping[str, Step]) -> tuple[Snapshot | None, str]:
    """Return what the controller at work shows, or None where none is, or it has shown nothing yet; and how old it is.

    The age is in words, and empty where it is as it should be.
    """
    owner, live = living_owner(folder), read_live(folder)
    if owner is None or live is None or live["pid"] != owner.pid:
        return None, ""
    beat = read_heartbeat(folder)
    silent_s, old = age_s(live, beat if beat and beat.pid == owner.pid else None, SystemClock().utc())
    told = f"The controller has shown nothing for {hours_minutes(silent_s)}. What is below is that old."
    return snapshot_of(live, steps), told if old else ""


Show = Callable[[Path, dict[str, Any], Snapshot | None], None]


@contextmanager
def _panel(console: Console) -> Iterator[Show]:
    """Draw in place, on a screen of its own: what was on the terminal comes back afterwards."""
    with Live(console=console, screen=True, auto_refresh=False) as live:

        def show(folder: Path, status: dict[str, Any], now: Snapshot | None) -> None:
            head = f"{folder}: {status['title']}: {status['state']}"
            live.update(Panel(head, now, _trouble(folder, status), simulated=status["simulated"]), refresh=True)

        yield show


@contextmanager
def _lines(console: Console) -> Iterator[Show]:
    """Print a line with the time for every change of state or step."""
    last = ""

    def show(folder: Path, status: dict[str, Any], now: Snapshot | None) -> None:  # noqa: ARG001 - one signature
        nonlocal last
        mark = " SIMULATED" if status["simulated"] else ""
        parts = (f"{status['state']}{mark}", status["step"], status["reason"], _trouble(folder, status))
        line = ": ".join(part for part in parts if part)
        if line != last:
            at = datetime.fromisoformat(status["last_utc"])
            done = f"{status['steps_done']}/{status['steps_total']}"
            console.print(f"{at:%Y-%m-%dT%H:%M:%SZ}  {done:>7}  {line}", soft_wrap=True)
            console.file.flush()
            last = line

    yield show


def _trouble(folder: Path, status: dict[str, Any]) -> str:
    """Return what must be seen first: data that are old, a question, a pause."""
    if status["old"]:
        return str(status["old"])
    if status["prompt"]:
        return f"ASKS: {status['prompt']['question']} (hil confirm {folder}, or --no)"
    if status["paused"]:
        return f"paused by {status['paused']['by']} (hil continue {folder})"
    return ""
