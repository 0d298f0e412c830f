"""What several sensors have together: before the data one price for a name, and one state of what scatters them all.

A name in another sensor has the same shape as probably as any that it may have there: a step of the one says that the
other may step as well, and hardly where.

What scatters several sensors by one cause is the same in each at any time: a room turns both of them, or neither. Each
block by itself says only that something wanders, so that all rows are weighed together, as one normal density, and as
those of blocks that know nothing of each other (the base's values are integrated out: Patterson & Thompson 1971).
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from hil.campaign import FloatArray
from hil.model.effects.columns import middle_hr
from hil.model.effects.prior import COMMON, SHARED
from hil.model.effects.scatter import Scatter
from hil.reconcile.search.chains import COMPARED
from hil.reconcile.search.points import SAME_SHAPE
from hil.reconcile.search.sets import SensorSearch, Set

_SIZES = 2.0 ** np.arange(-1.5, 2.0, 0.5)  # times the mean of what blocks say, the sizes that all may have in common


def log_prior(searches: Mapping[int, SensorSearch], lists: Mapping[int, Sequence[Set]]) -> FloatArray:
    """Log prior odds of every combination of sets, (m, m', …).

    What of a set is a mistake of one sensor, or has a name that is there already, costs what it costs by itself.
    """
    out = np.zeros([len(sets) for sets in lists.values()])
    names: dict[str, dict[int, Any]] = {}  # what the sets of a sensor have of each, (m,) along its axis
    of_a_set = [("has", bool), ("log_odds", float), ("shape", float), ("share", float)]
    none = np.array((False, -np.inf, -1.0, 1.0), of_a_set)
    shapes, common = dict[object, float](), set[str]()
    for axis, (n, sets) in enumerate(lists.items()):
        along = [size if k == axis else 1 for k, size in enumerate(out.shape)]
        terms, rest = searches[n].terms, np.zeros(along)
        many = Counter((term.shared, term.candidate.form) for term in terms)
        for name in {term.shared for term in terms}:
            names.setdefault(name, {})[axis] = np.full(along, none)
        for m, chosen in enumerate(sets):
            for term, log_odds in zip((terms[j] for j in chosen), searches[n].priced(chosen), strict=True):
                own = names[term.shared][axis]
                if not term.shared or own["has"].flat[m]:
                    rest.flat[m] += log_odds
                    continue
                shape = tuple(sorted(term.candidate.shape.items()))
                place = shapes.setdefault(shape, float(len(shapes)))
                own.flat[m] = True, log_odds, place, 1.0 / many[term.shared, term.candidate.form]
                effect = term.candidate.effect
                if term.is_mistake or (effect is not None and effect.common_to_sensors):
                    common.add(term.shared)
        out += rest
    for name, every in names.items():
        if any(own["has"].any() for own in every.values()):
            out += _of_a_name(list(every.values()), COMMON if name in common else SHARED)
    return out


def _of_a_name(every: Sequence[Any], rho: float) -> FloatArray:
    """Log prior odds of a name that all of these may have, each with probability `rho` where any has it."""
    price, first, log_which = np.array(-np.inf), np.array(-1.0), np.array(0.0)
    for own in every:
        if len(every) > 1:
            log_which = log_which + np.log(np.where(own["has"], rho, 1.0 - rho))
        as_probable = (1.0 - SAME_SHAPE) * own["share"] + SAME_SHAPE * (own["shape"] == first)
        log_which = log_which + np.where(own["has"] & (first >= 0.0), np.log(as_probable), 0.0)
        first = np.where(first >= 0.0, first, own["shape"])
        price = np.maximum(price, own["log_odds"])
    return np.where(np.isfinite(price), price + log_which, 0.0)


@dataclass(frozen=True)
class _Rows:
    """First rows of a block: `y` (n,), columns that are free, (n, q), and the covariance of all but one effect.

    `parts` are what the effect does at unit size, and `size` how much of it this block shows.
    """

    y: FloatArray
    free: FloatArray
    rest: FloatArray
    parts: Sequence[Scatter]
    hours: FloatArray
    size: float


def same_states(searches: Mapping[int, SensorSearch], chosen: Mapping[int, Set], name: str) -> float:
    """Return how much likelier (log) the rows are where an effect on the scatter has the same states in all sensors."""
    rows = [
        own
        for n, search in searches.items()
        for b in range(len(search.blocks))
        if (own := _rows(search, chosen[n], b, name)) is not None
    ]
    if len(rows) < 2:
        return 0.0
    usual = float(np.exp(np.mean([np.log(own.size) for own in rows])))
    between = np.block([[_between(a, b) for b in rows] for a in rows])
    rest, free = block_diag(*(own.rest for own in rows)), block_diag(*(own.free for own in rows))
    y, ends = np.concatenate([own.y for own in rows]), np.cumsum([0, *(len(own.y) for own in rows)])
    together, apart = np.empty(len(_SIZES)), np.empty((len(_SIZES), len(rows)))
    for k, size in enumerate(usual * _SIZES):
        every = size**2 * between
        together[k] = _log_density(y, free, rest + every)
        apart[k] = [
            _log_density(own.y, own.free, own.rest + every[a:b, a:b])
            for own, a, b in zip(rows, ends, ends[1:], strict=False)
        ]
    of_blocks = np.logaddexp.reduce(apart, axis=0) - np.log(len(_SIZES))
    return float(np.logaddexp.reduce(together) - np.log(len(_SIZES)) - of_blocks.sum())


def _between(a: _Rows, b: _Rows) -> FloatArray:
    """Return the covariance of an effect of unit size between the rows of two blocks, (n, m)."""
    pairs = zip(a.parts, b.parts, strict=True)
    return np.asarray(sum((p.columns[:, 0] @ q.columns[:, 0].T) * p.between(q, a.hours, b.hours) for p, q in pairs))


def _log_density(y: FloatArray, free: FloatArray, covariance: FloatArray) -> float:
    """Log density of what free columns (n, q) leave of rates (n,), up to what does not depend on the covariance."""
    root = np.linalg.cholesky(covariance)
    white = solve_triangular(root, np.column_stack([free, y]), lower=True)
    triangle = np.abs(np.diagonal(np.linalg.qr(white).R))
    return float(-np.sum(np.log(np.diagonal(root))) - np.sum(np.log(triangle[:-1])) - 0.5 * triangle[-1] ** 2)


def _rows(search: SensorSearch, chosen: Set, b: int, name: str) -> _Rows | None:
    """Return the rows of a block at the likeliest noise that has an effect; None where none has."""
    block, weighed = search.blocks[b], search.in_block(chosen, b)
    noise, points = block.noise, block.points
    own = np.array([kind.name == name for kind in noise.kinds], dtype=bool)
    has = np.any(points.amount[:, own] > 0.0, axis=1)
    if not has.any():
        return None
    t = int(np.argmax(np.where(has, weighed.terms_log + points.log_prior, -np.inf)))
    point, k = points.take(np.array([t])), int(np.argmax(points.amount[t] * own))
    without = replace(point, amount=np.where(own, 0.0, point.amount))
    unit = noise.unit * float(weighed.scales_left[t])
    rows = noise.order[:COMPARED]
    free = np.hstack([block.block.base, search.columns(chosen, b)])[rows]
    kind, at, channel = noise.kinds[k], block.block.rows[rows], block.block.channel[rows]
    parts = [
        replace(each, columns=each.columns[at, channel][:, None])
        for each in kind.effect.scatter(noise.conditions, kind.shape)
    ]
    parts = [replace(each, group=None if each.group is None else each.group[at]) for each in parts]
    size = float(points.amount[t, k]) * np.sqrt(unit) / kind.unit_deg_per_hr
    return _Rows(
        block.block.y[rows], free, unit * noise.covariance(without), parts, middle_hr(noise.conditions)[at], size
    )
