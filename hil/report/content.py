"""What the report says, derived from a campaign and, where there is one, from the journal of the night.

Everything here is plain text and numbers; `page.py` turns it into HTML.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.analysis.against import Comparison
from hil.analysis.in_spec import InSpec
from hil.analysis.night_verdict import night_verdict
from hil.analysis.published.reproduction import reproduce
from hil.campaign import Campaign
from hil.config.sweep import PUBLISHED
from hil.errors import InputError
from hil.files.numbers import decimals_for, degrees
from hil.files.page import filled
from hil.report.night import NightContent
from hil.solve import RunSolution, repeats, solve_campaign
from hil.solve.both_sensors import BothSensors, common_and_differential
from hil.solve.contractor import METHOD
from hil.solve.document import not_passed_of, of_sensors_in_words
from hil.solve.precision import smallest_seen_deg
from hil.solve.repeats import MAY_FOLLOW, SensorRepeats
from hil.solve.temperatures import how_many
from hil.solve.uncertain import MeanAt
from procedures.verdict import NOT_GOOD, Verdict
from procedures.words import counted, listed, numbered

_WANDER = (
    "the noise within a collect is seen within it: a wander slower than about a tenth of the collect is not in the "
    "standard errors (the scatter from run to run shows it)"
)
_UNSEEN_DEG = 5.0  # an error of the site that nobody makes who has looked at a map or a compass


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
        """Return the contractor's mean of the same runs, those that told it, where there is one."""
        means = () if self.contractor_shown is None else self.contractor_shown.means
        return next((each for each in means if not set(each.runs).isdisjoint(mean.runs)), None)


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
    rotors = {each.sensor for each in solutions if published and "MUB" in each.parameters}
    alone = [Campaign(campaign.title, campaign.source, {n: campaign.sensors[n]}) for n in sorted(rotors)]
    contractor = [each for one in alone for each in solve_campaign(one, "collins-4") if each.method == METHOD]
    beside, sensors = repeats(campaign, contractor), []
    for number, shown in repeats(campaign, solutions).items():
        own = [each for each in solutions if each.sensor == number]
        of_run = {each.run: each for each in contractor if each.sensor == number}
        found = None
        with suppress(InputError):  # where no single run has all three of the report's collects
            found = reproduce(campaign, number) if of_run else None
        sensors.append(SensorContent(number, own, of_run, shown, beside.get(number), found))
    return ReportContent(campaign, sensors, night, comparison, common_and_differential(campaign))


def headline(content: ReportContent) -> str:
    """Say in one sentence what was done and whether it is good."""
    made = {number: how_many(rows.conditions) for number, rows in content.campaign.sensors.items()}
    of_all = [f"{next(iter(made.values()))}, {counted(len(made), 'sensor')}"] if len(set(made.values())) == 1 else []
    what = "; ".join(of_all or [f"sensor {number}: {each}" for number, each in made.items()])
    counts = content.verdict_counts()
    verdicts = ", ".join(f"{number} {verdict}" for verdict, number in counts.items())
    night = content.night
    state = ""
    if night is not None and night.state != "complete":
        how = {"failed": "failed", "aborted": "was aborted"}.get(night.state, f"is {night.state}")
        state = f" The night {': '.join(filter(None, [how, night.reason]))}."
    return f"{what}: {verdicts}.{state}" if verdicts else f"nothing solved.{state}"


_OF_THE_UNIT = " What has changed since the earlier campaign is the unit's; a measurement is not judged by it."


def good(content: ReportContent) -> tuple[str, str]:
    """Say whether it is good, by a verdict and a sentence."""
    found = content.solutions
    state = ("incomplete" if content.campaign.missing else "complete") if content.night is None else content.night.state
    judged = night_verdict(state, found).verdict
    if state != "complete":
        missing = f"missing are {'; '.join(content.campaign.missing)}"
        if content.night is not None:
            done, asked = content.night.self_calibrations
            lacks = f"{asked - done} of {asked} self-calibrations are missing"
            missing = lacks if done < asked else content.night.reason
        worst = night_verdict("complete", found).verdict
        there = "what is there is measured well" if worst is Verdict.PASS else f"some of what is there is {worst}"
        return str(judged), f"{state.capitalize()}: {missing}; {there if found else 'nothing was solved'}."
    if not found:
        return str(judged), "Nothing was solved."
    if judged is Verdict.PASS and content.comparison is not None and content.comparison.doubts:
        return str(Verdict.MARGINAL), f"An earlier campaign contradicts this one. {content.comparison.doubts[0]}"
    whole_of = "that was asked for is there, and" if content.night is not None else "that is here is"
    words = {
        Verdict.PASS: f"Measured well: everything {whole_of} as a measurement must be.",
        Verdict.MARGINAL: "Usable, but something deserves a look; the reasons are below.",
        Verdict.INCONCLUSIVE: "Not conclusive: for some of it the evidence does not suffice; the reasons are below.",
        Verdict.FAIL: "Not good: some of it must not be used; the reasons are below.",
    }
    moved = judged is Verdict.PASS and content.comparison is not None and content.comparison.flagged
    return str(judged), f"{words[judged]}{_OF_THE_UNIT if moved else ''}"


