"""Bringing the unit to a collect position: by its own indexing, or by an operator who is asked and confirms."""

from collections.abc import Iterator, Mapping
from typing import Protocol, runtime_checkable

from drivers.clock import Clock
from drivers.errors import DeviceError


class Positioner(Protocol):
    """Moves the unit between collect positions, and knows where it is."""

    def move_to(self, position: str, timeout_s: float) -> None:
        """Go to `position` and return once it is confirmed; raise `DeviceTimeout` or `DeviceError` otherwise."""

    def position(self) -> str | None:
        """Return the confirmed position, or None where it is not known."""


@runtime_checkable
class BesideOthers(Protocol):
    """A positioner that waits a while at a time, so that others move meanwhile."""

    def moving(self, position: str, timeout_s: float) -> Iterator[float]:
        """Do as `move_to`, and yield how many seconds to wait each time."""


def move_all(
    positioners: Mapping[str, Positioner], clock: Clock, position: str, timeout_s: float
) -> Mapping[str, DeviceError]:
    """Bring units to `position`, at once where they can; return failures by unit. What turns several is told once."""
    turned: dict[int, list[str]] = {}
    for name, each in positioners.items():
        turned.setdefault(id(each), []).append(name)
    # What can only move alone comes first: no other is on its way meanwhile.
    in_order = sorted(turned.values(), key=lambda names: isinstance(positioners[names[0]], BesideOthers))
    moves = {tuple(names): _moving(positioners[names[0]], position, timeout_s) for names in in_order}
    waits_s, failed = dict.fromkeys(moves, 0.0), dict[str, DeviceError]()
    while waits_s:
        for names in [names for names, left_s in waits_s.items() if left_s <= 0.0]:
            try:
                waits_s[names] = next(moves[names])
            except (StopIteration, DeviceError) as ended:
                del waits_s[names]
                if isinstance(ended, DeviceError):
                    failed.update(dict.fromkeys(names, ended))
        if waits_s:
            wait_s = min(waits_s.values())
            clock.sleep(wait_s)
            waits_s = {names: left_s - wait_s for names, left_s in waits_s.items()}
    return failed


def _moving(positioner: Positioner, position: str, timeout_s: float) -> Iterator[float]:
    if isinstance(positioner, BesideOthers):
        yield from positioner.moving(position, timeout_s)
    else:
        positioner.move_to(position, timeout_s)
