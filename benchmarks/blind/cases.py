"""Sealed cases: a night, a unit, noise, hidden effects of a stated size; written as a campaign folder.

The size d of a hidden effect is its norm in units of the noise after the base model has been projected out: what is
left for anybody to see. The truth is returned, never written into the folder.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.blind.faults import FAULTS
from benchmarks.blind.night import Design, Night, make_night
from benchmarks.blind.physics import CATALOGUE, OUTSIDE, VARIANTS, Truth, make_truth
from benchmarks.blind.scatter import SCATTER, drawn, left_by

HIDDEN = {**CATALOGUE, **VARIANTS, **OUTSIDE}
AS_IT_IS = frozenset({"frame"})
"""Defects that have one size: they are not scaled to d."""


@dataclass(frozen=True)
class Noise:
    """What the rates are covered with, deg/hr. `kind` names a departure from the plain case."""

    collect: float = 0.9
    run_bias: float = 1.35  # run-level, per axis
    rho: float = 0.6  # correlation of the run-level part from run to run
    kind: str = "plain"  # plain, white, heavy, walk, run_mu, cold, row_ar
    unequal: float = 0.0  # spread of the collects' own noise, as the log's sigma
    stated: float = 1.0  # what the file states of it
    extra: float = 0.0  # white noise that the file does not state, deg/hr


@dataclass
class Case:
    """A campaign and what is hidden in it. `night` is as it was, `filed` as the file has it."""

    night: Night
    rates: np.ndarray  # (n, 2)
    se: np.ndarray  # (n, 2), as the file states it
    truth: Truth
    hidden: tuple[str, ...]
    sizes: tuple[float, ...]  # of the effects on the mean
    kept: tuple[float, ...]  # share of the norm that the base leaves
    signals: tuple[np.ndarray, ...]  # (n, 2) each: effects on the mean, then mistakes
    covariance: np.ndarray  # (2n, 2n), rows RA over RB: noise and effects on the scatter
    filed: Night
    spoiled: np.ndarray  # (n,), rows with a mistake


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
    """Covariance of one axis, (n, n): of rows with equal noise, whatever the kind."""
    lag = np.abs(night.run[:, None] - night.run[None, :])
    run_level = 0.0 if noise.kind == "white" else noise.run_bias**2
    return (noise.collect**2 + noise.extra**2) * np.eye(len(night)) + run_level * noise.rho**lag


def whitened(covariance: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Columns (2n, p) in units of the noise with this covariance (2n, 2n)."""
    return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), columns))


def beside_base(night: Night, covariance: np.ndarray, model: str, signal: np.ndarray) -> np.ndarray:
    """What is left of `signal` (n, 2) after whitening and projecting the base out, shape (2n,)."""
    both = whitened(covariance, np.column_stack([base_columns(night, model), signal.T.ravel()]))
    q, _ = np.linalg.qr(both[:, :-1])
    return np.asarray(both[:, -1] - q @ (q.T @ both[:, -1]))


def alike(case: Case, model: str) -> float:
    """The size of the cosine between two hidden effects, channel by channel amplitudes left free, beside the base.

    Both amplitudes of an effect are the unit's own, so what counts is the time history: the larger of the channels'.
    """
    halves = [np.split(beside_base(case.night, case.covariance, model, signal), 2) for signal in case.signals]
    cosines = [
        abs(float(a @ b)) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12)
        for a, b in zip(halves[0], halves[1], strict=True)
    ]
    return max(cosines)


