"""Small campaigns of every kind, as folders: good, bad rows, short soaks, one run, one temperature, triads, Table 1."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from hil.analysis.published.table import read_published_table
from hil.campaign import Campaign, Collects, Conditions
from hil.campaign.plausibility import judged_by_its_records
from hil.campaign.reader import read_campaign
from hil.campaign.writer import write_campaign
from tests.hil.analysis.thermal.nights import TRIAD, rotor_night
from tests.hil.solve.runs_of_a_unit import campaign, repeated, with_rates


def _changed(one: Campaign, rows: list[int], rates: np.ndarray) -> Campaign:
    changed = one.sensors[2].rates_deg_per_hr.copy()
    changed[rows] = rates
    return with_rates(one, changed)


def _good() -> Campaign:
    return campaign(12, 3, seed=1, scatter=2.0)


def _exchanged() -> Campaign:
    one = _good()
    return _changed(one, [12, 13], one.sensors[2].rates_deg_per_hr[[13, 12]])


def _exchanged_first(runs: int) -> Campaign:
    """One temperature: in run 1 collects 1 and 2, of three runs known by the others, of two not."""
    one = campaign(runs, runs, seed=8, scatter=2.0)
    return _changed(one, [0, 1], one.sensors[2].rates_deg_per_hr[[1, 0]])


def _exchanged_of_one_run() -> Campaign:
    """There and back in one run, of which collects 1 and 4 stand under each other's labels."""
    one = repeated(1, 1, (0, 2, 5, 1, 5, 2, 0), seed=3)
    return _changed(one, [0, 3], one.sensors[2].rates_deg_per_hr[[3, 0]])


def _exchanged_of_two_and_two() -> Campaign:
    """Two runs at each of two temperatures, collects 1 and 2 of the first exchanged."""
    one = campaign(4, 2, seed=1, scatter=2.0)
    return _changed(one, [0, 1], one.sensors[2].rates_deg_per_hr[[1, 0]])


def _mu_of_each_run() -> Campaign:
    """MU scatters from run to run by far more than anything else."""
    one = campaign(15, 3, seed=5, scatter=0.0)
    mu = np.random.default_rng(5).normal(0.0, 5.0, (15, 2))
    return _changed(one, list(range(2, 45, 3)), one.sensors[2].rates_deg_per_hr[2::3] + mu)


def _errors_too_small() -> Campaign:
    one = _good()
    return replace(one, sensors={2: replace(one.sensors[2], rates_se_deg_per_hr=np.full((36, 2), 0.2))})


def _exchanged_twice() -> Campaign:
    """In run 5 collects 1 and 2, in run 9 collects 2 and 3."""
    one = _exchanged()
    return _changed(one, [25, 26], one.sensors[2].rates_deg_per_hr[[26, 25]])


def _heavy() -> Campaign:
    """In run 5 f is 1.03 g."""
    one = _good()
    conditions = one.sensors[2].conditions
    f_g = conditions.f_g * np.where(conditions.run == 5, 1.03, 1.0)[:, None]
    return replace(one, sensors={2: replace(one.sensors[2], conditions=replace(conditions, f_g=f_g))})


def _far_off() -> Campaign:
    one = _good()
    return _changed(one, [14], one.sensors[2].rates_deg_per_hr[[14]] + [[0.0, 300.0]])


def _after_a_pause() -> Campaign:
    """Between runs 6 and 7 lie forty days, in which the bias went by 9 deg/hr: a jump, ageing, or a slow walk."""
    one = campaign(12, 3, seed=108, scatter=0.7)
    rows, later = one.sensors[2], np.arange(36) >= 18
    conditions = replace(rows.conditions, start_s=rows.conditions.start_s + 40.0 * 86400.0 * later)
    return replace(
        one,
        sensors={
            2: replace(rows, conditions=conditions, rates_deg_per_hr=rows.rates_deg_per_hr + 9.0 * later[:, None])
        },
    )


def _gaps() -> Campaign:
    """A collect of run 2 and a standard error of run 5 are missing, one of run 3 is huge, run 8 has no temperature."""
    one = _one_not_shown(8)
    errors, rates = _one_huge().sensors[2].rates_se_deg_per_hr.copy(), one.sensors[2].rates_deg_per_hr.copy()
    errors[13, 0] = rates[4] = np.nan
    return replace(one, sensors={2: replace(one.sensors[2], rates_deg_per_hr=rates, rates_se_deg_per_hr=errors)})


def _one_huge() -> Campaign:
    """One rate of run 3 is known to 300 deg/hr; it is as right as all others."""
    one = _good()
    errors = one.sensors[2].rates_se_deg_per_hr.copy()
    errors[7] = 300.0
    return replace(one, sensors={2: replace(one.sensors[2], rates_se_deg_per_hr=errors)})


