"""The whole uncertainty of a mean of repeats: what they show, what the sources give, and what is left unexplained.

    for each in budgets_of_means(measured_scenes(campaign, bench)[2], repeats(campaign, solutions)[2]):
        each.values["MUB"].expanded(2.0)     # of the mean at each.mean.temperature_degC
        each.unexplained                     # (p,) what repeats show beyond every source that the bench states

What all runs have in common (the site, the attitude) no repeat shows, and what makes runs differ no source need name.
So the variance is what repeats show, and the sources that do not vary from run to run; never less than all sources
give. It is known as well as the repeats tell their part (Welch-Satterthwaite, GUM G.4.1), and what is expanded is never
less than what they show by themselves.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import FloatArray
from hil.design.budget.budget import Budget, calculated_budget
from hil.design.budget.scenes import RunScene
from hil.solve.repeats import MeanAt, SensorRepeats, Uncertain

_SIGMAS = 2.0


@dataclass(frozen=True)
class MeanBudget:
    """The mean of the runs at one temperature, its `budget` (of one run) and `standard` (p,), the whole uncertainty."""

    mean: MeanAt
    scene: RunScene
    budget: Budget
    standard: FloatArray

    @property
    def shares(self) -> Mapping[str, FloatArray]:
        """What each source gives of the mean, (p,), by its title."""
        count = len(self.mean.runs)
        return {
            each.source.title: each.analytic / (np.sqrt(count) if each.source.varies == "run" else 1.0)
            for each in self.budget.shares
        }

    @property
    def unexplained(self) -> FloatArray:
        """What repeats show beyond all sources together, (p,): with these it makes `standard`."""
        sources = self.budget.total(len(self.mean.runs))
        return np.asarray(np.sqrt(np.maximum(self.standard**2 - sources**2, 0.0)))

    @property
    def values(self) -> dict[str, Uncertain]:
        """The mean of each parameter that some run could tell, with its whole uncertainty."""
        found = {}
        for place, name in enumerate(self.budget.names):
            if (shown := self.mean.values.get(name)) is not None:
                sd = float(self.standard[place])
                joint = shown.freedom * (sd / shown.sd) ** 4 if shown.sd > 0.0 else np.inf
                by = (Uncertain(shown.value, sd, freedom, shown.runs, shown.unit) for freedom in (joint, shown.freedom))
                found[name] = next(each for each in by if not each.expanded(_SIGMAS) < shown.expanded(_SIGMAS))
        return found


def budgets_of_means(runs: Sequence[RunScene], observed: SensorRepeats) -> Iterator[MeanBudget]:
    """Yield the budget of each mean of a sensor, by that of its run whose total is worst."""
    for mean in observed.means:
        own = [each for each in runs if each.run in mean.runs]
        both = [(each, calculated_budget(each.scene, each.sources, each.form)) for each in own]
        if both:
            scene, budget = max(both, key=lambda each: float(np.nansum(each[1].total() ** 2)))
            standard = mean_of_repeats(budget, len(mean.runs), as_solved(budget, scene.run, observed), mean)
            yield MeanBudget(mean, scene, budget, standard)


def as_solved(budget: Budget, run: int, observed: SensorRepeats | None) -> FloatArray:
    """What `hil solve` states of one run, (p,): its noise, and what repeats and residuals show; NaN where nothing."""
    told = {} if observed is None else observed.of_each.get(run, {})
    return np.array([told.get(name, np.nan) for name in budget.names])


def mean_of_repeats(budget: Budget, repeats: int, one: FloatArray, mean: MeanAt | None) -> FloatArray:
    """Return the whole uncertainty of the mean of some repeats, (p,): what they show, and what they have in common.

    `one` (p,) is what `hil solve` states of one run, `mean` what it states of the runs at that temperature, the same
    number where as many repeats are asked for. It is never less than what the budget's own sources give.
    """
    shown = one / np.sqrt(repeats)
    if mean is not None and len(mean.runs) == repeats:
        shown = np.array([mean.values[n].sd if n in mean.values else np.nan for n in budget.names])
    common = budget.total() ** 2 - budget.from_run_to_run**2
    return np.asarray(np.fmax(budget.total(repeats), np.sqrt(shown**2 + common)))
