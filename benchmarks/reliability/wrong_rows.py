"""What is said of rows that are wrong, and of rows that are not: how often, and how often rightly.

    python -m benchmarks.reliability.wrong_rows              # one JSON document, in some minutes

Campaigns of a rotor sensor whose bias scatters from run to run by 1 deg/hr and whose rates have 0.7 deg/hr of noise:
so many runs, at so many temperatures, in an order of positions. One rate of one is off by some deg/hr, or two collects
of a run have each other's labels; also those of a sensor that hardly feels them, a seventh as sensitive to g, by itself
and beside another such that took the same collects.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from dataclasses import replace

import numpy as np

from hil.campaign import Campaign, Collects, Conditions, FloatArray, Sensor
from hil.solve.wrong_rows import USED, wrong_rows

_SCATTER, _NOISE = 1.0, 0.7
_F = {"1": [-1.0, 0.0, 0.0], "2": [1.0, 0.0, 0.0], "3": [0.0, 0.0, 1.0], "4": [0.0, 0.0, -1.0]}
_K = np.array([[58.0, -20.0, 5.0], [20.0, 58.0, 9.0]])
_LITTLE = {2: _K / 7.0, 1: _K[::-1] * [[0.1], [-0.12]]}
_SHAPES = (
    (1, 1, "1234321"),
    (2, 1, "1234"),
    (3, 1, "123"),
    (3, 1, "1234321"),
    (6, 2, "123"),
    (12, 4, "123"),
    (24, 8, "123"),
    (8, 8, "123"),
)
_OFF_DEG_PER_HR = (10.0, 15.0, 30.0, 100.0)


def campaign(runs: int, temperatures: int, order: str, seed: int, k: FloatArray = _K, number: int = 2) -> Collects:
    """Return one sensor's collects, with nothing wrong."""
    rng = np.random.default_rng(seed if number == 2 else [seed, number])
    n, run = len(order) * runs, np.repeat(np.arange(1, runs + 1), len(order))
    setpoint = 20.0 * ((run - 1) * temperatures // runs) - 20.0
    f = np.array([_F[each] for each in order * runs])
    rates = 30.0 + 0.5 * setpoint[:, None] + f @ k.T + rng.normal(0.0, _NOISE, (n, 2))
    rates += rng.normal(0.0, _SCATTER, (runs, 2))[run - 1]
    sensor = Sensor(number, ("A", "B", "S"), {"RA": "A", "RB": "B"})
    count, lasts, still = np.arange(1, n + 1), np.full(n, 60.0), np.zeros((n, 3))
    columns = {"setpoint_degC": setpoint, "temperature_degC": setpoint + 8.0}
    conditions = Conditions(sensor, count, run, np.array([*order * runs]), 600.0 * count, lasts, f, still, columns)
    return Collects(conditions, rates, np.full((n, 2), _NOISE))


def spoiled(rows: Collects, seed: int, off: float | None) -> tuple[Collects, set[tuple[int, str]]]:
    """Return them with one rate off, or (None) labels of two collects of a run exchanged, and which rates are wrong."""
    rng, rates, conditions = np.random.default_rng(seed), rows.rates_deg_per_hr.copy(), rows.conditions
    i, c = int(rng.integers(len(rates))), int(rng.integers(2))
    wrong = {(int(conditions.collect[i]), ("RA", "RB")[c])}
    if off is None:
        other = (conditions.run == conditions.run[i]) & (conditions.position != conditions.position[i])
        pair = [i, int(rng.choice(np.flatnonzero(other)))]
        rates[pair] = rates[pair[::-1]]
        wrong = {(int(conditions.collect[k]), name) for k in pair for name in ("RA", "RB")}
    else:
        rates[i, c] += off * rng.choice([-1.0, 1.0])
    return replace(rows, rates_deg_per_hr=rates), wrong


def said(rows: Collects, wrong: set[tuple[int, str]], beside: Collects | None = None) -> str:
    """Return what is done about the rows, beside what is wrong with them; `beside` are another sensor's."""
    found = wrong_rows(Campaign("", "", {2: rows} | ({} if beside is None else {1: beside})))[2].rows
    done = {(k, name) for row in found if row.done != USED for k in row.collects for name in row.channels}
    if done:
        return "rightly done" if wrong <= done and {k for k, _ in wrong} == {k for k, _ in done} else "another is done"
    return "run named" if found else "nothing"


def exchanged(shape: tuple[int, int, str], seed: int, *, both: bool) -> str:
    """Return what is done about exchanged labels that a sensor hardly feels, by itself or beside another such."""
    one, other = (campaign(*shape, seed, _LITTLE[number], number) for number in (2, 1))
    return said(*spoiled(one, seed, None), spoiled(other, seed, None)[0] if both else None)


def main() -> None:
    """Count, and print one JSON document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clean", type=int, default=300, help="campaigns of each shape with nothing wrong")
    parser.add_argument("--each", type=int, default=60, help="campaigns of each shape and mistake")
    asked = parser.parse_args()
    rows = []
    for shape in _SHAPES:
        clean = Counter(said(campaign(*shape, seed), set()) for seed in range(asked.clean))
        mistakes = {
            "exchanged" if off is None else f"{off:g} deg/hr": Counter(
                said(*spoiled(campaign(*shape, seed), seed, off)) for seed in range(asked.each)
            )
            for off in (*_OFF_DEG_PER_HR, None)
        }
        for what, both in (("exchanged, hardly felt", False), ("the same, two sensors", True)):
            mistakes[what] = Counter(exchanged(shape, seed, both=both) for seed in range(asked.each))
        runs, temperatures, order = shape
        rows.append({"runs": runs, "temperatures": temperatures, "order": order, "of nothing wrong": clean, **mistakes})
    print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
