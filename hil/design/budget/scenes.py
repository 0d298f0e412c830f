"""From a planned sweep or a measured campaign to the scenes of an error budget: one for each run of each sensor.

    scenes = planned_scenes(sweep, bench)            # before the night: what the files say
    scenes = measured_scenes(campaign, bench, shown) # after it: standard errors, slopes and parameters as measured

The parameters that errors of attitude act on (GS, MU) are the model's where there is one with values, those that were
solved for after a night, and else typical of such a sensor.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from hil.campaign import Campaign, Collects, Conditions, FloatArray, IntArray
from hil.campaign.data import known_mean
from hil.campaign.stand_ins import OWN
from hil.config.bench import Bench
from hil.config.sweep import Sweep, check_sweep_against_bench
from hil.design.budget.sources import Scene, Source, sources, stated_by
from hil.design.conditions import planned_conditions
from hil.design.visibility.map import base_values
from hil.errors import InputError
from hil.files.document import plain
from hil.model import Model, fitting_conditions, load_model
from hil.model.effects.base import Base
from hil.model.effects.geometry import local_frame
from hil.model.forms import LinearForm, default_form
from hil.solve.precision import stated_noise
from hil.solve.repeats import SensorRepeats
from hil.solve.runs import solve_rates
from hil.solve.temperatures import level_degC, told_by
from hil.solve.wrong_rows import treated
from procedures.plan import make_plan
from procedures.settings import Restabilisation

_SAME_G = 0.05  # g: an orientation of the bench file is a collect's where gravity lies along the same axes to this

MEASURED = "measured standard errors"
_OR_MODEL = "standard errors, or the noise of the model where none are stated"
_EXACT = 1e-9  # deg/hr: residuals of rates that a model made are rounding
_LARGEST_NOISE = 1e9  # deg/hr: an average with more is none

_NOT_LYING = "how the sensor lay is not known (name its bench with --bench)"
_NO_NORTH = "the earth rate that is given (w) tells no north, so that nobody knows how wrong it is"
_NOT_GIVEN = "no earth rate is given (w is 0): what there is of it stands in the parameters, and in no ±"
_SLOPE = "dTdt_degC_per_min"
_UNIFORM = 1.0 / np.sqrt(3.0)  # standard deviation of what may be anything within ±1


@dataclass(frozen=True)
class RunScene:
    """A scene with its run, its sources, the model whose parameters are asked for, and what `base` is.

    `at` is the run's temperature, °C, and whose it is (`hil.solve.temperatures`); `left_out` has the titles of the
    sources that cannot be reckoned with, each with why.
    """

    run: int
    scene: Scene
    sources: tuple[Source, ...]
    form: LinearForm
    base_origin: str
    at: tuple[float | None, str | None]
    left_out: Mapping[str, str] = field(default_factory=dict)


def planned_scenes(sweep: Sweep, bench: Bench, model: Model | None = None) -> dict[int, list[RunScene]]:
    """Return the runs of each sensor as the files plan them; raises `InputError` where they do not fit together."""
    check_sweep_against_bench(sweep, bench)
    planned, stating = planned_conditions(make_plan(sweep.procedure()), bench), model
    if model is not None:
        model = fitting_conditions(model, [*planned.values()])
    elif bench.simulation_model:
        model = load_model(bench.simulation_model)
    limit = sweep.restabilisation.unit_slope_degC_per_min
    walk = bench.uncertainties.angle_random_walk
    stated = "bench file's" if "angle_random_walk" in bench.uncertainties.model_fields_set else "default"
    given = sources(
        bench.uncertainties,
        bench.name,
        limit * _UNIFORM,
        f"within the sweep's unit_slope, ±{limit:g} °C/min",
        f"{stated} angle_random_walk {walk:g} deg/√hr over the collect",
    )
    found: dict[int, list[RunScene]] = {}
    for number, conditions in planned.items():
        sigma = bench.uncertainties.of_collects(conditions)
        if np.any(sigma > _LARGEST_NOISE):
            raise InputError(f"{sweep.source}: collect.duration: {conditions.duration_s.min():g} s averages no noise")
        axes = np.array([bench.sensors[number].built[label].axes for label in conditions.position])
        form = default_form(conditions.rows(conditions.run == conditions.run[0]))
        found[number], every = [], given + stated_by(stating, conditions, measured=False)
        for run, here in conditions.of_each_run.items():
            base, origin = _base(conditions.rows(here), model)
            scene = Scene(conditions.rows(here), axes[here], base, sigma[here])
            found[number].append(RunScene(run, scene, every, form, origin, _at(conditions, here)))
    return found


def measured_scenes(
    campaign: Campaign, bench: Bench, shown: Mapping[int, SensorRepeats], model: Model | None = None
) -> dict[int, list[RunScene]]:
    """Return the runs of each sensor as they were measured, by the rates that `hil solve` solves, as noisy as it finds.

    `shown` is what repeats show. Runs that FAIL by their own records, which are in no mean, are left out.
    """
    used = treated(campaign).sensors
    return {number: list(_measured_runs(rows, bench, shown.get(number), model)) for number, rows in used.items()}


def _measured_runs(
    collects: Collects, bench: Bench, shown: SensorRepeats | None, model: Model | None
) -> Iterator[RunScene]:
    usual = f"angle_random_walk {bench.uncertainties.angle_random_walk:g} deg/√hr over the collect"
    measured = collects.rows(~np.all(np.isnan(collects.rates_deg_per_hr), axis=1))
    for run, here in measured.conditions.of_each_run.items():
        rows = measured.rows(here)
        conditions = rows.conditions
        form = default_form(conditions)
        stated = stated_noise(rows)
        by_errors = _OR_MODEL if model is not None and conditions.sensor.number in model.noise else MEASURED
        sigma, noise_by = (
            (bench.uncertainties.of_collects(conditions), usual) if stated is None else (stated, by_errors)
        )
        noisy: FloatArray | float = 1.0
        if shown is not None and not shown.stated and np.all(shown.left.deg_per_hr > _EXACT):
            sigma, noisy = np.ones(sigma.shape), shown.left.deg_per_hr  # all weigh alike
            noise_by = f"{shown.left.by} of all runs; no errors are stated"
        elif shown is not None:
            noisy, noise_by = shown.noise_times, shown.noise_by(noise_by)
        given = sources(bench.uncertainties, bench.name, *_slope(conditions), noise_by)
        given += stated_by(model, conditions, measured=True)
        base, origin = _base(conditions, model) if model is not None else _solved(rows, form)
        axes = _axes(conditions, bench)
        north = bool(np.any(local_frame(conditions).north))
        no_north = _NO_NORTH if np.any(conditions.w_deg_per_hr) else _NOT_GIVEN
        why_not = {
            each: no_north if each.needs_north and not north else _NOT_LYING * (each.needs_axes and axes is None)
            for each in given
        }
        usable = tuple(each for each, why in why_not.items() if not why)
        lying = np.broadcast_to(np.eye(3), (len(conditions), 3, 3)) if axes is None else axes
        sigma = np.where(np.isnan(rows.rates_deg_per_hr), np.nan, sigma)
        scene = Scene(conditions, lying, base, sigma, noisy)
        left_out = {each.title: why for each, why in why_not.items() if why}
        yield RunScene(run, scene, usable, form, origin, _at(measured.conditions, here), left_out)


def _at(conditions: Conditions, here: IntArray) -> tuple[float | None, str | None]:
    """Return the mean temperature of some of a sensor's collects, (k,), None where unknown, and whose it is."""
    level = level_degC(conditions)
    return None if level is None else plain(known_mean(level[here])), told_by(conditions)


