"""What one cause, or two, make of the differences between two campaigns: a shift, another gain, another temperature.

    looks_like(2, differ, earlier, repeats(earlier, solved)[2], 3.5)    # "one cause: RA is 1.052 ±0.006 times …"

A cause moves many values together, each as far as it acts there: as solved from the earlier campaign's own rates with a
hundredth more in one channel, or as its means follow temperature. Its size is fitted to all differences by their ±. It
is told where it leaves what chance leaves, and explains more than values that are others one by one: each of these, and
each cause, has to explain what is beyond chance of all that were compared.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import Self

import numpy as np
from scipy.special import chdtrc

from hil.campaign import BoolArray, Campaign, FloatArray
from hil.files.numbers import decimals_for
from hil.solve import repeats, solve_campaign
from hil.solve.repeats import SensorRepeats
from hil.solve.uncertain import RARE
from procedures.words import listed, spelled

_MOST = 2  # causes that are told beside each other
_AS_LIKELY = 6.0  # twice the log of how much likelier one of two makes what is seen, 20 times: it alone is told
_SURE = 3.0  # times its own uncertainty, which a cause has to be
_GAIN = 0.02  # by more than that a channel's gain is no unit's that aged
_STEP = 0.01
_SINGULAR = 1e6


@dataclass(frozen=True)
class Differ:
    """By how much `values` (m,) differ, each with its ±, `sd` (m,), and the `bound` (m,) of what chance may make of it.

    `places` are their parameters and temperatures.
    """

    places: Sequence[tuple[str, float | None]]
    values: FloatArray
    sd: FloatArray
    bound: FloatArray

    @property
    def beyond(self) -> BoolArray:
        """Which are beyond chance, (m,)."""
        return np.asarray(np.abs(self.values) > self.bound)

    def less(self, templates: FloatArray) -> tuple[Self, FloatArray, FloatArray]:
        """Return what causes that move values so, (m, k), leave of them, their sizes (k,) and standard deviations (k,).

        Those are infinite where the values do not tell the causes apart.
        """
        columns = templates / self.sd[:, None]
        squares = columns.T @ columns
        if np.linalg.cond(squares / np.sqrt(np.outer(np.diag(squares), np.diag(squares)))) > _SINGULAR:
            return self, np.zeros(len(squares)), np.full(len(squares), np.inf)
        covariance = np.linalg.inv(squares)
        sizes = covariance @ columns.T @ (self.values / self.sd)
        return replace(self, values=self.values - templates @ sizes), sizes, np.sqrt(np.diag(covariance))

    @property
    def squares(self) -> FloatArray:
        """Their squares in their ±, (m,)."""
        return np.asarray((self.values / self.sd) ** 2)


@dataclass(frozen=True)
class _Cause:
    """How a cause of size 1 moves values, (m,), and how it is told: its size, from nothing, or from one as a `gain`."""

    told: str
    unit: str
    template: FloatArray
    gain: bool = False

    def in_words(self, size: float, sd: float) -> str:
        """Say it with its size."""
        digits = decimals_for([sd])
        return self.told.format(f"{self.gain + size:.{digits}f} ±{sd:.{digits}f}{self.unit}")


def looks_like(number: int, differ: Differ, earlier: Campaign, shown: SensorRepeats, sigmas: float) -> tuple[str, bool]:
    """Say of a sensor which cause makes all of its differences, or which two do; empty where none, or more must.

    `shown` is what repeats show of it in the `earlier` campaign; `sigmas` is what one of all that were compared is
    beyond chance by. Of causes that cannot be told apart all are said. And whether, by any of them, a channel has
    another gain than a unit's that aged.
    """
    every, found = [*_causes(number, differ, earlier, shown)], []
    for some in chain.from_iterable(combinations(every, count) for count in range(1, _MOST + 1)):
        left, sizes, sds = differ.less(np.stack([each.template for each in some], axis=1))
        rest = float(left.squares.sum())
        if not np.any(left.beyond) and chdtrc(len(left.values), rest) > RARE and np.all(np.abs(sizes) > _SURE * sds):
            scaled = any(each.gain and abs(size) > _GAIN for each, size in zip(some, sizes.tolist(), strict=True))
            words = listed(map(_Cause.in_words, some, sizes.tolist(), sds.tolist()))
            found.append((rest + len(some) * sigmas**2, len(some), words, scaled))
    best, value_by_value = min(found, default=(np.inf,))[0], float(np.minimum(differ.squares, sigmas**2).sum())
    likely = [each for each in sorted(found) if each[0] < min(best + _AS_LIKELY, value_by_value)]
    by_count: dict[int, list[str]] = {}
    for _, count, words, _ in likely:
        by_count.setdefault(count, []).append(words)
    told = (f"{spelled(count)} cause{'s' * (count > 1)}: {', or '.join(of)}" for count, of in by_count.items())
    return ", or ".join(told), any(scaled for *_, scaled in likely)


def _causes(number: int, differ: Differ, earlier: Campaign, shown: SensorRepeats) -> Iterator[_Cause]:
    units = dict(zip(shown.names, shown.units, strict=True))
    names = np.array([name for name, _ in differ.places])
    for name in dict.fromkeys(names.tolist()):
        if np.count_nonzero(names == name) > 1:
            yield _Cause(f"{name} differs by {{}} at every temperature alike", f" {units[name]}", 1.0 * (names == name))
    rows, scales = earlier.sensors[number], dict[str, FloatArray]()
    for place, channel in enumerate(rows.conditions.sensor.channels):
        scaled = rows.rates_deg_per_hr.copy()
        scaled[:, place] *= 1.0 + _STEP
        other = replace(earlier, sensors={number: replace(rows, rates_deg_per_hr=scaled)})
        moved = (_means(repeats(other, solve_campaign(other))[number], differ) - _means(shown, differ)) / _STEP
        if np.isfinite(moved).all() and np.any(moved):
            scales[channel] = moved
    if len(scales) > 1:
        scales[f"each of {listed(scales)}"] = np.sum([*scales.values()], axis=0)
    for channels, moved in scales.items():
        yield _Cause(f"{channels} is {{}} times what it was", "", moved, gain=True)
    slope = _slopes(shown, differ)
    if np.isfinite(slope).all() and np.any(slope):
        yield _Cause("at every temperature the unit looks warmer by {}", " °C", slope)


def _means(shown: SensorRepeats, differ: Differ) -> FloatArray:
    """Return the means of the earlier campaign where values are compared, (m,), NaN where there is none."""
    at = {degC: {} if (mean := shown.at(degC)) is None else mean.values for _, degC in differ.places}
    return np.array([at[degC][name].value if name in at[degC] else np.nan for name, degC in differ.places])


def _slopes(shown: SensorRepeats, differ: Differ) -> FloatArray:
    """Return by how much each value follows temperature there, (m,), per °C; NaN where nothing tells it."""
    out = np.full(len(differ.places), np.nan)
    for name in {name for name, _ in differ.places}:
        known = [(at.temperature_degC, at.values[name].value) for at in shown.means if name in at.values]
        degC, values = np.array([(d, v) for d, v in known if d is not None]).reshape(-1, 2).T
        if len(degC) > 1:
            slope = np.gradient(values, degC)
            for i, (own, at) in enumerate(differ.places):
                if own == name and at is not None:
                    out[i] = slope[int(np.argmin(np.abs(degC - at)))]
    return out
