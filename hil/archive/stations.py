"""One parameter through the years, temperature by temperature: which means belong together, what all have in common.

stations = stations_of(means)                   # by temperature
values = at_usual_temperatures(stations)        # brought to where the unit usually was
entries, shifts, sd, left = shifts_of(values)   # of each calibration against the others
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import chdtrc

from hil.archive.index import ArchivedMean
from hil.archive.trend import Trend
from hil.campaign import FloatArray
from hil.solve.temperatures import nearest

_OTHERWISE = 0.01  # as improbable as this a jump must be alike at all temperatures, to be called a change with them

Values = Mapping[float | None, Mapping[str, tuple[float, float]]]


def stations_of(own: Sequence[ArchivedMean]) -> dict[float | None, list[ArchivedMean]]:
    """Group a parameter's means by temperature, coldest first: what `hil report --against` takes for the same one."""
    found: dict[float | None, list[ArchivedMean]] = {}
    for each in own:
        known = [at for at in found if at is not None]
        at = nearest(each.temperature_degC, known)
        found.setdefault(each.temperature_degC if at is None else at, []).append(each)
    return dict(sorted(found.items(), key=lambda of: (of[0] is None, of[0] or 0.0)))


def at_usual_temperatures(stations: Mapping[float | None, Sequence[ArchivedMean]]) -> Values:
    """Return values with their sd by entry, brought to the temperature at which the unit usually was at each station.

    How a parameter depends on temperature is told by its own stations; where there is only one, nothing is changed.
    """
    own = {at: np.array([np.nan if m.own_degC is None else m.own_degC for m in of]) for at, of in stations.items()}
    usual = {at: float(np.median(of)) if np.isfinite(of).all() else np.nan for at, of in own.items()}
    level = [float(np.median([m.value.value for m in of])) for of in stations.values()]
    where = np.array(list(usual.values()))
    slopes = np.zeros(len(where))
    if len(where) > 1 and np.isfinite(where).all() and np.all(np.diff(where) > 0.0):
        slopes = np.gradient(np.array(level), where)
    return {
        at: {
            m.entry: (m.value.value - off, m.value.sd)
            for m, off in zip(of, np.nan_to_num(slope * (own[at] - usual[at])).tolist(), strict=True)
        }
        for (at, of), slope in zip(stations.items(), slopes, strict=True)
    }


def shifts_of(
    values: Values,
) -> tuple[list[str], FloatArray, FloatArray, Values]:
    """Return the entries in order of time, the shift of each common to all temperatures (n,) with sd, and what is left.

    Each temperature has a value of its own and each calibration a shift: least squares, weighted.
    """
    names = sorted({name for of in values.values() for name in of}, key=_began)
    rows = [(k, names.index(name), *of[name]) for k, of in enumerate(values.values()) for name in of]
    k, i, y, sd = (np.array(column) for column in zip(*rows, strict=True))
    weight = 1.0 / np.where(np.isfinite(sd) & (sd > 0.0), sd, np.inf)
    if not np.all(weight > 0.0):
        return names, np.zeros(len(names)), np.full(len(names), np.nan), {}
    columns = np.zeros((len(y), len(values) + len(names)))
    columns[np.arange(len(y)), k.astype(int)] = 1.0
    columns[np.arange(len(y)), len(values) + i.astype(int)] = 1.0
    weighted = columns.T * weight**2
    found = np.linalg.lstsq(weighted @ columns, weighted @ y, rcond=None)[0]  # a shift of all is an offset of all
    shifts = found[len(values) :] - found[len(values) :].mean()
    errors = np.array([1.0 / np.sqrt(np.sum(weight[i == each] ** 2)) for each in range(len(names))])
    left: dict[float | None, dict[str, tuple[float, float]]] = {}
    for place, (at, of) in enumerate(values.items()):
        offset = found[place] + found[len(values) :].mean()
        left[at] = {name: (value - offset, error) for name, (value, error) in of.items()}
    return names, shifts, errors, left


def _began(entry: str) -> str:
    return entry.partition("/")[2]


def differs(left: Values, names: Sequence[str], together: Trend) -> bool:
    """Whether what was found as a jump is not the same at all temperatures."""
    if not together.step or len(left) < 2:
        return False
    after = set(names[together.step :])
    jumps = []
    for of in left.values():
        sides = [
            np.array([of[name] for name in of if (name in after) is late]).reshape(-1, 2) for late in (False, True)
        ]
        if all(len(side) for side in sides):
            error = np.sqrt(sum(np.sum(side[:, 1] ** 2) / len(side) ** 2 for side in sides))
            jumps.append((float(sides[1][:, 0].mean() - sides[0][:, 0].mean()), float(error)))
    sizes, errors = (np.array(column) for column in zip(*jumps, strict=True))
    mean = np.sum(sizes / errors**2) / np.sum(1.0 / errors**2)
    squares = float(np.sum(((sizes - mean) / errors) ** 2))
    return bool(len(jumps) > 1 and chdtrc(len(jumps) - 1, squares) < _OTHERWISE)
