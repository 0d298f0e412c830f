"""What the runs of a campaign say of each other's values: what these scatter by, and how they follow temperature.

    others = of_others(conditions, names, of_run, columns, seen, groups, common)
    others.within        # by temperature what each value of a run is known within
    others.lines         # each takes a temperature's values from between those of its neighbours

Runs of one temperature repeat each other. Where hardly any run does, values lie about a curve over temperature; where
some do, and temperatures enough were met, each temperature's lie as near to its neighbours' as they usually do.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hil.campaign import BoolArray, Conditions, FloatArray
from hil.model.effects.columns import flattened
from hil.solve.compared import curve_over
from hil.solve.precision import typical_scatter
from hil.solve.temperatures import visits

SHARE = 1.0 / 3.0
"""Of differences of two: what so many are below, a few that are wrong do not move."""
SIGMA = 1.64
"""A normal distribution's sigma by that."""
_HARDLY_ANY = 1.0 / 6.0  # of them
_BY_CHANCE = 2.0  # standard errors of one: noise makes hardly any larger
_FEW = 8.0  # runs that others tell of: of so many their scatter is known hardly better than by 2
_LEAST = 2  # and of fewer not at all
_LAGS = (1, 2)  # between repeats whose difference is taken
_LOUD = 3.0  # times: so much more repeats hardly scatter at one temperature than at most by chance, or than is typical
_SEVERAL = 5  # values at one temperature stand for all
_AS_NEAR = 2.0  # times what is left with the best: values with which no more is left may as well be right
_LINES = 3  # that tell how far values are off them: of fewer it is anyone's guess
_REPEATED = 3  # runs of one temperature tell what is usual there
_NONE = np.zeros((0, 0))


