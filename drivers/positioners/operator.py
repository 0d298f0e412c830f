"""A positioner that is a person: asked to bring the unit to a position, and believed only once they confirm.

positioner = OperatorPositioner(ask, clock, instructions={"1": "connector up, dowel pins in holes A and B"})
positioner.move_to("1", timeout_s=600.0)
"""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field

from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceError, DeviceTimeout

AskOperator = Callable[[str, float], bool | None]
"""Puts a question to the operator: on a terminal, a dashboard, or in a test. Takes it and how many seconds there are.

Returns True where the operator confirms, False where they refuse, None where no answer came in time.
"""


@dataclass(eq=False)
class OperatorPositioner:
    """A `Positioner` that asks an operator. The position is unknown until, and unless, it is confirmed.

    `instructions` says per position how the unit is to lie; where it is given, other positions are refused. Positions
    are asked for every time, also the one in which the unit already lies: seating it anew is the point. `hands` turn a
    simulated unit, which nobody else can.
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
