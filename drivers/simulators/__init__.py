"""Simulated devices, beside the real drivers and never inside them. They speak the same bytes.

No driver and no procedure imports from here (an import contract checks it); `hil` puts them together.
"""

from typing import Protocol


class SimulatedDevice(Protocol):
    """The far end of a transport: lazy, nothing runs between calls. `now_s` is the caller's clock, never going back."""

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes that the host sent at `now_s`."""

    def transmit(self, now_s: float) -> bytes:
        """Return the bytes that the device has sent since the last call, up to `now_s`."""

    def next_transmission(self, now_s: float) -> float | None:
        """Return when the device will next send a byte if nothing is asked of it, or None for never."""
