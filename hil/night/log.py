"""The log of a night: one JSON object per line in the night's folder, for people and programs that follow along.

The journal is the truth; the log says the same as it happens, and in addition every command that moves hardware, with
who and when, before it is sent. Times are the campaign's wall time in UTC.
"""

import os
from collections.abc import Mapping
from contextlib import suppress
from inspect import signature
from io import TextIOWrapper
from pathlib import Path
from typing import Any, TextIO, TypeVar, cast

import structlog

from drivers.clock import Clock
from hil.files.durable import RealDisk
from hil.records.journal import Listener
from hil.records.witnesses import LOG_KEPT, LOG_NAME

Device = TypeVar("Device")
_COMMANDS = {
    "prepare": "chamber: prepare",
    "set_temperature": "chamber: set temperature",
    "safe_state": "chamber: safe state",
    "move_to": "positioner: move",
    "moving": "positioner: move",
}


def lines_to(stream: TextIO, clock: Clock, who: str) -> Listener:
    """Return what writes one JSON object per line, with who and when, to a stream that somebody else closes."""

    def stamp(logger: object, method: str, facts: Any) -> Any:  # noqa: ARG001 - the signature of a processor
        return {"utc": clock.utc().isoformat(), **facts}

    logger = structlog.wrap_logger(
        structlog.WriteLogger(stream),
        processors=[stamp, structlog.processors.JSONRenderer(ensure_ascii=False, default=str)],
        wrapper_class=structlog.BoundLogger,
        who=who,
    )
    return lambda what, facts: logger.info(what, **facts)


class NightLog:
    """The log file of a night: one of `largest` bytes becomes .1, that .2, and so on to `kept`. Close it."""

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
        self._write = lines_to(self._file, self._clock, self._who)
        self._named = False  # as far as a power failure knows

    def say(self, what: str, facts: Mapping[str, Any]) -> None:
        """Write one line. A full disk must not end a night on account of its log: what cannot be written is lost."""
        try:
            if self._file.tell() >= self._largest:
                self._rotate()
            self._write(what, facts)
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
        with suppress(OSError):
            self._file.close()


def logged(device: Device, say: Listener) -> Device:
    """Return a chamber or a positioner whose commands are logged, with what they are given, before they are sent."""
    return cast(Device, _Logged(device, say))


class _Logged:
    def __init__(self, device: object, say: Listener) -> None:
        self._device, self._say = device, say

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._device, name)
        if name not in _COMMANDS:  # it only asks: the journal's heartbeats hold what was read
            return method

        def sent(*given: object, **named: object) -> Any:
            self._say(_COMMANDS[name], signature(method).bind(*given, **named).arguments)
            return method(*given, **named)

        return sent
