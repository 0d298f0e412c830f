"""The error budget of a self-calibration: what each source contributes to each parameter, two ways.

    budget = Budget(scene, sources(...), form)
    budget.shares[0].analytic     # (p,) one standard deviation, by the solver's response to small errors
    budget.shares[0].simulated    # (p,) the same from draws that went through the solver
    budget.total(repeats=3)           # of the mean of three runs: what varies from run to run is averaged

The analytic column propagates each source's covariance through the derivative of the solution. The simulated one draws
the source's errors, makes the rates that a sensor with known parameters would have shown, solves them as if nothing
were wrong, and looks how far off the parameters are. They must agree within the draws' own error, and both are printed.

    for each in budgets_of_means(measured_scenes(campaign, bench, shown)[2], shown[2]):
        each.values["MUB"].expanded(2.0)     # of the mean at each.mean.temperature_degC, its whole uncertainty
        each.unexplained                     # (p,) what repeats show beyond every source that the bench states
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.campaign import FloatArray, IntArray
from hil.design.budget.scenes import RunScene
from hil.design.budget.sources import Scene, Source
from hil.model.forms import LinearForm
from hil.solve.repeats import SensorRepeats
from hil.solve.runs import solve_rates
from hil.solve.uncertain import MeanAt, Uncertain

DRAWS = 100_000

SECOND_ORDER, OF_ALL = 1e-4, 0.01
"""deg/hr (or deg/hr/g), and of the total: contributions below a hundredth of the report's resolution are not compared,
nor do they differ by what is a hundredth of all together.

Where a parameter is immune to a source in first order, the draws still show the second.
"""

_CHUNK = 5_000  # small enough for the cache
_SIGMAS = 4.5  # of some sixty numbers compared, chance alone brings one beyond this in one budget of 2000
_EXPANDED = 2.0


@dataclass(frozen=True)
class Share:
    """One source's contribution to each parameter, (p,): one standard deviation, analytic and simulated."""

    source: Source
    analytic: FloatArray
    simulated: FloatArray


class Budget:
    """The budget of one run, for the parameters of `form`; NaN for those that the collects cannot know.

    `draws` is for each source; of none what is simulated is NaN. The same seed gives the same numbers. `everything`,
    (p,), is what all sources together give in the draws (drawn at once).
    """

    def __init__(
        self, scene: Scene, given: Sequence[Source], form: LinearForm, draws: int = DRAWS, seed: int = 0
    ) -> None:
        squares, rng = np.zeros((len(given) + 1, len(form.names))), np.random.default_rng(seed)
        rates = scene.rates(scene.gravity, scene.earth_rate, scene.base.bias)
        observed = rates - scene.conditions.w_channels_deg_per_hr
        right = _solved(scene, form, observed)
        for begin in range(0, draws, _CHUNK):
            many = min(_CHUNK, draws - begin)
            together = np.zeros((many, *rates.shape))
            for source, square in zip(given, squares, strict=False):
                components = source.columns(scene).shape[-1]
                wrong = source.changes(scene, source.size * rng.standard_normal((many, components)))
                together += wrong
                square += np.sum((_solved(scene, form, observed + wrong) - right) ** 2, axis=0)
            squares[-1] += np.sum((_solved(scene, form, observed + together) - right) ** 2, axis=0)
        spread = np.sqrt(squares / draws) if draws else np.full_like(squares, np.nan)
        to_parameters = response(scene, form)
        self.names, self.units, self.draws, self.everything = form.names, form.units, draws, spread[-1]
        each = zip(given, spread[:-1], strict=True)
        self.shares = tuple(Share(one, analytic_share(one, scene, to_parameters), of) for one, of in each)

    def total(self, repeats: int | IntArray = 1) -> FloatArray:
        """Return the standard deviation (p,) of the mean of `repeats` runs, the same of each parameter or (p,)."""
        parts = [each.analytic**2 / (repeats if each.source.varies == "run" else 1) for each in self.shares]
        return np.asarray(np.sqrt(np.sum(parts, axis=0)))

    def simulation_error(self, simulated: FloatArray) -> FloatArray:
        """Return one standard deviation of simulated contributions by the finite number of draws."""
        return np.asarray(simulated / np.sqrt(2.0 * self.draws))

    @property
    def from_run_to_run(self) -> FloatArray:
        """The part of one run's that is new in each run, (p,)."""
        varying = [each.analytic**2 for each in self.shares if each.source.varies == "run"]
        return np.asarray(np.sqrt(np.sum(varying, axis=0)))

    @property
    def agrees(self) -> bool:
        """Whether every contribution, and the total, is the same both ways, within the draws' own error."""
        return not self.too_large and not np.any(self._apart(self.total(), self.everything))

    @property
    def too_large(self) -> dict[str, list[str]]:
        """The parameters for which a source is too large for a linear calculation, by the source's id."""
        apart = {each.source.id: self._apart(each.analytic, each.simulated) for each in self.shares}
        return {
            source: [name for name, far in zip(self.names, found, strict=True) if far]
            for source, found in apart.items()
            if np.any(found)
        }

    def _apart(self, analytic: FloatArray, simulated: FloatArray) -> NDArray[np.bool_]:
        least = SECOND_ORDER + OF_ALL * self.total()
        return np.asarray(np.abs(analytic - simulated) > _SIGMAS * self.simulation_error(analytic) + least)


def response(scene: Scene, form: LinearForm) -> FloatArray:
    """Return what the solution makes of the rates (p, n·c): its derivative; NaN for what these collects cannot know."""
    unit_rates = np.eye(scene.sigma.size)
    return np.asarray(_solved(scene, form, unit_rates.reshape(-1, *scene.sigma.shape)).T)


