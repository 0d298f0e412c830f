"""Every self-calibration's parameters against its temperature: free at every temperature, or along chosen forms.

A visit is one run. Its parameters have the uncertainty that every other command states (`hil.solve.repeats`). Where
temperatures were reached from both sides, half the difference is a parameter of its own, so that the curve is the
middle one, and what is left of the scatter is without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import stdtrit

from hil.campaign import Collects, Conditions, FloatArray, IntArray
from hil.errors import InputError
from hil.model.forms import LinearForm
from hil.solve import solve
from hil.solve.repeats import CONFIDENCE
from hil.solve.runs import OBSERVABLE, stated_noise
from hil.solve.spread import Spread
from hil.solve.temperatures import same_temperature


@dataclass(frozen=True)
class Estimates:
    """Values (q,) with their covariance, and the degrees of freedom behind each variance (infinite where stated)."""

    values: FloatArray
    covariance: FloatArray
    freedom: float

    @property
    def se(self) -> FloatArray:
        """Standard errors, (q,)."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def half_width(self) -> FloatArray:
        """Half the width of each interval at `CONFIDENCE`, (q,)."""
        return np.asarray(self.se * stdtrit(self.freedom, 0.5 + 0.5 * CONFIDENCE))

    def part(self, start: int, count: int) -> Estimates:
        """Return `count` values from `start` on."""
        here = slice(start, start + count)
        return Estimates(self.values[here], self.covariance[here, here], self.freedom)

    def scaled(self, factors: FloatArray) -> Estimates:
        """Return each value times a factor, (q,)."""
        return Estimates(self.values * factors, self.covariance * np.outer(factors, factors), self.freedom)


@dataclass(frozen=True)
class Layout:
    """The rows of one sensor with its columns: `columns` (n, c, p) of the form, and how temperature enters.

    `middle_degC` and `half_degC` scale temperature to -1 … 1 for polynomials. `hysteresis` says that half the
    difference between the two directions is estimated. `factor` (p,) is what standard errors are times where residuals
    exceed them, and `spread` that of all runs, where temperatures are left out.
    """

    collects: Collects
    form: LinearForm
    columns: FloatArray
    stations: Stations
    middle_degC: float
    half_degC: float
    hysteresis: bool
    factor: FloatArray | float = 1.0
    spread: Spread | None = None

    @property
    def temperature_degC(self) -> FloatArray:
        """The temperature of each row, (n,)."""
        return np.asarray(self.collects.conditions.columns["temperature_degC"])

    @property
    def range_degC(self) -> tuple[float, float]:
        """The lowest and highest temperature measured."""
        return float(self.temperature_degC.min()), float(self.temperature_degC.max())

    def powers(self, temperature_degC: FloatArray, order: int) -> FloatArray:
        """Powers of the scaled temperature at k temperatures, (k, order + 1)."""
        scaled = (temperature_degC - self.middle_degC) / self.half_degC
        return np.asarray(np.polynomial.polynomial.polyvander(scaled, order))


@dataclass(frozen=True)
class Visits:
    """The v visits of one sensor: parameters (v, p), NaN where not told, and one standard deviation of each.

    `temperature_degC`, `station` and `direction` are (v,); `known` says that anything tells how large a deviation is.
    """

    layout: Layout
    values: FloatArray
    sd: FloatArray
    spread: Spread
    temperature_degC: FloatArray
    station: IntArray
    direction: FloatArray
    known: bool

    def along(self, place: int, order: int | None) -> tuple[Estimates, Estimates | None]:
        """Fit one parameter freely at each temperature (order None) or along powers; hysteresis apart."""
        stations = np.arange(len(self.layout.stations))
        basis = np.asarray(self.station[:, None] == stations, dtype=np.float64)
        size = len(stations) if order is None else order + 1
        if order is not None:
            basis = self.layout.powers(self.temperature_degC, order)
        if self.layout.hysteresis:
            basis = np.column_stack([basis, 0.5 * self.direction])
        found = solve(basis, self.values[:, place], self._levelled(place))
        freedom = float(self.spread.freedom[place])
        if not self.known:
            freedom = float(max(int(found.degrees_of_freedom), 1))
        fitted = Estimates(found.values, found.covariance, freedom)
        return fitted.part(0, size), fitted.part(size, 1) if self.layout.hysteresis else None

    def _levelled(self, place: int) -> FloatArray:
        """Deviations (v,), each that of its temperature's visits together: a mean there is the plain mean."""
        variance = self.sd[:, place] ** 2
        here = np.isfinite(self.values[:, place])
        sums, count = (np.bincount(self.station[here], weights=w) for w in (variance[here], np.ones(here.sum())))
        mean = np.divide(sums, count, out=np.ones_like(sums), where=count > 0)
        return np.asarray(np.sqrt(mean[np.minimum(self.station, len(mean) - 1)]))


