"""A controller's own timer, kept from running out while somebody looks after the chamber.

dead_man = DeadMan(controller, clock, seconds=10800.0)
dead_man.arm()          # before the first setpoint
dead_man.renew()        # at every look: arms again when a quarter of the time has passed
dead_man.rest()         # from the safe state on nobody renews it
"""

from dataclasses import dataclass, field

from drivers.chambers.controller import Controller
from drivers.clock import Clock
from drivers.errors import CommandRefused, ProtocolError

_RENEWED_WITHIN = 0.25  # of its time, so that a renewal which fails can be tried anew


@dataclass(eq=False)
class DeadMan:
    """The timer of one controller; `seconds` None for none at all. What it does raises what the controller raises.

    One that nobody asked for (`asked` False) is armed where the controller has one, and otherwise done without.
    """

    controller: Controller
    clock: Clock
    seconds: float | None
    asked: bool = True
    _armed_at_s: float | None = field(default=None, init=False)

    def arm(self) -> None:
        """Begin its time; raise `CommandRefused` where the controller has no timer."""
        if self.seconds is None:
            return
        device = self.controller.device
        try:
            if not self.controller.arm_dead_man(self.seconds):
                raise CommandRefused(f"{device} has no timer of its own; take dead_man out of the bench file")
        except (CommandRefused, ProtocolError):
            if self.asked:
                raise
            return
        self._armed_at_s = self.clock.now()

    def renew(self) -> None:
        """Begin its time anew, where it was armed and some of it has passed."""
        if self._armed_at_s is None or self.seconds is None:
            return
        if self.clock.now() - self._armed_at_s >= _RENEWED_WITHIN * self.seconds:
            self.arm()

    def rest(self) -> None:
        """Renew it no more; what is left of its time runs out."""
        self._armed_at_s = None
