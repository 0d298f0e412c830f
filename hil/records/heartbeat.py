"""The heartbeat of a controller: a small file in the night's folder that changes at least every few seconds.

It is written in place, without a sync and at most once a second of real time: it only has to outlive the process, and
a watchdog judges it by whether it changes, on a clock of its own. Nothing else is derived from it.
"""

import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from drivers.clock import Clock, SystemClock
from drivers.given_file import read_bytes
from hil.errors import InputError

HEARTBEAT_NAME = "heartbeat.json"
SILENCE_BORNE_S = 60.0
"""A living controller that has not beaten for so long, beyond what it asked for, hangs."""
_EVERY_S = 1.0
_SIZE = 160  # bytes, always: a shorter text must leave no rest of a longer one


@dataclass(frozen=True)
class Heartbeat:
    """One beat. `silent_s` is for how long none may follow: a device is being waited for."""

    pid: int
    count: int
    utc: str
    silent_s: float

    @property
    def at(self) -> datetime:
        """When it was, by the wall clock."""
        return datetime.fromisoformat(self.utc)


class HeartbeatFile:
    """Writes the heartbeat of this process; real time also where the night's is simulated. Close it."""

    def __init__(self, folder: Path, clock: Clock | None = None) -> None:
        self._clock = clock or SystemClock()
        self._file = os.open(folder / HEARTBEAT_NAME, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
        self._count = 0
        self._last_s = -_EVERY_S
        self._silent_s = 0.0

    def alive(self, silent_s: float = 0.0) -> None:
        """Beat, unless the last one is younger than a second and promised as much. Never raises `OSError`."""
        now_s = self._clock.now()
        if now_s - self._last_s < _EVERY_S and silent_s == self._silent_s:
            return
        self._count += 1
        self._last_s, self._silent_s = now_s, silent_s
        beat = Heartbeat(os.getpid(), self._count, self._clock.utc().isoformat(), silent_s)
        with suppress(OSError):
            os.pwrite(self._file, json.dumps(asdict(beat)).ljust(_SIZE).encode(), 0)

    def close(self) -> None:
        """Release the file. It stays where it is."""
        os.close(self._file)


def read_heartbeat(folder: Path) -> Heartbeat | None:
    """Return the newest heartbeat in `folder`, None where there is none (or it is just being written)."""
    try:
        beat = Heartbeat(**json.loads(read_bytes(folder / HEARTBEAT_NAME)))
        return beat if beat.at.tzinfo is not None else None
    except (InputError, ValueError, TypeError):
        return None
