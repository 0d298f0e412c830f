"""The rates of a campaign less what its runs may show each for itself, and less what they show together.

    rates = Whitened(collects)
    rates.squares, rates.freedom     # of what is left, in standard errors, and how many degrees of freedom it has

A run's bias and MU are its own, within what those of the other runs scatter by where enough were made to tell. What
else its rates show the others show too, at another temperature by a little more or less; where three runs took a
position at the same place in them, whatever the form says of it.
"""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from hil.campaign import Collects, FloatArray, IntArray
from hil.campaign.laws import FIXTURE_G, from_the_usual_g
from hil.model.forms import default_form
from hil.solve.identifiability import orthonormal, unit_columns
from hil.solve.neighbours import place_in_each_run
from hil.solve.temperatures import runs_by_temperature

_CHANGES = 0.1  # of its size: so much what neither a bias nor MU moves is another at another temperature, or place
_SHARE = 1.0 / 3.0  # of differences of two: what so many are below, a few that are wrong do not move
_SIGMA = 1.64  # a normal distribution's sigma by that
_FEW = 8.0  # runs that repeat others: of so many their scatter is known hardly better than by 2
_LEAST = 2  # and of fewer not at all
_LEVEL = 0.7  # of a channel's usual variance in every row's: standard errors leave out what differs by collect
_LAGS = (1, 2)  # between repeats whose difference is taken
_APART = 1e-9  # of the square of the largest: directions that are none
_REPEATED = 3  # collects in one place tell what it shows


class Whitened:
    """Rates (n, c) of one sensor, in standard errors, which are `known`, and the `weight` that made them so.

    `squares` is the sum over what is left of them, `freedom` its degrees. Of the bias of runs in `own_bias` those of
    others say nothing. `stated`: whether all rates have standard errors; otherwise all are 1 deg/hr.
    """

    def __init__(self, collects: Collects, own_bias: Collection[int] = ()) -> None:
        conditions, rates, se = collects.conditions, collects.rates_deg_per_hr, collects.rates_se_deg_per_hr
        self.collects, self.known = collects, np.isfinite(rates)
        self.stated = bool(np.all(se[self.known] > 0.0))
        variance = se**2 if self.stated else np.ones(se.shape)
        usual = np.array([np.median(v[k]) if k.any() else 1.0 for v, k in zip(variance.T, self.known.T, strict=True)])
        errors = np.sqrt((1.0 - _LEVEL) * np.where(self.known, variance, 1.0) + _LEVEL * usual)
        self.weight = np.where(self.known, 1.0 / errors, 0.0)
        form = default_form(conditions)
        columns = form.columns(conditions) * self.weight[..., None]
        of_run = np.array([name.startswith(("B", "MU")) for name in form.names])
        bias = np.array([name.startswith("B") for name in form.names])[of_run]
        own, steady = columns[..., of_run], columns[..., ~of_run]
        seen = np.where(self.known, rates - conditions.w_channels_deg_per_hr, 0.0) * self.weight
        groups = [of for _, of in runs_by_temperature(conditions)]
        self._runs = conditions.of_each_run
        scatter = _scatter(self._runs, columns, seen, groups)
        self._keeps: dict[int, FloatArray] = {}
        left = {}  # the covariance that is expected of what it keeps
        for run, rows in self._runs.items():
            free = np.full(own.shape[2], scatter is None) | (bias & (run in own_bias))
            basis = orthonormal(_flat(own[rows])[:, free])
            keeps, covariance = np.eye(len(basis)) - basis @ basis.T, np.diag(self.known[rows].reshape(-1) * 1.0)
            if scatter is not None:
                bound = _flat(own[rows])[:, ~free] * scatter[0][of_run][~free]
                directions, size, _ = np.linalg.svd(keeps @ bound, full_matrices=False)
                keeps = keeps - directions * (1.0 - 1.0 / np.sqrt(1.0 + size**2)) @ directions.T @ keeps
                covariance += bound @ bound.T / scatter[1] ** 2
            self._keeps[run], left[run] = keeps, keeps @ covariance @ keeps.T
        at = np.array([np.isin(conditions.run, of) for of in groups])[..., None, None]
        common = [steady, *([] if scatter is None else own * at)]
        changes = [*self._places(), *(steady * at if len(groups) > 1 else [])]
        white = self._white(np.concatenate([seen[..., None], steady, *common, *changes], axis=2))
        seen, excited = white[..., 0], white[..., 1 : 1 + steady.shape[2]]
        flat = white[..., 1 + steady.shape[2] :]
        several = sum(each.shape[2] for each in changes)
        sizes = [
            np.sum(seen[rows] ** 2) / max(float(np.sum(excited[rows] ** 2)), 1e-12) for rows in self._runs.values()
        ]
        loose = max(_CHANGES * float(np.sqrt(np.median(sizes))), 1e-9)  # of most: one may be wrong
        prior = np.hstack([np.zeros((several, flat.shape[2] - several)), np.eye(several) / loose])
        basis = _basis(np.vstack([_flat(flat), prior]))
        self._shown = basis[: seen.size].reshape(*seen.shape, -1)
        self._left = seen - self._shown @ np.einsum("ncq,nc->q", self._shown, seen)
        self.squares = float(np.sum(seen * self._left))
        shown = {run: _flat(self._shown[rows]) for run, rows in self._runs.items()}
        taken = sum(np.trace(of) - np.sum(shown[run] * (of @ shown[run])) for run, of in left.items())
        self.freedom = float(taken) + several - float(np.sum(basis[seen.size :] ** 2))

    def of(self, run: int) -> tuple[FloatArray, FloatArray]:
        """Return what squares (k·c, k·c) and products (k·c,) of changes to a run's rates, in standard errors, add."""
        keeps, shown = self._keeps[run], self.shown(run)
        return keeps.T @ keeps - shown.T @ shown, keeps.T @ self._left[self._runs[run]].reshape(-1)

    def shown(self, run: int) -> FloatArray:
        """Return what of changes to a run's rates all runs show together, (q, k·c)."""
        return np.asarray(_flat(self._shown[self._runs[run]]).T @ self._keeps[run])

    def _white(self, columns: FloatArray) -> FloatArray:
        """Return columns (n, c, p) less what each run shows for itself."""
        out = np.empty_like(columns)
        for run, rows in self._runs.items():
            out[rows] = (self._keeps[run] @ _flat(columns[rows])).reshape(columns[rows].shape)
        return out

    def _places(self) -> list[FloatArray]:
        """Return a column for each channel at each place that enough runs took, (n, c, c) each.

        A collect that lay otherwise than its label says is at none.
        """
        conditions = self.collects.conditions
        place = np.where(from_the_usual_g(conditions) > FIXTURE_G, -1, place_in_each_run(conditions))
        numbers, count = np.unique(place, return_counts=True)
        channels = np.eye(self.known.shape[1]) * self.weight[..., None]
        return [(place == each)[:, None, None] * channels for each in numbers[(count >= _REPEATED) & (numbers >= 0)]]


