"""How values of the base may follow temperature: not, or so far, in one of a few shapes, and how probably."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.solve.rows import Block

CALIBRATIONS = (4.0, 12.0, 36.0, 108.0, 324.0)
"""How far a value of the base follows temperature, in white noises: wide priors of what the data then settle."""
SHAPES = ((1.0, 0.0, 0.0), (0.5, 0.49, 0.01), (0.45, 0.45, 0.1), (0.0, 0.0, 1.0))
"""Shares of a straight line, of a smooth curve, and of what each temperature has for itself."""
FIXED = (0.0, 0)
FOLLOWS = (FIXED, *product(CALIBRATIONS, range(len(SHAPES))))
"""What one value of the base may do over temperature: how far it follows, and in what shape."""
ALONE = 0.5
"""How probably a value follows temperature in its own way, not in that of the unit's others."""
SMOOTH_DEGC = 30.0
"""Over which a smooth curve forgets itself: values of a unit turn two or three times over a sweep, not more."""
Profile = tuple[tuple[float, int], ...]
"""Of every value of the base, how far it follows temperature, and in which of the shapes."""


@cache
def log_profile(profile: Profile) -> float:
    """Log prior of what the values of the base do: some way that is the unit's, of which some of them depart."""
    alone = ALONE / len(FOLLOWS)
    alike = [np.prod([alone + (1.0 - ALONE) * (own == way) for own in profile]) for way in FOLLOWS]
    return float(np.log(np.mean(alike)))


def values_over_temperature(
    block: Block, conditions: Conditions, order: IntArray
) -> tuple[FloatArray, list[FloatArray]]:
    """Return the base's values anew at each temperature (N, r), and factors (S, S) of every shape over temperature.

    Where nobody knows the temperature, all shapes but the last are one value.
    """
    stations = np.unique(block.station)
    laid = block.at_each_temperature(block.values / np.sqrt(np.mean(block.values**2, axis=0)))[order]
    temperature = conditions.columns.get("temperature_degC")
    known = temperature is not None and bool(np.all(np.isfinite(temperature[block.rows])))
    own = temperature[block.rows] if known and temperature is not None else np.zeros(len(block.y))
    centre = np.array([np.mean(own[block.station == k]) for k in stations])
    mean, spread = float(np.mean(own)), float(own.std())
    line = (centre - mean) / max(spread, 1.0)
    curve = np.exp(-0.5 * (np.subtract.outer(centre, centre) / SMOOTH_DEGC) ** 2)
    of_all = [np.outer(line, line), curve, np.eye(len(stations))]
    return laid, [_root(sum(share * part for share, part in zip(shape, of_all, strict=True))) for shape in SHAPES]


def _root(covariance: FloatArray) -> FloatArray:
    """Return F with FF' a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
