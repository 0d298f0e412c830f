"""A campaign against an earlier one of the same unit: what changed, with its uncertainty, and what is beyond chance.

    comparison = Comparison(campaign, earlier)
    [each for each in comparison.differences if each.flagged]

A difference is this campaign's mean at a temperature less the earlier one's, with the standard uncertainty of both
means that every command states (`hil.solve.repeats`); where one of the campaigns repeated nothing, its runs scatter as
those of the other do. It is beyond three sigma where chance makes it so large as rarely
as that, in 0.27 % of cases: of few runs that is more than three of these uncertainties (Student's t). What changed is
what is beyond that and beyond what chance makes of all that were compared: none of them, in 99 % of comparisons. What
one cause makes of many of them is told as that cause (`hil.analysis.one_cause`).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import ndtri

from hil.analysis.night_verdict import night_verdict
from hil.analysis.one_cause import Differ, looks_like
from hil.campaign import Campaign, Collects, FloatArray
from hil.files.numbers import decimals_for, degrees, estimate
from hil.solve import repeats, solve_campaign
from hil.solve.repeats import SensorRepeats
from hil.solve.temperatures import apart, nearest, order_of_runs, runs_by_temperature, why_unsettled
from hil.solve.uncertain import RARE, MeanAt, Uncertain
from procedures.verdict import NOT_GOOD
from procedures.words import first_few, listed, numbered

SIGMAS = 3.0
_LEAST_PLACES = 3  # positions and temperatures in common that a turned sign or crossed channels must explain together
_PLACES = {"latitude_deg": 0.2, "heading_deg": 3.0}  # beyond what two people write of one bench
_MENDED = 0.05  # of the squares of what was different must be left
_SHOWN = 3  # differences in words


@dataclass(frozen=True)
class Difference:
    """One parameter at one temperature, and whose that is: its `means`, this campaign's and the earlier one's."""

    sensor: int
    parameter: str
    means: tuple[Uncertain, Uncertain]
    temperature_degC: float | None
    temperature_of: str | None
    unit_degC: tuple[float, float] | None

    @property
    def difference(self) -> Uncertain:
        """This campaign's mean less the earlier one's; its sd is NaN where neither noise nor scatter is known."""
        return self.means[0].less(self.means[1])

    @property
    def flagged(self) -> bool:
        """Whether chance makes so large a difference as rarely as one of three sigma."""
        return abs(self.difference.value) > self.difference.expanded(SIGMAS)

    @property
    def sentence(self) -> str:
        """Both means and their difference in words."""
        digits, (now, earlier) = decimals_for([self.difference.sd]), self.means
        at, by = degrees(self.temperature_degC, self.temperature_of, self.unit_degC), estimate(self.difference, digits)
        apart = f"a difference of {' '.join(by)} {now.unit}"
        was = f"{self.parameter} is {now.value:.{digits}f} now and was {earlier.value:.{digits}f}"
        return f"sensor {self.sensor}, {at}: {was}, {apart}"


class Comparison:
    """What two campaigns have in common, sensor by sensor, temperature by temperature (matched to 2 °C).

    `differences` of their means, and the `causes` that make all of that, in words; in `remarks` what must be
    known about them, of which `doubts` contradict this campaign; `without` says by sensor and temperature why there is
    none, and `meaningless` why no difference says anything of the unit: the same rates, two units, a bad campaign.
    `source` is who recorded the earlier one, and when.
    """

    def __init__(self, campaign: Campaign, earlier: Campaign) -> None:
        self.earlier, self.simulated, self.source = earlier.title, earlier.simulated, earlier.source
        self.differences: list[Difference] = []
        self.without: dict[tuple[int, float | None], str] = {}
        solved = solve_campaign(campaign), solve_campaign(earlier)
        now, before = repeats(campaign, solved[0]), repeats(earlier, solved[1])
        units = _unit(campaign), _unit(earlier)
        itself, told = list(_itself(campaign, earlier)), list(_units(*units))
        slips = [*_slips(campaign, earlier)]
        self._apart = [*slips, *_sites(campaign.site, earlier.site)]
        self.remarks = remarks = [*self._apart, *itself, *told, *_orders(campaign, earlier)]
        judged = night_verdict("complete", solved[1])
        bad = [f"The earlier campaign is {judged.verdict}: {judged.reason}."] if judged.verdict in NOT_GOOD else []
        self.meaningless = next(iter([*itself, *(told if all(units) and units[0] != units[1] else []), *bad]), "")
        for sensor, shown in now.items():
            if sensor not in before:
                remarks.append(f"The earlier campaign has no sensor {sensor}.")
                continue
            late = [[e for e in of if e.sensor == sensor and not e.settled] for of in solved]
            moving = [{run: [each.reason for each in e.beside] for e in of for run in e.runs} for of in late]
            for mean in shown.means:
                match, where = before[sensor].at(mean.temperature_degC), shown.where(mean)
                if why := _not_comparable(mean, match, moving):
                    self.without[sensor, mean.temperature_degC] = why
                    remarks.append(f"Sensor {sensor} at {degrees(**where)}: {why}.")
                elif match:
                    both = {
                        name: (one, match.values[name]) for name, one in mean.values.items() if name in match.values
                    }
                    self.differences += [Difference(sensor, name, each, **where) for name, each in both.items()]
        self._sigmas = max(SIGMAS, float(-ndtri(0.5 * RARE / max(len(self.differences), 1))))
        causes = {} if self.meaningless or slips else dict(self._causes(earlier, before))
        self.causes, self._caused = [told for told, _ in causes.values()], causes.keys()
        self.doubts = [*self._apart, *(f"{told[0].upper()}{told[1:]}." for told, scaled in causes.values() if scaled)]
        if not all(math.isfinite(each.difference.sd) for each in self.differences):
            remarks.append(
                "Where no uncertainty is given, neither standard errors nor repeats are there to tell it from."
            )

    @property
    def flagged(self) -> Sequence[Difference]:
        """The differences beyond chance, of all that were compared."""
        return [each for each in self.differences if self.counts(each)]

    def counts(self, each: Difference) -> bool:
        """Whether a difference is beyond what chance makes of all that were compared."""
        return abs(each.difference.value) > each.difference.expanded(self._sigmas)

    def _causes(self, earlier: Campaign, before: Mapping[int, SensorRepeats]) -> Iterator[tuple[int, tuple[str, bool]]]:
        """Yield by sensor what makes all its differences, where one cause or two do, and whether that is a gain."""
        changed = {each.sensor for each in self.flagged}
        for sensor in sorted({each.sensor for each in self.differences}, key=lambda each: each not in changed):
            of = [(each, each.difference) for each in self.differences if each.sensor == sensor]
            of = [(each, by) for each, by in of if math.isfinite(by.sd) and by.sd > 0.0]
            values, bound = np.array([(by.value, by.expanded(self._sigmas)) for _, by in of]).reshape(-1, 2).T
            places = [(each.parameter, each.temperature_degC) for each, _ in of]
            differ = Differ(places, values, bound / self._sigmas, bound)
            told, scaled = looks_like(sensor, differ, earlier, before[sensor], self._sigmas) if of else ("", False)
            if told:
                that = "all of that looks" if sensor in changed else "none alone, but all together look"
                yield sensor, (f"sensor {sensor}: {that} like {told}", scaled)

    @property
    def agreeing(self) -> str:
        """Say which values are as they were, none where all together differ, and by how much the others are not."""
        if not (found := self.flagged):
            return ""
        by = sorted(abs(each.difference.value) / each.difference.sd for each in found)
        far = " to ".join(dict.fromkeys(f"{each:.2g}" for each in (by[0], by[-1])))
        changed, known = {(each.sensor, each.parameter) for each in found}, {each.sensor for each in found}
        same = dict[int, dict[str, None]]()
        for each in self.differences:
            if (each.sensor, each.parameter) not in changed and each.sensor not in self._caused - known:
                same.setdefault(each.sensor, {})[each.parameter] = None
        named = "; ".join(f"sensor {number}: {listed(list(names))}" for number, names in same.items())
        agree = f"at every temperature these agree, {named}" if named else "no parameter agrees at every temperature"
        return f"they differ by {far} times their ±; {agree}"

    @property
    def sentence(self) -> str:
        """What was found, in one sentence."""
        if not self.differences:
            return f"nothing can be compared with “{self.earlier}”: {self._why_nothing}"
        found, all_of = len(self.flagged), len(self.differences)
        alone = all(mean.beyond is None for each in self.differences for mean in each.means)
        unknown = ", and beside it whatever changes from run to run, which neither repeats" * alone
        of = sorted({sensor for sensor, _ in self.without})
        less = f"; not compared is, of {numbered('sensor', of)}, what was {self._why_nothing}" if of else ""
        return (
            f"{found} of {all_of} differences from “{self.earlier}” {'is' if found == 1 else 'are'} beyond chance, "
            f"which alone brings any there in {100.0 * RARE:g} % of comparisons{unknown}{less}"
        )

    @property
    def _why_nothing(self) -> str:
        """Why there is no difference: the first cause, with the temperatures for which it holds, and how many more."""
        levels: dict[str, list[str]] = {}
        for (_, degC), why in self.without.items():
            levels.setdefault(why, []).append("no recorded temperature" if degC is None else f"{degC:z.0f} °C")
        why, at = next(iter(levels.items()), ("no sensor has a parameter in both", []))
        rest = len(self.without) - len(at)
        return f"at {listed(list(dict.fromkeys(at)))} " * bool(at) + why + f"; and {rest} more (below)" * (rest > 0)

    @property
    def first(self) -> Sequence[Difference]:
        """The first few of the differences beyond chance."""
        return first_few(self.flagged, _SHOWN)[0]

    def sentences(self) -> list[str]:
        """Say what was found, the first of it, and what contradicts that."""
        marked = self.sentence + "; the earlier campaign is SIMULATED" * self.simulated
        why = dict.fromkeys(filter(None, [*self._apart, self.meaningless]))
        rest = len(self.flagged) - len(self.first)
        more = [f"and {rest} more: the page has all"] * (rest > 0)
        same = filter(None, [self.agreeing])
        return [marked, *same, *self.causes, *(each.sentence for each in self.first), *more, *why]


_Place = tuple[str, tuple[int, ...]]  # a position, and the runs of one temperature


def _not_comparable(mean: MeanAt, match: MeanAt | None, moving: Sequence[Mapping[int, list[str]]]) -> str:
    """Return why a mean cannot be compared with the earlier one that matches it; empty where it can."""
    if match is None:
        return "the earlier campaign has no such temperature"
    for whose, of, moved in zip(("", "the earlier campaign's "), (mean, match), moving, strict=True):
        if runs := moved.keys() & {*of.runs}:
            return f"{whose}{numbered('run', runs)}: {why_unsettled(each for run in runs for each in moved[run])}"
    own = match.unit_degC
    if own is None or not apart(own, mean.unit_degC):
        return ""
    at = " … ".join(dict.fromkeys(f"{each:.1f}" for each in own))
    return f"not the same temperature: in the earlier campaign the unit was at {at} °C"


def _itself(campaign: Campaign, earlier: Campaign) -> Iterator[str]:
    pairs = [(rows, other) for n, rows in campaign.sensors.items() if (other := earlier.sensors.get(n)) is not None]
    if all(np.array_equal(a.rates_deg_per_hr, b.rates_deg_per_hr, equal_nan=True) for a, b in pairs) and pairs:
        yield (
            "Both hold the very same rates: the campaign is compared with itself, or with a copy whose other columns "
            "were changed, and nothing can differ."
        )


def _slips(campaign: Campaign, earlier: Campaign) -> Iterator[str]:
    """Yield which channels, turned or exchanged (with another sensor's, too), would agree again."""
    channels: dict[tuple[int, str], dict[_Place, FloatArray]] = {}
    for number in sorted(campaign.sensors.keys() & earlier.sensors.keys()):
        now, before = campaign.sensors[number], earlier.sensors[number]
        if list(now.conditions.sensor.channels) == list(before.conditions.sensor.channels):
            for place, rates in _same_place(now, before):
                for name, pair in zip(now.conditions.sensor.channels, rates.T, strict=True):
                    channels.setdefault((number, name), {})[place] = pair
    known = {each: rates for each, rates in channels.items() if len(rates) >= _LEAST_PLACES}
    away = {each: len(rates) * np.var(np.diff(list(rates.values()))) for each, rates in known.items()}  # beside a bias
    for (number, name), pairs in known.items():
        now, before = np.array(list(pairs.values())).T
        if np.sum((now + before) ** 2) < _MENDED * away[number, name]:
            yield f"Sensor {number}: the sign of {name} looks turned: with minus it agrees with the earlier rates."
    for one, other in combinations(known, 2):
        both = np.array([[known[one][place], known[other][place]] for place in known[one].keys() & known[other].keys()])
        if len(both) >= _LEAST_PLACES and np.sum((both[:, :, 0] - both[:, ::-1, 1]) ** 2) < _MENDED * (
            away[one] + away[other]
        ):
            of = f"Sensor {one[0]}" if one[0] == other[0] else f"Sensors {one[0]} and {other[0]}"
            yield f"{of}: {one[1]} and {other[1]} look exchanged: crosswise they agree with the earlier rates."


def _same_place(now: Collects, before: Collects) -> Iterator[tuple[_Place, FloatArray]]:
    """Yield the mean rates, (2, c), of both campaigns at each position and temperature that they have in common."""
    for temperature, runs in runs_by_temperature(now.conditions):
        groups = dict(runs_by_temperature(before.conditions))
        if (match := nearest(temperature, groups)) not in groups:
            continue
        for label in np.unique(now.conditions.position):
            here = (now.conditions.position == label) & np.isin(now.conditions.run, runs)
            there = (before.conditions.position == label) & np.isin(before.conditions.run, groups[match])
            means = [rows.rates_deg_per_hr[chosen] for rows, chosen in ((now, here), (before, there))]
            if all(len(each) and np.isfinite(each).all() for each in means):
                yield (str(label), tuple(runs)), np.array([each.mean(axis=0) for each in means])


def _sites(now: Mapping[str, float], before: Mapping[str, float]) -> Iterator[str]:
    for key, far in _PLACES.items():
        if key in now and key in before and abs(now[key] - before[key]) > far:
            what = key.removesuffix("_deg")
            yield f"The {what} is {now[key]:g} deg now and was {before[key]:g}: was the bench moved, or is one wrong?"


def _orders(campaign: Campaign, earlier: Campaign) -> Iterator[str]:
    for number in sorted(campaign.sensors.keys() & earlier.sensors.keys()):
        both = ({*order_of_runs(of.sensors[number].conditions).values()} for of in (campaign, earlier))
        now, before = (sorted("-".join(order) for order in orders) for orders in both)
        if not {*now} & {*before}:
            was = f"Collects were taken in the order {listed(now, 2)} now and {listed(before, 2)} before"
            yield f"{was}: what drifts through a run, or is missing from the model, moves their values otherwise."
            return


def _unit(campaign: Campaign) -> str:
    return " ".join(campaign.identity[name] for name in ("model", "serial") if name in campaign.identity)


def _units(unit: str, earlier_unit: str) -> Iterator[str]:
    if not unit or not earlier_unit:
        yield "That both campaigns are of the same unit is taken on trust: the records do not say."
    elif unit != earlier_unit:
        yield f"These are two units, {unit} now and {earlier_unit} before: what differs may be that."
