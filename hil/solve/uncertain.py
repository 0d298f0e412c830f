"""A value and how well it is known: one standard deviation, the degrees of freedom behind it, its intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from scipy.special import ndtr, stdtrit

from hil.solve.runs import finite

CONFIDENCE = 0.95
"""Of every interval that is stated."""


@dataclass(frozen=True)
class Uncertain:
    """A value with one standard deviation, NaN where not known, and the degrees of freedom behind it, in `unit`."""

    value: float
    sd: float
    freedom: float
    runs: int
    unit: str

    @property
    def half_width(self) -> float:
        """Half the 95 % interval."""
        return self.sd * float(stdtrit(self.freedom, 0.5 + 0.5 * CONFIDENCE))

    def expanded(self, sigmas: float) -> float:
        """Return what chance passes on one side as rarely as `sigmas` (more than 0) of a normal one, NaN where unknown.

        It is Student's t on the degrees of freedom behind the standard deviation: k·u of the GUM, G.3 and G.6.
        """
        return self.sd * float(-stdtrit(self.freedom, ndtr(-sigmas)))

    def less(self, other: Uncertain, *, told_together: bool = False) -> Uncertain:
        """Return this less the `other`: the variances of both, and the degrees of freedom behind them.

        Those are Welch's and Satterthwaite's (GUM G.4.1), but of two that the same runs tell no more than of either.
        """
        own = (self, other)
        parts, sd = [each.sd**4 / each.freedom for each in own], math.hypot(self.sd, other.sd)
        least, together = min(each.freedom for each in own), sum(parts)
        freedom = least if told_together else sd**4 / together if together > 0.0 else math.inf
        return Uncertain(self.value - other.value, sd, freedom, min(each.runs for each in own), self.unit)

    def document(self) -> dict[str, Any]:
        """Return the JSON of it: null where a thing is not known."""
        return {
            "value": self.value,
            "sd": finite(self.sd),
            "low": finite(self.value - self.half_width),
            "high": finite(self.value + self.half_width),
            "runs": self.runs,
            "unit": self.unit,
        }