def _no_errors(positions: tuple[int, ...] = (0, 1, 2, 1, 0)) -> Campaign:
    """Residuals of collects 1-2-3-2-1 say what noise is, or of 1-2-3 what runs differ by; in B it is more than in A."""
    one = repeated(9, 3, positions, seed=63)
    count = 9 * len(positions)
    noise = np.random.default_rng(9).normal(0.0, 3.0, (count, 1)) * [[0.0, 1.0]]
    one = with_rates(one, one.sensors[2].rates_deg_per_hr + noise)
    return replace(one, sensors={2: replace(one.sensors[2], rates_se_deg_per_hr=np.full((count, 2), np.nan))})


def _chamber_alone() -> Campaign:
    """Of temperatures the chamber's alone is recorded, and of standard errors those of channel A."""
    rows = _good().sensors[2]
    columns = {n: of for n, of in rows.conditions.columns.items() if n not in ("temperature_degC", "setpoint_degC")}
    errors = rows.rates_se_deg_per_hr * [1.0, np.nan]
    rows = replace(rows, conditions=replace(rows.conditions, columns=columns), rates_se_deg_per_hr=errors)
    return replace(_good(), sensors={2: rows})


def _contradicted() -> Campaign:
    """In run 6 the unit lay otherwise than its labels say, by its own accelerometers, and its bias was another."""
    one = _good()
    columns, rates = one.sensors[2].conditions.columns, one.sensors[2].rates_deg_per_hr.copy()
    shown, rates[15:18] = columns["accelerometer_A_g"].copy(), np.add(rates[15:18], [6.0, -5.0])
    shown[15:17] *= -1.0
    conditions = replace(one.sensors[2].conditions, columns={**columns, "accelerometer_A_g": shown})
    return replace(one, sensors={2: replace(one.sensors[2], rates_deg_per_hr=rates, conditions=conditions)})


def _short_soaks() -> Campaign:
    """The unit's own thermometer still falls by 10 °C through the runs of each setpoint."""
    one = _good()
    conditions = one.sensors[2].conditions
    late = 10.0 * np.exp(-0.35 * (np.arange(36) % 9))
    columns = {**conditions.columns, "temperature_degC": conditions.columns["setpoint_degC"] + late}
    return replace(one, sensors={2: replace(one.sensors[2], conditions=replace(conditions, columns=columns))})


def _one_not_shown(run: int = 5) -> Campaign:
    """The unit's own thermometer was silent through one run."""
    one = _good()
    conditions = one.sensors[2].conditions
    shown = np.where(conditions.run == run, np.nan, conditions.columns["temperature_degC"])
    conditions = replace(conditions, columns={**conditions.columns, "temperature_degC": shown})
    return replace(one, sensors={2: replace(one.sensors[2], conditions=conditions)})


def _no_thermometer() -> Campaign:
    """The unit has no thermometer of its own: the chamber's stands in for it."""
    one = _good()
    conditions = one.sensors[2].conditions
    columns = {name: of for name, of in conditions.columns.items() if name != "temperature_degC"}
    return replace(one, sensors={2: replace(one.sensors[2], conditions=replace(conditions, columns=columns))})


def _two_sensors() -> Campaign:
    one, other = _good(), campaign(12, 3, seed=2, scatter=2.0).sensors[2]
    layout = replace(other.conditions.sensor, number=1)
    first = replace(other, conditions=replace(other.conditions, sensor=layout))
    number = one.sensors[2].conditions.collect + len(first)
    second = replace(one.sensors[2], conditions=replace(one.sensors[2].conditions, collect=number))
    return replace(one, sensors={1: first, 2: second})


def _both_disturbed() -> Campaign:
    """What moves both sensors by the same in each run, far beyond what either does alone."""
    one, rng = _two_sensors(), np.random.default_rng(3)
    moved = np.repeat(rng.normal(0.0, 6.0, (12, 2)), 3, axis=0)
    for number, rows in one.sensors.items():
        one = with_rates(one, rows.rates_deg_per_hr + moved, number)
    return one


def _both_exchanged_and_another_bias() -> Campaign:
    """In both sensors labels of run 5 are exchanged, MU of sensor 1 scatters by 4, and run 9 has another bias."""
    one, rng = _two_sensors(), np.random.default_rng(13)
    for number, rows in one.sensors.items():
        rates = rows.rates_deg_per_hr.copy()
        rates[2::3] += rng.normal(0.0, 4.0 * (number == 1), (12, 2))
        rates[24:27] += 25.0
        rates[[12, 13]] = rates[[13, 12]]
        one = with_rates(one, rates, number)
    return one


