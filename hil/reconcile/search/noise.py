"""What the rates do by themselves: ordinary noise, a calibration per temperature, and each scatter of the catalogue.

The covariance of a block of rows is, up to one unknown scale s²,

    V = D + o² O + t² T + a² C

with D the stated white noise, O an offset of each run, T values of the base's own parameters at each temperature, and C
one effect on the scatter. D with O is ordinary noise; C is a hypothesis with prior odds, as an effect on the mean is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model.effects.base import Parameter, VarianceEffect
from hil.solve.rows import Block

OFFSETS = (0.0, 0.7, 1.4, 2.8, 5.6, 11.0)
"""Of an offset per run, in white noises: a factor of two is as fine as 24 runs can tell."""
AMOUNTS = (0.7, 1.4, 2.8, 5.6, 11.0)
"""Of an effect on the scatter, in white noises."""
LEVELS = {0.15: 0.3, 1.0: 0.7}
"""Share of the mean variance in every row's own, with its prior: standard errors leave out what differs by collect."""
CALIBRATIONS = (4.0, 12.0, 36.0, 108.0, 324.0)
"""How far the base's values follow temperature, in white noises: wide priors of what the data then settle."""
ROUGHNESS = (0.01, 0.1)
"""Share of that which each temperature has for itself; the rest is a straight line and a smooth curve."""
SMOOTH_DEGC = 30.0
"""Over which a smooth curve forgets itself: values of a unit turn two or three times over a sweep, not more."""
FEWEST_RUNS = 4
ALIKE = 0.985
"""Covariances of which the cosine is larger are one and the same to these rows."""


@dataclass(frozen=True)
class Kind:
    """An effect on the scatter at one shape, as a block of rows shows it.

    `covariance` (N, N) has a mean diagonal of one; `unit_deg_per_hr` is the deviation that it had at unit size.
    """

    effect: VarianceEffect
    shape: Mapping[str, float]
    covariance: FloatArray
    unit_deg_per_hr: float
    parameter: Parameter


