"""Mistakes in the data: of rows, runs, labels, signs and of the earth rate that the file states.

Each takes the night as it was, the rates that were measured, the unit, a size in deg/hr and random numbers, and says
what the file then holds. The rows that are spoiled are part of the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind.night import Night, bench_rate, turned
from benchmarks.blind.physics import Truth


@dataclass
class Spoiled:
    """What the file holds: rates (n, 2), the night as it is filed, and which rows are not as they should be (n,)."""

    rates: np.ndarray
    filed: Night
    rows: np.ndarray


Fault = Callable[[Night, np.ndarray, Truth, float, np.random.Generator], Spoiled]


def _one_run(night: Night, rng: np.random.Generator) -> np.ndarray:
    """The rows of a run that has two collects or more."""
    runs, collects = np.unique(night.run, return_counts=True)
    return np.flatnonzero(night.run == rng.choice(runs[collects > 1]))


def _marked(night: Night, rows: np.ndarray) -> np.ndarray:
    out = np.zeros(len(night), dtype=bool)
    out[rows] = True
    return out


def exchanged(night: Night, rates: np.ndarray, _t: Truth, _s: float, rng: np.random.Generator) -> Spoiled:
    """Two collects of one run are written under each other's position."""
    out = rates.copy()
    rows = np.flatnonzero(night.run == rng.choice(np.unique(night.run)))
    first, second = rng.choice(rows, 2, replace=False)
    out[[first, second]] = rates[[second, first]]
    return Spoiled(out, night, _marked(night, np.array([first, second])))


def _stood_elsewhere(night: Night, rates: np.ndarray, truth: Truth, rows: np.ndarray, turn: np.ndarray) -> Spoiled:
    """The rates of rows that stood further by `turn` (rad about the index axis) than the file says."""
    there = replace(night, theta=night.theta.copy())
    there.theta[rows] += turn
    g = np.broadcast_to(night.g, (len(night), 3))
    f, w = turned(there.theta, g), turned(there.theta, bench_rate(night.design, night.heading))
    out = rates + truth.rates(f, w) - truth.rates(night.f, night.w)
    return Spoiled(out, night, _marked(night, rows))


def _pose_of_a_collect(n: Night, rates: np.ndarray, truth: Truth, _s: float, rng: np.random.Generator) -> Spoiled:
    row = np.array([rng.integers(len(n))])
    return _stood_elsewhere(n, rates, truth, row, np.array([rng.choice([0.5, 1.0, -0.5]) * np.pi]))


def _pose_of_a_run(n: Night, rates: np.ndarray, truth: Truth, _s: float, rng: np.random.Generator) -> Spoiled:
    """A whole run was taken a quarter or half a turn further."""
    rows = _one_run(n, rng)
    return _stood_elsewhere(n, rates, truth, rows, np.full(len(rows), rng.choice([0.5, 1.0, -0.5]) * np.pi))


def _label_alone(n: Night, rates: np.ndarray, _t: Truth, _s: float, rng: np.random.Generator) -> Spoiled:
    """Another label stands in one row, whose f and w are what they were: nothing is wrong with the unit."""
    row = rng.integers(len(n))
    position = n.position.copy()
    position[row] = rng.choice([p for p in np.unique(position) if p != position[row]])
    return Spoiled(rates, replace(n, position=position), _marked(n, np.array([row])))


def _rows(n: Night, rates: np.ndarray, _t: Truth, size: float, rng: np.random.Generator) -> Spoiled:
    """One to three averages of one channel each are off."""
    out, rows = rates.copy(), rng.choice(len(n), rng.integers(1, 4), replace=False)
    for row in rows:
        out[row, rng.integers(2)] += rng.choice([-1.0, 1.0]) * size * rng.uniform(1.0, 3.0)
    return Spoiled(out, n, _marked(n, rows))


def _run(n: Night, rates: np.ndarray, _t: Truth, size: float, rng: np.random.Generator) -> Spoiled:
    """One run is off, every average by an amount of its own."""
    out, rows = rates.copy(), _one_run(n, rng)
    out[rows] += size * rng.normal(size=(len(rows), 2))
    return Spoiled(out, n, _marked(n, rows))


def _sign_of_a_run(n: Night, rates: np.ndarray, _t: Truth, _s: float, rng: np.random.Generator) -> Spoiled:
    out, rows = rates.copy(), _one_run(n, rng)
    out[rows, rng.integers(2)] *= -1.0
    return Spoiled(out, n, _marked(n, rows))


def _sign(n: Night, rates: np.ndarray, _t: Truth, _s: float, rng: np.random.Generator) -> Spoiled:
    """One channel is turned in sign throughout: to a base that is fitted, its earth rate has the wrong sign."""
    out = rates.copy()
    out[:, rng.integers(2)] *= -1.0
    return Spoiled(out, n, np.ones(len(n), dtype=bool))


def _clip(n: Night, rates: np.ndarray, _t: Truth, _s: float, rng: np.random.Generator) -> Spoiled:
    """One channel cannot go beyond a value that a few of its averages pass."""
    out, channel = rates.copy(), rng.integers(2)
    out[:, channel] = np.minimum(out[:, channel], np.quantile(out[:, channel], rng.uniform(0.85, 0.95)))
    return Spoiled(out, n, out[:, channel] != rates[:, channel])


def _earth_left_out(n: Night, rates: np.ndarray, _t: Truth, _s: float, _r: np.random.Generator) -> Spoiled:
    """The file has zeros for the earth rate, and the latitude."""
    return Spoiled(rates, replace(n, w=np.zeros_like(n.w)), np.ones(len(n), dtype=bool))


def _earth_heading(n: Night, rates: np.ndarray, _t: Truth, _s: float, rng: np.random.Generator) -> Spoiled:
    """The earth rate was computed for a heading that is off by 5 to 60 degrees."""
    wrong = n.heading + rng.choice([-1.0, 1.0]) * rng.uniform(5.0, 60.0)
    return Spoiled(rates, replace(n, w=turned(n.theta, bench_rate(n.design, wrong))), np.ones(len(n), dtype=bool))


def _earth_sign(n: Night, rates: np.ndarray, _t: Truth, _s: float, rng: np.random.Generator) -> Spoiled:
    """One of the bench's level components has the wrong sign in the file; the vertical one is as GS to any base."""
    rate = bench_rate(n.design, n.heading)
    rate[:, rng.integers(1, 3)] *= -1.0
    return Spoiled(rates, replace(n, w=turned(n.theta, rate)), np.ones(len(n), dtype=bool))


FAULTS: dict[str, Fault] = {
    "swap": exchanged,
    "pose@collect": _pose_of_a_collect,
    "pose@run": _pose_of_a_run,
    "label@alone": _label_alone,
    "row": _rows,
    "run": _run,
    "sign@run": _sign_of_a_run,
    "frame@channel": _sign,
    "clip": _clip,
    "earth@left out": _earth_left_out,
    "earth@heading": _earth_heading,
    "frame@sign": _earth_sign,
}
"""Mistakes in the data, made last; the name that is right stands before the @."""
