"""Two sensors in one unit: what they have in common from run to run, and what each does alone.

    both = common_and_differential(campaign)
    both.temperatures[0].parameters["BA"].common      # (BA of sensor 1 + BA of sensor 2) / 2
    both.correlations["BA"]                           # of what is left when each temperature's mean is taken off
    both.shared                                       # every pair of parameters that certainly moves together

What base, supply, mount or chamber do moves both sensors in the same runs; what a sensor does, it does alone. The
sensors need not lie alike, so a common cause may enter through different parameters: a base that turns about an axis
along which the one has its A and the other its B axis is BA of the one and BB of the other. Therefore every pair is
looked at. Earth rate and gravity are taken as the same for both: an error there is common too, but in every run alike.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from hil.analysis.scatter.signature import Interval, correlation_interval
from hil.campaign import Campaign, FloatArray
from hil.model.forms import MATRIX_6, PER_G, RATE
from hil.solve import RunSolution, solve_campaign
from hil.solve.temperatures import runs_by_temperature

FALSE_ALARM = 0.05
"""The chance that `shared` names any pair at all where the sensors have nothing in common."""

UNITS = dict(zip(MATRIX_6, (RATE,) * 2 + (PER_G,) * 4, strict=True))


@dataclass(frozen=True)
class Part:
    """The mean over repeats, its standard error by the collects' noise, and how it scattered from run to run."""

    value: float
    se: float | None
    run_to_run: float | None


@dataclass(frozen=True)
class CommonAndDifferential:
    """One parameter at one temperature: half the sum and the difference (second sensor less first)."""

    common: Part
    differential: Part


@dataclass(frozen=True)
class AtTemperature:
    """The runs at one temperature in which both sensors were solved."""

    temperature_degC: float | None
    runs: tuple[int, ...]
    parameters: Mapping[str, CommonAndDifferential]


@dataclass(frozen=True)
class SharedPair:
    """Parameters of the two sensors that move together from run to run: `first` of the one, `second` of the other."""

    first: str
    second: str
    correlation: float
    p: float


@dataclass(frozen=True)
class BothSensors:
    """What two sensors have in common. `correlations` has the same parameter of both; `shared` any pair."""

    sensors: tuple[int, int]
    temperatures: tuple[AtTemperature, ...]
    degrees_of_freedom: int
    correlations: Mapping[str, Interval]
    shared: tuple[SharedPair, ...]

    def sentences(self) -> list[str]:
        """Say what moves together, and how much of it."""
        one, two = self.sensors
        if self.degrees_of_freedom < 2:
            return [f"sensors {one} and {two}: too few repeats to tell what they have in common from run to run"]
        if not self.shared:
            found = f"nothing certainly moves together from run to run ({self.degrees_of_freedom} degrees of freedom)"
            return [f"sensors {one} and {two}: {found}; as far as these runs tell, each scatters alone"]
        return [
            f"{pair.first} of sensor {one} and {pair.second} of sensor {two} move together from run to run "
            f"(correlation {pair.correlation:+.2f}, p = {pair.p:.1g}): a common cause, such as base, supply or mount"
            for pair in self.shared
        ]

    def document(self) -> dict[str, Any]:
        """Return what `hil solve --json` prints of it."""
        return {
            "sensors": list(self.sensors),
            "degrees_of_freedom": self.degrees_of_freedom,
            "temperatures": [
                {
                    "temperature_degC": each.temperature_degC,
                    "runs": list(each.runs),
                    "parameters": {
                        name: {
                            "common": vars(both.common),
                            "differential": vars(both.differential),
                            "unit": UNITS[name],
                        }
                        for name, both in each.parameters.items()
                    },
                }
                for each in self.temperatures
            ],
            "correlations": {name: vars(each) for name, each in self.correlations.items()},
            "shared": [vars(pair) for pair in self.shared],
            "sentences": self.sentences(),
        }


