"""Which two collects of a run carry each other's labels: that exchange by which all runs agree, where there is one.

    by_which_all_agree(collects)       # (13, 14), their numbers, or None

A run's bias and MU are its own. What else its rates show, the other runs show too, at another temperature by a little
more or less, and a run that holds more rates than parameters shows it several times. Where that is contradicted, every
exchange within a run is tried; it is told only if no other does as well.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.special import chdtrc, fdtrc

from hil.campaign import Collects, FloatArray, IntArray
from hil.model.forms import default_form
from hil.solve.identifiability import orthonormal
from hil.solve.temperatures import runs_by_temperature

EXCHANGED = 0.02
"""Prior odds that labels are exchanged: those of the search."""
_HARDLY, _LIKELY = 1e-3, 0.02  # chance of residuals that are looked into, and of those that an exchange may leave
_PLAIN = np.log(20.0)  # and of no other exchange may it be more probable than that
_CHANGES = 0.1  # of its size: by so much is another at another temperature what neither a bias nor MU moves
_OTHERS = 10.0  # times their standard errors at most that others differ by, where a run is judged by them
_TOLD = 1e-6  # of a direction in a run's rates: where less is left, nothing tells what it should be


def by_which_all_agree(collects: Collects) -> tuple[int, int] | None:
    """Return the numbers of the two collects of one run with whose labels exchanged all rates agree, where they do not.

    None where they agree as they are filed, where no exchange mends that, and where several would.
    """
    measured = np.isfinite(collects.rates_deg_per_hr) & (collects.rates_se_deg_per_hr > 0.0)
    known = np.asarray(measured.all(axis=1))
    if not known.any():
        return None
    own = collects.rows(known)
    conditions, rates, weight = own.conditions, own.rates_deg_per_hr, 1.0 / own.rates_se_deg_per_hr
    runs, form = conditions.of_each_run, default_form(conditions)
    of_run = np.array([name.startswith(("B", "MU")) for name in form.names])
    columns = form.columns(conditions) * weight[..., None]
    seen, steady, beside = (rates - conditions.w_channels_deg_per_hr) * weight, columns[..., ~of_run], {}
    for run, rows in runs.items():
        basis = orthonormal(_flat(columns[rows][..., of_run]))
        beside[run] = np.eye(len(basis)) - basis @ basis.T
        seen[rows] = (beside[run] @ seen[rows].reshape(-1)).reshape(rows.size, -1)
        steady[rows] = (beside[run] @ _flat(steady[rows])).reshape(steady[rows].shape)
    shown, freedom = _shown(conditions.run, steady, seen, [of for _, of in runs_by_temperature(conditions)])
    left = seen - shown @ np.einsum("ncq,nc->q", shown, seen)
    whole = float(np.sum(seen * left))
    freedom += round(sum(float(np.trace(keeps)) for keeps in beside.values()))
    if freedom < 1 or chdtrc(freedom, whole) > _HARDLY:
        return None
    found, every = [], _pairs(own)
    least = EXCHANGED / max(sum(map(len, every.values())), 1)
    for run, pairs in every.items():
        rows = runs[run]
        free = beside[run] - _flat(shown[rows]) @ _flat(shown[rows]).T
        size, directions = np.linalg.eigh(free)
        told = size > _TOLD
        turned = directions[:, told] / np.sqrt(size[told])
        apart = turned.T @ left[rows].reshape(-1)
        degrees, others = int(told.sum()), whole - float(apart @ apart)
        if not degrees or _chance(whole - others, degrees, others, freedom - degrees) > _HARDLY:
            continue
        for i, j in pairs:
            moved = np.zeros_like(rates[rows])
            moved[[i, j]] = (rates[rows[[j, i]]] - rates[rows[[i, j]]]) * weight[rows[[i, j]]]
            remains = float(np.sum((apart + turned.T @ (free @ moved.reshape(-1))) ** 2))
            odds = np.log(least) + 0.5 * freedom * np.log(whole / max(others + remains, freedom))
            if odds > 0.0 and _chance(remains, degrees, others, freedom - degrees) > _LIKELY:
                found.append((odds, (int(conditions.collect[rows[i]]), int(conditions.collect[rows[j]]))))
    nothing = -np.inf, None
    (best, pair), (second, _) = sorted([*found, nothing, nothing], key=lambda each: -each[0])[:2]
    return pair if best > second + _PLAIN else None


def _chance(squares: float, degrees: int, others: float, freedom: int) -> float:
    """Return how probable such squares of a run are by its standard errors, or by what others differ by, if more."""
    if others <= freedom or others > _OTHERS**2 * freedom:  # by others that are wrong themselves anything would agree
        return float(chdtrc(degrees, squares))
    return float(fdtrc(degrees, freedom, squares / degrees * freedom / others))


def _flat(columns: FloatArray) -> FloatArray:
    """Return columns (n, c, p) of all rates, one below the other, (n·c, p)."""
    return columns.reshape(columns.shape[0] * columns.shape[1], -1)


def _pairs(collects: Collects) -> dict[int, list[tuple[int, int]]]:
    """Return by run which of its collects, by place in it, may be exchanged: of different positions."""
    position = collects.conditions.position
    return {
        run: [(i, j) for i, j in combinations(range(len(rows)), 2) if position[rows[i]] != position[rows[j]]]
        for run, rows in collects.conditions.of_each_run.items()
    }


def _shown(
    run: IntArray, steady: FloatArray, seen: FloatArray, groups: Sequence[Sequence[int]]
) -> tuple[FloatArray, int]:
    """Return a basis of what columns (n, c, p) show, at each temperature by a little more or less, (n, c, q).

    And the degrees of freedom that it takes: fewer than none, for how much more or less is known beforehand.
    """
    place = np.unique(run, return_inverse=True)[1]
    squares, excited = (np.bincount(place, np.sum(each.reshape(len(run), -1) ** 2, axis=1)) for each in (seen, steady))
    size = np.sqrt(np.median(squares / np.maximum(excited, 1e-12)))  # of most: one may be wrong
    at = np.array([np.isin(run, of) for of in groups if len(groups) > 1]).reshape(-1, len(run))
    changes = (steady[:, :, None, :] * at.T[:, None, :, None]).reshape(*steady.shape[:2], -1)
    several = changes.shape[2]
    prior = np.hstack([np.zeros((several, steady.shape[2])), np.eye(several) / max(_CHANGES * size, 1e-9)])
    basis = orthonormal(np.vstack([_flat(np.concatenate([steady, changes], axis=2)), prior]))
    return basis[: seen.size].reshape(*seen.shape, -1), several - basis.shape[1]
