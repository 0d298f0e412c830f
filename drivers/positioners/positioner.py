"""Bringing the unit to a collect position: by its own indexing, or by an operator who is asked and confirms."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Protocol

from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceError, DeviceTimeout


class Positioner(Protocol):
    """Moves the unit between collect positions, and knows where it is.

    One that others can move beside has a method `moving` too, which does as `move_to` and yields each time how many
    seconds to wait.
    """

    def move_to(self, position: str, timeout_s: float) -> None:
        """Go to `position` and return once it is confirmed; raise `DeviceTimeout` or `DeviceError` otherwise."""

    def position(self) -> str | None:
        """Return the confirmed position, or None where it is not known."""


def move_all(
    positioners: Mapping[str, Positioner], clock: Clock, position: str, timeout_s: float
) -> Mapping[str, DeviceError]:
    """Bring units to `position`, at once where they can; return failures by unit. What turns several is told once."""
    turned: dict[int, list[str]] = {}
    for name, each in positioners.items():
        turned.setdefault(id(each), []).append(name)
    # What can only move alone comes first: no other is on its way meanwhile.
    in_order = sorted(turned.values(), key=lambda names: hasattr(positioners[names[0]], "moving"))
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
    if hasattr(positioner, "moving"):
        yield from positioner.moving(position, timeout_s)
    else:
        positioner.move_to(position, timeout_s)


AskOperator = Callable[[str, float], bool | None]
"""Puts a question to the operator: on a terminal, a dashboard, or in a test. Takes it and how many seconds there are.

Returns True where the operator confirms, False where they refuse, None where no answer came in time.
"""


@dataclass(eq=False)
class OperatorPositioner:
    """A `Positioner` that asks an operator. The position is unknown until, and unless, it is confirmed.

    `instructions` says per position how the unit is to lie; where it is given, other positions are refused. Every
    position is asked for, also that in which the unit lies: seating anew is the point. `hands` turn a simulated unit.
    """

    ask: AskOperator
    clock: Clock
    _: KW_ONLY
    instructions: Mapping[str, str] = field(default_factory=dict)
    hands: Callable[[str], None] | None = None
    _position: str | None = field(default=None, init=False)

    def move_to(self, position: str, timeout_s: float) -> None:
        """Ask for `position`; `CommandRefused`, `DeviceTimeout` where nobody answers, `DeviceError` where unknown."""
        if self.instructions and position not in self.instructions:
            known = ", ".join(sorted(self.instructions))
            raise DeviceError(f"the bench has no position {position}; its operator knows {known}")
        self._position = None
        asked_s = self.clock.now()
        if self.hands is not None:
            self.hands(position)
        how = f" ({lies})" if (lies := self.instructions.get(position)) else ""
        question = f"Bring the unit to position {position}{how} and confirm when it lies still."
        answer = self.ask(question, timeout_s)
        waited_s = self.clock.now() - asked_s
        if answer is None or waited_s > timeout_s:
            raise DeviceTimeout(
                f"the operator did not confirm position {position} within {timeout_s:g} s; "
                "bring the unit there and start the step again"
            )
        if not answer:
            raise CommandRefused(f"the operator refused to confirm position {position}; ask why before going on")
        self._position = position

    def position(self) -> str | None:
        return self._position
