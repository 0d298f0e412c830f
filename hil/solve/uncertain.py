"""A value and how well it is known: one standard deviation, the degrees of freedom behind it, its intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from scipy.special import ndtr, stdtrit

from hil.solve.runs import finite

CONFIDENCE = 0.95
"""Of every interval that is stated."""


@dataclass(frozen=True)
class Uncertain:
    """A value with one standard deviation, NaN where not known, and the degrees of freedom behind it, in `unit`.

    `beyond` is what single runs scatter by beyond what goes on within them, in `sd` too; None where nothing was
    repeated, and `sd` knows nothing of it.
    """

    value: float
    sd: float
    freedom: float
    runs: int
    unit: str
    beyond: float | None = None

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
        Where nothing was repeated beside one, it scatters as the repeats of the other show, which then tell of both.
        """
        own = (self._scattering_as(other), other._scattering_as(self))
        told_together |= own != (self, other)
        parts, sd = [each.sd**4 / each.freedom for each in own], math.hypot(*(each.sd for each in own))
        least, together = min(each.freedom for each in own), sum(parts)
        freedom = least if told_together else sd**4 / together if together > 0.0 else math.inf
        return Uncertain(self.value - other.value, sd, freedom, min(each.runs for each in own), self.unit)

    def _scattering_as(self, other: Uncertain) -> Uncertain:
        """Return this with the scatter that the repeats of the `other` show, where it has none to tell its own."""
        if self.beyond is not None or other.beyond is None:
            return self
        return replace(self, sd=math.hypot(self.sd, other.beyond / math.sqrt(self.runs)), beyond=other.beyond)

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


@dataclass(frozen=True)
class MeanAt:
    """The runs at one temperature and the mean of each parameter over those that could tell it.

    `scatter` is the standard deviation of those very runs (n - 1), NaN of a single one; `unit_degC` what the unit's own
    thermometer showed through them, lowest and highest, and `own_degC` in the mean, NaN where it did not.
    """

    temperature_degC: float | None
    runs: tuple[int, ...]
    values: Mapping[str, Uncertain]
    scatter: Mapping[str, float]
    unit_degC: tuple[float, float] | None = None
    own_degC: float = math.nan
