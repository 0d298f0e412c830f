"""How well values are known: a value with its standard deviation and interval, and what runs scatter by."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from scipy.special import chdtrc, fdtrc, ndtr, stdtrit

from hil.campaign import BoolArray, FloatArray, IntArray
from hil.files.document import picked, plain

CONFIDENCE = 0.95
"""Of every interval that is stated."""
RARE = 0.01
"""Chance of what is not put down to chance."""
_ROUNDING = 1e-9  # of a square: less is arithmetic's
_TINY = 1e-300


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

    def less(self, other: Self, *, told_together: bool = False) -> Self:
        """Return this less the `other`: the variances of both, and the degrees of freedom behind them.

        Those are Welch's and Satterthwaite's (GUM G.4.1), but of two that the same runs tell no more than of either.
        Where nothing was repeated beside one, it scatters as the repeats of the other show, which then tell of both.
        """
        own = (self._scattering_as(other), other._scattering_as(self))
        told_together |= own != (self, other)
        parts, sd = [each.sd**4 / each.freedom for each in own], math.hypot(*(each.sd for each in own))
        least, together = min(each.freedom for each in own), sum(parts)
        freedom = least if told_together else sd**4 / together if together > 0.0 else math.inf
        runs = min(each.runs for each in own)
        return replace(self, value=self.value - other.value, sd=sd, freedom=freedom, runs=runs, beyond=None)

    def _scattering_as(self, other: Self) -> Self:
        """Return this with the scatter that the repeats of the `other` show, where it has none to tell its own."""
        if self.beyond is not None or other.beyond is None:
            return self
        return replace(self, sd=math.hypot(self.sd, other.beyond / math.sqrt(self.runs)), beyond=other.beyond)

    def document(self) -> dict[str, Any]:
        """Return the JSON of it: null where a thing is not known."""
        low, high = plain(self.value - self.half_width), plain(self.value + self.half_width)
        return picked(self, "value sd", low=low, high=high, **picked(self, "runs unit"))


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


@dataclass(frozen=True)
class Spread:
    """How p parameters scatter from run to run at one temperature, (p,) each.

    `observed` is their standard deviation, NaN where nothing was repeated; `stated` what the runs' standard errors,
    times `factor`, say of it, and `beyond` what these leave unexplained; `times` is the scatter in each run's own
    standard error, by which one that is large hides nothing; `degrees` how many runs were repeated. Those that are
    `uneven` scatter more at some temperatures than at others, as chance hardly explains; `shared` are the degrees of
    freedom of repeats of which each temperature has its own scatter, no more than `degrees` (Satterthwaite, Box: few
    where one temperature has most of it), by which rare events are told. `residuals` are the degrees of
    freedom of what a run's noise is known by, infinite where it is stated. Both are of each parameter, or of all.
    Where nothing was repeated, `beyond` is what is `stated_beyond`, if anything is.
    `common` is how many times standard errors what residuals leave is that is the same in every run: no repeat shows
    it, and no mean averages it.

    `freedom` are those behind a standard deviation: of `residuals` where nothing was repeated, else as many as runs
    with equal errors would have (Welch and Satterthwaite), and more, up to those of `residuals`, where errors explain
    what they scatter by: that is known better the more repeats agree (`benchmarks/intervals.py` measures the coverage).
    """

    observed: FloatArray
    beyond: FloatArray
    stated: FloatArray
    times: FloatArray
    degrees: IntArray
    freedom: FloatArray
    uneven: BoolArray
    shared: FloatArray
    factor: FloatArray
    residuals: FloatArray | float = math.inf
    common: FloatArray | float = 0.0

    @classmethod
    def of(
        cls,
        values: FloatArray,
        errors: FloatArray,
        group: IntArray,
        factor: FloatArray | float = 1.0,
        residuals: FloatArray | float = math.inf,
        common: FloatArray | float = 0.0,
        stated_beyond: FloatArray | float = 0.0,
    ) -> Self:
        """Pool the scatter of r runs' values (r, p) about the mean of each `group` (r,) that they repeat.

        `errors` (r, p) are standard errors, NaN where there is none; a value that is NaN was not measured.
        """
        known, (places, at) = np.isfinite(values), np.unique(group, return_inverse=True)
        rows, own = np.where(known, values, 0.0), np.where(known, factor * np.nan_to_num(errors), 0.0) ** 2

        def total(of_each: FloatArray) -> FloatArray:
            out = np.zeros((len(places), values.shape[1]))
            np.add.at(out, at, of_each)
            return out

        count = np.maximum(total(known), 1.0)
        squares = total(np.where(known, rows - (total(rows) / count)[at], 0.0) ** 2)
        explained, degrees = total(own) * (1.0 - 1.0 / count), count - 1.0
        # What is beyond shows in runs of small standard errors: one that is large hides nothing. Where none is, alike.
        weight = np.where(known, np.where(np.any(known & (own <= 0.0), axis=0), 1.0, 1.0 / np.maximum(own, _TINY)), 0.0)
        freedom = degrees.sum(axis=0)
        enough = np.maximum(freedom, 1.0)
        observed = np.where(freedom > 0, np.sqrt(squares.sum(axis=0) / enough), np.nan)

        def by(weight: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
            share = weight / np.maximum(total(weight), _TINY)[at]
            weighed = np.sum(weight * (rows - total(share * rows)[at]) ** 2, axis=0)
            shows = weight * (1.0 - share)
            more = weighed - np.sum(shows * own, axis=0)
            more = np.where(more > _ROUNDING * weighed, more, 0.0)
            beyond = np.sqrt(more / np.maximum(shows.sum(axis=0), _TINY)) * (freedom > 0)
            return share, shows, weighed, np.fmin(beyond, observed)  # no part of it is more than the whole

        share, shows, weighed, beyond = by(weight)
        # The larger that is, the more alike runs show it (DerSimonian and Kacker's two steps).
        *_, beyond = by(weight / (1.0 + weight * beyond**2))
        beyond = np.where(freedom > 0, beyond, stated_beyond)
        expected = explained + degrees * beyond**2
        odd = uneven(squares / np.where(expected > 0.0, expected, np.inf), degrees)
        of_each_4 = np.sum(squares**2 / (degrees + 2.0), axis=0)
        shared = np.minimum(
            freedom, np.where(of_each_4 > 0.0, squares.sum(axis=0) ** 2 / np.maximum(of_each_4, _TINY), np.inf)
        )
        stated = np.sqrt(explained.sum(axis=0) / enough)
        every = np.all(~known | (own > 0.0), axis=0) & (stated > 0.0)
        times = np.where(every, np.sqrt(weighed / enough), observed / np.where(stated > 0.0, stated, np.inf))
        of_each = np.broadcast_to(np.asarray(factor, dtype=np.float64), observed.shape)
        size = weight * np.where(own + beyond**2 > 0.0, own + beyond**2, 1.0)  # of values that do not differ: alike
        same = np.sum(size**2 * (1.0 - 2.0 * share), axis=0) + np.sum(total(size * share) ** 2, axis=0)
        tell = np.sum(size * (1.0 - share), axis=0) ** 2 / np.maximum(same, _TINY)
        by_errors = np.sum(shows * weight * own, axis=0) / np.maximum(np.sum(shows * size, axis=0), _TINY)
        behind = np.where(freedom > 0, tell + np.minimum(0.5 * (tell * by_errors) ** 2, residuals), residuals)
        degrees = freedom.astype(np.int64)
        return cls(observed, beyond, stated, times, degrees, behind, odd, shared, of_each, residuals, common)

    def parts(self, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a run's own deviation by its standard errors (…, p), and that which is the same in every run."""
        own = np.where((self.degrees > 0) & ~np.isfinite(errors), 0.0, errors)
        return np.asarray(np.hypot(self.factor * own, self.beyond)), np.asarray(self.common * np.nan_to_num(own))

    def sd(self, errors: FloatArray) -> FloatArray:
        """Return the standard deviation of a run's values by its standard errors (…, p); NaN where nothing tells it."""
        return np.asarray(np.hypot(*self.parts(errors)))

    def beyond_of(self, place: int) -> float | None:
        """Return what one parameter scatters by beyond errors, None where no repeats show it and nothing states it."""
        return float(self.beyond[place]) if self.degrees[place] or self.beyond[place] > 0.0 else None

    def more_than(self, within: Self) -> BoolArray:
        """Which differ between groups that hold some of these together by more than `within` them, as `certain` is."""
        apart, of_each = self.degrees - within.degrees, np.maximum(within.degrees, 1)
        known, own = (np.nan_to_num(each.observed) ** 2 * each.degrees for each in (self, within))
        times = (known - own) / np.maximum(apart, 1) / np.maximum(own / of_each, _TINY)
        told = (apart > 0) & (within.degrees > 0) & (own > 0.0)
        return np.asarray(told & (fdtrc(np.maximum(apart, 1), of_each, times) * max(np.count_nonzero(told), 1) < RARE))

    def far_better_than(self, other: Self) -> bool:
        """Whether something repeats by less in these groups than in others, as chance hardly makes any of two so."""
        told = (self.degrees > 0) & (other.degrees > 0) & (self.times > 0.0)
        times = np.where(told, other.times / np.where(told, self.times, 1.0), 0.0) ** 2
        chance = fdtrc(np.maximum(other.degrees, 1), np.maximum(self.degrees, 1), times)
        return bool(np.any(told & (chance * 2 * len(told) < RARE)))

    @property
    def certain(self) -> BoolArray:
        """Which scatter more than standard errors, times `factor`, say, beyond chance at `RARE` for all together."""
        known = np.minimum(self.residuals, 1e9)
        chance = fdtrc(np.maximum(self.degrees, 1), known, self.times**2)
        more = (self.stated <= 0.0) | (chance * np.count_nonzero(self.degrees) < RARE)
        return np.asarray((self.observed > 0.0) & more)  # NaN where nothing was repeated


