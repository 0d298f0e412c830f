"""A server of simulated devices in a thread of its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

from drivers.simulators.serve import DeviceServer


@contextmanager
def running(server: DeviceServer) -> Iterator[DeviceServer]:
    """Let it serve for as long as the context lasts; raise what a device raised meanwhile."""
    failed: list[BaseException] = []

    def run() -> None:
        try:
            server.run()
        except BaseException as failure:
            failed.append(failure)

    thread = Thread(target=run, name="simulated devices", daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.interrupt()
        thread.join()
    for failure in failed:
        raise failure
