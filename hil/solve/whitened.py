"""The rates of a campaign less what its runs may show each for itself, and less what they show together.

    rates = Whitened(collects)
    rates.squares, rates.freedom     # of what is left, in standard errors, and how many degrees of freedom it has

A run's bias and MU are its own, within what those of the other runs scatter by where enough were made to tell: about
those of others at its temperature, or, where hardly any run repeats another, about a curve over temperature. So is GS
where hardly any two runs have the same. What else its rates show the others show too, at another temperature by a
little more or less; where three runs took a position at the same place in them, whatever the form says of it.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from copy import copy
from functools import lru_cache
from itertools import compress, product
from typing import NamedTuple, Self

import numpy as np

from hil.campaign import BoolArray, Collects, Conditions, FloatArray, IntArray
from hil.campaign.laws import FIXTURE_G, from_the_usual_g
from hil.model.effects.columns import flattened
from hil.model.forms import default_form
from hil.solve.identifiability import orthonormal, unit_columns
from hil.solve.precision import typical_scatter
from hil.solve.temperatures import runs_by_temperature, visits

_CHANGES = 0.1  # of its size: so much what neither a bias nor MU moves is another at another temperature, or place
# Where each temperature was met once, that follows a curve as bias and MU do, and is off it by so much of itself.
_SHARE = 1.0 / 3.0  # of differences of two: what so many are below, a few that are wrong do not move
_SIGMA = 1.64  # a normal distribution's sigma by that
_HARDLY_ANY = 1.0 / 6.0  # of them
_BY_CHANCE = 2.0  # standard errors of one: noise makes hardly any larger
_CURVE = 3  # order of what parameters follow over temperature at most
_FEW = 8.0  # runs that others tell of: of so many their scatter is known hardly better than by 2
_LEAST = 2  # and of fewer not at all
_LEVEL = 0.7  # of a channel's usual variance in every row's: standard errors leave out what differs by collect
_LOUDER = 0.2  # probability that one temperature is noisier than rates tell by themselves
_TIMES = (1.5, 2.2, 3.3, 5.0)  # as noisy as they tell
_NOISIER = 1.5  # times: so much noisier one channel may seem than another by chance
_OF_A_CHANNEL = 20.0  # degrees of freedom that tell its noise as well as is known before: that all are alike
_LAGS = (1, 2)  # between repeats whose difference is taken
_APART = 1e-9  # of the square of the largest: directions that are none
_LOUD = 3.0  # times: so much more repeats hardly scatter at one temperature than at most by chance, or than is typical
_SEVERAL = 5  # values at one temperature stand for all
_AS_NEAR = 2.0  # times what is left with the best: values with which no more is left may as well be right
_LINES = 3  # that tell how far values are off them: of fewer it is anyone's guess
_REPEATED = 3  # collects in one place tell what it shows
_TOLD = 1e-3  # of what a run's bias or MU shows: where others leave less, they tell nothing of it


class _Others(NamedTuple):
    """What others say of p values of a run, by g temperatures: what they are known `within`, and `usual`, (g, p) each.

    `common` (q, n) is how those that all have in common go from row to row; each of `lines` (r, g) takes a
    temperature's from between its neighbours', which it is `off` by (r, p) at most, and by a `share` (r, p) of that.
    """

    within: FloatArray
    usual: FloatArray
    common: FloatArray
    lines: FloatArray
    off: FloatArray
    share: FloatArray

    def smooth(self, of_run: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return the rows (m, g·q) that q values `of_run` (p,) add for every line, and the squares of their shares."""
        each = self.lines[:, None, :, None] * np.eye(of_run.sum())[:, None] / self.off[:, of_run, None, None]
        return each.reshape(-1, self.lines.shape[1] * of_run.sum()), self.share[:, of_run].ravel() ** 2


