"""Whether a unit is in spec: its parameters against a limits file, beside whether it was measured well.

    found = judge(limits, repeats(campaign, solutions), night_verdict("complete", solutions))
    found.word                     # in spec, out of spec, cannot tell
    found.characteristics[0].word  # so of one parameter at one temperature

By a guard band (ISO 14253-1, ILAC-G8) a characteristic is in spec where all of the interval that it is known to lie in
is within its limits, out of spec where none of it is, and cannot be told otherwise. The interval is k·u on either side,
u being the uncertainty of the unit's parameter that `hil.solve.repeats` states, with Student's t for few repeats: so a
unit whose parameter lies on a limit is called in spec as rarely as k sigma are passed on one side, 2.3 % of times at
k = 2. A scatter's interval is that of chi-square at the same probability. Simple acceptance takes the value alone.
A measurement that is FAIL or INCONCLUSIVE tells nothing of the unit.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from itertools import combinations
from pathlib import Path
from typing import Any

from scipy.special import chdtri, ndtr

from hil.analysis.against import Comparison
from hil.analysis.night_verdict import night_verdict
from hil.campaign import Campaign
from hil.config.limits import Limits, ParameterLimits, load_limits
from hil.config.recorded import recorded_limits
from hil.files.numbers import decimals_for, degrees
from hil.records import reading
from hil.records.reader import is_night
from hil.records.status import night_status
from hil.solve import RunSolution, repeats
from hil.solve.repeats import SensorRepeats
from hil.solve.temperatures import why_unsettled
from hil.solve.uncertain import MeanAt, Uncertain
from procedures.verdict import NOT_GOOD, Judgement
from procedures.words import counted, numbered

_ALONE = "nothing was repeated, so what changes from run to run is not known: measure a temperature more than once"
_ONCE = "no temperature was measured twice: measure one more than once"
_UNEVEN = "it scatters more at some temperatures than at others, so that no one uncertainty holds at each"
_NO_TEMPERATURE = "no temperature was recorded: runs at different ones may count as repeats"
_NO_EARLIER = "no earlier campaign was given to compare with (--against)"
_OF = {"value": "", "scatter": " from run to run", "change": ", change since the earlier campaign", "span": ", span"}


class Word(StrEnum):
    """Whether a unit, or one of its characteristics, is in spec."""

    IN = "in spec"
    OUT = "out of spec"
    UNKNOWN = "cannot tell"


_Ends = tuple[float | None, float | None]


@dataclass(frozen=True)
class Characteristic:
    """What a limit is of: a parameter's `value` at a temperature, `scatter`, `change` at a temperature, or `span`.

    `temperature_of` is the column that the temperature is of, `unit_degC` what the unit's own thermometer showed.
    `interval` is where it lies by the decision rule, None where nobody can tell, and then `reason` says why.
    """

    sensor: int
    parameter: str
    of: str
    limits: _Ends
    unit: str = ""
    temperature_degC: float | None = None
    temperature_of: str | None = None
    unit_degC: tuple[float, float] | None = None
    value: float | None = None
    interval: tuple[float, float] | None = None
    reason: str = ""

    @property
    def word(self) -> Word:
        """Whether it is in spec: the limits themselves are."""
        if self.interval is None or not all(map(math.isfinite, self.interval)):
            return Word.UNKNOWN
        least = -math.inf if self.limits[0] is None else self.limits[0]
        most = math.inf if self.limits[1] is None else self.limits[1]
        if least <= self.interval[0] and self.interval[1] <= most:
            return Word.IN
        return Word.OUT if self.interval[1] < least or self.interval[0] > most else Word.UNKNOWN

    @property
    def name(self) -> str:
        """Which it is, in words."""
        where = degrees(self.temperature_degC, self.temperature_of, self.unit_degC)
        at = "" if self.temperature_degC is None else f" at {where}"
        return f"sensor {self.sensor}, {self.parameter}{_OF[self.of]}{at}"

    @property
    def sentence(self) -> str:
        """What was found of it, and what it may be."""
        wide = [abs(end - (self.value or 0.0)) for end in self.interval or ()]
        digits = decimals_for(wide)
        if self.value is None or self.interval is None:
            return f"{self.name}: {self.reason}"
        within = f", within {self.interval[0]:.{digits}f} … {self.interval[1]:.{digits}f}" if max(wide) > 0.0 else ""
        return f"{self.name}: {self.value:.{digits}f}{within}; allowed is {self.allowed} {self.unit}"

    @property
    def allowed(self) -> str:
        """The limits in words."""
        least, most = self.limits
        if least is None or most is None:
            return f"at most {most:g}" if least is None else f"at least {least:g}"
        return f"{least:g} … {most:g}"

    def document(self) -> dict[str, Any]:
        """Return the JSON of it: null where a thing is not known, or no limit."""
        known = self.interval if self.interval and all(map(math.isfinite, self.interval)) else (None, None)
        plain = {name: value for name, value in asdict(self).items() if name not in ("limits", "interval", "of")}
        ends = {"low": known[0], "high": known[1], "limit_low": self.limits[0], "limit_high": self.limits[1]}
        return {**plain, **ends, "characteristic": self.of, "verdict": str(self.word)}


@dataclass(frozen=True)
class InSpec:
    """What the limits say of a unit, beside how it was `measured`."""

    limits: Limits
    measured: Judgement
    characteristics: Sequence[Characteristic]

    def those(self, word: Word) -> Sequence[Characteristic]:
        """Return the characteristics that are so."""
        return [each for each in self.characteristics if each.word is word]

    @property
    def word(self) -> Word:
        """In spec where all characteristics are; never where the measurement is not good."""
        if self.measured.verdict in NOT_GOOD:
            return Word.UNKNOWN
        return next((word for word in (Word.OUT, Word.UNKNOWN) if self.those(word)), Word.IN)

    @property
    def reason(self) -> str:
        """Why, in a sentence."""
        count, out = len(self.characteristics), self.those(Word.OUT)
        if self.measured.verdict in NOT_GOOD:
            would = f"; by the runs that are good {len(out)} of {counted(count, 'limit')} would be broken"
            return f"the measurement is {self.measured.verdict}: {self.measured.reason}{would if out else ''}"
        if self.word is Word.IN:
            return f"{counted(count, 'limit')} of {count} kept, by {self.limits.rule}"
        those, what = self.those(self.word), "broken" if self.word is Word.OUT else "cannot be told"
        return (
            f"{len(those)} of {counted(count, 'limit')} {what}, by {self.limits.rule}; the first: {those[0].sentence}"
        )

    def sentences(self) -> list[str]:
        """Say what the unit is, and each characteristic that is not in spec."""
        said = f"{self.word.upper()}: {self.reason} ({self.limits.title}; {self.limits.source})"
        doubtful = [*self.those(Word.OUT), *self.those(Word.UNKNOWN)]
        return [said, *(f"{each.word}: {each.sentence}" for each in doubtful)]

    def brief(self) -> dict[str, str]:
        """Return what is recorded of a night: the word, why, and by which limits."""
        by = {"title": self.limits.title, "origin": self.limits.origin, "decision": self.limits.rule}
        return {"verdict": str(self.word), "reason": self.reason, **by}

    def document(self) -> dict[str, Any]:
        """Return the JSON of it, every characteristic included."""
        return {**self.brief(), "characteristics": [each.document() for each in self.characteristics]}


def judge(
    limits: Limits,
    shown: Mapping[int, SensorRepeats],
    solutions: Sequence[RunSolution],
    measured: Judgement,
    comparison: Comparison | None = None,
) -> InSpec:
    """Judge a unit by what repeats show of each sensor; `comparison` with an earlier campaign tells its changes."""
    found: list[Characteristic] = []
    for number, of in limits.sensors.items():
        own = [each for each in solutions if each.sensor == number]
        bad = {run for each in own if each.verdict in NOT_GOOD for run in each.runs}
        moving = {run: [of.reason for of in each.beside] for each in own if not each.settled for run in each.runs}
        alone = {run for each in own if not each.compared for run in each.runs}
        for name, each in of.items():
            if number not in shown or name not in shown[number].names:
                found.append(
                    Characteristic(number, name, "value", (each.low, each.high), reason="no run could tell it")
                )
                continue
            one = _Judged(limits, number, name, each, shown[number], bad, moving, alone)
            found += [*one.values(), *one.scatter(), *one.span(), *one.change(comparison)]
    return InSpec(limits, measured, found)


@dataclass(frozen=True)
class _Judged:
    """One parameter of one sensor, of which some runs are `bad`, `moving` or have no other to be compared with."""

    rule: Limits
    sensor: int
    name: str
    limits: ParameterLimits
    shown: SensorRepeats
    bad: set[int]
    moving: Mapping[int, list[str]]
    alone: set[int]

    def _doubt(self, means: Sequence[MeanAt]) -> str:
        """Say why these means tell nothing of the unit; empty where they do."""
        if any(self.name not in mean.values for mean in means):
            return "no run could tell it here"
        told = [self.shown.runs_of(mean, self.name) for mean in means]
        every = {run for runs in told for run in runs}
        if found := self.bad & every:
            return f"{numbered('run', found)}: not good (INCONCLUSIVE or FAIL)"
        if late := self.moving.keys() & every:
            return f"{numbered('run', late)}: {why_unsettled(of for run in late for of in self.moving[run])}"
        if self.rule.sigmas and any(mean.values[self.name].beyond is None for mean in means):
            return _ALONE
        if self.shown.uneven[self._place] and self.rule.sigmas:
            return _UNEVEN
        single = self.alone.intersection(runs[0] for runs in told if len(runs) == 1)
        once = "measured once, beside nothing that would show a wrong collect: repeat it"
        return f"{numbered('run', single)}: {once}" if single and self.rule.sigmas else ""

    @property
    def _place(self) -> int:
        return self.shown.names.index(self.name)

    @property
    def _degrees(self) -> int:
        return int(self.shown.spread.degrees[self._place])

    def _wide(self, of: Uncertain) -> float:
        """Return half the interval of a mean, or of a difference of two."""
        return of.expanded(self.rule.sigmas) if self.rule.sigmas else 0.0

    def _told(
        self, of: str, limits: _Ends, doubt: str, value: float | None = None, *ends: float, **at: Any
    ) -> Characteristic:
        unit, known = self.shown.units[self._place], (ends[0], ends[1]) if ends and not doubt else None
        return Characteristic(self.sensor, self.name, of, limits, unit, value=value, interval=known, reason=doubt, **at)

    def _told_at(self, at: MeanAt, of: str, limits: _Ends, doubt: str, found: Uncertain | None) -> Characteristic:
        ends = () if found is None else (found.value, found.value - self._wide(found), found.value + self._wide(found))
        return self._told(of, limits, doubt, *ends, **self.shown.where(at))

    def values(self) -> Iterator[Characteristic]:
        limits = (self.limits.low, self.limits.high)
        for mean in self.shown.means if limits != (None, None) else ():
            yield self._told_at(mean, "value", limits, self._doubt([mean]), mean.values.get(self.name))

    def scatter(self) -> Iterator[Characteristic]:
        limits = (None, self.limits.scatter)
        doubt = self._doubt([e for e in self.shown.means if self.name in e.values and e.values[self.name].runs > 1])
        doubt = doubt or (_ONCE if not self._degrees else "" if self.shown.told_by else _NO_TEMPERATURE)
        if self.limits.scatter is not None and doubt:
            yield self._told("scatter", limits, doubt)
        elif self.limits.scatter is not None:
            sd, chance = float(self.shown.spread.observed[self._place]), float(ndtr(-self.rule.sigmas))
            ends = [sd * math.sqrt(self._degrees / chdtri(self._degrees, each)) for each in (chance, 1.0 - chance)]
            yield self._told("scatter", limits, "", sd, *(ends if self.rule.sigmas else (sd, sd)))

    def span(self) -> Iterator[Characteristic]:
        limits, doubt = (None, self.limits.span), self._doubt(self.shown.means)
        if len(self.shown.means) < 2:
            doubt = "it takes two temperatures or more"
        if self.limits.span is not None and doubt:
            yield self._told("span", limits, doubt)
        elif self.limits.span is not None:
            pairs = combinations([mean.values[self.name] for mean in self.shown.means], 2)
            every = [one.less(other, told_together=True) for one, other in pairs]
            apart = [(abs(each.value), self._wide(each)) for each in every]
            least, most = max(size - wide for size, wide in apart), max(size + wide for size, wide in apart)
            yield self._told("span", limits, "", max(apart)[0], max(least, 0.0), most)

    def change(self, comparison: Comparison | None) -> Iterator[Characteristic]:
        if self.limits.change is None:
            return
        limits = (-self.limits.change, self.limits.change)
        if comparison is None:
            yield self._told("change", limits, _NO_EARLIER)
            return
        found = {(each.sensor, each.parameter, each.temperature_degC): each for each in comparison.differences}
        whole = next(filter(None, [comparison.meaningless, *comparison.doubts]), "")
        for mean in self.shown.means:
            at, doubt = mean.temperature_degC, whole or self._doubt([mean])
            if (each := found.get((self.sensor, self.name, at))) is None:
                doubt = doubt or comparison.without.get((self.sensor, at), "the earlier campaign has no such mean")
                yield self._told_at(mean, "change", limits, doubt, None)
            else:
                yield self._told_at(mean, "change", limits, doubt, each.difference)


def in_spec_of(
    source: Path,
    campaign: Campaign | None,
    solutions: Sequence[RunSolution],
    name: str | None = None,
    comparison: Comparison | None = None,
    state: str = "",
) -> InSpec | None:
    """Judge what is in a folder by the limits of that `name`, or else by those that the night has on record.

    `state` is the night's (of hil.status/1) where the caller knows it. None where there are no limits. Raises
    `InputError` for limits that are not there, or not of such a unit.
    """
    night = is_night(source)
    limits = None if name is None else load_limits(name)
    if limits is not None and campaign is not None:
        sensors = {number: each.conditions.sensor for number, each in campaign.sensors.items()}
        there = {number: of for number, of in limits.sensors.items() if number in sensors}
        limits.model_copy(update={"sensors": there or limits.sensors}).check(
            sensors, campaign.identity.get("model", "")
        )
    elif limits is None and night:
        with reading(source) as journal:
            limits = recorded_limits(journal.night.configuration)
    if limits is None:
        return None
    if not state:
        lacks = campaign is not None and bool(campaign.missing)
        state = night_status(source)["state"] if night else "incomplete" if lacks else "complete"
    shown = {} if campaign is None else repeats(campaign, solutions)
    return judge(limits, shown, solutions, night_verdict(state, solutions), comparison)
