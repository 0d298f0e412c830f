"""One controller per bench: whoever drives a device owns its port on this machine, whatever folder the night is in.

    with bench_lock(bench, folder):
        build_bench(bench)

A lock file for each real port stands in /run/lock (else the folder for temporary files), under a name made from the
port itself: the same adapter under another name in /dev is the same port. Devices simulated in process need no lock.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from hil.config import Bench
from hil.config.ports import SIMULATED_SCHEME
from hil.files.lock import LockFile, Owner

_RUNTIME = Path("/run/lock")


@contextmanager
def bench_lock(bench: Bench, night: Path) -> Iterator[None]:
    """Own every real port of a bench for the night in the folder `night`.

    Raises `InputError` that names the owner where another controller, or a watchdog, has one of them.
    """
    with ExitStack() as owned:
        for port in sorted(_real_ports(bench)):
            owned.enter_context(_lock_of(bench, port, night).acquire())
        yield


def _real_ports(bench: Bench) -> set[str]:
    ports = {bench.imu.port, bench.chamber.port, bench.chamber.ramp_port or SIMULATED_SCHEME}
    return {_identity(port) for port in ports if not port.startswith(SIMULATED_SCHEME)}


def _identity(port: str) -> str:
    return port.lower() if "://" in port else os.path.realpath(port)


def _lock_of(bench: Bench, port: str, night: Path) -> LockFile:
    def refuse(owner: Owner | None) -> str:
        return (
            f"{bench.source or bench.name}: another controller owns the bench ({port}: {owner or 'owner unknown'}); "
            "wait until it has ended, or abort it first"
        )

    name = hashlib.sha256(port.encode()).hexdigest()[:16]
    folder = _RUNTIME if os.access(_RUNTIME, os.W_OK) else Path(tempfile.gettempdir())
    return LockFile(folder / f"hil-bench-{name}.lock", refuse, what=str(night.resolve()), shared=True)
