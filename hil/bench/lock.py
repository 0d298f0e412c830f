"""One controller per bench: whoever drives a device owns its port on this machine, whatever folder the night is in.

A lock file for each real port stands in /run/lock (else the folder for temporary files), under names made from the
port itself, whatever it is called: two names in /dev of one adapter are one port, and so are localhost, 127.0.0.1 and
every other name of one machine. Devices simulated in process need no lock.
"""

import hashlib
import os
import socket
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import urlsplit

from drivers.errors import TransportError
from hil.config import Bench
from hil.config.ports import COM_PORT, SIMULATED_SCHEME
from hil.errors import InputError
from hil.files.lock import LockFile, refuse_without_locks

_RUNTIME = Path("/run/lock")


@contextmanager
def bench_lock(bench: Bench, night: Path) -> Iterator[None]:
    """Own every real port of a bench for the night in the folder `night`; `InputError` names who has one of them."""
    refuse_without_locks()
    ports = {bench.chamber.port, *(each.imu.port for each in bench.each.values())}
    real = {name: port for port in ports if not port.startswith(SIMULATED_SCHEME) for name in port_names(port)}
    begin, what = f"{bench.source or bench.name}: another controller owns the bench", str(night.resolve())
    with ExitStack() as owned:
        for name, port in sorted(real.items()):
            words = (f"{begin} ({port}: ", "); wait until it has ended, or abort it first")
            owned.enter_context(_lock("bench", name, words, what))
        yield


def port_lock(port: str) -> Callable[[], None]:
    """Own a port for as long as it is open, until what is returned is called; raise `TransportError` where it is taken.

    A device server on TCP takes whoever comes, and two programs that talk to one chamber get each other's answers.
    """
    owned, words = ExitStack(), (f"{port}: somebody else has the port open (", "); close the other program")
    try:
        for name in sorted(port_names(port)):
            owned.enter_context(_lock("port", name, words))
    except InputError as error:
        owned.close()
        raise TransportError(str(error)) from None
    return owned.close


def port_names(port: str) -> set[str]:
    """Return by what a port is known, however it is written: two that share one are the same port."""
    if COM_PORT.fullmatch(port):
        return {port.upper().removeprefix("\\\\.\\")}
    if "://" not in port:
        real = os.path.realpath(port)
        with suppress(OSError):
            found = os.stat(real)
            return {f"device {found.st_rdev}"} if stat.S_ISCHR(found.st_mode) else {real}
        return {real}
    names = {port.lower()}
    with suppress(OSError, ValueError):  # no name, or one that nobody knows now
        parts = urlsplit(port.lower())
        names = {f"{(parts.hostname or '').rstrip('.')}:{parts.port}"}
        for *_, address in socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_STREAM):
            names.add(f"{_machine(str(address[0]))}:{parts.port}")
    return names


def _machine(address: str) -> str:
    """Return the address of a machine, one and the same for all that are this machine's own."""
    given = ip_address(address.partition("%")[0])
    found = getattr(given, "ipv4_mapped", None) or given
    family = socket.AF_INET6 if found.version == 6 else socket.AF_INET
    with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as own:
        own.bind((str(found), 0))  # only an address of one's own can be had
        return "this machine"
    return str(found)


def _lock(kind: str, name: str, words: tuple[str, str], what: str = "") -> LockFile:
    """Take a lock of a port; `words` refuse it, before and after who has it."""
    digest = hashlib.sha256(name.encode()).hexdigest()[:16]
    folder = _RUNTIME if os.access(_RUNTIME, os.W_OK) else Path(tempfile.gettempdir())
    return LockFile(folder / f"hil-{kind}-{digest}.lock", words, what=what, shared=True).acquire()
