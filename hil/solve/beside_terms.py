"""Solving beside what is known: what a model's terms explain is off the rates, what it states of noise is in errors.

    campaign, model = read_campaign("night"), load_model("model.yaml")
    solutions = solve_campaign(beside(campaign, model), model.form)

So the improved model that reconcile writes gives parameters that are no longer bent by the effect it names, and a run
is held against no less noise than reconcile holds it against. Whatever else is asked of the campaign is asked of this.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import replace

import numpy as np

from hil.campaign import Campaign, Collects, Conditions, FloatArray, IntArray
from hil.campaign.stand_ins import with_stand_ins
from hil.errors import InputError
from hil.model import Model
from hil.model.effects.columns import flattened
from hil.model.effects.scatter import Scatter
from hil.model.forms import default_form
from hil.solve.identifiability import orthonormal, project_out
from hil.solve.repeats import Grouping, SensorRepeats, repeats
from hil.solve.runs import RunSolution, solve_campaign
from hil.solve.temperatures import runs_by_temperature
from hil.solve.wrong_rows import wrong_rows

_NOTHING = 1e-6  # deg/hr, at 1 g: less is what arithmetic leaves


def beside_usual(
    campaign: Campaign,
    shown: Mapping[int, SensorRepeats],
    usual: Callable[[Conditions], FloatArray],
    alike: Grouping = runs_by_temperature,
) -> tuple[Campaign, Mapping[int, SensorRepeats], Set[int]]:
    """Return what repeats show, with `usual` errors (n, c) of sensors whose noise nothing tells.

    Neither errors, nor residuals, nor runs of one temperature. Of the others it is what was `shown`. With it the
    campaign with them, and which sensors these are.
    """
    assumed = {n for n, each in shown.items() if not each.stated and np.isnan(each.left.deg_per_hr).all()}
    if not assumed:
        return campaign, shown, assumed
    rows = {n: campaign.sensors[n] for n in assumed}
    laid = {n: replace(each, rates_se_deg_per_hr=usual(each.conditions)) for n, each in rows.items()}
    campaign = replace(campaign, sensors={**campaign.sensors, **laid})
    return campaign, repeats(campaign, solve_campaign(campaign), alike), assumed


def solve_beside(campaign: Campaign, model: Model) -> tuple[RunSolution, ...]:
    """Solve every run of a campaign that is `beside` a model for the model's form.

    Its terms have the model's values, which are not refitted.
    """
    found = []
    for each in solve_campaign(campaign, model.form):
        sensor = campaign.sensors[each.sensor].conditions.sensor
        terms = [f"{term.effect} as model {model.title} has it" for term, _ in model.terms_for(sensor)]
        noise = [f"noise as the file of model {model.full_title} states it"] * (sensor.number in model.noise)
        found.append(replace(each, model=model.full_title, assumed=(*each.assumed, *terms, *noise)))
    return tuple(found)


def beside(campaign: Campaign, model: Model) -> Campaign:
    """Return the campaign less what a model's terms make of its rates, with the noise that the model states.

    What scatters inside a run is in the standard errors; so is white noise where a sensor states none of its own; and
    what differs from run to run stands in `run_scatter`. Raises `InputError` where a term or a size needs a column that
    the data lacks, or the model has no values for a sensor on which it has a term.
    """
    asked = {number: rows.conditions for number, rows in with_stand_ins(campaign).sensors.items()}
    sensors, run_scatter, terms = {}, {}, {}
    for number, rows in campaign.sensors.items():
        parts = model.stated_scatter(asked[number])
        if model.terms_for(rows.conditions.sensor):
            if not model.has_values(rows.conditions.sensor):
                raise InputError(
                    f"model {model.title}: it has named terms but no values for sensor {number}; its terms cannot be "
                    "taken off the rates"
                )
            terms[number] = model.rates(asked[number]) - model.base_for(asked[number]).rates
        sensors[number] = with_scatter(with_white_noise_of(model, rows, asked[number]), parts)
        run_scatter[number] = scatter_of_runs(asked[number], parts)
    noisy = replace(campaign, sensors=sensors, run_scatter=run_scatter)
    # Terms act where rates belong, wherever they are filed: what is large enough hides that, in what is taken off.
    wrong = wrong_rows(_less(noisy, terms)) if terms else {}
    for number in [n for n in terms if wrong[n].rows and not wrong[n].mends]:
        wrong[number] = wrong_rows(noisy)[number]
    return _less(noisy, {number: wrong[number].as_filed(of) for number, of in terms.items()})


def _less(campaign: Campaign, rates: Mapping[int, FloatArray]) -> Campaign:
    """Return the campaign less rates (n, c) of some sensors."""
    laid = {
        number: replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr - rates.get(number, 0.0))
        for number, rows in campaign.sensors.items()
    }
    return replace(campaign, sensors=laid)


def with_white_noise_of(model: Model, rows: Collects, conditions: Conditions) -> Collects:
    """Return collects without standard errors with those that a model's angle random walk makes over each of them."""
    white = model.white_noise(conditions)
    errors = rows.rates_se_deg_per_hr
    if white is None or np.any(errors[np.isfinite(rows.rates_deg_per_hr)] > 0.0):
        return rows
    return replace(rows, rates_se_deg_per_hr=np.broadcast_to(white[:, None], errors.shape).copy())


