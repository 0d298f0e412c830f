"""A port that could not be opened, in a bench that is looked at all the same: whatever uses it gets the reason."""

from typing import NoReturn

from drivers.errors import DeviceError, TransportError


class ClosedPort:
    """A `Transport` that never opened. Every use raises a `TransportError` with the sentence of `reason`."""

    def __init__(self, url: str, reason: DeviceError) -> None:
        self.name = url
        self._reason = reason

    def close(self) -> None:
        """Do nothing: nothing is open."""

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise TransportError(str(self._reason)) from self._reason

    write = read_available = read = read_until = drain = _refuse