class Whitened:
    """Rates (n, c) of one sensor, in standard errors, which are `known`, and the `weight` that made them so.

    `squares` is the sum over what is left of them, `freedom` its degrees. Of the bias, B, or MU of runs in `apart`
    those of others say nothing. `stated`: whether all rates have standard errors; otherwise all are 1 deg/hr.
    """

    def __init__(self, collects: Collects, apart: Collection[tuple[int, str]] = ()) -> None:
        as_stated = np.ones(collects.rates_deg_per_hr.shape)
        self._lay(collects, apart, as_stated)
        if np.any(self._noisier_channel() > 1.0):  # than what a bias or MU of a run's own makes of it
            self._lay(collects, [*product(collects.conditions.of_each_run, ("B", "MU"))], as_stated)
            self._lay(collects, apart, as_stated * self._noisier_channel())
        if np.any((level := self._noisier_temperature()) > 1.0):  # what is noisier tells less, whatever its errors say
            self._lay(collects, apart, self._level * level)

    def _lay(self, collects: Collects, apart: Collection[tuple[int, str]], level: FloatArray) -> None:
        conditions, rates, se = collects.conditions, collects.rates_deg_per_hr, collects.rates_se_deg_per_hr
        self.collects, self._apart, self._level = collects, apart, level
        self.known = np.isfinite(rates)
        self.stated = bool(np.all(se[self.known] > 0.0))
        variance = level**2 * (se**2 if self.stated else np.ones(se.shape))
        usual = np.array([np.median(v[k]) if k.any() else 1.0 for v, k in zip(variance.T, self.known.T, strict=True)])
        errors = np.sqrt((1.0 - _LEVEL) * np.where(self.known, variance, 1.0) + _LEVEL * usual)
        self.weight = np.where(self.known, 1.0 / errors, 0.0)
        form = default_form(conditions)
        columns = form.columns(conditions) * self.weight[..., None]
        of_run, bias, mu = (np.array([n.startswith(of) for n in form.names]) for of in (("B", "MU"), "B", "MU"))
        self._names = [*compress(form.names, of_run)]
        own, steady = columns[..., of_run], columns[..., ~of_run]
        seen = np.where(self.known, rates - conditions.w_channels_deg_per_hr, 0.0) * self.weight
        groups = runs_by_temperature(conditions)
        at = self._at = np.array([np.isin(conditions.run, of) for _, of in groups])
        self._runs = conditions.of_each_run
        scatter = _scatter(conditions, form.names, of_run, columns, seen, groups, at)
        group_of = {run: k for k, (_, runs) in enumerate(groups) for run in runs}
        self._keeps: dict[int, FloatArray] = {}
        self._own = {run: flattened(own[rows]) for run, rows in self._runs.items()}
        left = {}  # the covariance that is expected of what it keeps
        for run, rows in self._runs.items():
            free = (of_run & (scatter is None)) | (bias & ((run, "B") in apart)) | (mu & ((run, "MU") in apart))
            every = flattened(columns[rows])
            basis = orthonormal(every[:, free])
            keeps, covariance = np.eye(len(basis)) - basis @ basis.T, np.diag(self.known[rows].reshape(-1) * 1.0)
            if scatter is not None:
                bound, usual = (every[:, ~free] * of[group_of[run]][~free] for of in (scatter.within, scatter.usual))
                directions, size, _ = np.linalg.svd(keeps @ bound, full_matrices=False)
                keeps = keeps - directions * (1.0 - 1.0 / np.sqrt(1.0 + size**2)) @ directions.T @ keeps
                covariance += usual @ usual.T
            self._keeps[run], left[run] = keeps, keeps @ covariance @ keeps.T
        common = [steady, *([] if scatter is None else own * scatter.common[..., None, None])]
        along = scatter is not None and len(scatter.common) < len(groups)
        curve = steady * scatter.common[:-1, ..., None, None] if scatter is not None and along else steady[:0, None]
        steps = steady * at[..., None, None] if len(groups) > 1 else steady[:0, None]
        changes = [*self._places(), *curve, *steps]
        white = self._white(np.concatenate([seen[..., None], steady, *common, *changes], axis=2))
        seen, excited = white[..., 0], white[..., 1 : 1 + steady.shape[2]]
        flat = white[..., 1 + steady.shape[2] :]
        several = sum(each.shape[2] for each in changes)
        sizes = [
            np.sum(seen[rows] ** 2) / max(float(np.sum(excited[rows] ** 2)), 1e-12) for rows in self._runs.values()
        ]
        loose = max(_CHANGES * float(np.sqrt(np.median(sizes))), 1e-9)  # of most: one may be wrong
        off_it = np.arange(several) >= several - steady.shape[2] * len(steps) * along
        bounds = loose * np.where(off_it, _CHANGES, 1.0)
        prior, expected = np.zeros((several, flat.shape[2])), np.ones(several)
        prior[:, flat.shape[2] - several :] = np.diag(1.0 / bounds)
        if scatter is not None and len(scatter.lines):
            (lines, shares), before = scatter.smooth(of_run), steady.shape[2]
            prior = np.vstack([prior, np.pad(lines, ((0, 0), (before, flat.shape[2] - before - lines.shape[1])))])
            expected = np.append(expected, shares)
        basis = _basis(np.vstack([flattened(flat), prior]))
        self._shown = basis[: seen.size].reshape(*seen.shape, -1)
        self._left = seen - self._shown @ np.einsum("ncq,nc->q", self._shown, seen)
        self.squares = float(np.sum(seen * self._left))
        shown = {run: flattened(self._shown[rows]) for run, rows in self._runs.items()}
        self._freedom_of = {
            run: float(np.trace(of) - np.sum(shown[run] * (of @ shown[run]))) for run, of in left.items()
        }
        left_free = expected @ (1.0 - np.sum(basis[seen.size :] ** 2, axis=1))
        self.freedom = sum(self._freedom_of.values()) + float(left_free)

    def louder(self, runs: Collection[int]) -> Iterator[tuple[float, Self]]:
        """Yield them as they are if a temperature of some of the runs is noisier than they tell, with its log odds.

        Less by how much less probable rates are that scatter so much more, whatever they are.
        """
        told = [own for own in self._at if np.isin(self.collects.conditions.run[own], [*runs]).any()]
        odds = float(np.log(_LOUDER / len(_TIMES) / len(self._at)))
        for own, times in product(told if len(self._at) > 1 else (), _TIMES):
            out = copy(self)
            out._lay(self.collects, self._apart, self._level * np.where(own, times, 1.0)[:, None])
            there = np.unique(self.collects.conditions.run[own]).tolist()
            free = [sum(each._freedom_of[run] for run in there) for each in (self, out)]
            yield odds - 0.5 * sum(free) * float(np.log(times)), out

    @property
    def _least(self) -> float:
        """The size below which nothing is quiet: that of standard errors as they are stated, 0 where none are."""
        freedom = max(self.freedom, 0.0)
        return float(np.sqrt(0.5 * freedom / max(int(self.known.sum()), 1)) / _SIGMA) if self.stated else 0.0

    def _noisier_channel(self) -> FloatArray:
        """Return how many times noisier than the quietest each channel is, (c,): 1 where few rates tell, or hardly."""
        left, freedom = np.abs(self._left), max(self.freedom, 0.0)
        size = np.array([_usual(left[:, c][self.known[:, c]]) for c in range(self.known.shape[1])])
        quietest = max(float(np.min(size[size > 0.0], initial=np.inf)), self._least)
        return _noisier(size / quietest, np.full(len(size), freedom / len(size)))

    def _noisier_temperature(self) -> FloatArray:
        """Return how many times noisier than is usual rates are at their temperature, (n, 1), likewise."""
        left, at = np.abs(self._left), self._at[:, :, None] & self.known
        size = np.array([_usual(left[here]) for here in at])
        usual = max(float(np.median(size)), self._least, _APART)
        share = at.sum(axis=(1, 2)) / max(int(self.known.sum()), 1)
        level = _noisier(size / usual, max(self.freedom, 0.0) * share)
        return np.asarray(np.max(np.where(self._at, level[:, None], 1.0), axis=0)[:, None])

    def of(self, run: int) -> tuple[FloatArray, FloatArray]:
        """Return what squares (k·c, k·c) and products (k·c,) of changes to a run's rates, in standard errors, add."""
        keeps, shown = self._keeps[run], self.shown(run)
        return keeps.T @ keeps - shown.T @ shown, keeps.T @ self._left[self._runs[run]].reshape(-1)

    def moved(self, run: int, rates: FloatArray, squares: float) -> Self:
        """Return them with those of a run changed by so much, (k·c,) in standard errors, which leaves these squares."""
        out, rows = copy(self), self._runs[run]
        out._left = self._left - np.einsum("ncq,q->nc", self._shown, self.shown(run) @ rates)
        out._left[rows] += (self._keeps[run] @ rates).reshape(out._left[rows].shape)
        out.squares = squares
        return out

    def shown(self, run: int) -> FloatArray:
        """Return what of changes to a run's rates all runs show together, (q, k·c)."""
        return np.asarray(flattened(self._shown[self._runs[run]]).T @ self._keeps[run])

    def own(self, run: int, kind: str) -> FloatArray:
        """Return what values of a run's own, those of which the names begin so, do to its rates, (k·c, q)."""
        return self._own[run][:, [name.startswith(kind) for name in self._names]]

    @property
    def alone(self) -> Mapping[int, tuple[str, ...]]:
        """The runs of whose bias, or of whose MU, no other tells anything, with of which; none where of the whole."""
        out = {}
        for run, own in self._own.items():
            size, kept, shown = (np.sum(of**2, axis=0) for of in (own, self._keeps[run] @ own, self.shown(run) @ own))
            lacks = (size > 0.0) & (kept - shown <= _TOLD * kept + _APART * size)
            if lacks.any():
                every = np.array_equal(lacks, size > 0.0)
                out[run] = () if every else tuple(compress(self._names, lacks))
        return out

    def _white(self, columns: FloatArray) -> FloatArray:
        """Return columns (n, c, p) less what each run shows for itself."""
        out = np.empty_like(columns)
        for run, rows in self._runs.items():
            out[rows] = (self._keeps[run] @ flattened(columns[rows])).reshape(columns[rows].shape)
        return out

    def _places(self) -> list[FloatArray]:
        """Return columns (n, c, c) of places that enough runs took: what lay otherwise than labelled is at none."""
        conditions = self.collects.conditions
        place = np.where(from_the_usual_g(conditions) > FIXTURE_G, -1, place_in_each_run(conditions))
        numbers, count = np.unique(place, return_counts=True)
        channels = np.eye(self.known.shape[1]) * self.weight[..., None]
        return [(place == each)[:, None, None] * channels for each in numbers[(count >= _REPEATED) & (numbers >= 0)]]


