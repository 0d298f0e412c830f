"""Every self-calibration's parameters against its temperature: free at every temperature, or along chosen forms.

`layout_of` says which rows of a sensor are fitted, in which form, and which temperatures those are. A visit is one run.
Its parameters have the uncertainty that every other command states (`hil.solve.repeats`). Where temperatures were
reached from both sides, half the difference is a parameter of its own, so that the curve is the middle one, and what is
left of the scatter is without it. Of a visit of which nobody knows from which side (the first of a night) it is as
uncertain as it is large.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from scipy.special import stdtrit

from hil.campaign import Collects, Conditions, FloatArray, IntArray
from hil.campaign.stand_ins import OWN
from hil.errors import InputError
from hil.model.forms import LinearForm, default_form, named_form
from hil.solve import Solution, solve
from hil.solve.precision import stated_noise
from hil.solve.runs import solve_rates
from hil.solve.temperatures import (
    at_no_temperature,
    runs_by_temperature,
    too_few,
    unit_mean_degC,
    unsettled,
    why_unsettled,
)
from hil.solve.uncertain import CONFIDENCE, Spread
from procedures.words import counted, numbered

_MOVES_DEGC = 0.1  # half the range of a thermometer that tells anything


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


@dataclass(frozen=True)
class Layout:
    """The rows of one sensor with its columns: `columns` (n, c, p) of the form, and how temperature enters.

    `middle_degC` and `half_degC` scale temperature to -1 … 1 for polynomials. `factor` (p,) is what standard errors are
    times, `residuals` (p,) the degrees of freedom of that, `common` (p,) what is the same in every run and `alone` by
    name the runs that are others, as `hil solve` has them; `spread` is that of all runs, where temperatures are left
    out.
    """

    collects: Collects
    form: LinearForm
    columns: FloatArray
    stations: Stations
    middle_degC: float
    half_degC: float
    factor: FloatArray | float = 1.0
    residuals: FloatArray | float = math.inf
    common: FloatArray | float = 0.0
    alone: Mapping[str, Collection[int]] = field(default_factory=dict)
    spread: Spread | None = None

    @cached_property
    def hysteresis(self) -> bool:
        """Whether half the difference between the two directions is estimated."""
        return len(self.stations.both_directions) > 0

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


class Visits:
    """The v visits of one sensor, solved for the layout's form: parameters (v, p), NaN where not told.

    `sd` (v, p) is each visit's own, `common` (v, p) the error that is the same in every run, in one direction, and
    `of_each` (v, p) both together, as `hil solve` states it.
    They scatter as those that repeat a temperature from one side do, or from either where none does.
    `temperature_degC`, `station` and `direction` are (v,), all directions 0 where nothing was reached from both sides;
    `known` says that anything tells how large a deviation is.
    """

    def __init__(self, layout: Layout) -> None:
        conditions, sigma = layout.collects.conditions, stated_noise(layout.collects)
        label = np.unique(conditions.run, return_inverse=True)[1]
        rates = layout.collects.rates_deg_per_hr - conditions.w_channels_deg_per_hr
        rows = [np.flatnonzero(label == k) for k in range(label.max() + 1)]
        errors = [None if sigma is None else sigma[here] for here in rows]
        found = [solve_rates(layout.columns[here], rates[here], e) for here, e in zip(rows, errors, strict=True)]
        self.layout = layout
        self.values, stated = np.array([each.values for each in found]), np.array([each.se for each in found])
        first = [here[0] for here in rows]
        apart = [np.isin(conditions.run[first], [*layout.alone.get(name, ())]) for name in layout.form.names]
        self.values[np.array(apart).T] = np.nan
        self.station = layout.stations.number[first]
        self.direction = layout.stations.direction[first] * layout.hysteresis
        self.temperature_degC = np.array([layout.temperature_degC[here].mean() for here in rows])
        place = np.unique(np.stack([self.station, self.direction.astype(np.int64)]), axis=1, return_inverse=True)[1]
        told = layout.factor, layout.residuals, layout.common
        from_one_side, whatever = (Spread.of(self.values, stated, at, *told) for at in (place.ravel(), self.station))
        self.spread = layout.spread or (from_one_side if np.any(from_one_side.degrees) else whatever)
        sd, self.common = self.spread.parts(stated)
        told = sd[np.isfinite(self.values)]
        self.known = bool(np.isfinite(told).all() and np.all(told > 0.0))
        self.sd = sd if self.known else np.ones_like(sd)
        self.of_each = np.hypot(self.sd, self.common)

    def free(self, place: int) -> Estimates:
        """Fit one parameter freely at each temperature, to be tested: by no more degrees of freedom than repeats share.

        Of repeats that agree by chance, errors seem to explain more than they do: an interval is seldom wrong by that,
        but so rare an event as a test of many parameters asks for was told by it ten times too often.
        """
        found = self.along(place, None)[0]
        repeated = float(self.spread.shared[place]) if self.known else 0.0
        return replace(found, freedom=min(found.freedom, repeated or math.inf))

    def along(self, place: int, order: int | None) -> tuple[Estimates, Estimates | None]:
        """Fit one parameter freely at each temperature (order None) or along powers; hysteresis apart."""
        stations = np.arange(len(self.layout.stations))
        basis = np.asarray(self.station[:, None] == stations, dtype=np.float64)
        size = len(stations) if order is None else order + 1
        if order is not None:
            basis = self.layout.powers(self.temperature_degC, order)
        found, off = self._solved(place, basis)
        freedom = float(self.spread.freedom[place])
        if not self.known:
            freedom = float(max(int(found.degrees_of_freedom), 1))
        fitted = Estimates(found.values, found.covariance + np.outer(off, off), freedom)
        return fitted.part(0, size), fitted.part(size, 1) if self.layout.hysteresis else None

    def _solved(self, place: int, basis: FloatArray) -> tuple[Solution, FloatArray]:
        """Fit one parameter along `basis` (v, q); beside it hysteresis, and half of it where the side is not known.

        With the solution comes what the error that is the same in every run makes of its values.
        """
        values, sd = self.values[:, place], self.sd[:, place]
        common = np.where(np.isfinite(values), self.common[:, place], math.nan)
        if not self.layout.hysteresis:
            return solve(basis, values, sd), solve(basis, common, sd).values
        beside = np.stack([0.5 * self.direction, self.direction == 0.0], axis=1)
        stations = np.asarray(self.station[:, None] == np.arange(len(self.layout.stations)), dtype=np.float64)
        free = solve(np.hstack([stations, beside]), values, sd)
        half = 0.5 * math.hypot(free.values[-2], free.se[-2])
        unknown = np.eye(basis.shape[1] + 2)[-1:]
        rows = np.vstack([np.hstack([basis, beside]), unknown])
        prior, widths = math.nan if math.isnan(half) else 0.0, np.append(sd, half)
        found, off = (solve(rows, np.append(each, prior), widths) for each in (values, common))
        return found, off.values


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
    """Group rows by their run's temperature (`runs_by_temperature`); raises `InputError` where the rows have none."""
    temperature = conditions.columns.get("temperature_degC")
    if temperature is None or not np.all(np.isfinite(temperature)):
        what = "lacks the column temperature_degC" if temperature is None else "has rows without temperature_degC"
        raise InputError(
            f"sensor {conditions.sensor.number}: the campaign {what}: record it, there is nothing to fit against"
        )
    groups = [runs for _, runs in runs_by_temperature(conditions, apart_degC)]
    number = np.argmax([np.isin(conditions.run, runs) for runs in groups], axis=0)
    centre = np.array([unit_mean_degC(conditions, runs) for runs in groups])
    rising = np.argsort(centre, kind="stable")
    number = np.argsort(rising)[number]
    direction, came = np.zeros(len(number)), 0.0
    for before, here in pairwise(np.argsort(conditions.start_s, kind="stable").tolist()):
        if number[here] != number[before]:
            came = float(np.sign(number[here] - number[before]))
        direction[here] = came
    return Stations(number, centre[rising], direction)


