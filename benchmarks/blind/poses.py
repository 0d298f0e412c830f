"""Three-axis units in static poses, as people record them by hand: the other form that campaign data comes in."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

POSES = 18
SIGMA = 8.0  # deg/hr per pose and channel


def write_triad(seed: int, d: float, folder: Path) -> Path:
    """Write 18 poses of a triad with biases, white noise and a full g-sensitivity of size d (0: none)."""
    rng = np.random.default_rng(seed)
    f = rng.normal(size=(POSES, 3))
    f /= np.linalg.norm(f, axis=1, keepdims=True)
    signal = f @ rng.normal(size=(3, 3)).T  # not symmetric
    left = signal - signal.mean(0)
    signal *= d * SIGMA / np.linalg.norm(left)
    sigma = SIGMA * np.exp(rng.normal(0.0, 0.3, (POSES, 3)))
    rates = rng.normal(0.0, 2000.0, 3) + signal + sigma * rng.normal(size=(POSES, 3))
    folder.mkdir(parents=True)
    (folder / "campaign.yaml").write_text(
        "schema: hil.campaign/1\ntitle: sealed triad\nsource: blind benchmark, simulated\nsimulated: true\n"
        "sensors:\n  1:\n    axes: [X, Y, Z]\n    channels: {GX: X, GY: Y, GZ: Z}\nnotes: earth rate given as 0\n"
    )
    names = ["collect", "run", "sensor", "position", "start_s", "duration_s"]
    names += [f"f_{a}_g" for a in "XYZ"] + [f"w_{a}_deg_per_hr" for a in "XYZ"]
    names += [f"G{a}_deg_per_hr" for a in "XYZ"] + [f"G{a}_se_deg_per_hr" for a in "XYZ"]
    with (folder / "collects.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for i in range(POSES):
            writer.writerow([i + 1, 1, 1, f"pose-{i + 1:02d}", 20.0 * i, 10.0, *f[i], 0, 0, 0, *rates[i], *sigma[i]])
    return folder
