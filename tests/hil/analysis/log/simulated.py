"""A simulated log with known truth: a unit put down by hand in many poses, carried between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

BIAS_DEG_PER_HR = np.array([400.0, -250.0, 120.0])
SENSITIVITY = np.array([[60.0, -25.0, 10.0], [35.0, -40.0, 5.0], [-15.0, 30.0, 80.0]])
"""Not symmetric, in no two entries alike: a transposition shows."""
ACCELEROMETER = np.array([0.05, -0.03, 0.02, 1.01, 0.97, 1.02, 0.01, -0.02, 0.015])
"""Bias, g; scale factors; leans of Y to X, Z to X, Z to Y, rad."""
TURNING = np.array([[0.01, -0.004, 0.006], [0.012, -0.02, -0.003], [-0.008, 0.005, 0.015]])
"""The rate is (1 + TURNING) times what the gyros show beyond their rest."""
HZ, REST_S, CARRY_S = 100.0, 3.0, 1.5
RATE_NOISE, F_NOISE = 200.0, 0.002


def poses(n: int, seed: int = 1) -> np.ndarray:
    """Return n unit vectors, (n, 3): first along +Z, -Z, +X, -X, +Y, -Y, then anywhere."""
    anywhere = np.random.default_rng(seed).normal(size=(n, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    axes = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], dtype=float)
    return np.vstack([axes, anywhere])[:n]


def shown_g(f_g: np.ndarray) -> np.ndarray:
    """Return what the accelerometers show at f, (…, 3) both."""
    b, s, (yx, zx, zy) = ACCELEROMETER[:3], ACCELEROMETER[3:6], ACCELEROMETER[6:]
    lean = np.array([[1.0, 0.0, 0.0], [yx, 1.0, 0.0], [zx, zy, 1.0]])
    return np.asarray(s * (f_g @ lean.T) + b)


def _turn(before: np.ndarray, after: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Return an axis about which, and an angle by which, a unit turns so that f goes from `before` to `after`."""
    across = after - before
    axis = np.cross(across, rng.normal(size=3))
    axis /= np.linalg.norm(axis)
    one, other = (each - (each @ axis) * axis for each in (before, after))
    return axis, -float(np.arctan2(np.cross(one, other) @ axis, one @ other))


def _turned(f_g: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """Return f, (3,), along the axes of a unit that has turned about `axis` by `angle`, rad."""
    along = (f_g @ axis) * axis
    return np.asarray(along + (f_g - along) * np.cos(angle) - np.cross(axis, f_g) * np.sin(angle))


@dataclass
class Simulated:
    """Columns of a log, to be spoiled and written; `label` of each row, `starts` the first row at rest of each pose."""

    f_g: np.ndarray
    t_s: np.ndarray
    rates: np.ndarray
    acc: np.ndarray
    starts: list[int]
    label: np.ndarray
    names: Mapping[str, str] = field(default_factory=dict)

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns by the names that the project's own tables have."""
        table = {"t_s": self.t_s}
        table |= {f"G{axis}_deg_per_hr": self.rates[:, k] for k, axis in enumerate("XYZ")}
        return table | {f"acc{axis}_g": self.acc[:, k] for k, axis in enumerate("XYZ")}

    def write(self, path: Path, columns: Mapping[str, np.ndarray] | None = None, labels: bool = False) -> Path:
        """Write the columns as CSV; NaN is an empty cell."""
        table = dict(columns or self.columns())
        lines = [",".join([*table, *(["label"] if labels else [])])]
        for i, row in enumerate(np.column_stack(list(table.values())).tolist()):
            cells = ["" if cell != cell else repr(cell) for cell in row]
            lines.append(",".join([*cells, *([str(self.label[i])] if labels else [])]))
        path.write_text("\n".join(lines) + "\n")
        return path


def simulate(n: int = 14, seed: int = 1, rest_s: float = REST_S) -> Simulated:
    """Return a log of n poses at rest for `rest_s`, each reached by a turn of `CARRY_S` with a shaking hand."""
    rng = np.random.default_rng(seed)
    where = poses(n, seed)
    rest, carry = round(rest_s * HZ), round(CARRY_S * HZ)
    f, rates, starts, names = [], [], [], []
    for k, pose in enumerate(where):
        starts.append(sum(map(len, f)))
        f.append(np.tile(pose, (rest, 1)))
        rates.append(np.zeros((rest, 3)))
        if k + 1 < n:
            axis, angle = _turn(pose, where[k + 1], rng)
            way = 0.5 * (1.0 - np.cos(np.pi * np.arange(1, carry + 1) / carry))
            f.append(np.array([_turned(pose, axis, angle * part) for part in way]))
            speed = np.diff(way, prepend=0.0) * angle * HZ
            rates.append(np.outer(np.rad2deg(speed) * 3600.0, axis))
        axis = int(np.argmax(np.abs(pose)))
        label = f"{'+' if pose[axis] > 0 else '-'}{'XYZ'[axis]}" if k < 6 else f"pose {k}"
        names += [label] * (rest + (carry if k + 1 < n else 0))
    f_g, turning = np.vstack(f), np.vstack(rates)
    shown = turning @ np.linalg.inv(np.eye(3) + TURNING).T
    made = BIAS_DEG_PER_HR + f_g @ SENSITIVITY.T + shown + RATE_NOISE * rng.normal(size=f_g.shape)
    shaken = F_NOISE + 0.1 * np.any(turning != 0.0, axis=1, keepdims=True)
    acc = shown_g(f_g) + shaken * rng.normal(size=f_g.shape)
    return Simulated(where, np.arange(len(f_g)) / HZ, made, acc, starts, np.array(names))