def _one_noisy() -> Campaign:
    """Channel B scatters by three times what its standard errors say, channel A as they say."""
    one = campaign(12, 3, seed=11, scatter=0.5)
    noise = np.random.default_rng(9).normal(0.0, 0.7 * np.sqrt(8.0), (36, 1)) * [[0.0, 1.0]]
    return with_rates(one, one.sensors[2].rates_deg_per_hr + noise)


def _one_noisy_that_residuals_show() -> Campaign:
    """The same with collects 1-2-3-2-1: residuals tell which channel it is."""
    one = repeated(12, 3, (0, 1, 2, 1, 0), seed=4)
    noise = np.random.default_rng(9).normal(0.0, 4.0, (60, 1)) * [[0.0, 1.0]]
    return with_rates(one, one.sensors[2].rates_deg_per_hr + noise)


def _two_plans() -> Campaign:
    """Sensor 1 was measured at two temperatures only, sensor 2 at four."""
    both = _two_sensors()
    return replace(both, sensors={1: both.sensors[1].rows(both.sensors[1].conditions.run < 7), 2: both.sensors[2]})


def _exchanged_body() -> Campaign:
    """Collects 1 and 2 of run 5 stand under each other's labels in both sensors; sensor 1 is too noisy to prove it."""
    one, rng = _two_sensors(), np.random.default_rng(6)
    sensors = {}
    for number, rows in one.sensors.items():
        swapped = np.arange(len(rows))
        swapped[[12, 13]] = [13, 12]
        noise = rng.normal(0.0, 60.0 * (number == 1), rows.rates_deg_per_hr.shape)
        errors = np.maximum(rows.rates_se_deg_per_hr, 60.0 * (number == 1))
        shown = {name: of[swapped] if name.startswith("accel") else of for name, of in rows.conditions.columns.items()}
        conditions = replace(rows.conditions, columns=shown)
        sensors[number] = Collects(conditions, (rows.rates_deg_per_hr + noise)[swapped], errors)
    return judged_by_its_records(replace(one, sensors=sensors))


def _triad(wrong: bool = False) -> Campaign:
    """Twenty-four poses of a triad in one run; one of them in another pose than its row says."""
    rng = np.random.default_rng(4)
    f = rng.normal(size=(24, 3))
    f /= np.linalg.norm(f, axis=1, keepdims=True)
    rates = np.array([100.0, -50.0, 30.0]) + f @ rng.normal(0.0, 30.0, (3, 3)).T + rng.normal(0.0, 5.0, (24, 3))
    rates[16] += [350.0, -200.0, 150.0] if wrong else 0.0
    n = np.arange(24)
    labels = np.array([f"pose-{k}" for k in n])
    conditions = Conditions(
        TRIAD, n + 1, np.ones(24, dtype=np.int64), labels, 10.0 * n, np.full(24, 5.0), f, np.zeros((24, 3)), {}
    )
    return Campaign("poses", "", {1: Collects(conditions, rates, np.full((24, 3), 5.0))})


def _rotor_and_triad() -> Campaign:
    """One unit whose sensors are of two kinds: a triad in 24 poses, and a rotor sensor three times over."""
    one, other = _triad(), campaign(3, 3, seed=5, scatter=2.0).sensors[2]
    number = other.conditions.collect + len(one.sensors[1])
    return replace(
        one, sensors={**one.sensors, 2: replace(other, conditions=replace(other.conditions, collect=number))}
    )


def _one_run_far_off_beside_another_sensor() -> Campaign:
    """Four collects of two sensors, one rate of sensor 2 off by 300: the other sensor fits as well."""
    one, other = (repeated(1, 1, (0, 2, 5, 1), seed=seed).sensors[2] for seed in (0, 50))
    rates, layout = one.rates_deg_per_hr.copy(), replace(other.conditions.sensor, number=1)
    rates[1, 0] += 300.0
    conditions = replace(other.conditions, sensor=layout, collect=other.conditions.collect + len(one))
    first = Collects(conditions, 20.0 - 0.7 * other.rates_deg_per_hr[:, ::-1], other.rates_se_deg_per_hr)
    return Campaign("made", "", {1: first, 2: replace(one, rates_deg_per_hr=rates)})


