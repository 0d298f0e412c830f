"""The in-process transport waits by jumping the clock, and fails as a port fails."""

from __future__ import annotations

import pytest

from drivers.clock import VirtualClock
from drivers.errors import DeviceTimeout, TransportError
from drivers.simulators.memory import MemoryTransport


class Beacon:
    """Sends `.` every 10 s, and repeats what it is told after `delay_s`."""

    def __init__(self, delay_s: float = 3.0, first_s: float = 10.0) -> None:
        self.delay_s = delay_s
        self.calls = 0
        self._next_s = first_s
        self._replies: list[tuple[float, bytes]] = []

    def receive(self, data: bytes, now_s: float) -> None:
        """Answer later."""
        self._replies.append((now_s + self.delay_s, data))

    def transmit(self, now_s: float) -> bytes:
        """Send what is due."""
        self.calls += 1
        sent = b"".join(data for when, data in self._replies if when <= now_s)
        self._replies = [(when, data) for when, data in self._replies if when > now_s]
        while self._next_s <= now_s:
            sent += b"."
            self._next_s += 10.0
        return sent

    def next_transmission(self, now_s: float) -> float | None:
        """Return when something is due."""
        return min([self._next_s, *(when for when, _ in self._replies)])


class Mute:
    """Never sends anything."""

    def receive(self, data: bytes, now_s: float) -> None:
        """Take it."""

    def transmit(self, now_s: float) -> bytes:
        """Send nothing."""
        return b""

    def next_transmission(self, now_s: float) -> float | None:
        """Never."""
        return None


def test_a_read_jumps_to_the_moment_at_which_the_device_sends() -> None:
    """Ten seconds cost a handful of calls, and the clock shows them."""
    clock, device = VirtualClock(), Beacon()
    transport = MemoryTransport(device, clock, "sim://beacon")
    assert transport.read(2, timeout_s=60.0) == b".."
    assert clock.now() == pytest.approx(20.0)
    assert device.calls < 10


def test_a_read_that_gets_too_little_returns_it_at_the_deadline() -> None:
    """Fewer bytes, no exception, and not a moment later."""
    clock = VirtualClock()
    assert MemoryTransport(Beacon(), clock, "sim://beacon").read(5, timeout_s=25.0) == b".."
    assert clock.now() == pytest.approx(25.0)
    assert MemoryTransport(Mute(), clock, "sim://mute").read(1, timeout_s=5.0) == b""
    assert clock.now() == pytest.approx(30.0)


def test_reading_until_a_terminator_leaves_the_rest() -> None:
    """What follows the terminator is there for the next read."""
    clock = VirtualClock()
    transport = MemoryTransport(Beacon(), clock, "sim://beacon")
    transport.write(b"OK\r\nmore")
    assert transport.read_until(b"\r\n", timeout_s=5.0) == b"OK\r\n"
    assert clock.now() == pytest.approx(3.0)
    assert transport.read_available() == b"more"


def test_a_terminator_that_does_not_come_is_a_timeout_that_says_what_came() -> None:
    """The message names the port and the bytes."""
    transport = MemoryTransport(Beacon(), VirtualClock(), "sim://beacon")
    transport.write(b"garb")
    with pytest.raises(DeviceTimeout, match=r"sim://beacon: no b'\\r\\n' within 5 s; what arrived: b'garb'"):
        transport.read_until(b"\r\n", timeout_s=5.0)


def test_draining_throws_away_a_late_reply() -> None:
    """A stale reply cannot answer the next request."""
    clock = VirtualClock()
    transport = MemoryTransport(Beacon(), clock, "sim://beacon")
    transport.write(b"late")
    clock.sleep(4.0)
    assert transport.read_available() == b"late"
    assert transport.read_available() == b""


def test_an_unplugged_port_fails_and_what_was_sent_meanwhile_is_lost() -> None:
    """Every call fails until the cable is back; nothing old arrives then."""
    clock = VirtualClock()
    transport = MemoryTransport(Beacon(), clock, "sim://beacon")
    transport.pulled_between.append((0.0, 35.0))
    for call in (transport.read_available, lambda: transport.write(b"x"), lambda: transport.read(1, 1.0)):
        with pytest.raises(TransportError, match="sim://beacon: the port is gone"):
            call()
    clock.sleep(35.0)
    assert transport.read_available() == b""
    assert transport.read(1, 10.0) == b"."


def test_a_closed_port_may_be_closed_again_but_not_read() -> None:
    """Closing twice is allowed."""
    transport = MemoryTransport(Mute(), VirtualClock(), "sim://mute")
    transport.close()
    transport.close()
    with pytest.raises(TransportError, match="is closed"):
        transport.read_available()


def test_a_clock_that_rounds_never_stops_a_wait() -> None:
    """Late in the night a tiny step would be lost in the clock's last digit; the wait still ends."""
    clock = VirtualClock(now_s=1e9)
    device = Beacon(first_s=1e9 + 1.0 / 3.0)
    assert MemoryTransport(device, clock, "sim://beacon").read(1, timeout_s=20.0) == b"."
