"""All that may be wrong with a run, and how probable each is before the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.model.effects.prior import COMMON

ODDS = {
    "rate": 0.05,
    "collect": 0.05,
    "exchanged": 0.02,
    "channels": 0.005,
    "sensors": 0.005,
    "turned": 0.005,
    "all turned": 0.00025,
    "bias": 0.02,
    "run": 0.02,
}
"""Prior odds that a campaign has one of a kind; the search has these, too."""
AS_IT_LAY = float(np.log(1e4))
"""Log odds that labels are exchanged where the unit's accelerometers say so, rather than that these are wrong."""
MOSTLY = float(np.log(COMMON / (1.0 - COMMON)))
"""Log odds that labels which are exchanged in one sensor are so in another that was recorded with it."""
AGAIN = 0.3
"""How probably labels that are exchanged, or signs turned, in one run are so in more: whoever did it did so again."""


@dataclass(frozen=True)
class Cause:
    """One thing that may be wrong with a run: what, in which `rows` (k,), of some `channels` or, empty, of all.

    `off` is by how much, deg/hr, its first row is off in each channel, (c,); nothing where that is no matter. `instead`
    are the rates (k, c) of its rows that the other sensor shows, where the two were exchanged.
    """

    what: str
    run: int
    rows: tuple[int, ...]
    channels: tuple[int, ...] = ()
    off: tuple[float, ...] = ()
    instead: tuple[tuple[float, ...], ...] = ()

    @property
    def place(self) -> tuple[object, ...]:
        """What it is one with: a collect of which a rate is wrong is a wrong collect, and a bias is its run's."""
        if self.what in ("rate", "collect"):
            return (self.run, self.rows)
        return (self.what, self.run, self.rows, None if self.what == "bias" else self.channels)


def made_again(times: int, runs: int) -> float:
    """Return the log odds that a mistake was made in one more of so many runs, the `times`-th: any others may be it."""
    return float(np.log(AGAIN * times / (runs - times + 1)))


def all_of(causes: Sequence[str]) -> str:
    """Say of one way to explain rates what is wrong: one thing, or several."""
    return f"{'both ' * (len(causes) == 2)}{', and '.join(causes)}"
