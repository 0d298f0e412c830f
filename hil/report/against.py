"""A campaign against an earlier one of the same unit: what changed, with its uncertainty, and what is beyond chance.

    comparison = compare(campaign, earlier)
    [each for each in comparison.differences if each.flagged]

A difference is this campaign's mean at a temperature less the earlier one's. Its standard uncertainty is the larger of
two: what the collects' noise gives, and what the runs of both scatter by at that temperature, s √(1/n + 1/m). Few runs
tell a scatter badly: it is widened by Student's t, so that three of these uncertainties are passed by chance in 0.27 %
of cases, as three sigma are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from hil.campaign import Campaign, FloatArray
from hil.solve import Estimate, RunSolution, solve_campaign
from hil.solve.temperatures import nearest, runs_by_temperature

SIGMAS = 3.0
_BY_CHANCE = 0.00135  # of a normal distribution, beyond three sigma on one side


@dataclass(frozen=True)
class Difference:
    """One parameter at one temperature, in `unit`; `sigma` is None where neither noise nor scatter is known."""

    sensor: int
    temperature_degC: float | None
    parameter: str
    unit: str
    now: float
    earlier: float
    runs: tuple[int, int]
    sigma: float | None

    @property
    def difference(self) -> float:
        """This campaign's mean less the earlier one's."""
        return self.now - self.earlier

    @property
    def flagged(self) -> bool:
        """Whether the difference is beyond three times its uncertainty."""
        return self.sigma is not None and abs(self.difference) > SIGMAS * self.sigma


@dataclass(frozen=True)
class Comparison:
    """What two campaigns have in common, how it differs, and in words what must be known about it."""

    earlier: str
    simulated: bool
    source: str  # who recorded the earlier one, and when
    differences: Sequence[Difference]
    remarks: Sequence[str]

    @property
    def flagged(self) -> Sequence[Difference]:
        """The differences beyond three sigma."""
        return [each for each in self.differences if each.flagged]

    @property
    def sentence(self) -> str:
        """What was found, in one sentence."""
        if not self.differences:
            return f"nothing can be compared with “{self.earlier}”"
        found, all_of = len(self.flagged), len(self.differences)
        chance = all_of * 2.0 * _BY_CHANCE
        return (
            f"{found} of {all_of} differences from “{self.earlier}” {'is' if found == 1 else 'are'} beyond 3 sigma; "
            f"chance alone gives {chance:.1g}"
        )


_Groups = Mapping[float | None, Sequence[RunSolution]]


def compare(campaign: Campaign, earlier: Campaign) -> Comparison:
    """Compare the means of two campaigns, sensor by sensor, temperature by temperature (matched to 2 °C)."""
    now, before = _by_temperature(campaign), _by_temperature(earlier)
    differences: list[Difference] = []
    remarks = list(_units(_unit(campaign), _unit(earlier)))
    for sensor, groups in now.items():
        if sensor not in before:
            remarks.append(f"The earlier campaign has no sensor {sensor}.")
            continue
        for temperature, solutions in groups.items():
            match = _nearest(temperature, before[sensor])
            if match is None:
                remarks.append(f"Sensor {sensor} at {_at(temperature)}: the earlier campaign has no such temperature.")
                continue
            differences += _differences(sensor, temperature, solutions, match)
    if any(each.sigma is None for each in differences):
        remarks.append("Where no uncertainty is given, neither standard errors nor repeats are there to tell it from.")
    return Comparison(earlier.title, earlier.simulated, earlier.source, differences, remarks)


def _unit(campaign: Campaign) -> str:
    return " ".join(campaign.identity[name] for name in ("model", "serial") if name in campaign.identity)


def _units(unit: str, earlier_unit: str) -> Iterator[str]:
    if not unit or not earlier_unit:
        yield "That both campaigns are of the same unit is taken on trust: the records do not say."
    elif unit != earlier_unit:
        yield f"These are two units, {unit} now and {earlier_unit} before: what differs may be that."


def _by_temperature(campaign: Campaign) -> dict[int, _Groups]:
    solutions = solve_campaign(campaign)
    return {
        number: {
            temperature: [each for each in solutions if each.sensor == number and each.run in runs]
            for temperature, runs in runs_by_temperature(collects.conditions)
        }
        for number, collects in campaign.sensors.items()
    }


def _nearest(temperature: float | None, groups: _Groups) -> Sequence[RunSolution] | None:
    if temperature is None or not math.isfinite(temperature):
        return groups.get(None)
    match = nearest(temperature, [each for each in groups if each is not None])
    return None if match is None else groups[match]


def _differences(
    sensor: int, temperature: float | None, now: Sequence[RunSolution], before: Sequence[RunSolution]
) -> Iterator[Difference]:
    for name in dict.fromkeys(name for each in now for name in each.parameters):
        a, b = _known(now, name), _known(before, name)
        if not a or not b:
            continue
        first, second = _values(a), _values(b)
        yield Difference(
            sensor,
            temperature,
            name,
            a[0].unit,
            float(first.mean()),
            float(second.mean()),
            (len(a), len(b)),
            _uncertainty(first, second, _noise(a), _noise(b)),
        )


def _known(solutions: Sequence[RunSolution], name: str) -> list[Estimate]:
    found = [each.parameters[name] for each in solutions if name in each.parameters]
    return [each for each in found if each.value is not None]


def _values(estimates: Sequence[Estimate]) -> FloatArray:
    return np.array([each.value for each in estimates], dtype=np.float64)


def _noise(estimates: Sequence[Estimate]) -> float:
    """Return the standard error of the mean by the collects' noise, NaN where a run states none."""
    se = np.array([each.se if each.se is not None else math.nan for each in estimates], dtype=np.float64)
    return float(np.sqrt(np.sum(se**2)) / len(se))


def _uncertainty(now: FloatArray, before: FloatArray, noise: float, noise_before: float) -> float | None:
    """Return the standard uncertainty of the difference of two means; None where nothing tells it."""
    known = [math.hypot(noise, noise_before)]
    degrees = len(now) + len(before) - 2
    if degrees > 0:
        squares = float(np.sum((now - now.mean()) ** 2) + np.sum((before - before.mean()) ** 2))
        scatter = math.sqrt(squares / degrees * (1.0 / len(now) + 1.0 / len(before)))
        known.append(scatter * float(student.isf(_BY_CHANCE, degrees)) / SIGMAS)
    finite = [each for each in known if math.isfinite(each)]
    return max(finite) if finite else None


def _at(temperature: float | None) -> str:
    return "no stated temperature" if temperature is None else f"{temperature:.1f} °C"
