"""What the report says, derived from a campaign and, where there is one, from the journal of the night.

Everything here is plain text and numbers; `page.py` turns it into HTML.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.analysis.published.reproduction import Reproduction, reproduce
from hil.analysis.scatter.both_sensors import common_and_differential
from hil.analysis.scatter.signature import ScatterSignature
from hil.analysis.scatter.sources import campaign_signatures
from hil.campaign import Campaign, FloatArray
from hil.errors import InputError
from hil.report.against import Comparison
from hil.report.night import NightContent
from hil.solve import RunSolution, solve_campaign
from hil.solve.contractor import METHOD
from hil.solve.temperatures import runs_by_temperature
from procedures.verdict import Verdict


@dataclass(frozen=True)
class Repeat:
    """The self-calibrations of one sensor at one temperature, by model: parameter name to values, shape (runs,)."""

    temperature_degC: float | None
    runs: tuple[int, ...]
    matrix: Mapping[str, FloatArray]
    contractor: Mapping[str, FloatArray]


@dataclass(frozen=True)
class SensorContent:
    """One sensor: its self-calibrations grouped by temperature, and every single solution.

    `contractor` holds the contractor's solution by run; `reproduction` is None where the collects are not the report's
    three; `scatter` says what the repeats scattered by, temperature by temperature and pooled.
    """

    number: int
    repeats: Sequence[Repeat]
    solutions: Sequence[RunSolution]
    contractor: Mapping[int | None, RunSolution]
    reproduction: Reproduction | None = None
    scatter: Sequence[ScatterSignature] = ()

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of all parameters that some run was solved for."""
        return tuple(dict.fromkeys(name for solution in self.solutions for name in solution.parameters))

    @property
    def is_rotor(self) -> bool:
        """Whether the sensor has the report's six parameters."""
        return "MUB" in self.parameter_names

    @property
    def has_contractor(self) -> bool:
        """Whether its collects are those from which the contractor's solution is made."""
        return any(repeat.contractor for repeat in self.repeats)


@dataclass(frozen=True)
class ReportContent:
    """Everything that the report shows."""

    campaign: Campaign
    sensors: Sequence[SensorContent]
    night: NightContent | None = None
    comparison: Comparison | None = None
    both_sensors: Sequence[str] = ()

    def verdict_counts(self) -> Mapping[Verdict, int]:
        """How many solutions got which verdict."""
        found = [each.verdict for sensor in self.sensors for each in sensor.solutions]
        return {verdict: found.count(verdict) for verdict in Verdict if verdict in found}


def gather(
    campaign: Campaign, night: NightContent | None = None, comparison: Comparison | None = None
) -> ReportContent:
    """Solve the campaign with each sensor's default model and group the self-calibrations by temperature."""
    solutions = solve_campaign(campaign)
    contractor = {
        (each.run, number): each
        for number in campaign.sensors
        for each in solutions_of_contractor(campaign, number, solutions)
    }
    scatter = campaign_signatures(campaign)
    sensors = []
    for number, collects in campaign.sensors.items():
        own = [each for each in solutions if each.sensor == number]
        repeats = [
            _repeat(temperature, runs, own, contractor)
            for temperature, runs in runs_by_temperature(collects.conditions)
        ]
        beside = {run: each for (run, sensor), each in contractor.items() if sensor == number}
        own_scatter = [each for each in scatter if each.sensor == number]
        sensors.append(SensorContent(number, repeats, own, beside, _reproduced(campaign, number, beside), own_scatter))
    both = common_and_differential(campaign)
    return ReportContent(campaign, sensors, night, comparison, () if both is None else both.sentences())


def _reproduced(campaign: Campaign, sensor: int, contractor: Mapping[int | None, RunSolution]) -> Reproduction | None:
    if not contractor:
        return None
    try:
        return reproduce(campaign, sensor)
    except InputError:  # no single run has all three of the report's collects
        return None


def solutions_of_contractor(campaign: Campaign, sensor: int, solutions: Sequence[RunSolution]) -> Sequence[RunSolution]:
    """The contractor's four-parameter solutions (A-13)-(A-16), where the sensor's collects are the report's three."""
    if not any("MUB" in each.parameters for each in solutions if each.sensor == sensor):
        return ()
    one = Campaign(campaign.title, campaign.source, {sensor: campaign.sensors[sensor]})
    return [each for each in solve_campaign(one, "collins-4") if each.method == METHOD]


def _repeat(
    temperature: float | None,
    runs: tuple[int, ...],
    solutions: Sequence[RunSolution],
    contractor: Mapping[tuple[int | None, int], RunSolution],
) -> Repeat:
    own = [each for each in solutions if each.run in runs]
    beside = [contractor[each.run, each.sensor] for each in own if (each.run, each.sensor) in contractor]
    return Repeat(temperature, runs, _values(own), _values(beside))


def _values(solutions: Sequence[RunSolution]) -> Mapping[str, FloatArray]:
    names = dict.fromkeys(name for each in solutions for name in each.parameters)
    return {
        name: np.array([each.parameters[name].value for each in solutions if name in each.parameters], dtype=np.float64)
        for name in names
    }
