"""Campaigns that others measured, with an effect added that was not there: real noise under a known truth.

The logs stand beside the checkout (../shared/data, or the folder named by HIL_REFERENCE_DATA); where they are absent
there are no such cases. What is added is sized by the scatter that the log has itself about a bias.
"""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.blind.night import EARTH_RATE_DEG_PER_HR

_BESIDE = Path(__file__).resolve().parents[3] / "shared" / "data"

Added = Callable[[dict[str, np.ndarray], np.random.Generator], np.ndarray]


def logs() -> list[Path]:
    """The folders of the measured campaigns, none where they are absent."""
    folder = Path(os.environ.get("HIL_REFERENCE_DATA", _BESIDE)) / "campaigns"
    return sorted(path.parent for path in folder.glob("*/collects.csv"))


def _g_sensitivity(log: dict[str, np.ndarray], r: np.random.Generator) -> np.ndarray:
    return np.asarray(log["f"] @ r.normal(size=(3, 3)).T)


def _jump(log: dict[str, np.ndarray], r: np.random.Generator) -> np.ndarray:
    n = len(log["f"])
    later = np.arange(n) >= r.integers(n // 4, 3 * n // 4)
    return np.outer(later, r.normal(size=3))


def _ageing(log: dict[str, np.ndarray], r: np.random.Generator) -> np.ndarray:
    return np.outer(log["start_s"] / np.ptp(log["start_s"]), r.normal(size=3))


def _vertical_earth_rate(log: dict[str, np.ndarray], _r: np.random.Generator) -> np.ndarray:
    """What a file leaves out that has zeros for the earth rate: its vertical part is along f, north is not known."""
    return EARTH_RATE_DEG_PER_HR * np.sin(np.deg2rad(_LATITUDE_DEG)) * log["f"]


_LATITUDE_DEG = 51.0
ADDED: dict[str, Added] = {
    "g_sensitivity": _g_sensitivity,
    "jump": _jump,
    "ageing": _ageing,
    "earth@left out": _vertical_earth_rate,
}


def write_real(seed: int, log: str, hidden: tuple[str, ...], d: float, folder: Path) -> Path:
    """Write a log with an effect of size d added to its rates; of size 0: as it was measured.

    The earth rate has a size of its own, so there the log's scatter about its mean is what is made smaller: to a d-th
    of what the earth rate is, as a better gyro would have it.
    """
    rng = np.random.default_rng(seed)
    source = next(path for path in logs() if path.name == log)
    shutil.copytree(source, folder)
    with (source / "collects.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    axes = "XYZ"

    def column(*names: str) -> np.ndarray:
        return np.array([[float(row[name]) for name in names] for row in rows])

    names = [f"G{a}_deg_per_hr" for a in axes]
    errors = [f"G{a}_se_deg_per_hr" for a in axes]
    rates, se = column(*names), column(*errors)
    known = {"f": column(*(f"f_{a}_g" for a in axes)), "start_s": column("start_s")[:, 0]}
    mean = rates.mean(0)
    for name in hidden if d else ():
        signal = ADDED[name](known, rng)
        beside = signal - signal.mean(0)
        in_noise = float(np.sqrt(np.sum((beside / (rates - mean).std(0, ddof=1)) ** 2)))
        if name == "earth@left out":
            rates, se = mean + (rates - mean) * in_noise / d + signal, se * in_noise / d
            text = (folder / "campaign.yaml").read_text()
            (folder / "campaign.yaml").write_text(f"{text}site: {{latitude_deg: {_LATITUDE_DEG}}}\n")
        else:
            rates = rates + signal * d / in_noise
    for i, row in enumerate(rows):
        row.update({name: f"{value:.4f}" for name, value in zip(names, rates[i], strict=True)})
        row.update({name: f"{value:.4f}" for name, value in zip(errors, se[i], strict=True)})
    with (folder / "collects.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return folder
