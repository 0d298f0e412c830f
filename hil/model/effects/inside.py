"""What shows inside a collect: an effect that tests the series of its samples, and what such a test says."""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.special import stdtr

from hil.campaign import FloatArray, Sensor, Series
from hil.model.effects.base import Described

FEWEST = 16
"""Samples (or blocks of them) below which nothing is asked."""

FEWEST_BESIDE = 8
"""Collects below which nobody knows what is usual of them."""
OFTEN = 0.2
"""Share of a channel's collects, from which on all are what these are: beside coloured noise, or of a shape."""
OF_NORMAL = 1.4826  # standard deviations, of a median deviation
_OF_A_MEDIAN = 0.5  # of what a standard deviation knows: between its .37 of very many and what few leave


@dataclass(frozen=True)
class SeriesFinding:
    """What a test of one channel's series says. `p_value` is NaN where the series is too short to ask.

    Beside noise that is `coloured` one series cannot tell what noise makes of a size.
    """

    p_value: float
    estimates: Mapping[str, float]
    sentence: str
    coloured: bool = False
    channel: str = ""


class SeriesEffect(Described):
    """An effect that shows inside a collect: a test of the series with an exact or conservative null distribution."""

    size: ClassVar[str] = ""
    """The estimate that is as often below zero as above it where there is only noise; empty where none is."""

    def test(self, series: Series, sensor: Sensor) -> tuple[SeriesFinding, ...]:
        """Test every channel of one collect's series by itself."""
        findings = []
        for index, channel in enumerate(sensor.channels):
            known = int(np.isfinite(series.rates_deg_per_hr[:, index]).sum())
            short = SeriesFinding(math.nan, {}, f"too few samples ({known}) to ask")
            found = short if known < FEWEST else self._test_channel(series, index)
            findings.append(replace(found, sentence=f"{channel}: {found.sentence}", channel=channel))
        return tuple(findings)

    @abstractmethod
    def _test_channel(self, series: Series, channel: int) -> SeriesFinding:
        """Return what one channel shows."""

    def p_values(self, findings: Sequence[SeriesFinding]) -> FloatArray:
        """Return the p-values (n,) of one channel's collects.

        Noise that wanders makes sizes in every collect, and one alone cannot tell its colour: where several show such
        noise a size has to stand out of what half of them show. Student's t, with the degrees of freedom of a median.
        """
        own = np.array([each.p_value for each in findings])
        coloured = float(np.mean([each.coloured for each in findings])) > OFTEN
        if not (self.size and coloured) or len(findings) < FEWEST_BESIDE:
            return own
        sizes = np.array([each.estimates[self.size] for each in findings])
        usual = OF_NORMAL * float(np.median(np.abs(sizes - np.median(sizes))))
        beside = 2.0 * stdtr(_OF_A_MEDIAN * (len(sizes) - 1), -np.abs(sizes) / max(usual, 1e-300))
        return np.asarray(np.maximum(own, beside))

    def summary(self, series: Series, channel: int) -> FloatArray:
        """Return what `together` needs of one collect's channel, (k,): empty where it asks for nothing."""
        return np.empty(0)

    def together(self, summaries: Sequence[FloatArray]) -> tuple[float, Mapping[str, float], str] | None:
        """Test all collects of a channel at once for what each shows a little of: p-value, estimates, a sentence.

        `summaries` are those of its collects, (k,) each, as `summary` returns them. None where the effect has nothing
        that is the same from collect to collect.
        """
        return None
