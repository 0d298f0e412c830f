"""Campaigns with known truth: parameters along given curves, white noise and run-to-run scatter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hil.campaign import Campaign, Collects, Conditions, Sensor
from hil.model.equation import RD_GC_86_1_SENSOR_2
from hil.model.forms import matrix_6_form, triad_12_form

Curve = Callable[[np.ndarray], np.ndarray]
PUBLISHED_DEGC = (-29.7, -14.4, -6.8, 6.3, 23.4, 37.8, 48.9, 60.0)
ROTOR = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})
TRIAD = Sensor(1, ("X", "Y", "Z"), {"GX": "X", "GY": "Y", "GZ": "Z"})
RUN_TO_RUN = {"BA": 1.8, "BB": 4.3, "MUA": 3.74, "MUB": 3.95}  # the shipped truth's
WHITE = 0.93
G = np.array([0.9999, 0.001, -0.016])


def scaled(temperature_degC: np.ndarray) -> np.ndarray:
    """Return the temperature on -1 … 1 over the published range."""
    return (temperature_degC - 15.15) / 44.85


def rotor_night(
    rng: np.random.Generator,
    curves: Mapping[str, Curve],
    *,
    temperatures_degC: Sequence[float] = PUBLISHED_DEGC,
    runs: int = 3,
    run_to_run: Mapping[str, float] = RUN_TO_RUN,
    white: float = WHITE,
    hysteresis: Mapping[str, float] | None = None,
    positions: Sequence[str] = ("1", "2", "3"),
) -> Campaign:
    """Return the published sequence at temperatures in the order visited; parameters without a curve are zero.

    `hysteresis` adds half of its value where a temperature was reached from below, and takes half off from above.
    """
    count = len(temperatures_degC) * runs
    run = np.repeat(np.arange(1, count + 1), len(positions))
    setpoint = np.repeat(np.asarray(temperatures_degC, dtype=np.float64), len(positions) * runs)
    position = np.tile(positions, count)
    f_g = np.array([RD_GC_86_1_SENSOR_2[label].components(G) for label in position])
    temperature = setpoint + rng.normal(0.0, 0.1, len(run))
    conditions = _conditions(ROTOR, run, position, f_g, temperature)
    values = _values(matrix_6_form(ROTOR).names, curves, temperature)
    before = np.concatenate([[np.nan], np.asarray(temperatures_degC, dtype=np.float64)[:-1]])
    came = np.repeat(np.nan_to_num(np.sign(np.asarray(temperatures_degC) - before)), len(positions) * runs)
    for place, name in enumerate(matrix_6_form(ROTOR).names):
        values[:, place] += rng.normal(0.0, run_to_run.get(name, 0.0), count + 1)[run]
        values[:, place] += 0.5 * came * (hysteresis or {}).get(name, 0.0)
    rates = np.einsum("ncp,np->nc", matrix_6_form(ROTOR).columns(conditions), values)
    rates += rng.normal(0.0, white, rates.shape)
    return campaign(Collects(conditions, rates, np.full(rates.shape, white)))


def triad_night(rng: np.random.Generator, curves: Mapping[str, Curve], white: float = 2.0) -> Campaign:
    """Return six poses at each of the published temperatures for a three-axis triad."""
    poses = np.concatenate([np.eye(3), -np.eye(3)])
    run = np.repeat(np.arange(1, 17), 6)
    temperature = np.repeat(np.repeat(PUBLISHED_DEGC, 2), 6) + rng.normal(0.0, 0.1, len(run))
    position = np.tile([f"pose-{place}" for place in range(6)], 16)
    conditions = _conditions(TRIAD, run, position, np.tile(poses, (16, 1)), temperature)
    values = _values(triad_12_form(TRIAD).names, curves, temperature)
    rates = np.einsum("ncp,np->nc", triad_12_form(TRIAD).columns(conditions), values)
    rates += rng.normal(0.0, white, rates.shape)
    return campaign(Collects(conditions, rates, np.full(rates.shape, white)))


def campaign(collects: Collects) -> Campaign:
    """Wrap one sensor's collects."""
    return Campaign("a night", "simulated for a test", {collects.conditions.sensor.number: collects}, simulated=True)


def _conditions(
    sensor: Sensor, run: np.ndarray, position: np.ndarray, f_g: np.ndarray, temperature: np.ndarray
) -> Conditions:
    n = len(run)
    columns = {"temperature_degC": temperature}
    start_s = 3600.0 * run + 120.0 * np.arange(n)
    return Conditions(
        sensor, np.arange(1, n + 1), run, position, start_s, np.full(n, 60.0), f_g, np.zeros((n, 3)), columns
    )


def _values(names: Sequence[str], curves: Mapping[str, Curve], temperature: np.ndarray) -> np.ndarray:
    zero = np.zeros_like(temperature)
    return np.stack([curves[name](temperature) + zero if name in curves else zero for name in names], -1)
