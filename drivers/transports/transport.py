"""Bytes to and from a device, with deadlines: of a serial port, a TCP socket, a simulated device in memory."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceError, DeviceTimeout, ProtocolError, SensorFault, TransportError

Reply = TypeVar("Reply")

ATTEMPTS = 3
"""How often something is tried at a device: one glitch must not end a night."""


@dataclass(frozen=True)
class Timing:
    """How a controller wants to be spoken to, seconds.

    `late_s` is for replies that do not show which request they answer (a bare number): after a request without an
    answer the line is listened to for so long, so that a late reply is not taken for the next one's.
    """

    timeout_s: float = 2.0
    pause_after_query_s: float = 0.3
    pause_after_command_s: float = 0.5
    late_s: float = 0.0


_POLL_S = 0.002  # between looks while a read waits
_SHOWN = 60  # bytes of what arrived in a message: noise without end must not fill it


class Transport(ABC):
    """A two-way byte stream. Reads never block past their deadline, the clock's; every failure is a `TransportError`.

    `name` is the port as a person would name it: `/dev/ttyUSB0`, `socket://192.0.2.7:10001`, `sim://imu`. A transport
    says how bytes are written, and how what has come is added to `_arrived`.
    """

    def __init__(self, name: str, clock: Clock) -> None:
        self.name = name
        self._clock = clock
        self._arrived = bytearray()

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send all of `data`."""

    @abstractmethod
    def close(self) -> None:
        """Release the port. Closing twice is allowed."""

    @abstractmethod
    def _fill(self) -> None:
        """Take over what is there, without waiting; raise `TransportError` where there will be nothing."""

    def read_available(self) -> bytes:
        """Return what has already arrived, perhaps nothing; never waits."""
        self._fill()
        return self._take(len(self._arrived))

    def read(self, size: int, timeout_s: float) -> bytes:
        """Return `size` bytes, or fewer where `timeout_s` passed first."""
        deadline_s = self._clock.now() + timeout_s
        self._fill()
        while len(self._arrived) < size and self._fill_before(deadline_s):
            pass
        return self._take(min(size, len(self._arrived)))

    def read_until(self, terminator: bytes, timeout_s: float) -> bytes:
        """Return bytes up to and including `terminator`; raise `DeviceTimeout` naming what arrived instead."""
        deadline_s = self._clock.now() + timeout_s
        self._fill()
        while terminator not in self._arrived:
            if not self._fill_before(deadline_s):
                size, begin = len(self._arrived), bytes(self._arrived[:_SHOWN])
                arrived = f"{begin!r}, the first of {size} bytes" if size > _SHOWN else repr(begin)
                raise DeviceTimeout(f"{self.name}: no {terminator!r} within {timeout_s:g} s; what arrived: {arrived}")
        return self._take(self._arrived.index(terminator) + len(terminator))

    def _take(self, size: int) -> bytes:
        data = bytes(self._arrived[:size])
        del self._arrived[:size]
        return data

    def _fill_before(self, deadline_s: float) -> bool:
        """Wait a little and fill; False, and nothing is done, where the deadline has passed."""
        now_s = self._clock.now()
        if now_s >= deadline_s:
            return False
        self._clock.sleep(min(_POLL_S, deadline_s - now_s))
        self._fill()
        return True


class ClosedPort(Transport):
    """A port that is not open here: whoever reads or writes gets the sentence of `reason` as a `TransportError`."""

    def __init__(self, name: str, clock: Clock, reason: DeviceError) -> None:
        super().__init__(name, clock)
        self._reason = reason

    def write(self, data: bytes) -> None:
        self._fill()

    def close(self) -> None:
        """Do nothing: nothing is open."""

    def _fill(self) -> None:
        raise TransportError(str(self._reason)) from self._reason


def own_port(name: str, clock: Clock) -> ClosedPort:
    """Return a port that the library of a device opens by itself: it has a name, and carries no byte of ours."""
    only = f"{name}: only a driver that opens its device itself has such a port; name the port"
    return ClosedPort(name, clock, TransportError(only))


def asked(ask: Callable[[], Reply]) -> Reply:
    """Return what `ask` does, tried at most `ATTEMPTS` times; raise its last error, saying how often it was tried.

    A read may be repeated, because nothing changes by it. A refusal is asked again too: noise on the line turns a good
    request into an unknown one; and so is a port that failed, because a transport opens it again where it can.
    """
    left = ATTEMPTS
    while True:
        left -= 1
        try:
            return ask()
        except (DeviceTimeout, ProtocolError, SensorFault, CommandRefused, TransportError) as error:
            if left <= 0:
                raise type(error)(f"{error} (asked {ATTEMPTS} times)") from error
