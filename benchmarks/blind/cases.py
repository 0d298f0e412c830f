"""Sealed cases: a night, a unit, noise, hidden effects of a stated size; written as a campaign folder.

The size d of a hidden effect is its norm in units of the noise after the base model has been projected out: what is
left for anybody to see. The truth is returned, never written into the folder.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.blind.night import Design, Night, make_night
from benchmarks.blind.physics import CATALOGUE, OUTSIDE, Truth, make_truth

HIDDEN = {**CATALOGUE, **OUTSIDE}
AS_IT_IS = frozenset({"frame"})
"""Defects that have one size: they are not scaled to d."""
MISLABELLED = "swap"
"""Two collects of one run under each other's position: not a sum, so it is made last."""


@dataclass(frozen=True)
class Noise:
    """What the rates are covered with, deg/hr. `kind` names a departure from the plain case."""

    collect: float = 0.9
    run_bias: float = 1.35  # run-level, per axis
    rho: float = 0.6  # correlation of the run-level part from run to run
    kind: str = "plain"  # plain, white, heavy, walk, run_mu, cold, row_ar


@dataclass
class Case:
    """A campaign and what is hidden in it."""

    night: Night
    rates: np.ndarray  # (n, 2)
    se: np.ndarray  # (n, 2), as the file states it
    truth: Truth
    hidden: tuple[str, ...] = ()
    sizes: tuple[float, ...] = ()
    kept: tuple[float, ...] = ()  # share of the norm that the base leaves
    signals: tuple[np.ndarray, ...] = ()  # (n, 2) each


def base_columns(night: Night, model: str) -> np.ndarray:
    """Columns of the base model, rows RA then RB, shape (2n, p). Written here anew on purpose."""
    n, f = len(night), night.f
    zero, one = np.zeros(n), np.ones(n)
    pairs = {
        "BA": (one, zero),
        "BB": (zero, one),
        "GSA": (f[:, 0], f[:, 1]),
        "GSB": (f[:, 1], -f[:, 0]),
        "MUA": (zero, -f[:, 2]),
        "MUB": (f[:, 2], zero),
    }
    names = {"constant": ["BA", "BB"], "collins-4": ["BA", "BB", "GSA", "GSB"]}.get(model, list(pairs))
    columns = np.stack([np.concatenate(pairs[name]) for name in names], 1)
    if model != "matrix-6-thermal":
        return columns
    t = np.tile((night.rotor - 25.0) / 40.0, 2)[:, None]
    return np.hstack([columns, columns * t, columns * t**2])


def noise_covariance(night: Night, noise: Noise) -> np.ndarray:
    """Covariance of one axis, (n, n)."""
    lag = np.abs(night.run[:, None] - night.run[None, :])
    run_level = 0.0 if noise.kind == "white" else noise.run_bias**2
    return noise.collect**2 * np.eye(len(night)) + run_level * noise.rho**lag


def beside_base(night: Night, noise: Noise, model: str, signal: np.ndarray) -> np.ndarray:
    """What is left of `signal` (n, 2) after whitening and projecting the base out, shape (2n,)."""
    factor = np.linalg.cholesky(noise_covariance(night, noise))
    white = np.kron(np.eye(2), np.linalg.inv(factor))
    q, _ = np.linalg.qr(white @ base_columns(night, model))
    s = white @ signal.T.ravel()
    return np.asarray(s - q @ (q.T @ s))


def visible_norm(night: Night, noise: Noise, model: str, signal: np.ndarray) -> float:
    """Norm of `signal` (n, 2) after whitening and projecting the base out."""
    return float(np.linalg.norm(beside_base(night, noise, model, signal)))


def alike(case: Case, model: str) -> float:
    """The size of the cosine between two hidden effects, channel by channel amplitudes left free, beside the base.

    Both amplitudes of an effect are the unit's own, so what counts is the time history: the larger of the channels'.
    """
    halves = [np.split(beside_base(case.night, Noise(), model, signal), 2) for signal in case.signals]
    cosines = [
        abs(float(a @ b)) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12)
        for a, b in zip(halves[0], halves[1], strict=True)
    ]
    return max(cosines)


def whitened_norm(night: Night, noise: Noise, signal: np.ndarray) -> float:
    """Norm of `signal` (n, 2) after whitening alone."""
    factor = np.linalg.cholesky(noise_covariance(night, noise))
    return float(np.linalg.norm(np.linalg.solve(factor, signal)))