def analytic_share(source: Source, scene: Scene, to_parameters: FloatArray) -> FloatArray:
    """Return one source's contribution (p,) by the derivative `to_parameters` (p, n·c) of the solution."""
    columns = source.columns(scene)
    return np.asarray(source.size * np.linalg.norm(to_parameters @ columns.reshape(-1, columns.shape[-1]), axis=1))


def _solved(scene: Scene, form: LinearForm, observed: FloatArray) -> FloatArray:
    """Solve rates (..., n, c), where the scene has any; (..., p)."""
    there = np.isfinite(scene.sigma)
    rates, sigma = np.where(there, observed, np.nan), np.where(there, scene.sigma, 1.0)
    return solve_rates(form.columns(scene.conditions), rates, sigma).values


@dataclass(frozen=True)
class MeanBudget:
    """The mean of the runs at one temperature, its `budget` (of one run) and `standard` (p,), the whole uncertainty.

    What all runs have in common (the site, the attitude) no repeat shows, and what makes runs differ no source need
    name. So the variance is what repeats show, and the sources that do not vary from run to run; never less than all
    sources give. It is known as well as the repeats tell their part (Welch-Satterthwaite, GUM G.4.1), and what is
    expanded is never less than what they show by themselves.
    """

    mean: MeanAt
    scene: RunScene
    budget: Budget
    standard: FloatArray

    @property
    def shares(self) -> Mapping[str, FloatArray]:
        """What each source gives of the mean, (p,), by its title."""
        root = np.sqrt(repeats_of(self.budget, self.mean))
        return {
            each.source.title: each.analytic / (root if each.source.varies == "run" else 1.0)
            for each in self.budget.shares
        }

    @property
    def unexplained(self) -> FloatArray:
        """What repeats show beyond all sources together, (p,): with these it makes `standard`."""
        sources = self.budget.total(repeats_of(self.budget, self.mean))
        return np.asarray(np.sqrt(np.maximum(self.standard**2 - sources**2, 0.0)))

    @property
    def values(self) -> dict[str, Uncertain]:
        """The mean of each parameter that some run could tell, with its whole uncertainty."""
        found = {}
        for place, name in enumerate(self.budget.names):
            if (shown := self.mean.values.get(name)) is not None:
                sd = float(self.standard[place])
                joint = shown.freedom * (sd / shown.sd) ** 4 if shown.sd > 0.0 else np.inf
                by = (replace(shown, sd=sd, freedom=freedom) for freedom in (joint, shown.freedom))
                found[name] = next(each for each in by if not each.expanded(_EXPANDED) < shown.expanded(_EXPANDED))
        return found


def budgets_of_means(runs: Sequence[RunScene], observed: SensorRepeats) -> Iterator[MeanBudget]:
    """Yield the budget of each mean of a sensor."""
    for mean in observed.means:
        if any(each.run in mean.runs for each in runs):
            scene, budget = moves_most(runs, mean, observed)
            standard = mean_of_repeats(budget, repeats_of(budget, mean), scene.run, observed, mean)
            yield MeanBudget(mean, scene, budget, standard)


def moves_most(runs: Sequence[RunScene], mean: MeanAt, observed: SensorRepeats) -> tuple[RunScene, Budget]:
    """Return the run of a mean whose total moves it most, with its budget: one that is hardly known moves none."""
    both = [(each, Budget(each.scene, each.sources, each.form, draws=0)) for each in runs if each.run in mean.runs]
    least = 1e-9  # deg/hr: where nothing states a run's uncertainty all weigh alike
    return max(
        both, key=lambda of: np.nansum(of[1].total() ** 2 / np.fmax(as_solved(of[1], of[0].run, observed), least) ** 4)
    )


def as_solved(budget: Budget, run: int, observed: SensorRepeats | None, repeats: int | IntArray = 1) -> FloatArray:
    """What `hil solve` states of one run, (p,): its noise, and what repeats and residuals show; NaN where nothing.

    Or would state of the mean of so many `repeats` of it: what is the same in every run none of them averages.
    """
    both = ({}, {}) if observed is None else (observed.of_each.get(run, {}), observed.alike.get(run, {}))
    one, alike = (np.array([told.get(name, np.nan) for name in budget.names]) for told in both)
    return np.asarray(np.sqrt((one**2 - alike**2) / repeats + alike**2))


def repeats_of(budget: Budget, mean: MeanAt | None) -> IntArray:
    """Return of how many runs the mean of each parameter is, (p,): of those that could tell it; 1 where none could."""
    known = {} if mean is None else mean.values
    return np.array([known[name].runs if name in known else 1 for name in budget.names])


def mean_of_repeats(
    budget: Budget, repeats: IntArray, run: int, observed: SensorRepeats | None, mean: MeanAt | None
) -> FloatArray:
    """Return the whole uncertainty of the mean of `repeats` (p,), (p,): what they show, and what they have in common.

    It is what `hil solve` would state of repeats of one `run`, or, where as many are asked for, states in the `mean` of
    the runs at that temperature; and never less than what the budget's own sources give.
    """
    shown = as_solved(budget, run, observed, repeats)
    if mean is not None:
        sd = np.array([mean.values[n].sd if n in mean.values else np.nan for n in budget.names])
        shown = np.where(repeats == repeats_of(budget, mean), sd, shown)
    common = budget.total() ** 2 - budget.from_run_to_run**2
    return np.asarray(np.fmax(budget.total(repeats), np.sqrt(shown**2 + common)))
