"""Simulated devices, beside the real drivers and never inside them. They speak the same bytes.

No driver and no procedure imports from here (an import contract checks it); `hil` puts them together.
"""

from typing import Protocol


class SimulatedDevice(Protocol):
    """A device at the far end of a transport: in memory, on a pty, or on a TCP port.

    It is lazy: nothing runs between calls. `now_s` is the caller's clock and never goes backwards.
    """

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes that the host sent at `now_s`."""

    def transmit(self, now_s: float) -> bytes:
        """Return the bytes that the device has sent since the last call, up to `now_s`."""

    def next_transmission(self, now_s: float) -> float | None:
        """Return when the device will next send a byte if nothing is asked of it, or None for never."""
