"""A port that could not be opened, in a bench that is looked at all the same: whatever uses it gets the reason."""

from drivers.clock import Clock
from drivers.errors import DeviceError, TransportError
from drivers.transports import Transport


class ClosedPort(Transport):
    """A `Transport` that never opened. Every use raises a `TransportError` with the sentence of `reason`."""

    def __init__(self, url: str, clock: Clock, reason: DeviceError) -> None:
        super().__init__(url, clock)
        self._reason = reason

    def write(self, data: bytes) -> None:
        """Send nothing."""
        del data
        self._fill()

    def close(self) -> None:
        """Do nothing: nothing is open."""

    def _fill(self) -> None:
        raise TransportError(str(self._reason)) from self._reason