def draw_noise(night: Night, noise: Noise, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return noise (n, 2) and the standard errors that the file states (n, 2)."""
    n = len(night)
    sigma = np.full(n, noise.collect)
    if noise.kind == "cold":
        sigma = np.where(night.rotor < 0.0, 3.0 * sigma, sigma)
    unit = rng.standard_t(4, (n, 2)) / np.sqrt(2.0) if noise.kind == "heavy" else rng.normal(size=(n, 2))
    if noise.kind == "row_ar":
        for i in range(1, n):
            unit[i] = 0.4 * unit[i - 1] + np.sqrt(1 - 0.16) * unit[i]
    out = sigma[:, None] * unit
    runs = int(night.run.max()) + 1
    if noise.kind == "walk":
        level = np.cumsum(rng.normal(0.0, 0.5 * noise.run_bias, (runs, 2)), 0)
    else:
        level = np.zeros((runs, 2))
        level[0] = noise.run_bias * rng.normal(size=2)
        for k in range(1, runs):
            level[k] = noise.rho * level[k - 1] + np.sqrt(1 - noise.rho**2) * noise.run_bias * rng.normal(size=2)
    if noise.kind != "white":
        out += level[night.run]
    if noise.kind == "run_mu":
        out += rng.normal(0.0, 2.0, (runs, 2))[night.run] * night.f[:, 2:3]
    return out, np.repeat(sigma[:, None], 2, 1)


def make_case(
    seed: int,
    hidden: tuple[str, ...] = (),
    d: float = 8.0,
    *,
    model: str = "matrix-6-thermal",
    design: Design | None = None,
    noise: Noise | None = None,
) -> Case:
    """Make one sealed case; the same seed gives the same case."""
    rng = np.random.default_rng(seed)
    design, noise = design or Design(), noise or Noise()
    night = make_night(design, rng)
    truth = make_truth(night, rng, thermal=model == "matrix-6-thermal", mu=0.0 if model == "collins-4" else 1.0)
    rates = truth.rates(night.f, night.w)
    sizes, kept, signals = [], [], []
    for name in hidden:
        if name == MISLABELLED:
            continue
        signal = HIDDEN[name](night, truth, rng)
        visible = visible_norm(night, noise, model, signal)
        kept.append(visible / max(whitened_norm(night, noise, signal), 1e-12))
        size = 1.0 if name in AS_IT_IS else d / max(visible, 1e-9)
        signals.append(size * signal)
        sizes.append(size * visible)
    errors, se = draw_noise(night, noise, rng)
    measured = rates + sum(signals, np.zeros_like(rates)) + errors
    if MISLABELLED in hidden:
        measured = exchanged(night, measured, rng)
    return Case(night, measured, se, truth, hidden, tuple(sizes), tuple(kept), tuple(signals))


def kept_share(name: str, model: str, design: Design, units: int = 6) -> float:
    """What share of an effect's norm the base leaves, the median over a few units."""
    cases = [make_case(seed, (name,), 1.0, model=model, design=design) for seed in range(units)]
    return float(np.median([case.kept[0] for case in cases]))


def exchanged(night: Night, rates: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The rates with two collects of one run written under each other's position."""
    out = rates.copy()
    rows = np.flatnonzero(night.run == rng.choice(np.unique(night.run)))
    first, second = rng.choice(rows, 2, replace=False)
    out[[first, second]] = rates[[second, first]]
    return out


def write_case(case: Case, folder: Path, *, with_conditions: bool = True) -> Path:
    """Write the campaign folder of a case (and nothing of its truth)."""
    folder.mkdir(parents=True)
    (folder / "campaign.yaml").write_text(
        "schema: hil.campaign/1\ntitle: sealed case\nsource: blind benchmark, simulated\nsimulated: true\n"
        "sensors:\n  2:\n    axes: [A, B, S]\n    channels: {RA: A, RB: B}\n"
        "conditions:\n  supply_V: supply voltage, volt\n"
        "  spin_period_us: period of the rotor, microsecond\n  vibration_rms_g: vibration at the unit, g rms\n"
    )
    n = case.night
    columns: dict[str, np.ndarray] = {
        "collect": np.arange(1, len(n) + 1),
        "run": n.run,
        "sensor": np.full(len(n), 2),
        "position": n.position,
        "start_s": n.start_s,
        "duration_s": np.full(len(n), n.design.collect_s),
    }
    for i, axis in enumerate("ABS"):
        columns[f"f_{axis}_g"] = n.f[:, i]
        columns[f"w_{axis}_deg_per_hr"] = n.w[:, i]
    for i, channel in enumerate(("RA", "RB")):
        columns[f"{channel}_deg_per_hr"] = case.rates[:, i]
        columns[f"{channel}_se_deg_per_hr"] = case.se[:, i]
    if with_conditions:
        columns |= {
            "temperature_degC": n.rotor,
            "case_degC": n.case,
            "setpoint_degC": n.setpoint,
            "dTdt_degC_per_min": n.rotor_slope,
            "time_since_power_on_s": n.start_s,
            "time_since_setpoint_s": n.since_setpoint_s,
            "time_since_index_s": np.full(len(n), 30.0),
            "supply_V": n.supply,
            "spin_period_us": n.spin_us,
            "vibration_rms_g": n.vibration,
        }
    with (folder / "collects.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return folder
