"""The log of a night: one JSON object per line in the night's folder, for people and programs that follow along.

The journal is the truth; the log says the same as it happens, and in addition every command that moves hardware, with
who and when, before it is sent. Times are the campaign's wall time in UTC.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from io import TextIOWrapper
from pathlib import Path
from typing import Any, Protocol, TextIO

import structlog

from drivers.chambers import Chamber, ChamberLimits, ChamberReading, SafeState
from drivers.chambers.chamber import ChamberIdentity
from drivers.clock import Clock
from drivers.positioners.positioner import Positioner
from hil.files.durable import RealDisk
from hil.records.witnesses import LOG_KEPT, LOG_NAME


class Log(Protocol):
    """Takes what is said: a night's file, or a stream."""

    def say(self, what: str, facts: Mapping[str, Any]) -> None:
        """Write one line."""


def _lines_to(stream: TextIO, clock: Clock, who: str) -> Any:
    """Return a logger that writes one JSON object per line, with who and when."""

    def stamp(logger: object, method: str, facts: Any) -> Any:  # noqa: ARG001 - the signature of a processor
        return {"utc": clock.utc().isoformat(), **facts}

    return structlog.wrap_logger(
        structlog.WriteLogger(stream),
        processors=[stamp, structlog.processors.JSONRenderer(ensure_ascii=False, default=str)],
        wrapper_class=structlog.BoundLogger,
        who=who,
    )


class StreamLog:
    """The log of a single command, on a stream that somebody else closes."""

    def __init__(self, stream: TextIO, clock: Clock, who: str) -> None:
        self._logger = _lines_to(stream, clock, who)

    def say(self, what: str, facts: Mapping[str, Any]) -> None:
        """Write one line."""
        self._logger.info(what, **facts)


class NightLog:
    """The log file of a night, appended to. Close it.

    A file of `largest` bytes becomes log.jsonl.1, that one log.jsonl.2, and so on; the one after the `kept` is deleted.
    """

    def __init__(
        self, folder: Path, clock: Clock, who: str, *, largest: int = 10_000_000, kept: int = LOG_KEPT
    ) -> None:
        self._path = folder / LOG_NAME
        self._clock, self._who = clock, who
        self._largest, self._kept = largest, kept
        self._open()

    def _open(self) -> None:
        # Line buffered: a line is in the operating system's hands, and so survives the death of the process.
        self._file: TextIOWrapper = self._path.open("a", encoding="utf-8", buffering=1)
        self._logger = _lines_to(self._file, self._clock, self._who)
        self._named = False  # as far as a power failure knows

    def say(self, what: str, facts: Mapping[str, Any]) -> None:
        """Write one line. A full disk must not end a night on account of its log: what cannot be written is lost."""
        try:
            if self._file.tell() >= self._largest:
                self._rotate()
            self._logger.info(what, **facts)
            if "digest" in facts:  # the end of an attempt, which the journal says as durably
                os.fsync(self._file.fileno())
                if not self._named:
                    RealDisk().synchronise_folder(self._path.parent)
                    self._named = True
        except (OSError, ValueError):  # ValueError: the file could not be opened again
            return

    def _rotate(self) -> None:
        self._file.close()
        for number in range(self._kept, 0, -1):
            older = self._path if number == 1 else self._path.with_name(f"{LOG_NAME}.{number - 1}")
            if older.exists():
                older.replace(self._path.with_name(f"{LOG_NAME}.{number}"))
        self._open()

    def close(self) -> None:
        """Close the file."""
        try:
            self._file.close()
        except OSError:
            return


class LoggedChamber:
    """A chamber whose commands are logged before they are sent."""

    def __init__(self, chamber: Chamber, log: Log) -> None:
        self._chamber = chamber
        self._log = log

    @property
    def limits(self) -> ChamberLimits:
        """The limits given by the bench file."""
        return self._chamber.limits

    def identify(self) -> ChamberIdentity:
        """Ask who is there."""
        return self._chamber.identify()

    def prepare(self) -> None:
        """Set the native limits and start constant-temperature operation."""
        self._log.say("chamber: prepare", {"low_degC": self.limits.low_degC, "high_degC": self.limits.high_degC})
        self._chamber.prepare()

    def read(self) -> ChamberReading:
        """Read the chamber; not logged, the journal's heartbeats hold the readings."""
        return self._chamber.read()

    def set_temperature(self, setpoint_degC: float) -> None:
        """Set the setpoint."""
        self._log.say("chamber: set temperature", {"setpoint_degC": setpoint_degC})
        self._chamber.set_temperature(setpoint_degC)

    def safe_state(self) -> SafeState:
        """Bring the chamber to its safe state."""
        self._log.say("chamber: safe state", {})
        return self._chamber.safe_state()

    def close(self) -> None:
        """Release the port."""
        self._chamber.close()


class LoggedPositioner:
    """A positioner whose moves are logged before they begin."""

    def __init__(self, positioner: Positioner, log: Log) -> None:
        self._positioner = positioner
        self._log = log

    def move_to(self, position: str, timeout_s: float) -> None:
        """Go to a position."""
        self._log.say("positioner: move", {"position": position, "timeout_s": timeout_s})
        self._positioner.move_to(position, timeout_s)

    def position(self) -> str | None:
        """Return the confirmed position."""
        return self._positioner.position()
