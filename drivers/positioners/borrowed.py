"""A positioner that a device of another library is: a rotary table of ophyd, ophyd-async, pymeasure."""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass

from drivers.borrowed import Value
from drivers.clock import Clock
from drivers.errors import DeviceTimeout

_POLL_S = 0.1


@dataclass(eq=False)
class BorrowedPositioner:
    """A `drivers.positioners.positioner.Positioner`: `move` is told an angle of `degrees`, `angle` says where it is.

    `stop` is called where it does not get there in time.
    """

    clock: Clock
    degrees: Mapping[str, float]
    move: Value
    angle: Value
    _: KW_ONLY
    tolerance_deg: float = 0.1
    stop: Callable[[], object] = lambda: None

    def position(self) -> str | None:
        """Return the position in which it lies, None between two. Angles that differ by whole turns are one."""
        now = float(self.angle.get())
        off = {label: abs((now - degrees + 180.0) % 360.0 - 180.0) for label, degrees in self.degrees.items()}
        return next((label for label, by in off.items() if by <= self.tolerance_deg), None)

    def move_to(self, position: str, timeout_s: float) -> None:
        """Turn there and wait until it is there; raise `DeviceTimeout` where it is not in time."""
        give_up_s = self.clock.now() + timeout_s
        try:
            self.move.put(self.degrees[position], timeout_s)
        except DeviceTimeout:
            self.stop()
            raise
        while self.position() != position:
            if self.clock.now() >= give_up_s:
                self.stop()
                raise DeviceTimeout(f"the table is not in position {position} after {timeout_s:g} s; look at its drive")
            self.clock.sleep(_POLL_S)
