"""Solve a campaign: each run of each sensor for the parameters of a named model, with a verdict and its reason.

    solutions = solve_campaign(read_campaign("my-campaign"))
    solutions[0].parameters["MUB"]  # Estimate(value=-7.5, se=1.1, unit="deg/hr/g")

A run that cannot support a parameter gets none: its value is None, the sentence in `unobservable` names what is
missing, and the verdict is INCONCLUSIVE. Where residuals are left they decide between PASS (their chi-square would be
exceeded in at least 5 % of cases by chance), MARGINAL and FAIL (in less than 0.1 %), beside standard errors as large as
repeats of the sensor show them to be, as every ± is. The verdict is the worst of that, of how the run was measured and
what its records contradict (`Campaign.verdicts`, `contradicted`), of what the other runs say of its collects, and of
whether the standard errors are small enough to say anything (`hil.solve.precision`).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from hil.campaign import Campaign, Collects, FloatArray
from hil.campaign.plausibility import accelerations_g
from hil.errors import InputError
from hil.files.document import plain
from hil.model.forms import LinearForm, default_form, named_form
from hil.solve.beside_runs import BesideRuns
from hil.solve.between_runs import BetweenRuns, between_runs
from hil.solve.contractor import METHOD, can_follow, solve_as_contractor
from hil.solve.identifiability import orthonormal
from hil.solve.least_squares import Solution, solve
from hil.solve.precision import measured_well_enough, stated_noise
from hil.solve.residuals import (
    APART,
    LACKS,
    MOVED,
    Changes,
    Left,
    beyond_errors,
    judge,
    noise_left,
    what_lacks,
    wider_in_words,
)
from hil.solve.temperatures import law_not_told, runs_by_temperature
from hil.solve.wrong_rows import treated, wrong_rows
from procedures.verdict import Judgement, Verdict

OBSERVABLE = 1e-3
"""A combination counts as seen where the collects excite it by more than a thousandth of what they excite best.

A thousandth of 1 g is a milliradian: less than that, and the error of the attitude is as large as the excitation.
"""

LEAST_SQUARES = "weighted least squares"
UNSTATED = "every rate of a channel has the same, unstated noise"


@dataclass(frozen=True)
class Estimate:
    """A parameter's value, standard error and unit; None where these collects cannot tell."""

    value: float | None
    se: float | None
    unit: str


@dataclass(frozen=True)
class RunSolution:
    """One sensor's parameters from one run (or, for a thermal model, from all: `run` is None, `runs` says which).

    `covariance` (p, p) in the order of `parameters`, NaN where unknown; `condition_number` None where infinite;
    `residual_rms_deg_per_hr` None without degrees of freedom; `combinations` are seen mixtures of parameters that are
    not known singly. `chi_square` is that of the residuals, None without stated standard errors, and `of_channels` what
    each channel has of it, of squares in deg/hr without them, and of its degrees of freedom, (c,) each. `compared`:
    whether other runs say what this one's collects should show; `settled`: whether its soak had ended. `per_noise`
    (p, c) are the standard errors of rates of which those of one channel have a noise of 1 deg/hr, None where standard
    errors are stated. `differ` is what its sensor's runs differ by that no parameter of a run makes: beside that noise
    it is `judged` by its residuals, and `beside` that by how it was measured; `between` is what explains what runs of
    one temperature differ by, and `left` what tells the noise of a sensor's rates that state no errors; `form_reason`
    says why no fuller form was taken. What the campaign has `taken_as_zero` is none of the `parameters`.
    """

    run: int | None
    runs: tuple[int, ...]
    sensor: int
    model: str
    method: str
    parameters: Mapping[str, Estimate]
    combinations: Mapping[str, Estimate]
    covariance: FloatArray
    condition_number: float | None
    residual_rms_deg_per_hr: float | None
    degrees_of_freedom: int
    unobservable: tuple[str, ...]
    judged: Judgement
    assumed: tuple[str, ...]
    form_reason: str = ""
    beside: tuple[Judgement, ...] = ()
    chi_square: float | None = None
    of_channels: tuple[FloatArray, FloatArray] | None = None
    compared: bool = True
    settled: bool = True
    per_noise: FloatArray | None = None
    differ: Changes = field(default_factory=lambda: Changes(np.zeros(1), np.zeros(1)))
    between: BetweenRuns = field(default_factory=BetweenRuns)
    left: Left = field(default_factory=Left)

    def by_noise(self, deg_per_hr: FloatArray) -> Mapping[str, Estimate]:
        """Return the parameters with the standard errors of rates of this noise (c,), NaN: unknown, where none is."""
        if self.per_noise is None:
            return self.parameters
        errors = (plain(float(np.linalg.norm((deg_per_hr * of)[of > 0.0]))) for of in self.per_noise)
        return {name: replace(each, se=se) for (name, each), se in zip(self.parameters.items(), errors, strict=True)}

    @property
    def causes(self) -> list[Judgement]:
        """What gives the verdict, then what gives a lesser one; of a PASS why it is one, and of which form."""
        worrying = [each for each in (*self.beside, self.judged) if each.verdict is not Verdict.PASS]
        passed = [replace(self.judged, reason=each) for each in (self.form_reason, self.judged.reason) if each]
        return sorted(worrying, key=lambda each: -each.severity) or passed

    @property
    def verdict(self) -> Verdict:
        """The worst of its causes."""
        return self.causes[0].verdict

    @property
    def reason(self) -> str:
        """All causes, the worst first; and why of its form, where it has a reason."""
        return "; ".join(filter(None, dict.fromkeys([*(each.reason for each in self.causes), self.form_reason])))

    @property
    def exceeds_errors(self) -> bool:
        """Whether the residuals are so much larger than the standard errors allow that the run is a FAIL."""
        return self.judged.verdict is Verdict.FAIL


