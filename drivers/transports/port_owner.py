"""One owner per port, for ports that the system does not guard by itself.

    transport = owned("socket://192.0.2.7:10001", lambda: open_port("socket://192.0.2.7:10001", clock=clock))

A serial port is opened exclusively. A device server on TCP takes whoever comes, and two programs that talk to one
chamber get each other's answers. A lock file of this machine, held for as long as the port is open and freed by the
system when the program dies, keeps the second one out.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from drivers.errors import TransportError
from drivers.transports.transport import Transport


class OwnedTransport:
    """A `Transport` over another, which gives a lock back when it is closed."""

    def __init__(self, transport: Transport, lock: int) -> None:
        self._transport = transport
        self._lock: int | None = lock

    @property
    def name(self) -> str:
        """The port as a person would name it."""
        return self._transport.name

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        self._transport.write(data)

    def read_available(self) -> bytes:
        """Return what has already arrived, perhaps nothing; never waits."""
        return self._transport.read_available()

    def read(self, size: int, timeout_s: float) -> bytes:
        """Return `size` bytes, or fewer where `timeout_s` passed first."""
        return self._transport.read(size, timeout_s)

    def read_until(self, terminator: bytes, timeout_s: float) -> bytes:
        """Return bytes up to and including `terminator`; raise `DeviceTimeout` naming what arrived instead."""
        return self._transport.read_until(terminator, timeout_s)

    def drain(self) -> bytes:
        """Throw away and return what has arrived."""
        return self._transport.drain()

    def close(self) -> None:
        """Release the port and the lock. Closing twice is allowed."""
        self._transport.close()
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)


def owned(url: str, open_transport: Callable[[], Transport]) -> Transport:
    """Open a port as its only owner on this machine; raise `TransportError` where somebody else has it open.

    Ports without `://` are the system's to guard and are opened as they are.
    """
    if "://" not in url:
        return open_transport()
    lock = _locked(url)
    try:
        return OwnedTransport(open_transport(), lock)
    except BaseException:
        os.close(lock)
        raise


def _locked(url: str) -> int:
    """Return a locked descriptor whose file says who holds it."""
    name = hashlib.sha256(url.strip().lower().encode()).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"hil-port-{name}.lock"
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise TransportError(f"{url}: the lock file {path} cannot be used ({error.strerror}); remove it") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        holder = os.read(lock, 64).decode("ascii", errors="replace").strip() or "unknown"
        os.close(lock)
        raise TransportError(
            f"{url}: somebody else has the port open (process {holder}); close the other program"
        ) from None
    with suppress(OSError):  # for the message alone
        os.ftruncate(lock, 0)
        os.pwrite(lock, f"{os.getpid()}\n".encode(), 0)
    return lock
