"""What several sensors have together before the data: one price for a name, and for which of them have it.

A name in another sensor has the same shape as probably as any that it may have there: a step of the one says that the
other may step as well, and hardly where.
"""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from hil.campaign import BoolArray, FloatArray
from hil.model.effects.prior import COMMON, SHARED
from hil.reconcile.search.sets import SensorSearch, Set

SAME_SHAPE = 0.5
"""How probably what several sensors have is of one shape in all of them, and not of any that it may have in each."""


def log_prior(searches: Mapping[int, SensorSearch], lists: Mapping[int, Sequence[Set]]) -> FloatArray:
    """Log prior odds of every combination of sets, (m, m', …).

    What of a set is a mistake of one sensor, or has a name that is there already, costs what it costs by itself.
    """
    out = np.zeros([len(sets) for sets in lists.values()])
    names: dict[str, dict[int, _InSets]] = {}
    shapes, common = dict[object, float](), set[str]()
    for axis, (n, sets) in enumerate(lists.items()):
        along = [size if k == axis else 1 for k, size in enumerate(out.shape)]
        terms, rest = searches[n].terms, np.zeros(along)
        many = Counter((term.shared, term.candidate.form) for term in terms)
        for name in {term.shared for term in terms}:
            names.setdefault(name, {})[axis] = _InSets(along)
        for m, chosen in enumerate(sets):
            for term, log_odds in zip((terms[j] for j in chosen), searches[n].priced(chosen), strict=True):
                own = names[term.shared][axis]
                if not term.shared or own.has.flat[m]:
                    rest.flat[m] += log_odds
                    continue
                shape = tuple(sorted(term.candidate.shape.items()))
                place = shapes.setdefault(shape, float(len(shapes)))
                own.put(m, log_odds, place, 1.0 / many[term.shared, term.candidate.form])
                effect = term.candidate.effect
                if term.is_mistake or (effect is not None and effect.common_to_sensors):
                    common.add(term.shared)
        out += rest
    for name, every in names.items():
        if any(own.has.any() for own in every.values()):
            out += _of_a_name(list(every.values()), COMMON if name in common else SHARED)
    return out


class _InSets:
    """One name in the sets of one sensor, (m,) along its axis: its odds, its shape, and what share that is of all."""

    def __init__(self, along: Sequence[int]) -> None:
        self.has: BoolArray = np.zeros(along, dtype=bool)
        self.log_odds, self.shape, self.share = np.full(along, -np.inf), np.full(along, -1.0), np.ones(along)

    def put(self, m: int, log_odds: float, shape: float, share: float) -> None:
        """Say what the set at place m has."""
        self.has.flat[m], self.log_odds.flat[m], self.shape.flat[m], self.share.flat[m] = True, log_odds, shape, share


def _of_a_name(every: Sequence[_InSets], rho: float) -> FloatArray:
    """Log prior odds of a name that all of these may have, each with probability `rho` where any has it."""
    price, first, log_which = np.array(-np.inf), np.array(-1.0), np.array(0.0)
    for own in every:
        if len(every) > 1:
            log_which = log_which + np.log(np.where(own.has, rho, 1.0 - rho))
        as_probable = (1.0 - SAME_SHAPE) * own.share + SAME_SHAPE * (own.shape == first)
        log_which = log_which + np.where(own.has & (first >= 0.0), np.log(as_probable), 0.0)
        first = np.where(first >= 0.0, first, own.shape)
        price = np.maximum(price, own.log_odds)
    return np.where(np.isfinite(price), price + log_which, 0.0)