def _usual(left: FloatArray) -> float:
    """Return the size that a share of some rates is below, which a few that are wrong do not move; 0 of none."""
    return float(np.quantile(left, _SHARE)) if left.size else 0.0


def _noisier(times: FloatArray, freedom: FloatArray) -> FloatArray:
    """Return how many times noisier some rates are, (k,), as far as their degrees of freedom tell: 1 where hardly."""
    level = np.maximum(times, 1.0) ** (freedom / (freedom + _OF_A_CHANNEL))
    return np.where(level > _NOISIER, level, 1.0)


_once = lru_cache(maxsize=4)(Whitened)


def whitened(collects: Collects, apart: frozenset[tuple[int, str]] = frozenset()) -> Whitened:
    """Return them of collects, once for whoever asks: the sensor itself, the other one, and for what nobody sees."""
    return _once(collects, apart)


def place_in_each_run(conditions: Conditions) -> IntArray:
    """Number collects, (n,), by position and by the how-manieth time that their run took it.

    What drifts through a run shows where a position is taken again: that is compared with its like.
    """
    position = np.unique(conditions.position, return_inverse=True)[1]
    place = np.unique(np.stack([conditions.run, position]), axis=1, return_inverse=True)[1].reshape(-1)
    order = np.argsort(place, kind="stable")
    again = np.empty_like(place)
    again[order] = np.arange(len(place)) - np.searchsorted(place[order], place[order])
    return np.asarray(len(position) * again + position)


