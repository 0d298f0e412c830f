"""The index of a simulated unit: one move at a time, and what the status says meanwhile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.simulators.faults import FaultPlan, ImuFault


@dataclass(frozen=True)
class IndexState:
    """What the frames say: position code (0 while moving) and bits, shape (n,); whether the last command failed."""

    code: NDArray[np.int64]
    moving: NDArray[np.bool_]
    in_position: NDArray[np.bool_]
    fault: bool


class SimulatedIndex:
    """Moves to commanded positions. A command during a move begins a new one from where it is."""

    def __init__(self, positions: Mapping[str, int], first: str, move_s: float, faults: FaultPlan) -> None:
        self.positions = positions
        self._faults = faults
        self.move_s = move_s
        self._code = positions[first]  # where it is, or where it is going
        self._arrives_s = -np.inf
        self._fault = False

    def command(self, label: str, now_s: float) -> list[tuple[str, float, float]]:
        """Take the command to go to `label`; return the move (target, begins_s, ends_s) that begins, if one does.

        An index that is stuck says that it moves, and does not; one that slips even says that it has arrived.
        """
        if self._faults.active(ImuFault.INDEX_REFUSED, now_s):
            self._fault = True
            return []
        self._fault = False
        if self._faults.active(ImuFault.INDEX_WRONG_POSITION, now_s):
            label = next(other for other in self.positions if other != label)
        stuck = self._faults.active(ImuFault.INDEX_NEVER_FINISHES, now_s)
        slips = self._faults.active(ImuFault.INDEX_SLIPS, now_s)
        self._code = self.positions[label]
        self._arrives_s = np.inf if stuck else now_s + self.move_s
        return [] if stuck or slips else [(label, now_s, float(self._arrives_s))]

    def state(self, times_s: NDArray[np.float64]) -> IndexState:
        """Return the state at `times_s`, shape (n,), all after the last command and before the next one."""
        moving = times_s < self._arrives_s
        return IndexState(
            code=np.where(moving, 0, self._code),
            moving=moving,
            in_position=~moving,
            fault=self._fault,
        )
