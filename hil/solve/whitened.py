"""The rates of a campaign less what its runs may show each for itself, and less what they show together.

    rates = Whitened(collects)
    rates.squares, rates.freedom     # of what is left, in standard errors, and how many degrees of freedom it has

A run's bias and MU are its own, within what those of the other runs scatter by where enough were made to tell: about
those of others at its temperature, or, where hardly any run repeats another, about a curve over temperature. So is GS
where hardly any two runs have the same. What else its rates show the others show too, at another temperature by a
little more or less; where three runs took a position at the same place in them, whatever the form says of it.
"""

from collections.abc import Collection, Iterator, Mapping
from copy import copy
from functools import lru_cache
from itertools import compress, product
from typing import Self

import numpy as np

from hil.campaign import Collects, Conditions, FloatArray, IntArray
from hil.campaign.laws import FIXTURE_G, from_the_usual_g
from hil.model.effects.columns import flattened
from hil.model.forms import default_form
from hil.solve.identifiability import orthonormal, unit_columns
from hil.solve.others import SHARE, SIGMA, of_others
from hil.solve.temperatures import runs_by_temperature

_CHANGES = 0.1  # of its size: so much what neither a bias nor MU moves is another at another temperature, or place
# Where each temperature was met once, that follows a curve as bias and MU do, and is off it by so much of itself.
_LEVEL = 0.7  # of a channel's usual variance in every row's: standard errors leave out what differs by collect
_LOUDER = 0.2  # probability that one temperature is noisier than rates tell by themselves
_TIMES = (1.5, 2.2, 3.3, 5.0)  # as noisy as they tell
_NOISIER = 1.5  # times: so much noisier one channel may seem than another by chance
_OF_A_CHANNEL = 20.0  # degrees of freedom that tell its noise as well as is known before: that all are alike
_OF_UNSTATED = 4.0  # likewise, of one that states no errors: channels of a unit are hardly known to be alike
_APART = 1e-9  # of the square of the largest: directions that are none
_REPEATED = 3  # collects in one place tell what it shows
_TOLD = 1e-3  # of what a run's bias or MU shows: where others leave less, they tell nothing of it


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
        scatter = of_others(conditions, form.names, of_run, columns, seen, groups, at)
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
        return float(np.sqrt(0.5 * freedom / max(int(self.known.sum()), 1)) / SIGMA) if self.stated else 0.0

    def _noisier_channel(self) -> FloatArray:
        """Return how many times noisier than the quietest each channel is, (c,): 1 where few rates tell, or hardly."""
        left, freedom = np.abs(self._left), max(self.freedom, 0.0)
        size = np.array([_usual(left[:, c][self.known[:, c]]) for c in range(self.known.shape[1])])
        quietest = max(float(np.min(size[size > 0.0], initial=np.inf)), self._least)
        known_before = _OF_A_CHANNEL if self.stated else _OF_UNSTATED
        return _noisier(size / quietest, np.full(len(size), freedom / len(size)), known_before)

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
    return float(np.quantile(left, SHARE)) if left.size else 0.0


def _noisier(times: FloatArray, freedom: FloatArray, known_before: float = _OF_A_CHANNEL) -> FloatArray:
    """Return how many times noisier some rates are, (k,), as far as their degrees of freedom tell: 1 where hardly."""
    level = np.maximum(times, 1.0) ** (freedom / (freedom + known_before))
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


def _basis(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis (N, r) of what many columns (N, p) span, by their products: a life has many rows."""
    columns = unit_columns(columns)
    size, directions = np.linalg.eigh(columns.T @ columns)
    told = size > _APART * max(float(size.max(initial=0.0)), 1.0)
    return np.asarray(columns @ (directions[:, told] / np.sqrt(size[told])))
