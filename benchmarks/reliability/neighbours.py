"""How often a collect that is off is noticed beside the other runs, and how often one is that is not.

    python -m benchmarks.reliability.neighbours              # one JSON document, in half a minute

Campaigns of a rotor sensor in three positions, whose bias scatters from run to run by 1 deg/hr and whose rates have
0.7 deg/hr of noise. `off` is in units of both together.
"""

from __future__ import annotations

import argparse
import json

import numpy as np

from hil.campaign import Collects, Conditions, Sensor
from hil.solve.neighbours import compared_with_neighbours

_SCATTER, _NOISE = 1.0, 0.7
_SIGMA = float(np.hypot(_SCATTER, _NOISE))
_F = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_K = np.array([[58.0, -20.0, 5.0], [20.0, 58.0, 9.0]])
_SHAPES = ((9, 3), (16, 8), (24, 3), (24, 1))


def campaign(runs: int, per_temperature: int, seed: int, off: float = 0.0) -> Collects:
    """Return one sensor's collects; one channel of one in the middle is `off`."""
    rng = np.random.default_rng(seed)
    n, run = 3 * runs, np.repeat(np.arange(1, runs + 1), 3)
    setpoint = 20.0 * ((run - 1) // per_temperature) - 20.0
    f = np.tile(_F, (runs, 1))
    rates = 30.0 + 0.5 * setpoint[:, None] + f @ _K.T + rng.normal(0.0, _NOISE, (n, 2))
    rates += np.repeat(rng.normal(0.0, _SCATTER, (runs, 2)), 3, axis=0)
    rates[n // 2, 0] += off * _SIGMA
    sensor = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})
    count, lasts, still = np.arange(1, n + 1), np.full(n, 60.0), np.zeros((n, 3))
    columns = {"setpoint_degC": setpoint, "temperature_degC": setpoint + 8.0}
    position = np.tile(["1", "2", "3"], runs)
    conditions = Conditions(sensor, count, run, position, 600.0 * count, lasts, f, still, columns)
    return Collects(conditions, rates, np.full((n, 2), _NOISE))


def main() -> None:
    """Count, and print one JSON document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clean", type=int, default=1500, help="campaigns of each shape with nothing wrong")
    parser.add_argument("--each", type=int, default=100, help="campaigns of each shape and size")
    asked = parser.parse_args()

    def noticed(shape: tuple[int, int], count: int, off: float) -> int:
        return sum(bool(compared_with_neighbours(campaign(*shape, seed, off)).judged) for seed in range(count))

    rows = [
        {
            "runs": shape[0],
            "at_each_temperature": shape[1],
            "called_of_nothing_wrong": [noticed(shape, asked.clean, 0.0), asked.clean],
            "noticed_when_off_by": {off: noticed(shape, asked.each, off) / asked.each for off in (6, 8, 10, 12, 16)},
        }
        for shape in _SHAPES
    ]
    print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