def _scatter(
    conditions: Conditions,
    names: Sequence[str],
    of_run: BoolArray,
    columns: FloatArray,
    seen: FloatArray,
    groups: Sequence[tuple[float | None, Sequence[int]]],
    common: FloatArray,
) -> _Others | None:
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
    degrees, lines = float(degrees_of.sum()), (np.zeros((0, len(groups))), *np.zeros((2, 0, len(names))))
    apart_in = [[one - other for lag in _LAGS for one, other in zip(of, of[lag:], strict=False)] for of in repeated]
    apart = [each for of in apart_in for each in of]
    typical = np.array([typical_scatter(name, conditions.sensor) for name in names])
    degC = np.array([at for at, _ in groups], dtype=np.float64)
    if degrees < _LEAST:
        met = [k for k, of in enumerate(repeated) if of]
        if len(met) - 2 < _LEAST or not np.isfinite(degC).all():
            return None
        apart = _off_a_line([(degC[k], np.mean(repeated[k], axis=0)) for k in met])
        order, degrees = min(_CURVE, (len(met) - _LEAST) // 2), float(len(met) - 2)
        common = np.vander((degC - degC.mean()) / np.ptp(degC), order + 1).T @ common
        typical[:] = 0.0  # what is off a curve is also what the curve of a unit is off one of that order
    else:
        lines = _from_neighbours(degC, repeated, np.median(errors, axis=0))
    least = np.maximum(1.0 / np.sqrt(1.0 + degrees / _LEAST), np.median(errors, axis=0))
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
    by_chance = _BY_CHANCE * np.median(errors, axis=0)
    known = np.isfinite(typical) & (degrees >= _FEW)
    changes = of_run | (known & (by_chance < least) & (least < _LOUD * typical))
    return _Others(within * changes, scatter * changes, common, *lines)


def _most_are_within(apart: Sequence[FloatArray]) -> FloatArray:
    """Return the scatter (p,) of values by differences of two, (p,) each, which a few that are wrong do not move."""
    return np.asarray(_SIGMA * np.quantile(np.abs(np.array(apart)), _SHARE, axis=0, method="lower"))


def _from_neighbours(
    degC: FloatArray, values: Sequence[Sequence[FloatArray]], noise: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return lines (r, g) that each take a temperature's values from between its neighbours', with `off` and `share`.

    They are off by what is usual, no less than a run's `noise` (p,), or by what is left of them with that run at each
    temperature with which least is: there values bend. Where one run is alone, and that is more than of all others, the
    line tells nothing.
    """
    met = [k for k, of in enumerate(values) if of and np.isfinite(degC[k])]
    if len(met) - 2 < _LINES:
        return np.zeros((0, len(degC))), *np.zeros((2, 0, 0))
    middle = [(float(degC[k]), np.median(values[k], axis=0)) for k in met]
    usual = np.maximum(_most_are_within(_off_a_line(middle)), noise)
    lines = np.zeros((len(met) - 2, len(degC)))
    for line, (below, own, above) in zip(lines, zip(met, met[1:], met[2:], strict=False), strict=True):
        share = (degC[own] - degC[below]) / (degC[above] - degC[below])
        line[[below, own, above]] = share - 1.0, 1.0, -share
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


def _off_a_line(known: Sequence[tuple[float, FloatArray]]) -> list[FloatArray]:
    """Return how far values (p,) at each °C are off the line of their neighbours, as two repeats would be apart."""
    out = []
    for (cold, below), (at, value), (warm, above) in zip(known, known[1:], known[2:], strict=False):
        share = (at - cold) / (warm - cold)
        off = value - (1.0 - share) * below - share * above
        out.append(off * np.sqrt(2.0 / (1.0 + (1.0 - share) ** 2 + share**2)))
    return out


def _basis(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis (N, r) of what many columns (N, p) span, by their products: a life has many rows."""
    columns = unit_columns(columns)
    size, directions = np.linalg.eigh(columns.T @ columns)
    told = size > _APART * max(float(size.max(initial=0.0)), 1.0)
    return np.asarray(columns @ (directions[:, told] / np.sqrt(size[told])))
