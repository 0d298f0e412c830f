"""Where the simulated unit is turned to, when it turns, and which self-calibration it takes each stay to belong to.

The unit is one rigid body: both sensors turn by the same rotation. While it turns its rate sensors see the motion, four
orders of magnitude above what is measured, so that a single sample of it in a collect shows.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from hil.campaign import FloatArray
from hil.model.equation import Orientation

Axes = Mapping[int, FloatArray]  # by sensor: its axes in the bench frame, one per row


@dataclass(frozen=True)
class Resumed:
    """What of a night went before, where one is carried on; as it stands, nothing.

    `first_run` is the self-calibration that comes next or is half done, which keeps its run-to-run scatter; `visited`
    are the positions whose collects it has; `session` is a number that no earlier part of the night had, for new noise.
    For `gone_s` the night has been going, and `begun` are the keys of the steps that have, of whichever unit.
    """

    first_run: int = 1
    visited: Sequence[str] = ()
    session: int = 0
    gone_s: float = 0.0
    begun: Collection[str] = ()


FROM_THE_START = Resumed()


@dataclass(frozen=True)
class Leg:
    """A move and the stay after it. The very first leg has no move. Axes are (k, 3) by sensor, `turn_rad` (3,)."""

    position: str
    begins_s: float
    ends_s: float  # of the move
    run: int  # of the self-calibration, from 1
    start: Axes
    stop: Axes
    turn_rad: FloatArray  # rotation vector of the move in the bench frame, (3,)
    settling_s: float = 0.0  # time constant of the settling after the move
    number: int = 0  # in time order; a stay is what a campaign calls a collect

    def turned(self, times_s: FloatArray) -> tuple[Rotation, FloatArray]:
        """Return the rotation since a move began, (n,), and its rate in the bench frame, (n, 3), rad/s."""
        length_s = self.ends_s - self.begins_s
        done = np.clip((times_s - self.begins_s) / length_s, 0.0, 1.0)
        share = done**2 * (3.0 - 2.0 * done)
        speed = 6.0 * done * (1.0 - done) / length_s
        return Rotation.from_rotvec(share[:, None] * self.turn_rad), speed[:, None] * self.turn_rad


class Timeline:
    """Every leg so far. Legs are added in time order."""

    def __init__(
        self,
        orientations: Mapping[int, Mapping[str, Orientation]],
        position: str,
        *,
        resumed: Resumed,
        new_run_after_s: float,
    ) -> None:
        self._orientations = orientations
        self._new_run_after_s = new_run_after_s
        self._visited = set(resumed.visited)  # positions of the present run
        here = self._axes_at(position)
        self.legs = [Leg(position, -np.inf, -np.inf, resumed.first_run, here, here, np.zeros(3))]

    def place(self, position: str) -> None:
        """Put the unit where it is at power-on; only before the first move."""
        here = self._axes_at(position)
        self.legs[0] = replace(self.legs[0], position=position, start=here, stop=here)

    def add(self, position: str, begins_s: float, ends_s: float, settling_s: float) -> Leg:
        """Add a move. A return to a position of the present run, after a rest, begins the next self-calibration."""
        last = self.legs[-1]
        run = last.run
        if position in self._visited and begins_s - last.ends_s >= self._new_run_after_s:
            run += 1
            self._visited.clear()
        self._visited.add(position)
        start, stop = last.stop, self._axes_at(position)
        if begins_s < last.ends_s:  # on the way still
            turned = last.turned(np.array([begins_s]))[0].as_matrix()[0]
            start = {number: axes @ turned.T for number, axes in last.start.items()}
        sensor = min(stop)
        turn = Rotation.from_matrix(stop[sensor].T @ start[sensor]).as_rotvec()
        leg = Leg(position, begins_s, ends_s, run, start, stop, turn, settling_s, len(self.legs))
        self.legs.append(leg)
        return leg

    def parts(self, times_s: FloatArray) -> Iterator[tuple[Leg, bool, slice]]:
        """Yield (leg, moving, slice of `times_s`) so that every time, (n,), belongs to one part; times rise."""
        first_s = times_s[0]
        number = len(self.legs) - 1
        while self.legs[number].begins_s > first_s:
            number -= 1
        at = 0
        for leg, following in zip(self.legs[number:], [*self.legs[number + 1 :], None], strict=True):
            until_s = np.inf if following is None else following.begins_s
            for moving, end_s in ((True, min(leg.ends_s, until_s)), (False, until_s)):
                stop = int(np.searchsorted(times_s, end_s, side="left"))
                if stop > at:
                    yield leg, moving, slice(at, stop)
                    at = stop

    def _axes_at(self, position: str) -> dict[int, FloatArray]:
        return {number: table[position].axes for number, table in self._orientations.items()}
