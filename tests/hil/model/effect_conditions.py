"""Conditions of invented campaigns for the tests of the catalogue: the report's orientations, and a triad's poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.campaign import Conditions, FloatArray, Sensor
from hil.model.effects.base import Base
from hil.model.equation import RD_GC_86_1_SENSOR_2, Orientation

ROTOR = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})
TRIAD = Sensor(1, ("X", "Y", "Z"), {"GX": "X", "GY": "Y", "GZ": "Z"})
POSITIONS = {**RD_GC_86_1_SENSOR_2, "4": Orientation.from_signed_axes("4", "-3", "+2", "-1")}
LEVEL = (1.0, 0.0, 0.0)
W = (8.54, 10.7, 6.2)
TEMPERATURES = (-29.7, -14.4, -6.8, 6.3, 23.4, 37.8, 48.9, 60.0)


def power_cycled(conditions: Conditions) -> Conditions:
    """The same collects with the power taken away before each change of the chamber's temperature."""
    plateau = conditions.columns["chamber_degC"]
    first = np.array([conditions.start_s[plateau == t].min() for t in plateau])
    return replace(conditions, columns={**conditions.columns, "time_since_power_on_s": conditions.start_s - first})


def campaign(
    positions: Sequence[str] = ("1", "2", "3"),
    temperatures: Sequence[float] = TEMPERATURES,
    runs_each: int = 3,
    g: Sequence[float] = LEVEL,
    w: Sequence[float] = W,
    soak_s: float = 2700.0,
    every_column: bool = True,
) -> Conditions:
    """Return the conditions of a rotor sensor's sweep, with every condition column that an effect may need."""
    rng = np.random.default_rng(86)
    order = [(t, run) for t in range(len(temperatures)) for run in range(runs_each)]
    run = np.repeat(np.arange(1, len(order) + 1), len(positions))
    plateau = np.repeat([t for t, _ in order], len(positions))
    within = np.tile(np.arange(len(positions)), len(order))
    start = 100.0 + run * soak_s + (run * len(positions) + within) * 120.0
    since_setpoint = np.concatenate(
        [start[plateau == t] - start[plateau == t][0] + soak_s for t in range(len(temperatures))]
    )
    label = np.tile(np.array(positions), len(order))
    temperature = np.array(temperatures)[plateau] + np.exp(-since_setpoint / 1800.0)
    n = len(run)
    columns = {
        "temperature_degC": temperature,
        "dTdt_degC_per_min": 0.1 * np.exp(-since_setpoint / 1800.0) * np.where(plateau % 2, -1.0, 1.0),
        "case_degC": temperature - 3.0 + 0.2 * rng.standard_normal(n),
        "chamber_degC": np.array(temperatures)[plateau],
        "setpoint_degC": np.array(temperatures)[plateau],
        "time_since_power_on_s": start - 50.0,
        "time_since_setpoint_s": since_setpoint,
        "time_since_index_s": 20.0 + 2.0 * rng.random(n),
        "supply_V": 28.0 + 0.2 * rng.standard_normal(n),
        "spin_period_us": 10000.0 + rng.standard_normal(n),
        "vibration_rms_g": 0.05 + 0.02 * rng.random(n),
    }
    return Conditions(
        ROTOR,
        collect=np.arange(1, n + 1),
        run=run,
        position=label,
        start_s=start,
        duration_s=np.full(n, 60.0),
        f_g=np.array([POSITIONS[name].components(g) for name in label]),
        w_deg_per_hr=np.array([POSITIONS[name].components(w) for name in label]),
        columns=columns if every_column else {},
    )


def one_run(positions: Sequence[str] = ("1", "2", "3"), g: Sequence[float] = LEVEL) -> Conditions:
    """Return a single run at 20 °C."""
    return campaign(positions, temperatures=(20.0,), runs_each=1, g=g)


def triad_poses(count: int = 24, every_column: bool = True) -> Conditions:
    """Return a three-axis triad in poses of every direction, all in one run."""
    rng = np.random.default_rng(24)
    f = rng.standard_normal((count, 3))
    f /= np.linalg.norm(f, axis=1, keepdims=True)
    w = rng.standard_normal((count, 3))
    start = 100.0 * np.arange(count)
    columns = {"temperature_degC": 25.0 + 0.01 * start, "time_since_index_s": np.full(count, 30.0)}
    return Conditions(
        TRIAD,
        collect=np.arange(1, count + 1),
        run=np.ones(count, dtype=np.int64),
        position=np.array([f"pose-{index:02d}" for index in range(count)]),
        start_s=start,
        duration_s=np.full(count, 60.0),
        f_g=f,
        w_deg_per_hr=10.0 * w / np.linalg.norm(w, axis=1, keepdims=True),
        columns=columns if every_column else {},
    )


TERMS = {"BA": 22.0, "BB": -38.0, "GSA": 60.0, "GSB": -25.0, "MUA": -37.0, "MUB": -7.5}


def rotor_base(conditions: Conditions, slopes: bool = True) -> Base:
    """Return the base of a rotor sensor with the terms above, and slopes by temperature."""
    t = TERMS
    rows = len(conditions)
    k = np.array([[t["GSA"], t["GSB"], t["MUB"]], [-t["GSB"], t["GSA"], -t["MUA"]]])
    bias, k = np.tile([t["BA"], t["BB"]], (rows, 1)), np.tile(k, (rows, 1, 1))
    rates = bias + np.einsum("nca,na->nc", k, conditions.f_g) + conditions.w_channels_deg_per_hr
    if not slopes:
        return Base(bias, k, rates)
    return Base(bias, k, rates, np.tile([-0.22, 0.85], (rows, 1)), 0.002 * k)


def triad_base(conditions: Conditions) -> Base:
    """Return the base of a triad with a full sensitivity matrix."""
    rows = len(conditions)
    k = np.tile(np.arange(9.0).reshape(3, 3) - 4.0, (rows, 1, 1))
    bias = np.tile([100.0, -50.0, 20.0], (rows, 1))
    rates = bias + np.einsum("nca,na->nc", k, conditions.f_g) + conditions.w_channels_deg_per_hr
    return Base(bias, k, rates, np.full_like(bias, 0.5), np.zeros_like(k))


def moved(columns: FloatArray, values: Sequence[float]) -> FloatArray:
    """Return what parameters of these sizes add to the rates, (n, c)."""
    return np.asarray(columns @ np.array(values))


def of_each_position(conditions: Conditions) -> FloatArray:
    """Rates that are the same whenever a position is taken again."""
    return np.unique(conditions.position, return_inverse=True)[1][:, None] + np.array([1.0, 2.0])
