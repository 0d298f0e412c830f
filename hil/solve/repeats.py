"""What repeats show: the mean at each temperature, and how sure it and every single run are.

    found = repeats(campaign, solve_campaign(campaign))[2]
    found.means[0].values["MUB"]       # Uncertain(value=-7.5, sd=2.2, …)
    found.of_run(solution)["MUB"]      # of one run: its standard error and what repeats show beside it

A run's standard error knows what goes on within its collects. Whatever changes from run to run shows when the same
temperature is measured again, and in residuals where there are any; standard errors do not know it. So a run's variance
is se² F + b². F is how much larger than allowed squares are in the channels that tell the parameter: of residuals of
runs that had settled, or of what differs from run to run and no parameter that changes there moves; that alone tells
errors that are too large. b² is what the variance of repeats at one temperature, pooled over the temperatures, has
beyond that. Of rates without standard errors se is by the residuals of all runs together: of its own few, small by
chance, a run would seem known best. A mean weighs runs by their variance: n that are alike divide it by √n, and one
that is hardly known moves nothing. Intervals are Student's, on as many degrees of freedom as runs were repeated, and on
more where standard errors, which are known better, explain what repeats show. So 93 to 97 % of them hold the truth in a
sweep of a dozen repeats and more, whatever b is; of fewer up to all do, where standard errors explain them.
Every command that states an uncertainty asks here.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from scipy.special import chdtrc

from hil.campaign import BoolArray, Campaign, Collects, Conditions, FloatArray
from hil.files.numbers import degrees
from hil.solve.between_runs import BetweenRuns
from hil.solve.precision import stated_noise, to_record_of
from hil.solve.residuals import DIFFERENCES, NO_ONE, Changes, Left, shares_of
from hil.solve.runs import RunSolution, told_by_runs
from hil.solve.temperatures import (
    nearest,
    of_runs_degC,
    runs_by_temperature,
    told_by,
    unit_mean_degC,
    unit_range_degC,
    visits,
)
from hil.solve.uncertain import RARE, MeanAt, Spread, Uncertain, gathered, means_at
from hil.solve.wrong_rows import treated
from procedures.words import counted, listed, numbered, significant

Grouping = Callable[[Conditions], Sequence[tuple[float | None, tuple[int, ...]]]]
"""Which runs repeat each other, with their temperature."""
MAY_FOLLOW = "{} in every collect, which what changes from run to run may follow"
OF_MEANS = "each row is a mean of runs: by what these scattered is in its standard error, and so in every ±"
_ONCE = "no parameter was told twice at one temperature"
_VISITED_ONCE = (
    "each temperature was gone to once: what changes from visit to visit, as a jump between two does, is not known, "
    "and no ± has it"
)
_IN_NO_MEAN = "{}: the soak had not ended, and none repeats a run of which it had: in no mean"
_NEITHER = "and have neither standard errors nor residuals"
MISSTATED = 1.5
"""How many times as large noise has to be for anybody to see to it: it is known hardly better from unit to unit."""


@dataclass(frozen=True)
class SensorRepeats:
    """One sensor's means, coldest first, and how its parameters scatter from run to run.

    `told_by` is the column whose temperatures those are (None: there is none); `not_used` are runs that FAIL by their
    own records. `of_each` is one standard deviation of every parameter that a run could tell, by run, and `alike` what
    of it is the same in every run. `differ` is what differs from run to run, and no parameter that changes there moves,
    of runs that nothing is said against. `noise_times` (c,) is that, or what residuals exceed them by beyond chance
    where what differs neither shows nor contradicts it; `same_times` is how much those of channels do that are no
    noise; `by_noise` is how parameters scatter beside errors as large as noise is. `left_deg_per_hr` (c,) is what
    residuals make of the noise of rates without errors, NaN where they have some or nothing tells it, `stated` whether
    they have, and `noise_told` whether anything but those errors tells what noise there is. `to_record` are columns
    that nobody recorded and that what scatters beyond noise may follow. `of_means`: rows are printed means of runs,
    whose standard errors have what these scattered by. `temperature_degC` is that of every run that has one;
    `of_visits` parameters differ between visits to one, `between` says by what; `visited_once` says
    so of several temperatures, where each was gone to once, and `in_no_mean` of runs of which nobody knows theirs.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    spread: Spread
    by_noise: Spread
    means: Sequence[MeanAt]
    told_by: str | None = None
    not_used: tuple[int, ...] = ()
    of_each: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    alike: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    channels: Sequence[str] = ()
    differ: Changes = field(default_factory=lambda: Changes(np.zeros(0), np.zeros(0)))
    noise_times: FloatArray = field(default_factory=lambda: np.ones(1))
    same_times: Mapping[str, float] = field(default_factory=dict)
    left: Left = field(default_factory=Left)
    stated: bool = True
    noise_told: bool = False
    to_record: Sequence[str] = ()
    of_means: bool = False
    temperature_degC: Mapping[int, float] = field(default_factory=dict)
    of_visits: Sequence[str] = ()
    between: BetweenRuns = field(default_factory=BetweenRuns)
    visited_once: Sequence[str] = ()
    in_no_mean: Sequence[str] = ()

    @classmethod
    def of(cls, units: Mapping[str, str], spread: Spread, means: Sequence[MeanAt]) -> Self:
        """Return what means of parameters with these `units`, and their spread, show by themselves."""
        return cls(tuple(units), tuple(units.values()), spread, spread, means)

    @property
    def times_of(self) -> dict[str, float]:
        """By how much more or less than their standard errors averages scatter, by channel, 1 where chance explains it.

        Where it cannot be told of which channel that is, all have the same.
        """
        return dict(zip(self.channels, self.differ.times.tolist(), strict=True))

    def at(self, temperature_degC: float | None) -> MeanAt | None:
        """Return the mean at what is this temperature of another campaign, None where there is none."""
        known = {each.temperature_degC: each for each in self.means}
        return known.get(nearest(temperature_degC, known))

    @property
    def usual(self) -> dict[str, float]:
        """What each parameter is at the middle of its means at all temperatures, those left out that no mean knows."""
        known = ((name, [v for each in self.means if (v := each.values.get(name))]) for name in self.names)
        return {name: float(np.median([v.value for v in of if v.value is not None])) for name, of in known if of}

    def runs_of(self, mean: MeanAt, name: str) -> tuple[int, ...]:
        """Return the runs that the mean of one parameter holds: those of the mean that could tell it."""
        but = self.between.alone.get(name, ())
        return tuple(run for run in mean.runs if name in self.of_each.get(run, ()) and run not in but)

    def where(self, mean: MeanAt) -> dict[str, Any]:
        """Return of which temperature a mean is, whose that is, and what the unit's own thermometer showed."""
        return {
            "temperature_degC": mean.temperature_degC,
            "temperature_of": self.told_by,
            "unit_degC": mean.unit_degC,
        }

    def of_run(self, solution: RunSolution) -> dict[str, Uncertain]:
        """Return one run's values with what repeats show in their uncertainty; those that it could not tell lack."""
        told, found = solution.by_noise(self.left.deg_per_hr), {}
        errors = np.array([told[name].se if name in told else None for name in self.names], np.float64)
        every = zip(self.names, self.units, self.spread.sd(errors).tolist(), self.spread.freedom.tolist(), strict=True)
        for place, (name, unit, sd, freedom) in enumerate(every):
            if name in told and (value := told[name].value) is not None:
                found[name] = Uncertain(value, sd, freedom, 1, unit, self.spread.beyond_of(place))
        return found

    def noise(self, errors: FloatArray) -> FloatArray:
        """Return the noise of averages with these standard errors, (n, c), deg/hr each; NaN where nothing tells it."""
        left = np.broadcast_to(self.left.deg_per_hr, errors.shape)
        return np.asarray(self.noise_times * errors if self.stated else left)

    def of_a_collect(self, errors: FloatArray, columns: FloatArray) -> float:
        """Return what a collect of usual noise scatters by, rms deg/hr, with what parameters do from run to run.

        `errors` (n, c) are the standard errors of rates, `columns` (n, c, p) what these are of each parameter.
        """
        beyond = np.einsum("ncp,p->nc", columns**2, self.by_noise.beyond**2)
        return float(np.sqrt(np.median(np.nan_to_num(self.noise(errors)) ** 2) + np.mean(beyond)))

    def document(self) -> dict[str, Any]:
        """Return the JSON of it: `run_to_run` by parameter, `means` by temperature, and runs that are in neither."""
        told = (of.tolist() for of in (self.spread.observed, self.spread.beyond, self.spread.degrees))
        return {
            "run_to_run": {
                name: {"sd": sd, "beyond_standard_errors": more, "degrees_of_freedom": free, "unit": unit}
                for name, unit, sd, more, free in zip(self.names, self.units, *told, strict=True)
                if free
            },
            "means": [
                {
                    **self.where(each),
                    "runs": list(each.runs),
                    "parameters": {name: value.document() for name, value in each.values.items()},
                }
                for each in self.means
            ],
            "runs_not_used": list(self.not_used),
            "standard_errors": self.noise_in_words,
            "explained": self.between.in_words,
            **({} if self.stated else {"noise_deg_per_hr": self.left.of(self.channels)}),
        }

    def sentences(self) -> list[str]:
        """Say what repeats show beyond standard errors, or that nothing was told twice."""
        if not self.repeated:
            said = [OF_MEANS] * self.of_means
            if stated := self.by_model:
                by_name = (f"{name} by {beyond:.3g} {unit}" for name, beyond, unit in stated)
                said.append(
                    f"{_ONCE}: each ± has what the model states to scatter from run to run: {'; '.join(by_name)}"
                )
            return [
                *(said or [f"{_ONCE}: what changes from run to run is not known, and in no ±"]),
                *self.in_no_mean,
                *self.widened,
            ]
        of, noise = self.spread, self.by_noise

        def by(some: BoolArray) -> list[str]:
            every = zip(self.names, self.units, of.observed, noise.stated, some, strict=True)
            return [
                f"{n} by {sd:.3g} {u}{f' ({own:.2g} by noise)' * bool(own > 0)}" for n, u, sd, own, so in every if so
            ]

        told, may_be = by(noise.certain), by(of.beyond > noise.stated)
        every = of.degrees[noise.certain if told else of.degrees > 0]
        least = f"{every.min()} to " * bool(every.min() < every.max())
        freedom = f"{least}{counted(int(every.max()), 'degree')} of freedom"
        unknown = "" if self.told_by else "; no temperature was recorded, so that every run counts as a repeat"
        errors = self.noise_by("standard errors" if self.stated else self.left.by)
        if told:
            how = f"more than their {errors} say" if any(of.stated) else _NEITHER
            included = "; each ± includes what noise does not explain (hil reconcile asks what it follows)"
            more = f"{how} ({freedom}{unknown}): {'; '.join(told)}{included}"
        else:
            by_more = f", though by more: {'; '.join(may_be)}; each ± includes that" * bool(may_be)
            more = f"as their {errors} say, as far as {freedom} can tell{unknown}{by_more}"
        said = [f"repeats scatter {more}"] if told or may_be or not self.noise_in_words else []
        said += [f"record {MAY_FOLLOW.format(listed(self.to_record))}"] if self.to_record else []
        return [*said, *self.in_no_mean, *self.visited_once, *self.between.not_judged, *self.cautions]

    @property
    def cautions(self) -> list[str]:
        """Say what is to be known of every ±: where standard errors do not hold, and where no one scatter does."""
        return [*dict.fromkeys([*self.noise_in_words, *self.uneven_in_words]), *self.visits_in_words]

    @property
    def repeated(self) -> bool:
        """Whether any parameter was told twice at one temperature."""
        return bool(np.any(self.spread.degrees))

    @property
    def scatter_included(self) -> bool:
        """Whether a ± has what changes from run to run: by repeats, by what its rows are means of, or by a model."""
        return self.repeated or self.of_means or bool(self.by_model)

    @property
    def by_model(self) -> list[tuple[str, float, str]]:
        """What a model states to scatter from run to run, with its unit, of parameters of which no repeats tell it."""
        every = zip(self.names, self.spread.beyond.tolist(), self.units, self.spread.degrees, strict=True)
        return [(name, beyond, unit) for name, beyond, unit, degrees in every if beyond > 0.0 and not degrees]

    @property
    def widened(self) -> list[str]:
        """Say by how much residuals alone make a ± larger than standard errors say; nothing where repeats say more."""
        by_times: dict[str, list[str]] = {}
        for name, times in zip(self.names, np.hypot(self.spread.factor, self.spread.common).tolist(), strict=True):
            by_times.setdefault(significant(times), []).append(name)
        wider = [f"{times} times for {listed(names)}" for times, names in by_times.items() if float(times) > 1.0]
        more = "residuals make the ± larger than standard errors say"
        return [f"{more}: {'; '.join(wider)}"] if wider and self.stated and not self.repeated else []

    @property
    def misstated(self) -> bool:
        """Whether standard errors are so far off, by half of themselves or more, that somebody has to state others."""
        return any(max(times, 1.0 / times) > MISSTATED for times in self.times_of.values())

    def noise_by(self, errors: str) -> str:
        """Say what tells the noise of a collect: `errors`, and how many times as large it is where they do not."""
        if np.all(self.noise_times == 1.0):
            return errors
        of_each = zip(self.times_of, self.noise_times.tolist(), strict=True)
        each = listed(f"{channel} {significant(times)}" for channel, times in of_each)
        return f"{errors} times what residuals and repeats show ({each})"

    @property
    def noise_in_words(self) -> list[str]:
        """Say by how much standard errors are too small or too large, and where residuals are no noise."""
        by_noise = [*self.differ.in_words(self.channels), *self.left.larger]
        if self.same_times:
            each = listed(f"{channel} {significant(times)} times" for channel, times in self.same_times.items())
            alone = f"over all runs together residuals are in {each} what standard errors allow, and do not differ as"
            by_noise.append(f"{alone} much from run to run: what is left is the same in every run, and no noise")
        return by_noise

    @property
    def uneven(self) -> BoolArray:
        """Which parameters scatter more at some temperatures than at others, (p,): none that noise explains in all."""
        return np.asarray(self.spread.uneven & self.by_noise.certain)

    @property
    def uneven_in_words(self) -> list[str]:
        """Say what noise or which parameters are larger at some temperatures than at others: no one ± holds at each."""
        told, by_noise = [], [*self.differ.uneven_in_words(self.channels), *self.left.larger]
        for name in (name for name, odd in zip(self.names, self.uneven, strict=True) if odd):
            most = max(self.means, key=lambda mean: np.nan_to_num(mean.scatter.get(name, 0.0)))
            told.append(f"{name} (most at {degrees(most.temperature_degC)}, {numbered('run', most.runs)})")
        how = f"{'scatters' if len(told) == 1 else 'scatter'} more at some temperatures than at others"
        return [*by_noise, *([f"{listed(told)} {how}: {NO_ONE}"] if told else [])]

    @property
    def visits_in_words(self) -> list[str]:
        """Say which parameters differ from visit to visit by more than runs of one do: history, or time, moves them."""
        of_both = "every ± holds both; the way to a temperature may do that (hil thermal), or time (hil reconcile)"
        differ = f"differ{'s' if len(self.of_visits) == 1 else ''} between visits to one temperature by more than runs"
        return [f"{listed(self.of_visits)} {differ} of a visit do: {of_both}"] if self.of_visits else []