def common_and_differential(campaign: Campaign) -> BothSensors | None:
    """Compare the first two rotor sensors of a campaign; None where there are not two, or no run has both."""
    rotors = [number for number, rows in campaign.sensors.items() if rows.conditions.sensor.is_rotor][:2]
    if len(rotors) < 2:
        return None
    chosen = Campaign(campaign.title, campaign.source, {number: campaign.sensors[number] for number in rotors})
    solved = {(each.sensor, each.run): each for each in solve_campaign(chosen, "matrix-6") if _complete(each)}
    temperatures, away = [], []
    for temperature, runs in runs_by_temperature(campaign.sensors[rotors[0]].conditions):
        both = [run for run in runs if all((number, run) in solved for number in rotors)]
        if not both:
            continue
        values = np.array([[_values(solved[number, run]) for run in both] for number in rotors])  # (2, runs, 6)
        errors = np.array([[_errors(solved[number, run]) for run in both] for number in rotors])
        temperatures.append(AtTemperature(temperature, tuple(both), _parts(values, errors)))
        away.append(values - values.mean(axis=1, keepdims=True))
    if not temperatures:
        return None
    degrees = sum(len(each.runs) - 1 for each in temperatures)
    one, two = np.concatenate(away, axis=1)
    correlation = _correlations(one, two)
    same = {
        name: correlation_interval(_finite(correlation[i, i]), degrees) if degrees > 0 else Interval(None, None, None)
        for i, name in enumerate(MATRIX_6)
    }
    return BothSensors((rotors[0], rotors[1]), tuple(temperatures), degrees, same, _shared(correlation, degrees))


def _complete(solution: RunSolution) -> bool:
    return all(each.value is not None for each in solution.parameters.values())


def _values(solution: RunSolution) -> list[float]:
    return [float(solution.parameters[name].value or 0.0) for name in MATRIX_6]


def _errors(solution: RunSolution) -> list[float]:
    found = [solution.parameters[name].se for name in MATRIX_6]
    return [math.nan if each is None else each for each in found]


def _parts(values: FloatArray, errors: FloatArray) -> dict[str, CommonAndDifferential]:
    """Half the sum and the difference of values (2, runs, 6); the sensors' noise is independent."""
    runs = values.shape[1]
    noise = np.sqrt(np.sum(errors**2, axis=(0, 1))) / runs
    both = {"common": (0.5 * (values[0] + values[1]), 0.5 * noise), "differential": (values[1] - values[0], noise)}
    found = {
        kind: [
            Part(
                float(of[:, i].mean()),
                _finite(float(se[i])),
                float(np.std(of[:, i], ddof=1)) if runs > 1 else None,
            )
            for i in range(len(MATRIX_6))
        ]
        for kind, (of, se) in both.items()
    }
    return {
        name: CommonAndDifferential(found["common"][i], found["differential"][i]) for i, name in enumerate(MATRIX_6)
    }


def _correlations(one: FloatArray, two: FloatArray) -> FloatArray:
    """Correlation of every parameter of the one sensor with every one of the other, shape (6, 6)."""
    sizes = np.outer(np.sqrt(np.sum(one**2, axis=0)), np.sqrt(np.sum(two**2, axis=0)))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(one.T @ two / sizes)


def _shared(correlation: FloatArray, degrees: int) -> tuple[SharedPair, ...]:
    """Pairs whose correlation chance would give any of the 36 with a probability below `FALSE_ALARM`."""
    if degrees < 2:
        return ()
    found = []
    for i, j in itertools.product(range(len(MATRIX_6)), repeat=2):
        r = float(correlation[i, j])
        if not math.isfinite(r):
            continue
        tangent = abs(r) * math.sqrt((degrees - 1) / max(1.0 - r**2, 1e-12))
        p = float(2.0 * student.sf(tangent, degrees - 1))
        if p < FALSE_ALARM / correlation.size:
            found.append(SharedPair(MATRIX_6[i], MATRIX_6[j], r, p))
    return tuple(sorted(found, key=lambda pair: pair.p))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
