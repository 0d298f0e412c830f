"""What a simulated unit really was: what a solver should find."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hil.twin import SimulatedUnit
from hil.twin.grid import ROTOR


@dataclass(frozen=True)
class Truth:
    """What one sensor was during a self-calibration: its base parameters, deg/hr and deg/hr/g, by name."""

    temperature_degC: float
    parameters: Mapping[str, float]


def truth_of(unit: SimulatedUnit, run: int, number: int) -> Truth:
    """Return what a sensor was in self-calibration `run`, scatter included, at its mean rotor temperature in the run.

    What wanders, and the model's terms, are not part of its base. Raises `ValueError` for a run that has not begun.
    """
    legs = [leg for leg in unit._timeline.legs if leg.run == run and np.isfinite(leg.begins_s)]
    if not legs:
        raise ValueError(f"self-calibration {run} of the simulated unit has not begun")
    first, last = unit._grid.nodes(np.array([legs[0].ends_s, legs[-1].ends_s])).tolist()
    rotor_degC = float(unit._grid.state[first : last + 1, ROTOR].mean())
    curves, drawn = unit._sensors[number].model.sensors[number], unit._sensors[number].runs.get(run, {})
    values = {name: float(curve.at(np.array([rotor_degC]))[0]) for name, curve in curves.items()}
    return Truth(rotor_degC, {name: value + drawn.get(name, 0.0) for name, value in values.items()})
