"""What shows inside a collect: an effect that tests the series of its samples, and what such a test says."""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import FloatArray, Sensor, Series
from hil.model.effects.base import Described

FEWEST = 16
"""Samples (or blocks of them) below which nothing is asked."""


@dataclass(frozen=True)
class SeriesFinding:
    """What a test of one channel's series says. `p_value` is NaN where the series is too short to ask."""

    channel: str
    p_value: float
    estimates: Mapping[str, float]
    sentence: str


class SeriesEffect(Described):
    """An effect that shows inside a collect: a test of the series with an exact or conservative null distribution."""

    def test(self, series: Series, sensor: Sensor) -> tuple[SeriesFinding, ...]:
        """Test every channel of one collect's series by itself."""
        findings = []
        for index, channel in enumerate(sensor.channels):
            known = int(np.isfinite(series.rates_deg_per_hr[:, index]).sum())
            if known < FEWEST:
                p_value, estimates, sentence = math.nan, dict[str, float](), f"{known} samples are too few to ask"
            else:
                p_value, estimates, sentence = self._test_channel(series, index)
            findings.append(SeriesFinding(channel, p_value, estimates, f"{channel}: {sentence}"))
        return tuple(findings)

    @abstractmethod
    def _test_channel(self, series: Series, channel: int) -> tuple[float, dict[str, float], str]:
        """Return p-value, estimates and a sentence for one channel."""

    def summary(self, series: Series, channel: int) -> FloatArray:
        """Return what `together` needs of one collect's channel, (k,): empty where it asks for nothing."""
        return np.empty(0)

    def together(self, summaries: Sequence[FloatArray]) -> tuple[float, Mapping[str, float], str] | None:
        """Test all collects of a channel at once for what each shows a little of: p-value, estimates, a sentence.

        `summaries` are those of its collects, (k,) each, as `summary` returns them. None where the effect has nothing
        that is the same from collect to collect.
        """
        return None
