"""Three-axis units in static poses, as people record them by hand: the other form that campaign data comes in."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from benchmarks.blind.night import EARTH_RATE_DEG_PER_HR

POSES = 18
SIGMA = 8.0  # deg/hr per pose and channel
QUIET = 0.5  # of a unit that sees the earth turn
MISTAKES = ("", "earth@left out", "earth@heading", "frame@sign", "pose@collect", "scale@channel")
"""What is hidden in a campaign of a unit that sees the earth turn; "" for nothing; a channel of the other sign is a
scale of -1."""


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
    return _write(folder, f, np.zeros_like(f), rates, sigma, "notes: earth rate given as 0\n")


def write_quiet_triad(seed: int, mistake: str, folder: Path) -> tuple[Path, int | None]:
    """Write 18 poses of a quiet triad with biases that sees the earth turn, turned over in every way, and a mistake.

    Returns the folder and, where the mistake is of one collect, its number.
    """
    rng = np.random.default_rng(seed)
    latitude, heading = rng.uniform(30.0, 65.0), rng.uniform(0.0, 360.0)
    turns = np.linalg.qr(rng.normal(size=(POSES, 3, 3)))[0]  # columns: up, north and the third in the unit's axes
    turns[:, :, 2] *= np.linalg.det(turns)[:, None]
    up = np.array([1.0, 0.0, 0.0])

    def earth(lat_deg: float, turned_deg: float) -> np.ndarray:
        lat, turn = np.deg2rad(lat_deg), np.deg2rad(turned_deg)
        level = np.cos(lat) * np.array([np.cos(turn), np.sin(turn)])
        return np.asarray(EARTH_RATE_DEG_PER_HR * np.array([np.sin(lat), *level]))

    f, w = turns @ up, turns @ earth(latitude, heading)
    sigma = QUIET * np.exp(rng.normal(0.0, 0.2, (POSES, 3)))
    rates = rng.normal(0.0, 20.0, 3) + w + sigma * rng.normal(size=(POSES, 3))
    site, spoiled = "", None
    if mistake == "earth@left out":
        w, site = np.zeros_like(w), f"site: {{latitude_deg: {latitude:.2f}}}\n"
    elif mistake == "earth@heading":
        w = turns @ earth(latitude, heading + rng.choice([-1.0, 1.0]) * rng.uniform(20.0, 90.0))
    elif mistake == "frame@sign":
        w = turns @ (earth(latitude, heading) * np.array([-1.0, 1.0, 1.0]))
    elif mistake == "pose@collect":
        spoiled = int(rng.integers(POSES))
        f[spoiled], w[spoiled] = -f[spoiled], -w[spoiled]
    elif mistake == "scale@channel":
        rates[:, rng.integers(3)] *= -1.0
    return _write(folder, f, w, rates, sigma, site), None if spoiled is None else spoiled + 1


def _write(folder: Path, f: np.ndarray, w: np.ndarray, rates: np.ndarray, sigma: np.ndarray, more: str) -> Path:
    folder.mkdir(parents=True)
    (folder / "campaign.yaml").write_text(
        "schema: hil.campaign/1\ntitle: sealed triad\nsource: blind benchmark, simulated\nsimulated: true\n"
        f"sensors:\n  1:\n    axes: [X, Y, Z]\n    channels: {{GX: X, GY: Y, GZ: Z}}\n{more}"
    )
    names = ["collect", "run", "sensor", "position", "start_s", "duration_s"]
    names += [f"f_{a}_g" for a in "XYZ"] + [f"w_{a}_deg_per_hr" for a in "XYZ"]
    names += [f"G{a}_deg_per_hr" for a in "XYZ"] + [f"G{a}_se_deg_per_hr" for a in "XYZ"]
    with (folder / "collects.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for i in range(len(f)):
            writer.writerow([i + 1, 1, 1, f"pose-{i + 1:02d}", 20.0 * i, 10.0, *f[i], *w[i], *rates[i], *sigma[i]])
    return folder
