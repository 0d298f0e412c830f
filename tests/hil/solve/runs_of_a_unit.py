"""Campaigns of collects 1-2-3 of one unit, whose bias and MU scatter from run to run, and changes to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.campaign import Campaign, Collects, Conditions, FloatArray, Sensor
from hil.campaign.plausibility import judged_by_its_records
from hil.model.earth import Site

F_G = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
K = np.array([[58.0, -20.0, 5.0], [20.0, 58.0, 9.0]])
SITE = Site(34.6, 30.0)


def campaign(runs: int = 9, per_temperature: int = 3, seed: int = 0, scatter: float = 3.0) -> Campaign:
    """Return a campaign of collects 1-2-3 whose bias and MU scatter from run to run, with accelerometers."""
    rng = np.random.default_rng(seed)
    n = 3 * runs
    run = np.repeat(np.arange(1, runs + 1), 3)
    temperature = 20.0 * ((run - 1) // per_temperature) - 20.0
    f = np.tile(F_G, (runs, 1))
    w1, w2, w3 = SITE.earth_rate_deg_per_hr()
    w = np.tile([[-w1, w2, w3], [w1, w2, -w3], [w3, w2, w1]], (runs, 1))
    bias = np.stack([30.0 + 0.5 * temperature, -20.0 + 0.3 * temperature], 1)
    bias += np.repeat(rng.normal(0.0, scatter, (runs, 2)), 3, axis=0)
    rates = bias + f @ K.T + w[:, :2] + rng.normal(0.0, 0.7, (n, 2))
    columns = {f"accelerometer_{axis}_g": f[:, i] + rng.normal(0.0, 0.003, n) for i, axis in enumerate("ABS")}
    columns |= {"temperature_degC": temperature + 8.0, "setpoint_degC": temperature, "chamber_degC": temperature + 0.1}
    columns["time_since_setpoint_s"] = np.full(n, 3600.0)
    conditions = Conditions(
        Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"}),
        np.arange(1, n + 1),
        run,
        np.tile(["1", "2", "3"], runs),
        600.0 * np.arange(n),
        np.full(n, 60.0),
        f,
        w,
        columns,
    )
    rows = Collects(conditions, rates, np.full((n, 2), 0.7))
    return Campaign("made", "", {2: rows}, site={"latitude_deg": 34.6})


def up_and_down(seed: int, scatter: float = 3.0) -> Campaign:
    """Return ten runs, two of a visit, at 0, 25, 50, 25 and 0 °C."""
    one = campaign(10, 2, seed, scatter)
    rows, of = one.sensors[2], one.sensors[2].conditions
    here = np.array([0.0, 25.0, 50.0, 25.0, 0.0])[(of.run - 1) // 2]
    rates = rows.rates_deg_per_hr + np.outer(here - of.columns["setpoint_degC"], [0.5, 0.3])
    columns = {**of.columns, "setpoint_degC": here, "temperature_degC": here + 8.0, "chamber_degC": here + 0.1}
    return replace(one, sensors={2: replace(rows, conditions=replace(of, columns=columns), rates_deg_per_hr=rates)})


def with_rates(one: Campaign, rates: FloatArray, number: int = 2) -> Campaign:
    """Return the campaign with other rates of a sensor."""
    return replace(one, sensors={**one.sensors, number: replace(one.sensors[number], rates_deg_per_hr=rates)})


def with_column(one: Campaign, **columns: FloatArray) -> Campaign:
    """Return the campaign with other columns, judged by its records as a reader does."""
    rows = one.sensors[2]
    conditions = replace(rows.conditions, columns={**rows.conditions.columns, **columns})
    return judged_by_its_records(replace(one, sensors={2: replace(rows, conditions=conditions)}))


def repeated(runs: int, per_temperature: int, order: tuple[int, ...], seed: int = 0, drift: float = 0.0) -> Campaign:
    """Return a campaign of collects in another `order`; the bias moves by `drift` deg/hr from each to the next.

    Positions 4 to 6 are 1 to 3 under another label.
    """
    made, k = campaign(runs, per_temperature, seed, scatter=0.0).sensors[2], len(order)
    own = np.add.outer(3 * np.arange(runs), np.mod(order, 3)).reshape(-1)
    rows, place = made.rows(own), np.tile(np.arange(k), runs)
    rng = np.random.default_rng(seed)
    rates = rows.rates_deg_per_hr + drift * place[:, None] + rng.normal(0.0, 0.7, (k * runs, 2))
    number = np.arange(k * runs)
    position = np.tile([str(each + 1) for each in order], runs)
    conditions = replace(rows.conditions, collect=number + 1, start_s=600.0 * number, position=position)
    return Campaign("made", "", {2: Collects(conditions, rates, np.ones_like(rates))})
