"""What is hidden inside the collects: series of samples whose averages are the campaign's own rates.

A tone, a settling after the index move, steps, quantisation, saturation and bursts, with continuous parameters; also
white and correlated noise with nothing hidden.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.blind.cases import Case

RATE_HZ = 5.0
Inside = Callable[[np.ndarray, float, np.random.Generator], Callable[[np.ndarray, np.random.Generator], np.ndarray]]
"""(times, sigma, unit's own numbers) to what is done to one collect's samples."""


def _tone(t: np.ndarray, sigma: float, unit: np.random.Generator) -> Callable[..., np.ndarray]:
    frequency, size = unit.uniform(0.2, 2.2), unit.uniform(0.25, 0.6) * sigma
    return lambda x, r: x + size * np.cos(2.0 * np.pi * frequency * t + r.uniform(0.0, 6.28))


def _settle(t: np.ndarray, sigma: float, unit: np.random.Generator) -> Callable[..., np.ndarray]:
    tau, size = unit.uniform(2.0, 15.0), unit.choice([-1.0, 1.0]) * unit.uniform(0.5, 1.5) * sigma
    return lambda x, _r: x + size * np.exp(-t / tau)


def _step(t: np.ndarray, sigma: float, unit: np.random.Generator) -> Callable[..., np.ndarray]:
    size = unit.choice([-1.0, 1.0]) * unit.uniform(1.0, 2.5) * sigma
    return lambda x, r: x + size * (t > r.uniform(10.0, 50.0)) * (r.random() < 0.25)


def _quant(_t: np.ndarray, sigma: float, unit: np.random.Generator) -> Callable[..., np.ndarray]:
    step = unit.uniform(1.0, 3.0) * sigma
    return lambda x, _r: step * np.round(x / step)


def _saturation(_t: np.ndarray, sigma: float, unit: np.random.Generator) -> Callable[..., np.ndarray]:
    reach = unit.uniform(1.0, 1.8) * sigma
    return lambda x, _r: np.minimum(x, np.median(x) + reach)


def _bursts(t: np.ndarray, sigma: float, unit: np.random.Generator) -> Callable[..., np.ndarray]:
    size, share = unit.uniform(1.5, 3.0) * sigma, unit.uniform(0.1, 0.3)

    def noisy(x: np.ndarray, r: np.random.Generator) -> np.ndarray:
        begins = r.uniform(0.0, 60.0 * (1.0 - share))
        inside = (t > begins) & (t < begins + 60.0 * share) & (r.random() < 0.4)
        return np.asarray(x + inside * r.normal(0.0, size, len(t)))

    return noisy


INSIDE: dict[str, Inside] = {
    "beat": _tone,
    "settle": _settle,
    "jump": _step,
    "quant": _quant,
    "saturation": _saturation,
    "hash": _bursts,
}


def write_series(case: Case, name: str, folder: Path, seed: int, rho: float = 0.0) -> None:
    """Write series/NNNN.csv beside a case; `name` is what is hidden ("" for nothing), `rho` the correlation."""
    unit = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, 1.0 / RATE_HZ)
    sigma = 0.9 * np.sqrt(len(t) * (1.0 - rho) / (1.0 + rho))
    change = INSIDE[name](t, sigma, unit) if name else None
    (folder / "series").mkdir()
    for k in range(len(case.night)):
        noise = unit.normal(size=(len(t), 2)) * sigma
        for i in range(1, len(t) if rho else 0):
            noise[i] = rho * noise[i - 1] + np.sqrt(1.0 - rho**2) * noise[i]
        samples = case.rates[k] + noise - noise.mean(0)
        if change:
            changed = change(samples[:, 0], unit)
            samples[:, 0] = changed + case.rates[k][0] - changed.mean()
        with (folder / "series" / f"{k + 1:04d}.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["t_s", "RA_deg_per_hr", "RB_deg_per_hr"])
            writer.writerows(np.column_stack([t, samples]).tolist())
