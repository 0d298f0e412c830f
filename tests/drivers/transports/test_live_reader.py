"""The live reader: drains a port whatever the rest does, loses nothing silently, and ends without a trace."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.errors import DeviceTimeout, TransportError
from drivers.frames.counts import StreamCounts
from drivers.frames.layout import encode
from drivers.imu.stream import StreamImu
from drivers.simulators.serve import DeviceServer
from drivers.simulators.unit import SimulatedImu
from drivers.transports import open_port
from drivers.transports.live_reader import LiveReader
from tests.drivers.frames.streams import SteadyPhysics, mfs
from tests.drivers.simulators.running import running


class Port:
    """A port whose bytes and failures a test scripts; it waits as a real one does."""

    name = "test://port"

    def __init__(self) -> None:
        self.arriving = b""
        self.failure: TransportError | None = None
        self.written = b""
        self.closed = False
        self.reads = 0
        self._changed = threading.Condition()
        self._waiting, self._waits, self._known_after = False, 0, 0

    def send(self, data: bytes) -> None:
        """Let bytes arrive."""
        with self._changed:
            self.arriving += data
            self._tell()

    def fail(self, failure: TransportError | None) -> None:
        """Let the port fail, or come back."""
        with self._changed:
            self.failure = failure
            self._tell()

    def _tell(self) -> None:
        self._known_after = self._waits + (not self._waiting)  # this wait sees it, or the next
        self._changed.notify_all()

    @property
    def settled(self) -> bool:
        """Whether who reads has dealt with everything: it waits again after the wait that saw the last change."""
        with self._changed:
            return self._waits > self._known_after

    def wait(self, timeout_s: float) -> bool:
        """Wait as a real port does."""
        with self._changed:
            self._waits, self._waiting = self._waits + 1, True
            self._changed.wait_for(lambda: self.arriving or self.failure, timeout_s)
            self._waiting = False
            if self.failure:
                raise self.failure
            return bool(self.arriving)

    def read_available(self) -> bytes:
        """Return what has arrived."""
        with self._changed:
            self.reads += 1
            data, self.arriving = self.arriving, b""
            return data

    def write(self, data: bytes) -> None:
        """Remember what was written."""
        self.written += data

    def close(self) -> None:
        """Remember that it was closed."""
        self.closed = True


@pytest.fixture
def port() -> Port:
    """Return a scripted port."""
    return Port()


@pytest.fixture
def reader(port: Port) -> Iterator[LiveReader]:
    """Return a reader of the port; fail the test where its thread outlives it."""
    before = set(threading.enumerate())
    reader = LiveReader(port, SystemClock(), most_bytes=1000)  # type: ignore[arg-type]
    yield reader
    reader.close()
    assert set(threading.enumerate()) == before
    assert port.closed


def until(condition: Callable[[], object]) -> None:
    """Wait until the thread has done its part."""
    deadline = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def test_bytes_are_kept_in_order_and_given_as_asked(port: Port, reader: LiveReader) -> None:
    """Several arrivals join; reads take their part and leave the rest."""
    for part in (b"abc", b"def\r", b"\nrest"):
        port.send(part)
        until(lambda: port.settled)
    assert reader.read(4, timeout_s=5.0) == b"abcd"
    assert reader.read_until(b"\r\n", timeout_s=5.0) == b"ef\r\n"
    assert reader.read_available() == b"rest"
    assert reader.read_available() == b""
    reader.write(b"hello")
    assert port.written == b"hello"
    with pytest.raises(DeviceTimeout, match=r"test://port: no b'x' within 0.01 s"):
        reader.read_until(b"x", timeout_s=0.01)


def test_what_nobody_takes_is_bounded_and_counted(port: Port, reader: LiveReader) -> None:
    """The oldest bytes go, the newest stay, and every one that went is counted once."""
    for number in range(30):
        port.send(bytes([number]) * 100)
        until(lambda: port.settled)
    data = reader.read_available()
    assert data == b"".join(bytes([number]) * 100 for number in range(20, 30))
    assert (reader.take_overflow(), reader.take_overflow()) == (2000, 0)


@pytest.mark.slow
def test_a_failure_is_raised_after_the_bytes_before_it_and_as_long_as_it_lasts(port: Port, reader: LiveReader) -> None:
    """Then the port is back, and so are its bytes; an outage that nobody saw is raised once."""
    port.send(b"before")
    until(lambda: port.settled)
    port.fail(TransportError("test://port: gone"))
    until(lambda: port.settled)
    assert reader.read_available() == b"before"
    for _ in range(3):
        with pytest.raises(TransportError, match="gone"):
            reader.read_available()
    port.fail(None)
    until(lambda: port.settled)
    assert reader.read_available() == b""
    port.fail(TransportError("test://port: gone again"))
    until(lambda: port.settled)
    port.fail(None)
    port.send(b"after")
    until(lambda: port.settled)
    with pytest.raises(TransportError, match="gone again"):
        reader.read_available()
    assert reader.read_available() == b"after"


def test_a_failure_is_not_forgotten_where_bytes_overflow(port: Port, reader: LiveReader) -> None:
    """The bytes before and behind it are too many; it is still raised."""
    port.send(b"x" * 10)
    until(lambda: port.settled)
    port.fail(TransportError("test://port: gone"))
    until(lambda: port.settled)
    port.fail(None)
    port.send(b"y" * 2000)
    until(lambda: port.settled)
    assert reader.take_overflow() == 2010
    with pytest.raises(TransportError, match="gone"):
        reader.read_available()


def test_a_closed_reader_stays_closed(port: Port) -> None:
    """Its thread has ended, the port is released, and reading says so."""
    before = set(threading.enumerate())
    reader = LiveReader(port, SystemClock())  # type: ignore[arg-type]
    assert set(threading.enumerate()) > before
    reader.close()
    reader.close()
    assert set(threading.enumerate()) == before
    with pytest.raises(TransportError, match="the port is closed"):
        reader.read_available()


def test_the_driver_counts_what_overflowed(port: Port, reader: LiveReader) -> None:
    """In its counts, beside the frames that the counter misses."""
    sent = encode(mfs(), "sample", {"counter": np.arange(33)})
    imu = StreamImu(reader, mfs(), SystemClock())
    port.send(sent[: 59 * 3])
    until(lambda: port.settled)
    assert imu.read_block().counts == StreamCounts(ok=3)
    for at in range(59 * 3, len(sent), 59):
        port.send(sent[at : at + 59])
        until(lambda: port.settled)
    counts = imu.read_block().counts
    assert counts.overflow_bytes >= 59 * 30 - 1000
    assert counts.overflow_bytes == 59 * 30 - counts.ok * 59
    assert counts.lost == 30 - counts.ok
    assert imu.read_block().counts == StreamCounts()


class Metered:
    """A real port that counts what it gave before it was last waited at: so much its reader has dealt with."""

    def __init__(self, port: Any) -> None:
        self.name = port.name
        self.wait_at, self.write, self.read, self.close = port.wait, port.write, port.read, port.close
        self._take = port.read_available
        self._given = 0
        self.settled = 0

    def wait(self, timeout_s: float) -> bool:
        """Wait as the port does."""
        self.settled = self._given
        return bool(self.wait_at(timeout_s))

    def read_available(self) -> bytes:
        """Return what has arrived."""
        data: bytes = self._take()
        self._given += len(data)
        return data


def test_a_real_terminal_is_drained_while_nobody_reads() -> None:
    """More than the system would keep arrives during a long pause; nothing is missing afterwards."""
    master, slave = os.openpty()
    port = Metered(open_port(os.ttyname(slave), clock=SystemClock()))
    reader = LiveReader(port, SystemClock())  # type: ignore[arg-type]
    sent = encode(mfs(), "sample", {"counter": np.arange(5000)})
    at = 0
    while at < len(sent):
        at += os.write(master, sent[at : at + 2048])
    until(lambda: port.settled == len(sent))
    imu = StreamImu(reader, mfs(), SystemClock())
    assert imu.read_block().counts == StreamCounts(ok=5000)
    imu.close()
    for descriptor in (master, slave):
        os.close(descriptor)


def test_unplugging_and_replugging_a_server_is_survived() -> None:
    """The connection is lost and comes back by itself; the driver sees one error and then samples."""
    clock = SystemClock()
    server = DeviceServer({"imu": SimulatedImu(mfs(200.0), SteadyPhysics())}, clock, tcp_ports={"imu": 0})
    with running(server):
        url = server.urls["imu"]
        reader = LiveReader(open_port(url, clock=clock), clock)
        imu = StreamImu(reader, mfs(200.0), clock)
        until(lambda: imu.read_block().counts.ok)

    def is_down() -> bool:
        with suppress(TransportError):  # bytes may be left from before
            imu.discard()
            return False
        return True

    until(is_down)
    with pytest.raises(TransportError, match="socket://"):
        imu.read_block()
    begins_s = clock.now()
    device = SimulatedImu(mfs(200.0), SteadyPhysics(), starts_s=begins_s)
    with running(DeviceServer({"imu": device}, clock, tcp_ports={"imu": int(url.rsplit(":", 1)[1])})):
        counts = StreamCounts()

        def reads() -> bool:
            nonlocal counts
            with suppress(TransportError):
                counts += imu.read_block().counts
            return counts.ok > 20

        until(reads)
        imu.close()
    assert counts.bad_checksum == 0