def _base(conditions: Conditions, model: Model | None) -> tuple[Base, str]:
    if model is not None and model.has_values(conditions.sensor):
        return base_values(conditions, model), model.title
    return base_values(conditions, None), "typical of such a sensor"


def _solved(rows: Collects, form: LinearForm) -> tuple[Base, str]:
    """Return the base that this run was solved for, else a typical one."""
    conditions = rows.conditions
    rates = rows.rates_deg_per_hr - conditions.w_channels_deg_per_hr
    values = solve_rates(form.columns(conditions), rates, 1.0).values
    if np.any(np.isnan(values)):
        return _base(conditions, None)
    bias, k = form.terms(conditions, values)
    return Base(bias, k, rows.rates_deg_per_hr), "as solved from this run"


def _slope(conditions: Conditions) -> tuple[float, str]:
    """Return how fast the temperature still changed in a run, °C/min: as recorded, else as the usual criterion allows.

    Or by the line through the unit's own thermometer where that is more: readings of a few minutes do not tell less.
    """
    recorded, shown = (conditions.columns.get(name, np.full(len(conditions), np.nan)) for name in (_SLOPE, OWN))
    if np.any(np.isfinite(recorded)):
        return float(np.sqrt(np.nanmean(recorded**2))), f"as measured, {_SLOPE}"
    limit, known = Restabilisation().unit_slope_degC_per_min, np.isfinite(shown)
    minutes = (conditions.start_s[known] - conditions.start_s.mean()) / 60.0
    line = np.stack([np.ones_like(minutes), minutes], axis=1)
    slope = abs(float(np.linalg.lstsq(line, shown[known], rcond=1e-9)[0][1]))
    if slope > limit * _UNIFORM:
        return slope, f"as {OWN} went through the run"
    return limit * _UNIFORM, f"not measured; within ±{limit:g} °C/min"


def _axes(conditions: Conditions, bench: Bench) -> FloatArray | None:
    """Return the sensor's axes in the bench frame: the bench file's where it is that bench, else up, north and east.

    None where neither is known: positions of another bench, and no earth rate given.
    """
    number = conditions.sensor.number
    known = bench.sensors[number].built if number in bench.sensors else {}
    if all(label in known for label in conditions.position):
        axes = np.array([known[label].axes for label in conditions.position])
        gravity = np.einsum("nab,na->nb", axes, conditions.f_g)
        if np.all(np.abs(gravity - gravity.mean(axis=0)) < _SAME_G):
            return axes
    frame = local_frame(conditions)
    if not np.all(np.any(frame.north != 0.0, axis=1)):
        return None
    return np.stack([frame.up, frame.north, frame.east], axis=-1)