def repeats(
    campaign: Campaign, solutions: Sequence[RunSolution], alike: Grouping = runs_by_temperature
) -> dict[int, SensorRepeats]:
    """Return what repeats show of each sensor that some run was solved for: of one temperature, or as told `alike`."""
    found, used = {}, treated(campaign)
    for number, collects in used.sensors.items():
        runs = collects.conditions.run.tolist()
        own = [each for each in solutions if each.sensor == number and not set(each.runs).isdisjoint(runs)]
        if own:
            shown = _of_sensor(own, collects, alike, tuple(used.not_used[number]), campaign.run_scatter.get(number, {}))
            shown = replace(shown, temperature_degC=of_runs_degC(campaign.sensors[number].conditions))
            if campaign.rebuilt and shown.stated:  # beyond the errors of means of runs nothing scatters that is unknown
                known = [{n: replace(of, beyond=of.beyond or 0.0) for n, of in e.values.items()} for e in shown.means]
                means = [replace(mean, values=of) for mean, of in zip(shown.means, known, strict=True)]
                shown = replace(shown, means=means, of_means=True)
            found[number] = shown
    return found


def _of_sensor(
    own: Sequence[RunSolution],
    rows: Collects,
    grouped: Grouping,
    not_used: tuple[int, ...],
    run_scatter: Mapping[str, float],
) -> SensorRepeats:
    conditions, stated = rows.conditions, stated_noise(rows) is not None
    at, channels = list(grouped(conditions)), list(conditions.sensor.channels)
    telling = [e for e in own if e.settled] or own  # what moved inside a run that had not is no noise of others
    left = own[0].left
    units, values, errors = told_by_runs(own, left.deg_per_hr)
    values[np.array([[e.runs[0] in own[0].between.alone.get(name, ()) for name in units] for e in own])] = np.nan
    group = np.array([next((k for k, (_, runs) in enumerate(at) if each.runs[0] in runs), -1) for each in own])
    visited = [degC for degC, _ in visits(conditions) if degC is not None]
    told = {e.runs[0]: e.settled for e, known in zip(own, np.isfinite(values), strict=True) if known.any()}
    # Of a run that had not settled, and repeats none that had, nobody knows of which temperature it would be a mean.
    late = sorted(run for degC, of in at for run in of if degC is None and not told.get(run, True))
    at = [(degC, tuple(run for run in of if run in told and (told[run] or degC is not None))) for degC, of in at]
    known_shares = shares_of(rows)
    shares = np.array([known_shares.get(name, np.full(len(channels), 1.0 / len(channels))) for name in units])
    of_channels = [np.array(each.of_channels) for each in telling if each.chi_square is not None]
    squares, freedom = sum(of_channels, np.zeros((2, len(channels))))
    residual_times = np.sqrt(np.maximum(squares / np.maximum(freedom, 1.0), 1.0))
    differ, times = own[0].differ, own[0].differ.times
    odd = chdtrc(np.maximum(freedom, 0.5), squares) < RARE
    contradicted = odd & (Changes(differ.squares / residual_times**2, differ.freedom).times < 1.0)
    noise_times = np.where(odd & ~contradicted & (times == 1.0), residual_times, times)
    # Of a ± errors are as large as anything shows, and as well known as what shows it (Welch and Satterthwaite).
    smaller = (times < 1.0) & ~contradicted
    variance = shares * np.where(smaller, times, np.maximum(residual_times, times)) ** 2
    common = np.where(contradicted, variance - shares * times**2, 0.0).sum(axis=1)
    behind = np.where(smaller | (times > residual_times), differ.freedom, np.where(odd, freedom, math.inf))
    with np.errstate(divide="ignore"):
        part = variance / np.maximum(variance.sum(axis=1, keepdims=True), 1e-300)
        known = 1.0 / np.sum(part**2 / np.maximum(behind, 1.0), axis=1)
    residuals = np.minimum(known, shares @ left.freedom if np.isfinite(left.freedom).all() else math.inf)
    if left.by == DIFFERENCES:  # of what tells it by its own differences these are not known better by them
        residuals = np.where([name.startswith(("B", "MU")) for name in units], residuals, 1.0)
    changing = np.sqrt(variance.sum(axis=1) - common)
    beyond = np.array([run_scatter.get(name, 0.0) for name in units])
    of_visits = own[0].between.of_visits if grouped is runs_by_temperature else ()  # else visits stand apart
    lasting = own[0].between.lasting if grouped is runs_by_temperature and len(visited) > len(set(visited)) else ()
    visit = np.array([next(k for k, (_, runs) in enumerate(visits(conditions)) if e.runs[0] in runs) for e in own])
    by_visit = np.isin(list(units), lasting)
    one_each = gathered(values, errors, visit, by_visit)  # runs of a visit have in common what history made of them
    spread = Spread.of(*one_each, group, changing, residuals, np.sqrt(common), beyond)
    together = np.where(by_visit, visit[:, None], np.arange(len(own))[:, None])
    means = means_at(units, values, errors, group, at, spread, together)
    shown = replace(SensorRepeats.of(units, spread, means), left=left)
    by_noise = Spread.of(*one_each, group, np.sqrt(shares @ noise_times**2), residuals, stated_beyond=beyond)
    alike = np.nan_to_num(spread.parts(errors)[1]).tolist()
    return replace(
        shown,
        means=[
            replace(mean, unit_degC=unit_range_degC(*of), own_degC=unit_mean_degC(*of))
            for mean in shown.means
            for of in [(conditions, mean.runs)]
            if mean.runs
        ],
        told_by=told_by(conditions),
        not_used=not_used,
        of_each={e.runs[0]: {n: u.sd for n, u in shown.of_run(e).items()} for e in own},
        alike={e.runs[0]: dict(zip(units, of, strict=True)) for e, of in zip(own, alike, strict=True)},
        channels=channels,
        differ=differ,
        between=own[0].between,
        noise_times=noise_times,
        same_times={c: float(of) for c, of, is_so in zip(channels, residual_times, contradicted, strict=True) if is_so},
        by_noise=by_noise,
        to_record=to_record_of((n for n, odd in zip(units, by_noise.certain, strict=True) if odd), conditions),
        stated=stated,
        visited_once=[_VISITED_ONCE] * (1 < len(visited) == len(set(visited))),
        in_no_mean=[_IN_NO_MEAN.format(numbered("run", late))] * bool(late),
        of_visits=of_visits,
        noise_told=bool(freedom.sum() + differ.freedom.sum() > 0.5 or np.isfinite(left.deg_per_hr).all()),
    )