def draw_noise(night: Night, noise: Noise, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return noise (n, 2) and the standard errors that the file states (n, 2)."""
    n = len(night)
    sigma = np.full(n, noise.collect)
    if noise.kind == "cold":
        sigma = np.where(night.rotor < 0.0, 3.0 * sigma, sigma)
    if noise.unequal:
        sigma = sigma * np.exp(rng.normal(0.0, noise.unequal, n))
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
    if noise.extra:
        out += noise.extra * rng.normal(size=(n, 2))
    return out, np.repeat(noise.stated * sigma[:, None], 2, 1)


def make_case(
    seed: int,
    hidden: tuple[str, ...] = (),
    d: float = 8.0,
    *,
    model: str = "matrix-6-thermal",
    design: Design | None = None,
    noise: Noise | None = None,
    times_white: float = 3.0,
) -> Case:
    """Make one sealed case; the same seed gives the same case.

    Effects on the mean have size `d`; effects on the scatter leave `times_white` times the collects' noise beside the
    base, rms; bad averages are off by `d` times it and more. What has a size of its own keeps it.
    """
    rng = np.random.default_rng(seed)
    design, noise = design or Design(), noise or Noise()
    night = make_night(design, rng)
    truth = make_truth(night, rng, thermal=model == "matrix-6-thermal", mu=0.0 if model == "collins-4" else 1.0)
    rates = truth.rates(night.f, night.w)
    covariance = np.kron(np.eye(2), noise_covariance(night, noise))
    scattered = np.zeros_like(rates)
    of_scatter = np.random.default_rng([seed, 1])  # so that the same night has the same noise without it
    for name in (name for name in hidden if name in SCATTER):
        wanders = SCATTER[name](night, of_scatter)
        wanders *= (times_white * noise.collect) ** 2 / left_by(base_columns(night, model), wanders)
        covariance += wanders
        scattered += drawn(wanders, of_scatter)
    sizes, kept, signals = [], [], []
    for name in (name for name in hidden if name in HIDDEN):
        signal = HIDDEN[name](night, truth, rng)
        visible = float(np.linalg.norm(beside_base(night, covariance, model, signal)))
        kept.append(visible / max(float(np.linalg.norm(whitened(covariance, signal.T.ravel()))), 1e-12))
        size = 1.0 if name in AS_IT_IS else d / max(visible, 1e-9)
        signals.append(size * signal)
        sizes.append(size * visible)
    errors, se = draw_noise(night, noise, rng)
    measured = rates + sum(signals, np.zeros_like(rates)) + scattered + errors
    filed, spoiled = night, np.zeros(len(night), dtype=bool)
    for name in (name for name in hidden if name in FAULTS):
        after = FAULTS[name](filed, measured, truth, d * noise.collect, rng)
        expected = truth.rates(after.filed.f, after.filed.w) - truth.rates(filed.f, filed.w)
        signals.append(after.rates - measured - expected)
        measured, filed, spoiled = after.rates, after.filed, spoiled | after.rows
    return Case(
        night=night,
        rates=measured,
        se=se,
        truth=truth,
        hidden=hidden,
        sizes=tuple(sizes),
        kept=tuple(kept),
        signals=tuple(signals),
        covariance=covariance,
        filed=filed,
        spoiled=spoiled,
    )


def kept_share(name: str, model: str, design: Design, units: int = 6) -> float:
    """What share of an effect's norm the base leaves, the median over a few units."""
    cases = [make_case(seed, (name,), 1.0, model=model, design=design) for seed in range(units)]
    return float(np.median([case.kept[0] for case in cases]))


def write_case(case: Case, folder: Path, *, with_conditions: bool = True, without: Sequence[str] = ()) -> Path:
    """Write the campaign folder of a case (and nothing of its truth), some of the conditions' columns left out."""
    folder.mkdir(parents=True)
    site = "" if case.filed.w.any() else f"site: {{latitude_deg: {case.night.design.latitude_deg}}}\n"
    conditions = {
        "supply_V": "supply voltage, volt",
        "spin_period_us": "period of the rotor, microsecond",
        "vibration_rms_g": "vibration at the unit, g rms",
    }
    told = "".join(f"  {name}: {text}\n" for name, text in conditions.items() if name not in without)
    (folder / "campaign.yaml").write_text(
        f"schema: hil.campaign/1\ntitle: sealed case\nsource: blind benchmark, simulated\nsimulated: true\n{site}"
        "sensors:\n  2:\n    axes: [A, B, S]\n    channels: {RA: A, RB: B}\n" + (told and f"conditions:\n{told}")
    )
    n = case.filed
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
            "time_since_power_on_s": n.since_power_s,
            "time_since_setpoint_s": n.since_setpoint_s,
            "time_since_index_s": np.full(len(n), 30.0),
            "supply_V": n.supply,
            "spin_period_us": n.spin_us,
            "vibration_rms_g": n.vibration,
        }
    columns = {name: values for name, values in columns.items() if name not in without}
    with (folder / "collects.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return folder
