"""A positioner that a device of another library is: a rotary table of ophyd, ophyd-async, pymeasure.

table = BorrowedPositioner(clock, {"1": 0.0, "2": 90.0}, Value(motor), Value(motor, "user_readback"))
"""

from collections.abc import Callable, Mapping

from drivers.borrowed import Value
from drivers.clock import Clock
from drivers.errors import DeviceTimeout

_POLL_S = 0.1


class BorrowedPositioner:
    """A `drivers.positioners.positioner.Positioner`: `move` is told an angle of `degrees`, `angle` says where it is.

    `stop` is called where it does not get there in time.
    """

    def __init__(
        self,
        clock: Clock,
        degrees: Mapping[str, float],
        move: Value,
        angle: Value,
        *,
        tolerance_deg: float = 0.1,
        stop: Callable[[], object] = lambda: None,
    ) -> None:
        self._clock, self._degrees, self._tolerance_deg = clock, dict(degrees), tolerance_deg
        self._move, self._angle, self._stop = move, angle, stop

    def position(self) -> str | None:
        """Return the position in which it lies, None between two. Angles that differ by whole turns are one."""
        now = float(self._angle.get())
        off = {label: abs((now - degrees + 180.0) % 360.0 - 180.0) for label, degrees in self._degrees.items()}
        return next((label for label, by in off.items() if by <= self._tolerance_deg), None)

    def move_to(self, position: str, timeout_s: float) -> None:
        """Turn there and wait until it is there; raise `DeviceTimeout` where it is not in time."""
        give_up_s = self._clock.now() + timeout_s
        try:
            self._move.put(self._degrees[position], timeout_s)
        except DeviceTimeout:
            self._stop()
            raise
        while self.position() != position:
            if self._clock.now() >= give_up_s:
                self._stop()
                raise DeviceTimeout(f"the table is not in position {position} after {timeout_s:g} s; look at its drive")
            self._clock.sleep(_POLL_S)