@lru_cache(maxsize=4)
def solve_campaign(
    campaign: Campaign, model_name: str | None = None, sensor: int | None = None
) -> tuple[RunSolution, ...]:
    """Solve every run of every sensor, or of one, in the order of runs, then sensors.

    `model_name` None takes each run's default: matrix-6 for rotor sensors, triad-12 for triads whose positions allow
    it, constant otherwise with the reason. Raises InputError for a model that does not fit the sensor, or
    says how values follow temperature where these collects were made at too few to tell.
    """
    every, used = wrong_rows(campaign), treated(campaign).sensors
    found, rows = [], every if sensor is None else {sensor: every[sensor]}
    for number, wrong in rows.items():
        solved = [*_solved(wrong.collects, model_name)]
        beside = BesideRuns.of(campaign, number, wrong, used[number])
        chi = [np.sum(each.of_channels[0] / beside.differ.larger_in(each.runs) ** 2) for each in solved]
        among = _of_as_many([(float(of), each.degrees) for of, each in zip(chi, solved, strict=True) if each.tells])
        own = [_described(number, each, among, wrong.collects, beside) for each in solved]
        runs, layout = set(used[number].conditions.run.tolist()), used[number].conditions.sensor
        told = [each for each in own if not runs.isdisjoint(each.runs)]
        left = _noise_of(told, beside)
        times = float(beside.differ.times.max())
        between = BetweenRuns()
        if told and all(each.run is not None for each in told):
            units, values, errors = told_by_runs(told, left.deg_per_hr)
            errors *= [[beside.differ.larger_in(each.runs).max()] for each in told]
            first = [each.runs[0] for each in told]
            between = between_runs(units, first, values, errors, used[number].conditions, wrong.another)
        contradicted = between.judged
        for each in own:  # by how well its collects tell it, too, of this noise where they state none, or far too much
            told_by = each.by_noise(left.deg_per_hr).items()
            own_errors = {n: (None if of.se is None else min(times, 1.0) * of.se, of.unit) for n, of in told_by}
            judged = measured_well_enough(own_errors, layout, campaign.largest_se)
            apart = [contradicted[run] for run in each.runs if run in contradicted]
            assumed = (*each.assumed, *beside.assumed(each.runs, compared=bool(apart)))
            of_run = replace(each, beside=(*each.beside, *apart, judged), assumed=assumed)
            found.append(replace(of_run, between=between, left=left))
    return tuple(sorted(found, key=lambda each: (each.runs[0], each.sensor)))


def _noise_of(own: Sequence[RunSolution], beside: BesideRuns) -> Left:
    """Return what tells the noise of these runs, where they state no errors: those that had settled, if any had."""
    telling = [each for each in own if each.settled] or own  # what moved inside a run is no noise of others
    alone = [(e.runs[0], np.array(e.of_channels)) for e in telling if e.per_noise is not None and e.of_channels]
    groups = runs_by_temperature(beside.used.conditions)
    of_each = [(degC, [own for run, own in alone if run in runs]) for degC, runs in groups]
    at = [(degC, *np.sum(of, axis=0)) for degC, of in of_each if of]
    return noise_left(at, beside.unstated, len(beside.used.conditions.sensor.channels))