def visits(layout: Layout) -> Visits:
    """Solve every visit of a sensor for the layout's form."""
    conditions, sigma = layout.collects.conditions, stated_noise(layout.collects)
    label = np.unique(conditions.run, return_inverse=True)[1]
    rates = layout.collects.rates_deg_per_hr - conditions.w_channels_deg_per_hr
    values, errors, rows = [], [], []
    for k in range(label.max() + 1):
        here = np.flatnonzero(label == k)
        design = layout.columns[here].reshape(-1, len(layout.form.names))
        noise = None if sigma is None else sigma[here].reshape(-1)
        found = solve(design, rates[here].reshape(-1), noise, rank_tolerance=OBSERVABLE)
        values.append(found.values)
        errors.append(found.se)
        rows.append(here)
    station, direction = (
        np.array([of[r[0]] for r in rows]) for of in (layout.stations.number, layout.stations.direction)
    )
    at = np.array([layout.temperature_degC[r].mean() for r in rows])
    measured, stated = np.array(values), np.array(errors)
    place = np.unique(np.stack([station, direction.astype(np.int64)]), axis=1, return_inverse=True)[1].reshape(-1)
    spread = Spread.of(measured, stated, place, layout.factor) if layout.spread is None else layout.spread
    sd = spread.sd(stated)
    known = bool(np.isfinite(sd[np.isfinite(measured)]).all() and np.all(sd[np.isfinite(measured)] > 0.0))
    sd = sd if known else np.ones_like(sd)
    return Visits(layout, measured, sd, spread, at, station, direction, known)


@dataclass(frozen=True)
class Stations:
    """The temperatures that were visited, rising, and where each of n rows belongs.

    `number` (n,) indexes `centre_degC` (S,), the mean temperature of a station's rows. `direction` (n,) is +1 where the
    run came to its temperature from below, -1 from above, 0 where that is not known (the first of a night).
    """

    number: IntArray
    centre_degC: FloatArray
    direction: FloatArray

    def __len__(self) -> int:
        return len(self.centre_degC)

    @property
    def both_directions(self) -> IntArray:
        """The stations that were reached from below and from above."""
        found = [
            place for place in range(len(self)) if {-1.0, 1.0} <= set(self.direction[self.number == place].tolist())
        ]
        return np.array(found, dtype=np.int64)


def find_stations(conditions: Conditions, apart_degC: float | None = None) -> Stations:
    """Group rows by temperature, as `same_temperature` does; raises `InputError` where the rows have none."""
    temperature = conditions.columns.get("temperature_degC")
    if temperature is None or not np.all(np.isfinite(temperature)):
        what = "lacks the column temperature_degC" if temperature is None else "has rows without temperature_degC"
        raise InputError(f"sensor {conditions.sensor.number}: the campaign {what}; nothing can be said against it")
    number = same_temperature(conditions, apart_degC)
    centre = np.array([np.mean(temperature[number == place]) for place in range(number.max() + 1)])
    rising = np.argsort(centre, kind="stable")
    number = np.argsort(rising)[number]
    direction, came = np.zeros(len(number)), 0.0
    for before, here in pairwise(np.argsort(conditions.start_s, kind="stable").tolist()):
        if number[here] != number[before]:
            came = float(np.sign(number[here] - number[before]))
        direction[here] = came
    return Stations(number, centre[rising], direction)