@dataclass(frozen=True)
class Points:
    """Models of a block's noise, (t,) each: which kind (-1: ordinary), what of everything, and the log prior within it.

    `factor` (t, N, N) whitens: W'W = V^-1; `half_log_det` is that of V.
    """

    kind: IntArray
    amount: FloatArray
    offset: FloatArray
    calibration: FloatArray
    roughness: FloatArray
    level: FloatArray
    log_prior: FloatArray
    factor: FloatArray
    half_log_det: FloatArray

    def __len__(self) -> int:
        return len(self.kind)

    def take(self, index: IntArray) -> Points:
        """Return some of the points."""
        return Points(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


class Noise:
    """The parts of a block's covariance, in units of its mean white variance."""

    def __init__(
        self,
        block: Block,
        conditions: Conditions,
        effects: Sequence[VarianceEffect],
        *,
        calibrated: bool,
        stated: FloatArray | None = None,
    ) -> None:
        """`calibrated`: the base has values at each temperature. `stated` (N, N) is what the model states beside D."""
        self.block = block
        variance = block.sigma**2
        self.unit = float(np.mean(variance))
        self.white = np.diag(variance / self.unit) + (0.0 if stated is None else stated / self.unit)
        same_channel = block.channel[:, None] == block.channel[None, :]
        self.offset = np.where(same_channel & (block.run[:, None] == block.run[None, :]), 1.0, 0.0)
        stations = len(np.unique(block.station))
        seen = block.base @ block.base.T
        seen = seen / max(float(np.mean(np.diag(seen))), 1e-12)
        self.rough = seen * (block.station[:, None] == block.station[None, :])
        self.smooth = seen * _smooth(block, conditions)
        self.calibrated = calibrated and stations > 2
        runs = len(np.unique(block.run))
        rows = len(block.y) / runs / len(np.unique(block.channel))
        self.has_offsets = runs >= FEWEST_RUNS and rows > 1.5
        self.kinds = list(self._kinds(conditions, effects)) if self.has_offsets else []

    def _kinds(self, conditions: Conditions, effects: Sequence[VarianceEffect]) -> Iterator[Kind]:
        """Yield what these rows can tell from ordinary noise and from each other."""
        channels = len(conditions.sensor.channels)
        place = self.block.rows * channels + self.block.channel
        known = [np.eye(len(place)), self.white, self.offset]
        for effect in effects:
            if not effect.applies_to(conditions.sensor) or effect.missing(conditions):
                continue
            for shape in effect.shape_grid(conditions):
                covariance = effect.covariance(conditions, shape)[np.ix_(place, place)]
                size = float(np.mean(np.diag(covariance)))
                if size <= 0.0 or any(_cosine(covariance, other) > ALIKE for other in known):
                    continue
                known.append(covariance)
                (parameter,) = effect.parameters_for(conditions)[:1]
                yield Kind(effect, shape, covariance / size, float(np.sqrt(size)), parameter)

    def by_temperature(self, calibration: float, roughness: float) -> FloatArray:
        """Return the covariance (N, N) of a base whose values follow temperature, a smooth curve with a roughness."""
        return np.asarray(calibration**2 * ((1.0 - roughness) * self.smooth + roughness * self.rough))

    def covariance(
        self, kind: int, amount: float, offset: float, calibration: float, roughness: float, level: float
    ) -> FloatArray:
        """Return V of one point, (N, N), in units of the mean white variance."""
        mean = np.mean(np.diag(self.white))
        out = (1.0 - level) * self.white + level * mean * np.eye(len(self.white)) + offset**2 * self.offset
        out = out + self.by_temperature(calibration, roughness) if calibration else out
        return out + amount**2 * self.kinds[kind].covariance if kind >= 0 else out

    def ordinary(self) -> Points:
        """Return the points of ordinary noise."""
        offsets = OFFSETS if self.has_offsets else OFFSETS[:1]
        unequal = np.ptp(np.diag(self.white)) > 1e-6
        levels = LEVELS if unequal else {1.0: 1.0}
        wide = list(product(CALIBRATIONS, ROUGHNESS)) if self.calibrated else [(0.0, 0.0)]
        rows = []
        for offset, (level, share), values in product(offsets, levels.items(), wide):
            log_prior = -_log_offset(offset) + float(np.log(share / len(offsets) / len(wide)))
            rows.append((-1, 0.0, offset, *values, level, log_prior))
        return self._points(rows)

    def scattering(self, ordinary: Points) -> Points:
        """Return the points with an effect on the scatter, beside some of the ordinary ones: every offset anew."""
        beside = sorted(set(zip(ordinary.level, ordinary.calibration, ordinary.roughness, strict=True)))
        rows = []
        for kind, entry in enumerate(self.kinds):
            of_one = [k for k in self.kinds if k.effect is entry.effect]
            for amount, offset, (level, calibration, roughness) in product(AMOUNTS, OFFSETS[:-1], beside):
                value = amount * np.sqrt(self.unit) / entry.unit_deg_per_hr
                log_prior = entry.parameter.log_density(value) + float(np.log(np.log(2.0) / len(of_one)))
                at = (ordinary.level == level) & (ordinary.calibration == calibration)
                at &= ordinary.roughness == roughness
                share = float(
                    np.max(ordinary.log_prior[at] + np.log1p((ordinary.offset[at] / 4.0) ** 2))
                ) - _log_offset(offset)
                rows.append((kind, amount, offset, calibration, roughness, level, log_prior + share))
        return self._points(rows)

    def _points(self, rows: Sequence[tuple[float, ...]]) -> Points:
        size = len(self.block.y)
        if not rows:
            none = np.zeros(0)
            return Points(none.astype(int), none, none, none, none, none, none, np.zeros((0, size, size)), none)
        columns = np.array(rows, dtype=np.float64).T
        kind = columns[0].astype(np.int64)
        covariances = np.array([self.covariance(int(k), *row[1:6]) for k, row in zip(kind, rows, strict=True)])
        factor = np.linalg.cholesky(covariances)
        half = np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
        amount, offset, calibration, roughness, level, log_prior = columns[1:7]
        inverse = np.asarray(np.linalg.inv(factor), dtype=np.float64)
        return Points(kind, amount, offset, calibration, roughness, level, log_prior, inverse, half)


def joined_points(first: Points, second: Points) -> Points:
    """Return the points of both."""
    pairs = ((getattr(first, name), getattr(second, name)) for name in first.__dataclass_fields__)
    return Points(*(np.concatenate(pair) for pair in pairs))


def _log_offset(offset: float) -> float:
    """How much less probable an offset is for its size (log)."""
    return float(np.log1p((offset / 4.0) ** 2))


def _smooth(block: Block, conditions: Conditions) -> FloatArray:
    """Correlation of rows by temperature: a straight line and a smooth curve, (N, N); one where nobody knows it."""
    temperature = conditions.columns.get("temperature_degC")
    if temperature is None or not np.all(np.isfinite(temperature[block.rows])):
        return np.ones((len(block.y), len(block.y)))
    own = temperature[block.rows]
    centre = np.array([np.mean(own[block.station == k]) for k in block.station.tolist()])
    line = (centre - centre.mean()) / max(float(centre.std()), 1.0)
    curve = np.exp(-0.5 * (np.subtract.outer(centre, centre) / SMOOTH_DEGC) ** 2)
    return np.asarray(0.5 * np.multiply.outer(line, line) + 0.5 * curve)


def _cosine(one: FloatArray, other: FloatArray) -> float:
    return float(np.sum(one * other) / np.sqrt(np.sum(one**2) * np.sum(other**2)))