def to_do(content: ReportContent) -> list[str]:
    """Return what somebody has to do now: with a night that is not whole, with runs that are not good."""
    wrong_by = [(each, cause) for each in content.solutions for cause in each.causes if cause.verdict in NOT_GOOD]
    unused = {(of.number, run) for of in content.sensors for run in of.shown.not_used}
    errors = {of.number: [each.sd for at in of.shown.means for each in at.values.values()] for of in content.sensors}
    known = {
        "wrong": of_sensors_in_words(not_passed_of(content.solutions)),
        "lacks": {
            cause is each.judged and each.exceeds_errors and each.settled and (each.sensor, each.runs[0]) not in unused
            for each, cause in wrong_by
        },
        "unknown": [number for number, sds in errors.items() if sds and not np.isfinite(sds).any()],
        "to_record": sorted({name for sensor in content.sensors for name in sensor.shown.to_record}),
        "may_follow": MAY_FOLLOW,
    }
    return _filled("to_do", content, **known)


def _filled(what: str, content: ReportContent, **known: Any) -> list[str]:
    words = {"counted": counted, "listed": listed, "numbered": numbered}
    return filled("hil.report", f"{what}.txt.j2", r=content, **known, **words).splitlines()


def largest(content: ReportContent) -> Iterator[str]:
    """Yield of each sensor beside which the contractor's solution stands the largest term that it leaves out."""
    for sensor in (each for each in content.sensors if each.has_contractor):
        known = [(of.values.get(name), name, of) for of in sensor.shown.means for name in ("MUA", "MUB")]
        if sizes := [(value, name, of) for value, name, of in known if value is not None]:
            mean, name, repeat = max(sizes, key=lambda each: abs(each[0].value))
            digits = decimals_for([mean.sd]) - 1
            sigma = f" ±{mean.sd:.{digits}f}" if np.isfinite(mean.sd) else ""
            yield (
                f"Sensor {sensor.number}: the largest term that the contractor's model leaves out is {name} = "
                f"{mean.value:.{digits}f}{sigma} deg/hr/g at {degrees(repeat.temperature_degC, sensor.shown.told_by)}; "
                f"taking it for zero moves {'BB' if name == 'MUA' else 'BA'} by as much, in deg/hr."
            )


def assumed(content: ReportContent) -> list[str]:
    """Return what every number rests upon."""
    found = [text for each in content.solutions for text in each.assumed]
    if not found:
        return ["nothing: no collect was solved"]
    site = content.campaign.site
    told = [f"site: {', '.join(_with_unit(name, value) for name, value in site.items())}"] if site else []
    return list(dict.fromkeys([*told, *found, _WANDER]))


def _with_unit(name: str, value: float) -> str:
    words, _, unit = name.rpartition("_")
    return f"{words.replace('_', ' ')} {value:.4g} {unit}" if words else f"{name} {value:g}"


def cannot_tell(content: ReportContent) -> list[str]:
    """Return what these collects leave open, each thing once."""
    solutions, sensors = content.solutions, content.sensors
    open_things: dict[tuple[int, str], list[int]] = {}
    for each in solutions:
        for text in each.unobservable:
            open_things.setdefault((each.sensor, text), []).extend(each.runs)
    unseen = {name: least for name, least in smallest_seen_deg(content.campaign).items() if least > _UNSEEN_DEG}
    known = {
        "three_collects": any(of.is_rotor for of in sensors) and not any(of.degrees_of_freedom for of in solutions),
        "open": open_things,
        "solved": bool(solutions),
        "unseen": [f"of {n}, {f'below {of:.0f} deg' if of < 90.0 else 'of any size'}" for n, of in unseen.items()],
        "visited_once": any(len(sensor.shown.means) > 1 and _visited_once(sensor) for sensor in sensors),
    }
    nothing = "nothing that the model asks for is left open by these collects" if solutions else "no collect was solved"
    return _filled("cannot_tell", content, **known) or [nothing]


def _visited_once(sensor: SensorContent) -> bool:
    """Whether no temperature was come back to after another: the runs of each follow one another."""
    every = [mean.runs for mean in sensor.shown.means]
    order = sorted(run for runs in every for run in runs)
    return all(order.index(runs[-1]) - order.index(runs[0]) < len(runs) for runs in every)
