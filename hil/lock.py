"""One controller per folder: a lock file that says who owns it, and that no death of its owner can leave locked.

    with FolderLock(folder).acquire() as lock:
        lock.taken_over_from  # None, or the dead owner whose lock this was

The lock itself is the kernel's (`flock`), which ends with the process, even by kill -9. The text in the file says who
holds it, for people and for `hil status`; a text without a lock is what a dead owner leaves behind.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import socket
from dataclasses import asdict, dataclass
from pathlib import Path

from drivers.clock import SystemClock
from hil.errors import InputError

LOCK_NAME = "controller.lock"
_TRIES = 50
_PAUSE_S = 0.01


@dataclass(frozen=True)
class Owner:
    """The process that holds (or held) a lock."""

    pid: int
    host: str
    since_utc: str

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host} since {self.since_utc}"


class FolderLock:
    """The right to write in a folder. Held by at most one process at a time, and by one object within a process."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK_NAME
        self._descriptor: int | None = None
        self.taken_over_from: Owner | None = None

    def acquire(self) -> FolderLock:
        """Take the lock; raise `InputError` naming the owner where another controller holds it."""
        descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            self._lock(descriptor)
        except BaseException:
            os.close(descriptor)
            raise
        self._descriptor = descriptor
        self.taken_over_from = _read_owner(self._path)
        owner = Owner(os.getpid(), socket.gethostname(), SystemClock().utc().isoformat(timespec="seconds"))
        self._write_text(json.dumps(asdict(owner)))
        return self

    def _lock(self, descriptor: int) -> None:
        # Somebody who only looks (`living_owner`) holds the lock for an instant; a controller holds it for a night.
        for _ in range(_TRIES):
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            SystemClock().sleep(_PAUSE_S)
        owner = _read_owner(self._path)
        raise InputError(
            f"{self._path.parent}: another controller is at work here ({owner or 'owner unknown'}); "
            "wait until it has ended, or abort it first"
        )

    def _write_text(self, text: str) -> None:
        if self._descriptor is not None:
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, text.encode(), 0)

    def release(self) -> None:
        """Give the lock back. Releasing twice is allowed."""
        if self._descriptor is not None:
            # Emptied, never deleted: deleting would let two processes lock two files of the same name.
            with contextlib.suppress(OSError):
                self._write_text("")
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def living_owner(folder: Path) -> Owner | None:
    """Return who holds the lock of `folder` at this moment, or None where nobody does (never locked, or dead)."""
    path = folder / LOCK_NAME
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _read_owner(path) or Owner(0, "unknown host", "an unknown time")
    else:
        return None
    finally:
        os.close(descriptor)


def _read_owner(path: Path) -> Owner | None:
    try:
        text = path.read_text(encoding="utf-8")
        return Owner(**json.loads(text)) if text.strip() else None
    except (OSError, ValueError, TypeError):
        return None
