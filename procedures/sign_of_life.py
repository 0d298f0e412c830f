"""The controller's sign of life, for a watchdog in another process."""

from typing import Protocol


class SignOfLife(Protocol):
    """Tells a watchdog that the controller lives. Given at every poll, and so must cost next to nothing."""

    def alive(self, silent_s: float = 0.0) -> None:
        """Say so, and that no other sign may come for `silent_s` seconds (a device is being waited for)."""


class Unwatched:
    """Nobody watches."""

    def alive(self, silent_s: float = 0.0) -> None:
        """Ignore it."""
