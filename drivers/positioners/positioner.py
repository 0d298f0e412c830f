"""Bringing the unit to a collect position: by its own indexing, or by an operator who is asked and confirms."""

from typing import Protocol


class Positioner(Protocol):
    """Moves the unit between collect positions, and knows where it is."""

    def move_to(self, position: str, timeout_s: float) -> None:
        """Go to `position` and return once it is confirmed; raise `DeviceTimeout` or `DeviceError` otherwise."""

    def position(self) -> str | None:
        """Return the confirmed position, or None where it is not known."""
