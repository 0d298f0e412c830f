"""Two programs on one TCP port would read each other's answers: the second one is kept out."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from drivers.clock import VirtualClock
from drivers.errors import TransportError
from drivers.simulators.memory import MemoryTransport
from drivers.simulators.transcript import TranscriptDevice
from drivers.transports import Transport
from drivers.transports.port_owner import owned

URL = "socket://192.0.2.7:10001"


@pytest.fixture(autouse=True)
def _locks_of_our_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


def _open() -> Transport:
    return MemoryTransport(TranscriptDevice([(b"T?\n", b"1\n2\n")]), VirtualClock(), URL)


def test_a_second_owner_is_refused_until_the_first_has_closed() -> None:
    """In one program as between two; the message names the process."""
    first = owned(URL, _open)
    with pytest.raises(TransportError, match=rf"{URL}: somebody else has the port open \(process {os.getpid()}\)"):
        owned(URL, _open)
    first.close()
    first.close()
    owned(URL, _open).close()


def test_another_program_is_kept_out_and_a_dead_one_is_not_in_the_way(tmp_path: Path) -> None:
    """The system frees the lock of a program that was killed."""
    code = (
        "import sys, tempfile, time\n"
        f"tempfile.tempdir = {str(tmp_path)!r}\n"
        "from drivers.transports.port_owner import _locked\n"
        f"_locked({URL!r})\n"
        "print('held', flush=True)\n"
        "sys.stdin.read()\n"
    )
    other = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(TransportError, match=rf"process {other.pid}"):
            owned(URL, _open)
        other.kill()
        other.wait(10.0)
        owned(URL, _open).close()


def test_other_ports_are_other_locks_and_serial_ports_need_none(tmp_path: Path) -> None:
    """A path is guarded by the system."""
    first, second = owned(URL, _open), owned("socket://192.0.2.7:10002", _open)
    owned("/dev/ttyUSB0", _open)
    owned("/dev/ttyUSB0", _open)
    assert len(list(tmp_path.glob("hil-port-*.lock"))) == 2
    first.close()
    second.close()


def test_a_port_that_cannot_be_opened_is_not_owned() -> None:
    """The lock is given back."""

    def fail() -> Transport:
        raise TransportError("no")

    with pytest.raises(TransportError, match="no"):
        owned(URL, fail)
    owned(URL, _open).close()


def test_everything_else_goes_through() -> None:
    """All of the transport, to the byte."""
    port = owned(URL, _open)
    port.write(b"T?\n")
    assert port.name == URL
    assert port.read_until(b"\n", 1.0) == b"1\n"
    assert port.read(1, 1.0) == b"2"
    assert port.read_available() == b"\n"
    assert port.drain() == b""
    port.close()
