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
    """Bring every unit to `position` at once; return what failed, by unit. What turns several is told once."""
    turned: dict[int, list[str]] = {}
    for name, each in positioners.items():
        turned.setdefault(id(each), []).append(name)
    failed: dict[str, DeviceError] = {}
    waits_s: dict[str, float] = {}
    moves: dict[str, Iterator[float]] = {}

    def go_on(names: list[str]) -> None:
        first = names[0]
        try:
            if first in moves:
                waits_s[first] = next(moves[first])
            elif isinstance(each := positioners[first], BesideOthers):
                moves[first] = each.moving(position, timeout_s)
                waits_s[first] = 0.0
            else:
                each.move_to(position, timeout_s)
        except StopIteration:
            del waits_s[first]
        except DeviceError as error:
            waits_s.pop(first, None)
            failed.update(dict.fromkeys(names, error))

    for names in turned.values():
        go_on(names)
    while waits_s:
        for names in turned.values():
            if waits_s.get(names[0], 1.0) <= 0.0:
                go_on(names)
        if waits_s:
            wait_s = min(waits_s.values())
            clock.sleep(wait_s)
            waits_s = {name: left_s - wait_s for name, left_s in waits_s.items()}
    return failed