def layout_of(
    number: int,
    collects: Collects,
    model_name: str | None,
    apart_degC: float | None,
    factor_of: Mapping[str, Sequence[float]],
    as_zero: Sequence[str] = (),
    alone: Mapping[str, Collection[int]] = MappingProxyType({}),
) -> tuple[Layout, list[str]]:
    """Choose the form and the rows: temperatures at which no run tells every parameter are left out.

    `factor_of` has by parameter what its standard errors are times, the degrees of freedom of that, and what is common;
    `alone` the runs that are others.
    What is `as_zero` is in no form. Raises `InputError` where fewer than three temperatures are left.
    """
    notes: list[str] = []
    left = np.isnan(collects.conditions.columns.get(OWN, np.zeros(0)))
    if left.any() and not left.all():
        collects = collects.rows(~left)
        notes.append(f"sensor {number}: {counted(int(left.sum()), 'row')} without temperature: left out")
    if late := at_no_temperature(collects.conditions, apart_degC):
        why = unsettled(collects.conditions)
        cause = why_unsettled(why[run] for run in late if run in why)
        collects = collects.rows(~np.isin(collects.conditions.run, late))
        notes.append(f"sensor {number}: {numbered('run', late)}: {cause}: in none of these curves")
    stations = find_stations(collects.conditions, apart_degC)
    form = named_form(model_name, collects.conditions) if model_name else default_form(collects.conditions)
    form = form.without(as_zero)
    if form.reason:
        notes.append(f"sensor {number}: {form.reason}")
    factor, residuals, common = np.array([factor_of.get(name, (1.0, math.inf, 0.0)) for name in form.names]).T
    columns, run, rates = form.columns(collects.conditions), collects.conditions.run, 0.0 * collects.rates_deg_per_hr
    ranks = {
        r: solve_rates(columns[rows], rates[rows], 1.0).rank for r, rows in collects.conditions.of_each_run.items()
    }
    tell = {each for each, rank in ranks.items() if int(rank) == len(form.names)}
    whole = np.array([not tell.isdisjoint(run[stations.number == place].tolist()) for place in range(len(stations))])
    spread = None
    if not np.all(whole):
        without = ", ".join(f"{each:z.1f} °C" for each in stations.centre_degC[~whole])
        notes.append(f"sensor {number}: no run tells every parameter at {without}; left out")
        spread = Visits(Layout(collects, form, columns, stations, 0.0, 1.0, factor, residuals, common, alone)).spread
        keep = whole[stations.number]
        collects, columns = collects.rows(keep), columns[keep]
        number_of = np.cumsum(whole) - 1
        stations = Stations(number_of[stations.number[keep]], stations.centre_degC[whole], stations.direction[keep])
    if few := too_few(len(stations), " at which a run tells every parameter"):
        raise InputError(
            f"sensor {number}: {few} (--apart says how far apart two temperatures are)"
            + "".join(f"; {note.removeprefix(f'sensor {number}: ')}" for note in notes)
        )
    own = collects.conditions.columns["temperature_degC"]
    middle, half = 0.5 * float(own.min() + own.max()), 0.5 * float(np.ptp(own))
    if half < _MOVES_DEGC:
        shown = f"temperature_degC is {own.mean():z.1f} °C at every setpoint"
        raise InputError(f"sensor {number}: {shown}: look at that column, there is nothing to fit against")
    known = factor, residuals, common, alone, spread
    layout = Layout(collects, form, columns, stations, float(np.round(middle)), half, *known)
    if layout.hysteresis:
        middles = "values are the middle between both directions; without their difference, which the means and ± of"
        first = "of a first temperature, of which nobody knows from which side it was reached, half of it is in the ±"
        notes.append(f"sensor {number}: {middles} hil solve hold; {first}")
    return layout, notes
