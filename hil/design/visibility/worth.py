"""What a change to a sweep is worth: the visibility maps before and after, compared for each sensor.

for one in improvements({2: conditions}):
    print(one.change, one.newly_visible, one.separated, one.protected, one.size_ratio)
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import Conditions
from hil.design.visibility.map import NoiseLevel, Sight, Sights, visibility
from hil.model import Model, built_in_model
from hil.solve.changes import CHANGES

_CLEAN = 0.1
"""A leak that falls below this fraction of what it was is counted as gone."""

MOST_RUNS = 384
"""On so many of a campaign's runs at most, evenly chosen, a change is weighed: before and after alike."""


@dataclass(frozen=True)
class Improvement:
    """What a change to the sweep would bring: effects in sight, pairs apart, sizes smaller, parameters clean.

    In sight is what no sensor saw; apart, what any sensor could not tell apart.
    """

    change: str
    cost: str
    newly_visible: tuple[str, ...]
    separated: tuple[tuple[str, str], ...]
    protected: Mapping[int, tuple[tuple[str, str], ...]]  # sensor: effects, and base parameters they leak into no more
    size_ratio: float  # median over effects of the smallest visible size, after / before

    @property
    def worth(self) -> float:
        """Its rank: in sight, apart and clean count one each, a halved size of everything counts two."""
        return (
            len(self.newly_visible)
            + len(self.separated)
            + sum(map(len, self.protected.values()))
            - 2.0 * math.log2(max(self.size_ratio, 1e-3))
        )


def improvements(
    sensors: Mapping[int, Conditions], model: Model | None = None, noise: Mapping[int, NoiseLevel] | None = None
) -> tuple[Improvement, ...]:
    """Return what each change to the sweep would bring to its sensors, the most helpful first.

    Before and after are weighed with the same `noise`: further rows have no standard errors.
    """
    noise = noise or {}
    sensors = {n: _some_runs(rows) for n, rows in sensors.items()}
    before = {n: visibility(rows, model, noise.get(n)) for n, rows in sensors.items()}
    found = []
    for change in CHANGES:
        changed = {n: new for n, rows in sensors.items() if (new := change.apply(rows)) is not None}
        after = {
            n: visibility(rows, model or built_in_model(before[n].form), noise.get(n)) for n, rows in changed.items()
        }
        if after:
            found.append(_improvement(change.name, change.cost, before, after))
    return tuple(sorted(found, key=lambda one: -one.worth))


def _some_runs(conditions: Conditions) -> Conditions:
    runs = np.unique(conditions.run)
    if len(runs) <= MOST_RUNS:
        return conditions
    chosen = runs[np.linspace(0, len(runs) - 1, MOST_RUNS).round().astype(np.int64)]
    return conditions.rows(np.isin(conditions.run, chosen))


def _improvement(name: str, cost: str, before: Mapping[int, Sights], after: Mapping[int, Sights]) -> Improvement:
    pairs = {
        n: [(sight, other) for sight in before[n].effects if (other := after[n].sight(sight.effect.id)) is not None]
        for n in after
    }
    every = [pair for of in pairs.values() for pair in of]
    seen = {sight.effect.id for sights in before.values() for sight in sights.effects if sight.visible}
    newly = dict.fromkeys(o.effect.id for s, o in every if o.visible and s.effect.id not in seen)
    separated = dict.fromkeys(
        (sight.effect.id, rival)
        for sight, other in every
        for rival in sight.members
        if sight.effect.id < rival and rival not in other.members and other.visible
    )
    protected = {n: found for n, of in pairs.items() if (found := tuple(_protected(of)))}
    ratios = [other.best.value / sight.best.value for sight, other in every if sight.visible and other.visible]
    finite = [ratio for ratio in ratios if math.isfinite(ratio)]
    return Improvement(
        name, cost, tuple(newly), tuple(separated), protected, float(np.median(finite)) if finite else 1.0
    )


def _protected(pairs: Sequence[tuple[Sight, Sight]]) -> Iterator[tuple[str, str]]:
    """Yield effects with the parameters of one sensor that they moved, and move no more."""
    for sight, other in pairs:
        for name, leak in sight.leaks.items() if sight.effect.in_models else ():
            if leak > 1.0 and other.leaks.get(name, 0.0) < _CLEAN * leak:
                yield sight.effect.id, name
