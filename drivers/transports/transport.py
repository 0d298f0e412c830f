"""Bytes to and from a device, with deadlines.

Everything that talks to a device talks through a `Transport`, so a serial port, a TCP socket and a simulated device
in memory are interchangeable.
"""

from typing import Protocol


class Transport(Protocol):
    """A two-way byte stream. Reads never block past their deadline; every failure is a `TransportError`."""

    @property
    def name(self) -> str:
        """The port as a person would name it: `/dev/ttyUSB0`, `socket://192.0.2.7:10001`, `sim://imu`."""

    def write(self, data: bytes) -> None:
        """Send all of `data`."""

    def read_available(self) -> bytes:
        """Return what has already arrived, perhaps nothing; never waits."""

    def read(self, size: int, timeout_s: float) -> bytes:
        """Return `size` bytes, or fewer where `timeout_s` passed first."""

    def read_until(self, terminator: bytes, timeout_s: float) -> bytes:
        """Return bytes up to and including `terminator`; raise `DeviceTimeout` naming what arrived instead."""

    def drain(self) -> bytes:
        """Throw away and return what has arrived, so that a late reply cannot answer the next request."""

    def close(self) -> None:
        """Release the port. Closing twice is allowed."""
