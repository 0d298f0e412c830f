"""One controller per folder: a lock file that says who owns it, and that no death of its owner can leave locked.

The lock itself is the kernel's (`flock`), which ends with the process, even by kill -9. The text in the file says who
holds it, for people, for `hil status` and for the watchdog; a text without a lock is what a dead owner leaves behind.
"""

import contextlib
import json
import os
import socket
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

from drivers.clock import SystemClock
from drivers.given_file import read_text
from hil.errors import InputError, worded

try:
    import fcntl
except ImportError:  # Windows has no lock that ends with its process and that others can ask about
    fcntl = None  # type: ignore[assignment]

LOCK_NAME = "controller.lock"
_TRIES = 50
_PAUSE_S = 0.01


@dataclass(frozen=True)
class Owner:
    """The process that holds (or held) a lock. `started` is the kernel's start time of it: pids are used again."""

    pid: int
    host: str
    since_utc: str
    started: str = ""
    what: str = ""  # what it works on, where the lock itself does not say so

    def __str__(self) -> str:
        working = f", working on {self.what}" if self.what else ""
        return f"process {self.pid} on {self.host} since {self.since_utc}{working}"

    @property
    def is_that_process(self) -> bool:
        """Tell whether the process of this number is certainly the one that took the lock, and on this machine."""
        return self.host == socket.gethostname() and bool(self.started) and process_start(self.pid) == self.started


def process_start(pid: int) -> str:
    """Return when a process of this machine was started, in the kernel's ticks; empty where that cannot be told."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
    # The second field is the name in parentheses, which may hold anything; the start is the 22nd of all.
    fields = text.rpartition(")")[2].split()
    return fields[19] if len(fields) > 19 else ""


def refuse_without_locks() -> None:
    """Raise `InputError` on a system on which no bench is driven and no night carried out."""
    if fcntl is None:
        raise InputError(
            "benches are driven and nights carried out on Linux or macOS: this system has no lock that ends with its "
            "process. What was measured can be worked on here: solve, report, thermal, allan, reconcile, plot, export"
        )


class LockFile:
    """A lock that is held by at most one process at a time, and by one object within a process.

    `refusal`: what stands before and after the owner where it cannot be had; `shared`: every user may take it.
    """

    def __init__(self, path: Path, refusal: tuple[str, str], *, what: str = "", shared: bool = False) -> None:
        self._path = path
        self._refusal = refusal
        self._what = what
        self._mode = 0o666 if shared else 0o644
        self._descriptor: int | None = None
        self.taken_over_from: Owner | None = None

    def acquire(self) -> Self:
        """Take the lock; raise `InputError` where somebody else holds it, or the file cannot be used, or not here."""
        refuse_without_locks()
        descriptor = self._open()
        try:
            self._lock(descriptor)
        except BaseException:
            os.close(descriptor)
            raise
        self._descriptor = descriptor
        self.taken_over_from = read_owner(self._path)
        now = SystemClock().utc().isoformat(timespec="seconds")
        owner = Owner(os.getpid(), socket.gethostname(), now, process_start(os.getpid()), self._what)
        self._write_text(json.dumps(asdict(owner)))
        return self

    def _open(self) -> int:
        with worded(InputError, f"{self._path}: the lock file cannot be used (", OSError, ")"):
            with contextlib.suppress(FileNotFoundError):
                # Without O_CREAT first: with it, the kernel refuses somebody else's file in a folder such as /run/lock.
                return os.open(self._path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, self._mode)
            with contextlib.suppress(PermissionError):  # somebody else made it in the same instant
                os.fchmod(descriptor, self._mode)
            return descriptor

    def _lock(self, descriptor: int) -> None:
        # Somebody who only looks (`living_owner`) holds the lock for an instant; a controller holds it for a night.
        for _ in range(_TRIES):
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            SystemClock().sleep(_PAUSE_S)
        before, after = self._refusal
        raise InputError(f"{before}{read_owner(self._path) or 'owner unknown'}{after}")

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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


class FolderLock(LockFile):
    """The right to write in a folder."""

    def __init__(self, folder: Path) -> None:
        refusal = f"{folder}: another controller is at work here (", "); wait until it has ended, or abort it first"
        super().__init__(folder / LOCK_NAME, refusal)


def living_owner(folder: Path) -> Owner | None:
    """Return who holds the lock of `folder` at this moment, or None where nobody does (never locked, or dead)."""
    path = folder / LOCK_NAME
    if fcntl is None:
        return None
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return read_owner(path) or Owner(0, "unknown host", "an unknown time")
    else:
        return None
    finally:
        os.close(descriptor)


def read_owner(path: Path) -> Owner | None:
    """Return who a lock file names, or None where it names nobody that can be understood."""
    try:
        text = read_text(path)
        return Owner(**json.loads(text)) if text.strip() else None
    except (InputError, ValueError, TypeError):
        return None
