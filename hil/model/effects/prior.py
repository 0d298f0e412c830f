"""What is known before the data: how probable a name is, in which sensors and shapes, and how large it may be.

The search weighs by it, and what a design promises of the search is priced by it.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import Base, Described, Effect, Parameter, VarianceEffect, effect_columns
from hil.model.effects.catalogue import named

BaseBeside = Callable[[Effect, Mapping[str, float]], Base]

ALPHA = 0.05
"""Rate of false alarms where none is stated."""
SECOND_TIER = 0.2
"""Prior of what no effect of the catalogue describes, given that something is missing."""
SCATTER = 0.25
"""Prior of an effect on the scatter, beyond the ordinary: correlated bias is in every gyro."""
SHARED = 0.75
"""How probably an effect that one sensor (or channel) has is in another."""
COMMON = 0.97
"""And one that is common to sensors."""
HOLDS: tuple[tuple[float, float, float], ...] = ((18.0, 18.0, 0.6), (0.3, 0.3, 0.4))
"""Inverse-gamma (a, b) of s² in stated variances, and weight: errors are right to 17 %, or nobody knows how wrong.

Where none are stated the latter alone is left, in the variance that a rough fit leaves."""
OFFSETS = (0.0, 0.7, 1.4, 2.8, 5.6, 11.0)
"""Of an offset per run, and of an effect on the scatter, in white noises: 24 runs tell no less than a factor of two.

What may be larger is tried as far as that goes: a walk larger than all that is tried looks as if it came back, and of
offsets the largest would be jumps."""
MANY = 200
"""Shapes of one effect that are tried first; between the best of them and the next the others follow."""
STEP = 3.0
"""Factor between sizes that are tried: a normal prior that is off by its root loses a tenth of a log."""
_NOTHING = 1e-4  # deg/hr: what an effect of the largest typical size does not reach is not measured by any bench
UNSEEN = 0.03
"""A column of which the base leaves less is not asked about, nor in a block that it moves less than another."""


def name_odds(effects: Iterable[Effect], conditions: Conditions) -> dict[str, float]:
    """Share the odds of the catalogue out over the names of these effects."""
    odds: dict[str, float] = {}
    for effect in effects:
        odds[named(effect).id] = max(odds.get(named(effect).id, 0.0), effect.odds_for(conditions))
    return {name: (1.0 - SECOND_TIER) * own / sum(odds.values()) for name, own in odds.items()}


def scatter_log_odds(effects: Iterable[VarianceEffect]) -> dict[str, float]:
    """Share the odds (log) of an effect on the scatter out over these: one is no reason against another."""
    odds = {effect.id: effect.odds for effect in effects}
    return {name: float(np.log(SCATTER / (1.0 - SCATTER) * own / sum(odds.values()))) for name, own in odds.items()}


def in_another(effect: Described | None) -> float:
    """Return how probably what one sensor or channel has is in another; None is what no effect describes."""
    return COMMON if effect is not None and effect.common_to_sensors else SHARED


def log_in_one(effect: Effect, sensors: int) -> float:
    """Return the log prior that of several sensors one alone has an effect, or all where it is common to them."""
    has, rest = (COMMON, COMMON) if effect.common_to_sensors else (SHARED, 1.0 - SHARED)
    return float(np.log(has) + (sensors - 1) * np.log(rest)) if sensors > 1 else 0.0


def shapes_tried(
    effect: Effect, conditions: Conditions, base_beside: BaseBeside
) -> Iterator[tuple[Mapping[str, float], FloatArray]]:
    """Yield the shapes of an effect that are tried first, each as probable as another, with their columns (n, c, p).

    `base_beside` gives the base as it is if an effect of a shape acts beside it.
    A shape that does nothing is none, nor is one that does what another does: as where nothing tells one room before
    the night from another.
    """
    grid, known = effect.shape_grid(conditions), set[int]()
    typical = np.array([each.typical[1] for each in effect.parameters_for(conditions)])
    high = np.where((typical > 0.0) & np.isfinite(typical), typical, 1.0)
    for shape in grid[:: 1 + len(grid) // MANY]:
        own = effect_columns(effect, conditions, base_beside(effect, shape), shape)
        same = hash((own.round(9) + 0.0).tobytes())
        if float(np.abs(own * high).max(initial=0.0)) >= _NOTHING and same not in known:
            known.add(same)
            yield shape, own


@cache
def ladder(typical: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Return sizes (u,) that are tried, in middles of a typical range, and their log weights (u,)."""
    parameter = Parameter("", "", typical)
    low, _ = parameter.bounds
    values = 0.1 * low * STEP ** np.arange(int(np.ceil(np.log(parameter.largest / (low * 0.1)) / np.log(STEP))) + 1)
    log_weights = np.array([parameter.log_density(size) for size in values.tolist()])
    return np.asarray(values / middle(parameter)), np.asarray(log_weights - np.logaddexp.reduce(log_weights))


def middle(parameter: Parameter) -> float:
    """Return the middle of a typical range."""
    return float(np.sqrt(math.prod(parameter.bounds)))


def sizes_up_to(largest: float) -> tuple[float, ...]:
    """Return sizes that are tried, each twice the one before, up to the largest and as far as `OFFSETS` at least."""
    larger = math.ceil(math.log2(max(largest / OFFSETS[-1], 1.0)) - 0.5)
    return (*OFFSETS[1:], *(OFFSETS[-1] * 2.0 ** (k + 1) for k in range(larger)))


def log_offset(offset: float) -> float:
    """Return how much less probable an offset is for its size (log)."""
    return float(np.log1p((offset / 4.0) ** 2))


_NO_LOG = -1e300  # of nothing at all, and no infinity: to be taken from one


def log_sum(values: FloatArray, axis: int = 0) -> FloatArray:
    """Return the log of the sum of exponentials along an axis of (k, n), say: (n,); quicker than logaddexp."""
    peak = values.max(axis=axis, keepdims=True, initial=_NO_LOG)
    with np.errstate(divide="ignore"):
        return np.asarray(np.squeeze(peak, axis) + np.log(np.sum(np.exp(values - peak), axis=axis)))