def with_scatter(rows: Collects, parts: Sequence[Scatter]) -> Collects:
    """Return collects whose standard errors have what scatters inside a run: what its own values take is none of it.

    What white noise would have to be for them to leave as much: all of what changes from collect to collect.
    """
    conditions, stated = rows.conditions, rows.rates_se_deg_per_hr
    if not parts:
        return rows
    errors = np.sqrt(stated**2 + within_runs(conditions, parts))
    return replace(rows, rates_se_deg_per_hr=np.where(stated > 0.0, errors, stated))


def within_runs(conditions: Conditions, parts: Sequence[Scatter]) -> FloatArray:
    """Return the variance of each rate, (n, c), (deg/hr)², by what scatters inside a run."""
    out = np.zeros(conditions.w_channels_deg_per_hr.shape)
    for here, *_, within in _of_each_run(conditions, parts) if parts else ():
        out[here] = within.reshape(out[here].shape)
    return out


def scatter_of_runs(conditions: Conditions, parts: Sequence[Scatter]) -> dict[str, float]:
    """Return what the parameters of a run scatter by, by name, rms of all runs, beyond what is in standard errors."""
    squares: dict[str, list[float]] = {}
    for _, names, columns, covariance, within in _of_each_run(conditions, parts) if parts else ():
        response = np.linalg.pinv(columns, rcond=1e-3)
        for name, square in zip(names, np.diag(response @ (covariance - np.diag(within)) @ response.T), strict=True):
            squares.setdefault(name, []).append(max(float(square), 0.0))
    sizes = {name: float(np.sqrt(np.mean(of))) for name, of in squares.items()}
    return {name: size if size > _NOTHING else 0.0 for name, size in sizes.items()}


def _of_each_run(
    conditions: Conditions, parts: Sequence[Scatter]
) -> Iterator[tuple[IntArray, tuple[str, ...], FloatArray, FloatArray, FloatArray]]:
    """Yield rows (k,), names and columns (k·c, p) of the parameters, and the covariance (k·c, k·c) of what scatters.

    And the variance (k·c,) of white noise of which these would leave as much: what each collect draws anew is that.
    """
    for here in conditions.of_each_run.values():
        own = conditions.rows(here)
        form = default_form(own)
        there = [replace(p, columns=p.columns[here], group=None if p.group is None else p.group[here]) for p in parts]
        every = [(part.is_white, part.covariance(own)) for part in there]
        covariance = np.asarray(sum(of for _, of in every))
        white = sum((np.diag(of) for is_white, of in every if is_white), np.zeros(len(covariance)))
        columns = flattened(form.columns(own))
        basis = orthonormal(columns, 1e-6)
        left = np.diag(project_out(basis, project_out(basis, covariance - np.diag(white)).T))
        within = white + np.maximum(left, 0.0) / np.maximum(1.0 - np.sum(basis**2, axis=1), 1e-6)
        yield here, form.names, columns, covariance, within