def told_by_runs(own: Sequence[RunSolution], noise: FloatArray) -> tuple[dict[str, str], FloatArray, FloatArray]:
    """Return the units of what r solutions tell, by parameter, and its values and standard errors (r, p), NaN: untold.

    Of rates without errors those are what a `noise` (c,), deg/hr, makes.
    """
    units = {name: of.unit for each in own for name, of in each.parameters.items()}
    told = [[of.get(name, Estimate(None, None, "")) for name in units] for of in (e.by_noise(noise) for e in own)]
    values, errors = (np.array([[getattr(e, a) for e in of] for of in told], np.float64) for a in ("value", "se"))
    return units, values, errors


@dataclass(frozen=True)
class _Solved:
    """Collects with the form that they were solved for, the standard errors (n, c) that weighed them, and how."""

    run: int | None
    form: LinearForm
    collects: Collects
    sigma: FloatArray | None
    solution: Solution
    as_contractor: bool

    @property
    def tells(self) -> bool:
        """Whether residuals tell anything of stated standard errors."""
        return self.sigma is not None and self.degrees > 0

    @property
    def runs(self) -> tuple[int, ...]:
        """The runs that it is of."""
        return tuple(np.unique(self.collects.conditions.run).tolist())

    @property
    def degrees(self) -> int:
        """Degrees of freedom of the residuals."""
        return int(self.solution.degrees_of_freedom)

    @cached_property
    def of_channels(self) -> tuple[FloatArray, FloatArray]:
        """The squared residuals of each channel in standard errors, and their degrees of freedom, (c,) each."""
        solution, count = self.solution, len(self.collects.conditions.sensor.channels)
        if self.as_contractor:  # whose residuals are not those of its equations
            return np.full(count, float(solution.chi_square) / count), np.full(count, self.degrees / count)
        known = solution.measured
        sigma = np.ones(known.size) if self.sigma is None else self.sigma.reshape(-1)
        basis = orthonormal(solution.design[known] / sigma[known, None])
        squares, freedom = np.zeros(known.size), np.zeros(known.size)
        squares[known] = (solution.residuals[known] / sigma[known]) ** 2
        freedom[known] = 1.0 - np.sum(basis**2, axis=1)
        return squares.reshape(-1, count).sum(axis=0), freedom.reshape(-1, count).sum(axis=0)


def _solved(collects: Collects, model_name: str | None) -> Iterator[_Solved]:
    """Solve each run, or all of them together for a form that needs them."""
    together = model_name == "matrix-6-thermal"
    runs: dict[int | None, Collects] = {run: collects.rows(own) for run, own in collects.conditions.of_each_run.items()}
    for run, chosen in {None: collects}.items() if together else runs.items():
        conditions, sigma = chosen.conditions, stated_noise(chosen)
        form = default_form(conditions) if model_name is None else named_form(model_name, conditions)
        if untold := law_not_told(form, conditions):
            raise InputError(untold)
        if form.name == "collins-4" and can_follow(chosen):
            yield _Solved(run, form, chosen, sigma, solve_as_contractor(chosen, sigma), True)
            continue
        rates = chosen.rates_deg_per_hr - conditions.w_channels_deg_per_hr
        solution = solve_rates(form.columns(conditions), rates, sigma, form.names)
        yield _Solved(run, form, chosen, sigma, solution, False)


def solve_rates(
    columns: FloatArray, rates: FloatArray, sigma: FloatArray | float | None, names: Sequence[str] | None = None
) -> Solution:
    """Solve rates (..., n, c) of n collects for what has these columns (n, c, p), as far as the collects excite it.

    `sigma`, (n, c) or of all, are their standard errors, deg/hr; None where they are not stated.
    """
    design = columns.reshape(-1, columns.shape[-1])
    noise = None if sigma is None else np.broadcast_to(sigma, columns.shape[:-1]).reshape(-1)
    return solve(design, rates.reshape(*rates.shape[:-2], -1), noise, names=names, rank_tolerance=OBSERVABLE)


def _of_as_many(telling: Sequence[tuple[float, int]]) -> int:
    """Return of how many judgements one is that a run differs: 1 where even without such all differ, not by chance.

    Of each run there are the squares of its residuals, in standard errors, and their degrees of freedom. Of several
    all together are judged, and then each: by either a sound folder is as seldom accused as one run is.
    """
    both = min(len(telling), 2)
    among = max(both * len(telling), 1)
    usual = [(chi, nu) for chi, nu in telling if judge(chi, nu, 0, True, among).verdict is not Verdict.FAIL]
    altogether = judge(sum(chi for chi, _ in usual), sum(nu for _, nu in usual), 0, True, both)
    return among if altogether.verdict is Verdict.PASS else 1