def _scatter(
    runs: Mapping[int, IntArray], columns: FloatArray, seen: FloatArray, groups: Sequence[Sequence[int]]
) -> tuple[FloatArray, float] | None:
    """Return what a run's parameters (p,) are known within by those of others at its temperature; None for too few.

    And how many times as much as they scatter that is: of few nobody knows it well.
    """
    values: dict[int, FloatArray] = {}
    for run, rows in runs.items():
        design = _flat(columns[rows])
        fitted, _, rank, _ = np.linalg.lstsq(design, seen[rows].reshape(-1), rcond=1e-3)
        if rank == design.shape[1]:
            values[run] = np.asarray(fitted)
    repeated = [[values[run] for run in of if run in values] for of in groups]
    degrees = sum(max(len(of) - 1, 0) for of in repeated)
    if degrees < _LEAST:
        return None
    apart = np.array(
        [one - other for of in repeated for lag in _LAGS for one, other in zip(of, of[lag:], strict=False)]
    )
    times = 1.0 + _FEW / degrees
    usual = _SIGMA * np.quantile(np.abs(apart), _SHARE, axis=0, method="lower")
    return np.maximum(usual, 1.0) * times, times


def _basis(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis (N, r) of what many columns (N, p) span, by their products: a life has many rows."""
    columns = unit_columns(columns)
    size, directions = np.linalg.eigh(columns.T @ columns)
    told = size > _APART * max(float(size.max(initial=0.0)), 1.0)
    return np.asarray(columns @ (directions[:, told] / np.sqrt(size[told])))


def _flat(columns: FloatArray) -> FloatArray:
    """Return columns (n, c, p) of all rates, one below the other, (n·c, p)."""
    return columns.reshape(columns.shape[0] * columns.shape[1], -1)
