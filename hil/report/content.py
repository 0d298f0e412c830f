"""What the report says, derived from a campaign and, where there is one, from the journal of the night.

Everything here is plain text and numbers; `page.py` turns it into HTML.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hil.analysis.against import Comparison
from hil.analysis.in_spec import InSpec
from hil.analysis.published.reproduction import reproduce
from hil.campaign import Campaign
from hil.config.sweep import PUBLISHED
from hil.errors import InputError
from hil.report.night import NightContent
from hil.solve import RunSolution, repeats, solve_campaign
from hil.solve.both_sensors import BothSensors, common_and_differential
from hil.solve.contractor import METHOD
from hil.solve.repeats import MeanAt, SensorRepeats
from procedures.verdict import Verdict


@dataclass(frozen=True)
class Repeat:
    """The self-calibrations of one sensor at one temperature, and their means by model; `contractor` may lack."""

    runs: tuple[int, ...]
    matrix: MeanAt
    contractor: MeanAt | None

    @property
    def temperature_degC(self) -> float | None:
        """What the runs have in common; None where no temperature is known."""
        return self.matrix.temperature_degC


@dataclass(frozen=True)
class SensorContent:
    """One sensor: its self-calibrations grouped by temperature, and every single solution.

    `contractor` holds the contractor's solution by run; `reproduction` is None where the collects are not the report's
    three; `shown` says what repeats show of every uncertainty.
    """

    number: int
    repeats: Sequence[Repeat]
    solutions: Sequence[RunSolution]
    contractor: Mapping[int | None, RunSolution]
    shown: SensorRepeats
    contractor_shown: SensorRepeats | None = None
    reproduction: Mapping[str, Any] | None = None

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
    both: BothSensors | None = None
    in_spec: InSpec | None = None

    @property
    def solutions(self) -> Sequence[RunSolution]:
        """Every solution of every sensor."""
        return [each for sensor in self.sensors for each in sensor.solutions]

    def verdict_counts(self) -> Mapping[Verdict, int]:
        """How many solutions got which verdict."""
        found = [each.verdict for each in self.solutions]
        return {verdict: found.count(verdict) for verdict in Verdict if verdict in found}


def gather(
    campaign: Campaign, night: NightContent | None = None, comparison: Comparison | None = None, vocabulary: str = ""
) -> ReportContent:
    """Solve the campaign with each sensor's default model and group the self-calibrations by temperature.

    `vocabulary` is by default the night's: only in RD-GC-86-1's does the contractor's solution stand beside.
    """
    solutions = solve_campaign(campaign)
    published = (vocabulary or (night.vocabulary if night else "")) == PUBLISHED
    contractor = {
        (each.run, number): each
        for number in campaign.sensors
        if published
        for each in solutions_of_contractor(campaign, number, solutions)
    }
    matrix, beside = repeats(campaign, solutions), repeats(campaign, list(contractor.values()))
    sensors = []
    for number, shown in matrix.items():
        own = [each for each in solutions if each.sensor == number]
        others = beside.get(number)
        means = {} if others is None else {each.runs: each for each in others.means}
        at = [Repeat(each.runs, each, means.get(each.runs)) for each in shown.means]
        of_run = {run: each for (run, sensor), each in contractor.items() if sensor == number}
        sensors.append(SensorContent(number, at, own, of_run, shown, others, _reproduced(campaign, number, of_run)))
    return ReportContent(campaign, sensors, night, comparison, common_and_differential(campaign))


def _reproduced(
    campaign: Campaign, sensor: int, contractor: Mapping[int | None, RunSolution]
) -> Mapping[str, Any] | None:
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