def _described(sensor: int, solved: _Solved, among: int, every: Collects, beside: BesideRuns) -> RunSolution:
    """Return the solution with the worst of verdicts: of solving, of how it was measured, of what stands `beside`."""
    form, collects, solution = solved.form, solved.collects, solved.solution
    conditions, noise_stated = collects.conditions, solved.sigma is not None
    unobservable = () if solved.as_contractor else solution.observability.sentences
    equations = int(np.count_nonzero(~np.isnan(solution.residuals)))
    told, runs = form.without(beside.campaign.taken_as_zero), solved.runs
    settled, times = beside.moving.isdisjoint(runs), beside.differ.larger_in(runs)
    squares, freedom = solved.of_channels
    if unobservable:
        judged = Judgement(Verdict.INCONCLUSIVE, what_lacks(collects, every, unobservable))
    else:
        why = (APART if np.isin(beside.used.conditions.run, runs).sum() == 0 else LACKS) if settled else MOVED
        channels, left = list(conditions.sensor.channels), squares / times**2
        where, wider = beyond_errors(channels, (left, freedom), among), wider_in_words(channels, times)
        judged = judge(float(left.sum()), solved.degrees, equations, noise_stated, among, where, why, wider)
    unit, places = dict(zip(told.names, told.units, strict=True)), [form.names.index(name) for name in told.names]
    known = zip(told.names, *(plain(of[places]) for of in (solution.values, solution.se)), told.units, strict=True)
    return RunSolution(
        run=solved.run,
        runs=runs,
        sensor=sensor,
        model=form.name,
        method=METHOD if solved.as_contractor else LEAST_SQUARES,
        parameters={name: Estimate(*of) for name, *of in known},
        combinations={
            text: Estimate(plain(value), plain(se), _combined_unit(text, unit))
            for text, value, se in (solution.combinations() if unobservable else ())
        },
        covariance=solution.covariance[np.ix_(places, places)],
        condition_number=plain(solution.condition_number),
        residual_rms_deg_per_hr=plain(solution.residual_rms),
        degrees_of_freedom=solved.degrees,
        unobservable=unobservable,
        judged=judged,
        form_reason=f"the contractor's solution: {METHOD}" if solved.as_contractor else form.reason,
        assumed=_assumptions(told, collects, noise_stated, beside.campaign.rebuilt),
        beside=tuple(of[run] for run in runs for of in beside.judged if run in of),
        chi_square=float(solution.chi_square) if solved.tells else None,
        of_channels=solved.of_channels if solved.degrees else None,
        compared=beside.not_compared.keys().isdisjoint(runs),
        settled=settled,
        differ=beside.differ,
        per_noise=None if noise_stated else _per_noise(solution, len(conditions.sensor.channels))[places],
    )


def _per_noise(solution: Solution, channels: int) -> FloatArray:
    """Return the parameters' standard errors where every rate of one channel has a noise of 1, (p, c)."""
    response = np.zeros((solution.design.shape[1], solution.measured.size))
    response[:, solution.measured] = np.linalg.pinv(solution.design[solution.measured])
    of_rows = response[: len(solution.names)].reshape(len(solution.names), -1, channels)
    return np.asarray(np.linalg.norm(of_rows, axis=1))


def _assumptions(form: LinearForm, collects: Collects, noise_stated: bool, rebuilt: bool) -> tuple[str, ...]:
    posed = bool(np.isfinite(accelerations_g(collects)).any())
    said = {
        "f, the earth rate w and the scale factor are taken as given; local gravity is 1 g": True,
        "no mistake is the same in every run (labels, a sign, a channel, the heading): none of these collects shows "
        "it": True,
        "the pose was not measured (no accelerations): that the unit lay as each position says": not posed,
        "the earth rate is taken off what the table prints: the rates were made of that without it": rebuilt,
        "the earth rate is given as 0: what there is of it (up to 15.04 deg/hr) stands in the parameters, its vertical "
        "part looking like acceleration sensitivity": not rebuilt and not np.any(collects.conditions.w_deg_per_hr),
        "GSA and GSB are the same for both channels (isotropic rotor)": "GSA" in form.names,
        "MUA = MUB = 0": form.name == "collins-4",
        "no acceleration sensitivity": form.name == "constant",
        UNSTATED: not noise_stated,
    }
    return tuple(words for words, so in said.items() if so)


def _combined_unit(text: str, unit: Mapping[str, str]) -> str:
    """Unit of a combination: that of its members; biases are summed with what acts at 1 g, in deg/hr."""
    units = {unit[name] for name in text.replace("-", " ").replace("+", " ").split() if name in unit}
    return units.pop() if len(units) == 1 else "deg/hr"
