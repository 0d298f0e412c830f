"""The index of a simulated unit: one move at a time, and what the status says meanwhile."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from drivers.simulators.faults import FaultPlan, ImuFault


class SimulatedIndex:
    """Moves to commanded positions. A command during a move begins a new one from where it is."""

    def __init__(self, positions: Mapping[str, int], first: str, move_s: float, faults: FaultPlan) -> None:
        self.positions = positions
        self._faults = faults
        self.move_s = move_s
        self.code = positions[first]  # where it is, or where it is going
        self._arrives_s = -np.inf
        self.failed = False  # the last command

    def command(self, label: str, now_s: float) -> list[tuple[str, float, float]]:
        """Take the command to go to `label`; return the move (target, begins_s, ends_s) that begins, if one does.

        An index that is stuck says that it moves, and does not; one that slips even says that it has arrived.
        """
        if self._faults.active(ImuFault.INDEX_REFUSED, now_s):
            self.failed = True
            return []
        self.failed = False
        if self._faults.active(ImuFault.INDEX_WRONG_POSITION, now_s):
            label = next(other for other in self.positions if other != label)
        stuck = self._faults.active(ImuFault.INDEX_NEVER_FINISHES, now_s)
        slips = self._faults.active(ImuFault.INDEX_SLIPS, now_s)
        self.code = self.positions[label]
        self._arrives_s = np.inf if stuck else now_s + self.move_s
        return [] if stuck or slips else [(label, now_s, float(self._arrives_s))]

    def moving(self, times_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return when it moves of `times_s`, shape (n,), all after the last command and before the next one."""
        return np.asarray(times_s < self._arrives_s)
