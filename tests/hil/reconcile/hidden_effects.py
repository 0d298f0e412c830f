"""Campaigns with something hidden in them, written from the physics in plain numpy: nothing of the catalogue is used.

A night of the report's sensor: eight temperatures (or fewer), three runs at each, collects at index angles -90, +90, 0
(and 180) degrees, white noise and run-to-run bias. What is hidden is added by the test, as a function of the rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hil.campaign import Campaign, Collects, Conditions, Sensor

ROTOR = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})
TRIAD = Sensor(1, ("X", "Y", "Z"), {"GX": "X", "GY": "Y", "GZ": "Z"})
EIGHT = (-29.7, -14.4, -6.8, 6.3, 23.4, 37.8, 48.9, 60.0)
ANGLES = {"1": -90.0, "2": 90.0, "3": 0.0, "4": 180.0}


@dataclass
class Rows:
    """The rows of a night, before the rates: everything has shape (n,), `f` and `w` (n, 3)."""

    run: np.ndarray
    order: np.ndarray
    position: np.ndarray
    start_s: np.ndarray
    temperature: np.ndarray
    setpoint: np.ndarray
    slope: np.ndarray
    since_setpoint_s: np.ndarray
    supply: np.ndarray
    heading: np.ndarray
    f: np.ndarray
    w: np.ndarray

    def __len__(self) -> int:
        return len(self.run)


Hidden = Callable[[Rows], np.ndarray]


def lay_out(
    rng: np.random.Generator,
    temperatures: tuple[float, ...] = EIGHT,
    runs_each: int = 2,
    positions: tuple[str, ...] = ("1", "2", "3", "4"),
    headings: tuple[float, ...] = (30.0,),
) -> Rows:
    """Lay out the collects of a night, chronologically."""
    rows: list[tuple[float, ...]] = []
    labels: list[str] = []
    clock, run, before = 0.0, 0, 20.0
    for setpoint in temperatures:
        clock += 600.0
        reached = clock
        for _ in range(runs_each):
            run += 1
            clock += 2700.0
            for order, label in enumerate(positions):
                clock += 90.0
                left = (before - setpoint) * np.exp(-(clock - reached) / 1300.0)
                heading = headings[(run - 1) % len(headings)]
                rows.append(
                    (run, order, clock, setpoint, setpoint + left, -left / 1300.0 * 60.0, clock - reached, heading)
                )
                labels.append(label)
        before = setpoint
    run_, order_, start, set_, temperature, slope, since, heading = np.array(rows).T
    theta = np.deg2rad([ANGLES[label] for label in labels])
    g = np.array([np.sqrt(1 - 0.001**2 - 0.016**2), 0.001, -0.016])
    north, down = 15.041067 * np.cos(np.deg2rad(34.6)), 15.041067 * np.sin(np.deg2rad(34.6))
    h = np.deg2rad(heading)
    supply = 28.0 + rng.normal(0.0, 0.15, run + 1)[run_.astype(int)]

    def turned(v1: np.ndarray, v2: np.ndarray, v3: np.ndarray) -> np.ndarray:
        return np.stack([v1 * np.sin(theta) + v3 * np.cos(theta), v2, v1 * np.cos(theta) - v3 * np.sin(theta)], 1)

    one = np.ones(len(theta))
    return Rows(
        run_.astype(int),
        order_.astype(int),
        np.array(labels),
        start,
        temperature,
        set_,
        slope,
        since,
        supply,
        heading,
        turned(g[0] * one, g[1] * one, g[2] * one),
        turned(down * one, north * np.cos(h), north * np.sin(h)),
    )


def base_rates(rows: Rows, *, thermal: bool = True, mu: bool = True) -> np.ndarray:
    """R = B + K f + w of a plausible unit; quadratic in temperature where `thermal`."""
    t = (rows.temperature - 20.0) / 40.0 * (1.0 if thermal else 0.0)
    ba, bb = 20.0 - 6.0 * t + 2.0 * t**2, -5.0 + 25.0 * t - 4.0 * t**2
    gsa, gsb = 60.0 + 9.0 * t, -25.0 - 4.0 * t + t**2
    mua, mub = (6.0 + 9.0 * t - 5.0 * t**2, -9.0 + 5.0 * t + 3.0 * t**2) if mu else (0.0 * t, 0.0 * t)
    fa, fb, fs = rows.f.T
    ra = ba + gsa * fa + gsb * fb + mub * fs + rows.w[:, 0]
    rb = bb - gsb * fa + gsa * fb - mua * fs + rows.w[:, 1]
    return np.stack([ra, rb], 1)


def noise(
    rows: Rows, rng: np.random.Generator, *, sigma: float = 0.9, run_bias: float = 1.3, rho: float = 0.6
) -> np.ndarray:
    """White noise per collect and an AR(1) bias per run, each channel its own."""
    level = np.zeros((rows.run.max() + 1, 2))
    level[0] = rng.normal(size=2) * run_bias
    for k in range(1, len(level)):
        level[k] = rho * level[k - 1] + np.sqrt(1 - rho**2) * run_bias * rng.normal(size=2)
    return sigma * rng.normal(size=(len(rows), 2)) + level[rows.run]


def campaign_of(rows: Rows, rates: np.ndarray, *, stated: float | None = 0.9, conditions: bool = True) -> Campaign:
    """Make a campaign of rows and rates; `stated` is the standard error in the file."""
    columns = {}
    if conditions:
        columns = {
            "temperature_degC": rows.temperature,
            "setpoint_degC": rows.setpoint,
            "dTdt_degC_per_min": rows.slope,
            "time_since_setpoint_s": rows.since_setpoint_s,
            "time_since_power_on_s": rows.start_s,
            "supply_V": rows.supply,
        }
    known = Conditions(
        ROTOR,
        np.arange(1, len(rows) + 1),
        rows.run,
        rows.position.astype(str),
        rows.start_s,
        np.full(len(rows), 60.0),
        rows.f,
        rows.w,
        columns,
    )
    errors = np.full(rates.shape, np.nan if stated is None else stated)
    return Campaign("hidden", "test, simulated", {2: Collects(known, rates, errors)}, simulated=True)


def hidden_campaign(
    seed: int,
    hidden: Hidden | None = None,
    *,
    thermal: bool = True,
    mu: bool = True,
    quiet: float = 1.0,
    **layout: object,
) -> Campaign:
    """Make a campaign with `hidden` (rows to (n, 2) deg/hr) added to the base and the noise (scaled by `quiet`)."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, **layout)  # type: ignore[arg-type]
    rates = base_rates(rows, thermal=thermal, mu=mu) + quiet * noise(rows, rng)
    if hidden is not None:
        rates = rates + hidden(rows)
    return campaign_of(rows, rates)


def both(column: np.ndarray, a: float, b: float) -> np.ndarray:
    """The same history on both channels with sizes of their own."""
    return np.stack([a * column, b * column], 1)