def gathered(values: FloatArray, errors: FloatArray, place: IntArray, some: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return values and errors (r, p) of which `some` (p,) are one for each `place` (r,): its mean, in its first row.

    What is NaN was not told; of a place of which any error is not known all weigh alike.
    """
    values, errors = values.copy(), errors.copy()
    for p in np.flatnonzero(some):
        for k in np.unique(place):
            own = np.flatnonzero((place == k) & np.isfinite(values[:, p]))
            if len(own) > 1:
                share = _shares(errors[own, p])
                mean = share @ values[own, p], np.linalg.norm(share * errors[own, p])
                values[own, p] = errors[own, p] = np.nan
                values[own[0], p], errors[own[0], p] = mean
    return values, errors


def means_at(
    units: Mapping[str, str],
    values: FloatArray,
    errors: FloatArray,
    group: IntArray,
    at: Sequence[tuple[float | None, tuple[int, ...]]],
    spread: Spread,
    together: IntArray | None = None,
) -> list[MeanAt]:
    """Return the means of r runs' values (r, p), NaN where not told, with standard errors (r, p), by their `spread`.

    `at` are the temperatures with their runs, `group` (r,) says at which of them each run was made; runs that are
    `together` (r, p) have in common what is beyond their errors.
    """
    (sd, alike), means, each = spread.parts(errors), [], np.arange(len(values))
    for k, (temperature, runs) in enumerate(at):
        mean, scatter = {}, {}
        for p, name in enumerate(units):
            here = (group == k) & np.isfinite(values[:, p])
            if count := int(here.sum()):
                share, beyond = _shares(sd[here, p]), spread.beyond[p]
                in_common = np.bincount((each if together is None else together[:, p])[here], share)
                own = np.sqrt(np.maximum(sd[here, p] ** 2 - beyond**2, 0.0))
                error = math.hypot(*(share * own), *(in_common * beyond), share @ alike[here, p])
                known = float(spread.freedom[p]), count, units[name], spread.beyond_of(p)
                mean[name] = Uncertain(float(share @ values[here, p]), error, *known)
                scatter[name] = float(np.std(values[here, p], ddof=1)) if count > 1 else math.nan
        means.append(MeanAt(temperature, runs, mean, scatter))
    return means


def _shares(errors: FloatArray) -> FloatArray:
    """Return what each weighs of all by its error; alike where nothing says of which more is known."""
    weight = errors**-2.0 if np.all(errors > 0.0) else np.ones(len(errors))
    return np.asarray(weight / weight.sum())


def uneven(times: FloatArray, degrees: FloatArray) -> BoolArray:
    """Return which of p scatter otherwise from temperature to temperature: variances `times` (k, p) the expected.

    Bartlett's test (Snedecor and Cochran, Statistical Methods) at `RARE` for all parameters together.
    """
    told = (degrees > 0) & (times > 0.0)
    nu = np.where(told, degrees, 0.0)
    whole, others = np.maximum(nu.sum(axis=0), 1.0), told.sum(axis=0) - 1
    logs = np.log(np.where(told, times, 1.0))
    statistic = whole * np.log(np.maximum((nu * times).sum(axis=0) / whole, 1e-300)) - (nu * logs).sum(axis=0)
    inverse = np.where(told, 1.0 / np.maximum(nu, 1.0), 0.0).sum(axis=0) - 1.0 / whole
    chance = chdtrc(np.maximum(others, 1), statistic / (1.0 + inverse / (3.0 * np.maximum(others, 1))))
    return np.asarray((others > 0) & (chance < RARE / times.shape[1]))
