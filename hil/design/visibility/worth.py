"""What a change to a sweep is worth: the visibility maps before and after, compared.

for one in improvements(conditions, visibility(conditions)):
    print(one.change, one.newly_visible, one.separated, one.size_ratio)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.campaign import Conditions
from hil.design.visibility.map import Sights, visibility
from hil.model import Model, built_in_model
from hil.solve.changes import CHANGES

_CLEAN = 0.1
"""A leak that falls below this fraction of what it was is counted as gone."""


@dataclass(frozen=True)
class Improvement:
    """What a change to the sweep would bring: effects in sight, pairs apart, sizes smaller, parameters clean."""

    change: str
    cost: str
    newly_visible: tuple[str, ...]
    separated: tuple[tuple[str, str], ...]
    protected: tuple[tuple[str, str], ...]  # effect, and the base parameter that it no longer leaks into
    size_ratio: float  # median over effects of the smallest visible size, after / before

    @property
    def worth(self) -> float:
        """Its rank: in sight, apart and clean count one each, a halved size of everything counts two."""
        return (
            len(self.newly_visible)
            + len(self.separated)
            + len(self.protected)
            - 2.0 * math.log2(max(self.size_ratio, 1e-3))
        )


def improvements(
    conditions: Conditions,
    before: Sights,
    model: Model | None = None,
) -> tuple[Improvement, ...]:
    """Return what each change to the sweep would bring, the most helpful first."""
    found = []
    for change in CHANGES:
        changed = change.apply(conditions)
        if changed is None:
            continue
        after = visibility(
            changed, model or built_in_model(before.form), before.noise, before.false_alarm_rate, before.probability
        )
        found.append(_improvement(change.name, change.cost, before, after))
    return tuple(sorted(found, key=lambda one: -one.worth))


def _improvement(name: str, cost: str, before: Sights, after: Sights) -> Improvement:
    common = [(sight, other) for sight in before.effects if (other := after.sight(sight.effect.id)) is not None]
    newly = tuple(sight.effect.id for sight, other in common if other.visible and not sight.visible)
    separated = tuple(
        (sight.effect.id, rival)
        for sight, other in common
        for rival in sight.members
        if sight.effect.id < rival and rival not in other.members and other.visible
    )
    protected = tuple(
        (sight.effect.id, name)
        for sight, other in common
        for name, leak in sight.leaks.items()
        if sight.effect.in_models and leak > 1.0 and other.leaks.get(name, 0.0) < _CLEAN * leak
    )
    ratios = [other.best.value / sight.best.value for sight, other in common if sight.visible and other.visible]
    finite = [ratio for ratio in ratios if math.isfinite(ratio)]
    return Improvement(name, cost, newly, separated, protected, float(np.median(finite)) if finite else 1.0)
