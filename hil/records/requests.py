"""Asking something of a running controller, from another process: a command, a dashboard.

A request is one durable row in the night's journal, meant for the controller that is at work at this moment and never
acted upon by another. The controller hears of it at its next poll and writes its answer beside it; an event in the
journal says what came of it. Waiting for the answer is not needed: what was asked is done all the same.
"""

import contextlib
import getpass
import os
import socket
import sqlite3
from pathlib import Path

from drivers.clock import SystemClock
from hil.errors import InputError, worded
from hil.files.lock import living_owner
from hil.files.strict import one_line
from hil.records.ledger import Ledger
from hil.records.reader import JOURNAL_NAME, JournalReader, journal_of, open_readonly
from hil.records.rows import Event, RequestRow
from hil.records.troubles import made_safe
from procedures.requests import RequestKind

_BUSY_S = 10.0
_LOOK_S = 0.1


def request(folder: Path, kind: RequestKind, who: str, why: str = "", *, prompt: int | None = None) -> int:
    """Ask the controller at work in `folder`; return the number of the request.

    `prompt` is the number of the question that a CONFIRM or REFUSE answers (`standing_prompt`). Raises `InputError`
    where no controller is at work there, or the request cannot be recorded; nothing is asked then.
    """
    _require_controller(folder, kind)
    why = one_line("the reason or answer", why)
    path = folder / JOURNAL_NAME
    with worded(InputError, f"{path}: the request cannot be recorded (", sqlite3.Error, "); nothing was asked"):
        connection = sqlite3.connect(path, isolation_level=None, timeout=_BUSY_S)
        with contextlib.closing(connection):
            connection.execute("PRAGMA synchronous = FULL")
            # For a millisecond: a controller waits for whoever writes, and hardly ever for one that dies meanwhile.
            with Ledger(connection, folder).transaction():
                row = connection.execute(
                    "INSERT INTO requests (controller, kind, who, why, prompt, asked_utc) "
                    "SELECT max(id), ?, ?, ?, ?, ? FROM controllers",
                    (kind.value, who, why, prompt, SystemClock().utc().isoformat()),
                )
            return int(row.lastrowid or 0)


def wait_for_answer(folder: Path, number: int, timeout_s: float) -> RequestRow:
    """Return the request with its answer; `accepted` is still None where none came within `timeout_s`."""
    clock = SystemClock()
    with open_readonly(folder) as journal:
        while True:
            # Asked before the row is read: a controller that has ended has answered.
            last_look = clock.now() >= timeout_s or living_owner(folder) is None
            row = next(each for each in journal.requests() if each.number == number)
            if row.accepted is not None or last_look:
                return row
            clock.sleep(_LOOK_S)


def standing_prompt(folder: Path) -> Event | None:
    """Return the question that waits for an answer in `folder`, or None. Its `evidence["prompt"]` is its number."""
    if living_owner(folder) is None:
        return None
    with open_readonly(folder) as journal:
        return journal.standing("prompt", "prompt-ended")


def user() -> str:
    """Return the name of who runs this process."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container whose user has no name
        return f"uid {os.getuid()}"


def who_asks() -> str:
    """Return who runs this process, as a request names them: user@host."""
    return f"{user()}@{socket.gethostname()}"


def chamber_within(journal: JournalReader) -> bool:
    """Return whether the chamber is simulated inside the controller: it ends with it, and conditions no more."""
    from hil.config.ports import SIMULATED_SCHEME  # imported late: whoever reads a night needs no bench files
    from hil.config.recorded import understood

    text = journal.night.configuration
    bench = understood(text).get("bench", {}) if SIMULATED_SCHEME in text else {}
    return str(bench.get("chamber", {}).get("port", "")).startswith(SIMULATED_SCHEME)


def forsaken_chamber(journal: JournalReader) -> str:
    """Say in what state a controller that died left its chamber; empty where the last one has ended."""
    controllers, beat = journal.controllers(), journal.last_heartbeat()
    if not controllers or controllers[-1].ended is not None:
        return ""
    if chamber_within(journal):
        return "the simulated chamber ended with its controller"
    setpoint = None if beat is None else beat.readings.get("setpoint_degC")
    where = "" if setpoint is None else f", at {setpoint:.1f} °C when it was last heard of"
    return f"THE CHAMBER MAY STILL BE CONDITIONING{where}"


def _require_controller(folder: Path, kind: RequestKind) -> None:
    """Raise `InputError`, saying what can be done instead, where nobody would hear the request."""
    journal_of(folder)
    if living_owner(folder) is not None:
        return
    with open_readonly(folder) as journal:
        controllers, forsaken = journal.controllers(), forsaken_chamber(journal)
        to_do = made_safe(folder, within=chamber_within(journal))
    nobody = f"{folder}: no controller is at work here, so nobody would hear {kind.value}"
    if forsaken:
        raise InputError(f"{nobody}: it was killed, or lost its power, and {forsaken}; {to_do}")
    ended = (controllers[-1].ended or "") if controllers else ""
    how = f" (the last one ended: {ended})" if ended else ""
    on = "" if ended.startswith("complete") else f", hil resume {folder} carries on"
    raise InputError(f"{nobody}{how}; hil status {folder} says what became of it{on}")