def night_that_ended_early(seed: int = 2) -> Campaign:
    """Three runs at one temperature and one at another, where all parameters are others: no run is wrong."""
    at_0 = {"BA": 22.0, "BB": -14.0, "GSA": 55.0, "GSB": -22.5, "MUA": 6.0, "MUB": -13.0}
    slope = {"BA": -0.23, "BB": 1.2, "GSA": 0.21, "GSB": -0.085, "MUA": -0.05, "MUB": 0.4}
    curves = {name: lambda degC, name=name: at_0[name] + slope[name] * degC for name in at_0}
    scatter = {"BA": 0.5, "BB": 3.0, "MUA": 1.5, "MUB": 1.5}
    one = rotor_night(np.random.default_rng(seed), curves, temperatures_degC=(-10.0, 30.0), run_to_run=scatter)
    rows = one.sensors[2]
    return replace(one, sensors={2: rows.rows(rows.conditions.run < 5)})


def _dead(one: Campaign, number: int) -> Campaign:
    """The second channel of a sensor shows exactly 0 throughout."""
    alive = np.arange(one.sensors[number].rates_deg_per_hr.shape[1]) != 1
    return judged_by_its_records(with_rates(one, one.sensors[number].rates_deg_per_hr * alive, number))


def _clipped() -> Campaign:
    """Channel A shows no more than 40 deg/hr: the runs in which it stands there FAIL by that."""
    one = _good()
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[:, 0] = np.minimum(rates[:, 0], np.sort(rates[:, 0])[-5])
    return judged_by_its_records(with_rates(one, rates))


FOLDERS: dict[str, Callable[[], Campaign]] = {
    "good": _good,
    "labels exchanged": _exchanged,
    "labels exchanged in a body": _exchanged_body,
    "labels exchanged twice": _exchanged_twice,
    "labels exchanged, three runs": lambda: _exchanged_first(3),
    "labels exchanged, two runs": lambda: _exchanged_first(2),
    "labels exchanged, one run": _exchanged_of_one_run,
    "labels exchanged, two and two": _exchanged_of_two_and_two,
    "MU of each run": _mu_of_each_run,
    "drift through every run": lambda: repeated(12, 3, (0, 1, 2, 3, 4, 5, 0), drift=6.0),
    "position missing at one temperature": lambda: _changed(_good(), [2, 5, 8], np.full((3, 2), np.nan)),
    "standard errors too small": _errors_too_small,
    "one rate far off": _far_off,
    "f of another size": _heavy,
    "after a pause": _after_a_pause,
    "gaps": _gaps,
    "one standard error huge": _one_huge,
    "no standard errors": _no_errors,
    "no standard errors, three collects": lambda: _no_errors((0, 1, 2)),
    "the chamber's temperature alone, one channel without standard errors": _chamber_alone,
    "contradicted": _contradicted,
    "clipped": _clipped,
    "dead channel": lambda: _dead(_good(), 2),
    "poses, dead channel": lambda: _dead(_triad(), 1),
    "short soaks": _short_soaks,
    "one run without its thermometer": _one_not_shown,
    "no thermometer of its own": _no_thermometer,
    "two sensors": _two_sensors,
    "both sensors disturbed": _both_disturbed,
    "labels exchanged for both sensors, another bias": _both_exchanged_and_another_bias,
    "one channel noisy": _one_noisy,
    "one channel noisy, five collects": _one_noisy_that_residuals_show,
    "two plans": _two_plans,
    "one run": lambda: campaign(1, 1, seed=3),
    "one run, one rate far off, beside another sensor": _one_run_far_off_beside_another_sensor,
    "night that ended early": night_that_ended_early,
    "after a pause, simulated, not whole": lambda: replace(
        _after_a_pause(), simulated=True, missing=["self-calibration 13 at 40.0 °C: all of it"]
    ),
    "one temperature": lambda: campaign(8, 8, seed=5, scatter=2.0),
    "one temperature, three runs": lambda: campaign(3, 3, seed=5, scatter=2.0),
    "poses": _triad,
    "a rotor sensor and a triad": _rotor_and_triad,
    "poses, one wrong": lambda: _triad(wrong=True),
    "Table 1": lambda: read_published_table(Path("rd-gc-86-1-table-1")),
}

REAL = sorted((Path(__file__).parents[4] / "shared" / "data" / "campaigns").glob("*/campaign.*"))
"""Real logs, where they stand beside the checkout."""
LOGS = {path.parent.name: partial(read_campaign, path.parent) for path in REAL}
FOLDERS |= LOGS


def written(name: str, folder: Path) -> Path:
    """Write one of the campaigns as a folder and return it."""
    made = FOLDERS[name]()
    units = {column: "degC" for rows in made.sensors.values() for column in rows.conditions.columns if "degC" in column}
    write_campaign(replace(made, condition_units={**units, **made.condition_units}), folder)
    return folder
