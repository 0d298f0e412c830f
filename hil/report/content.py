"""What the report says, derived from a campaign and, where there is one, from the journal of the night.

Everything here is plain text and numbers; `page.py` turns it into HTML.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
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
class SensorContent:
    """One sensor: every single solution, and by `shown` its means by temperature with what repeats show.

    `contractor` holds the contractor's solution by run; `reproduction` is None where the collects are not the report's
    three.
    """

    number: int
    solutions: Sequence[RunSolution]
    contractor: Mapping[int | None, RunSolution]
    shown: SensorRepeats
    contractor_shown: SensorRepeats | None = None
    reproduction: Mapping[str, Any] | None = None

    @property
    def is_rotor(self) -> bool:
        """Whether the sensor has the report's six parameters."""
        return any("MUB" in each.parameters for each in self.solutions)

    @property
    def has_contractor(self) -> bool:
        """Whether its collects are those from which the contractor's solution is made."""
        return any(self.contractors(each) for each in self.shown.means)

    def contractors(self, mean: MeanAt) -> MeanAt | None:
        """Return the contractor's mean of the same runs, where there is one."""
        means = () if self.contractor_shown is None else self.contractor_shown.means
        return next((each for each in means if each.runs == mean.runs), None)


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
    numbers = campaign.sensors if published else ()
    contractor = [each for number in numbers for each in solutions_of_contractor(campaign, number, solutions)]
    beside, sensors = repeats(campaign, contractor), []
    for number, shown in repeats(campaign, solutions).items():
        own = [each for each in solutions if each.sensor == number]
        of_run = {each.run: each for each in contractor if each.sensor == number}
        found = None
        with suppress(InputError):  # where no single run has all three of the report's collects
            found = reproduce(campaign, number) if of_run else None
        sensors.append(SensorContent(number, own, of_run, shown, beside.get(number), found))
    return ReportContent(campaign, sensors, night, comparison, common_and_differential(campaign))


def solutions_of_contractor(campaign: Campaign, sensor: int, solutions: Sequence[RunSolution]) -> Sequence[RunSolution]:
    """The contractor's four-parameter solutions (A-13)-(A-16), where the sensor's collects are the report's three."""
    if not any("MUB" in each.parameters for each in solutions if each.sensor == sensor):
        return ()
    one = Campaign(campaign.title, campaign.source, {sensor: campaign.sensors[sensor]})
    return [each for each in solve_campaign(one, "collins-4") if each.method == METHOD]