class Others(NamedTuple):
    """What others say of p values of a run, by g temperatures: what they are known `within`, and `usual`, (g, p) each.

    `common` (q, n) is how those that all have in common go from row to row; each of `lines` (r, g) takes a
    temperature's from between its neighbours', which it is `off` by (r, p) at most, and by a `share` (r, p) of that.
    """

    within: FloatArray
    usual: FloatArray
    common: FloatArray
    lines: FloatArray = _NONE
    off: FloatArray = _NONE
    share: FloatArray = _NONE

    def smooth(self, of_run: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return the rows (m, g·q) that q values `of_run` (p,) add for every line, and the squares of their shares."""
        each = self.lines[:, None, :, None] * np.eye(of_run.sum())[:, None] / self.off[:, of_run, None, None]
        return each.reshape(-1, self.lines.shape[1] * of_run.sum()), self.share[:, of_run].ravel() ** 2


def of_others(
    conditions: Conditions,
    names: Sequence[str],
    of_run: BoolArray,
    columns: FloatArray,
    seen: FloatArray,
    groups: Sequence[tuple[float | None, Sequence[int]]],
    common: FloatArray,
) -> Others | None:
    """Return what a run's parameters are known within by those of others; None where too few tell of each other.

    That is more than their scatter, for of few nobody knows it well, but no more than is typical at most where it is
    less, both (g, p) by group: what scatters by far more at one temperature than at most is usual there. Others than
    those `of_run` (p,) scatter by nothing, unless they are known to and hardly any two of enough runs are as near as
    noise leaves most. And how they go from row to row by what all have in common, (q, n): by temperature, which is what
    those of each of the `groups` have in `common` (g, n), or, where hardly any run repeats another, along a curve.
    """
    values: dict[int, FloatArray] = {}
    errors = []
    for run, rows in conditions.of_each_run.items():
        design = flattened(columns[rows])
        fitted, _, rank, _ = np.linalg.lstsq(design, seen[rows].reshape(-1), rcond=1e-3)
        if rank == design.shape[1]:
            values[run] = np.asarray(fitted)
            errors.append(np.sqrt(np.diag(np.linalg.inv(design.T @ design))))
    repeated = [[values[run] for run in of if run in values] for _, of in groups]
    degrees_of = np.array([max(len(of) - 1, 0) for of in repeated], dtype=np.float64)
    degrees = float(degrees_of.sum())
    apart_in = [[one - other for lag in _LAGS for one, other in zip(of, of[lag:], strict=False)] for of in repeated]
    apart = [each for of in apart_in for each in of]
    typical = np.array([typical_scatter(name, conditions.sensor) for name in names])
    degC, hardly_any = np.array([at for at, _ in groups], dtype=np.float64), degrees < _LEAST
    if hardly_any:
        met = [k for k, of in enumerate(repeated) if of]
        if len(met) - 2 < _LEAST or not np.isfinite(degC).all():
            return None
        apart = [*_off(_lines(degC[met]), [np.mean(repeated[k], axis=0) for k in met])]
        degrees, common = float(len(met) - 2), curve_over(degC, len(met)).T @ common
        typical[:] = 0.0  # what is off a curve is also what the curve of a unit is off one of that order
    noise = np.median(errors, axis=0)
    least = np.maximum(1.0 / np.sqrt(1.0 + degrees / _LEAST), noise)
    gone_to = [(degC, [values[run] for run in runs if run in values]) for degC, runs in visits(conditions)]
    of_visits = [[np.mean(of, axis=0) for degC, of in gone_to if degC == at and of] for at, _ in groups]
    again = [one - other for of in of_visits for lag in _LAGS for one, other in zip(of, of[lag:], strict=False)]
    if len(again) > 1:  # what differs from visit to visit makes runs of one no two that were others
        least = np.maximum(least, _most_are_within(again))
    scatter = np.tile(np.maximum(_most_are_within(apart), least), (len(groups), 1))
    known_by = np.full(scatter.shape, degrees)
    for k, of in enumerate(apart_in):
        if len(repeated[k]) >= _REPEATED:  # of which one that is wrong does not move what most are within
            loud = (own := _most_are_within(of)) > _LOUD * scatter[k]
            scatter[k, loud], known_by[k, loud] = own[loud], degrees_of[k]
    within = scatter * (1.0 + _FEW / known_by)
    within = np.where(scatter < typical, np.minimum(within, typical), within)
    least = np.quantile(np.abs(np.array(apart)), _HARDLY_ANY, axis=0, method="lower")
    by_chance = _BY_CHANCE * noise
    known = np.isfinite(typical) & (degrees >= _FEW)
    changes = of_run | (known & (by_chance < least) & (least < _LOUD * typical))
    lines = () if hardly_any else _from_neighbours(degC, repeated, noise)
    return Others(within * changes, scatter * changes, common, *lines)


def _most_are_within(apart: Sequence[FloatArray] | FloatArray) -> FloatArray:
    """Return the scatter (p,) of values by differences of two, (p,) each, which a few that are wrong do not move."""
    return np.asarray(SIGMA * np.quantile(np.abs(np.array(apart)), SHARE, axis=0, method="lower"))


def _from_neighbours(
    degC: FloatArray, values: Sequence[Sequence[FloatArray]], noise: FloatArray
) -> tuple[FloatArray, ...]:
    """Return the lines (r, g) of `Others`, with `off` and `share`; nothing where too few temperatures tell.

    They are off by what is usual, no less than a run's `noise` (p,), or by what is left of them with that run at each
    temperature with which least is: there values bend. Where one run is alone, and that is more than of all others, the
    line tells nothing.
    """
    met = [k for k, of in enumerate(values) if of and np.isfinite(degC[k])]
    if len(met) - 2 < _LINES:
        return ()
    lines = np.zeros((len(met) - 2, len(degC)))
    lines[:, met] = _lines(degC[met])
    usual = _most_are_within(_off(lines[:, met], [np.median(values[k], axis=0) for k in met]))
    usual = np.maximum(usual, noise)
    far = np.maximum(_left_of([*lines[:, met]], [np.array(values[k]) for k in met]), usual)
    least = usual * (1.0 + _FEW / len(lines))
    of_one, off = np.any(lines[:, [len(of) < 2 for of in values]] != 0.0, axis=1)[:, None], np.maximum(far, least)
    off = np.where(of_one & (off > np.max(off, axis=0, where=~of_one, initial=0.0)) & (off > least), np.inf, off)
    return lines, off, far / off


def _left_of(lines: Sequence[FloatArray], values: Sequence[FloatArray]) -> FloatArray:
    """Return what lines (r, g) leave at most (r, p) with values (m, p) at g = r + 2 places that are nearly the best.

    One is chosen of those at each place. A line is of three places that are next to each other, so that what is best of
    all before it, and of all after it, goes by two.
    """
    some = [np.quantile(of, np.linspace(0.0, 1.0, min(len(of), _SEVERAL)), axis=0, method="nearest") for of in values]
    left = []
    for j, line in enumerate(lines):
        one, other, third = (line[j + k] * some[j + k] for k in range(3))
        left.append(np.abs(one[:, None, None] + other[:, None] + third))
    before, after = [np.zeros_like(left[0][:, :, 0])], [np.zeros_like(left[-1][0])]
    for here, back in zip(left, reversed(left), strict=True):
        before.append(np.min(before[-1][:, :, None] + here, axis=0))
        after.append(np.min(back + after[-1], axis=2))
    every = [first[:, :, None] + here + last for first, here, last in zip(before, left, after[-2::-1], strict=False)]
    near = [total <= _AS_NEAR * total.min(axis=(0, 1, 2)) for total in every]
    return np.array([np.max(of, axis=(0, 1, 2), where=own, initial=0.0) for of, own in zip(left, near, strict=True)])


def _lines(degC: FloatArray) -> FloatArray:
    """Return what takes the value at each of g rising temperatures from between those of the next two, (g - 2, g)."""
    out = np.zeros((len(degC) - 2, len(degC)))
    for j, line in enumerate(out):
        share = (degC[j + 1] - degC[j]) / (degC[j + 2] - degC[j])
        line[j : j + 3] = share - 1.0, 1.0, -share
    return out


def _off(lines: FloatArray, values: Sequence[FloatArray]) -> FloatArray:
    """Return how far values (g, p) are off lines (r, g), as two repeats would be apart, (r, p)."""
    return np.asarray(lines @ np.array(values) * np.sqrt(2.0 / np.sum(lines**2, axis=1, keepdims=True)))
