"""Screen many units that were measured in the same way: what is missing, in which of them, in all of them.

Every term is tried at a few models of the noise, in many units at once; where that finds something, again at all that
forty units of the fleet leave probable; and where that does, too, at those that the unit's own rates leave. What weighs
a unit never depends on which others are weighed, so that processes may share the work. Values of the base stand or
follow temperature, whichever is more probable in those forty, as in `hil reconcile`.

Units whose layout differs (a missing row, another order, other temperatures) need a screen of their own; what an effect
follows (supply, temperature) is taken from the first unit. Discoveries over units are held to a false discovery rate;
what a screening finds is worth a full `reconcile`, nothing more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.campaign import Campaign, Conditions, FloatArray, IntArray
from hil.campaign.stand_ins import WIDEST_DEGC
from hil.errors import InputError
from hil.model import Model, fitting_campaign
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, VARIANCE_EFFECTS
from hil.model.effects.geometry import LEVEL
from hil.model.effects.prior import log_sum
from hil.reconcile.proof.places import false_discovery
from hil.reconcile.rivals import CERTAIN
from hil.reconcile.search.block_search import GLANCED
from hil.reconcile.search.layout import may_be_calibrated, searches
from hil.reconcile.search.lookalikes import names_alike
from hil.reconcile.search.problem import pose
from hil.reconcile.search.sets import LEADING, SensorSearch
from hil.solve.temperatures import ELSEWHERE_DEGC, same_temperature

NOISY_UNITS = 40  # evenly over the fleet, say what noise is: one alone knows its own too badly to judge others by
ASKED_UNITS = 8  # so many of these say whether the base's values follow temperature
FRACTIONS = (0.01, 0.03, 0.1, 0.3, 0.6, 1.0)  # of the fleet, the shares that may have a shared effect
ASKED_AGAIN = 0.5  # log odds from which a unit is weighed again at all of them: a discovery takes three and more
CALLED = 2.5  # log odds from which the unit's own noise is asked, of every discovery: q < .05 takes odds of 19
TOGETHER = 16  # units that are weighed at once: their numbers then stay in the processor's cache


def beside_the_earth(campaign: Campaign) -> dict[int, FloatArray]:
    """Return the rates of each sensor less the earth's, (n, c) deg/hr: what of a unit is no part of the layout."""
    return {n: of.rates_deg_per_hr - of.conditions.w_channels_deg_per_hr for n, of in campaign.sensors.items()}


class Stood:
    """How the sensors of a campaign stood, by their number: in which positions and runs, at which temperatures."""

    def __init__(self, conditions: Mapping[int, Conditions]) -> None:
        none = {n: np.full(len(rows), -1) for n, rows in conditions.items()}
        known = {n: same_temperature(rows) for n, rows in conditions.items() if "temperature_degC" in rows.columns}
        self._known = {
            n: (rows, np.unique(rows.run, return_inverse=True)[1], (none | known)[n]) for n, rows in conditions.items()
        }

    def like(self, campaign: Campaign) -> bool:
        """Whether every sensor stood so in another campaign, so that what is laid out for one serves the other."""
        others = campaign.sensors
        return all(n in others and _alike(others[n].conditions, *known) for n, known in self._known.items())


def _alike(other: Conditions, known: Conditions, order: IntArray, levels: IntArray) -> bool:
    told = [rows.columns.get("temperature_degC") for rows in (other, known)]
    same = len(known) == len(other) and known.sensor.channels == other.sensor.channels
    if not same or len({of is None for of in told}) > 1:
        return False
    if np.any(order != np.unique(other.run, return_inverse=True)[1]) or np.any(np.abs(known.f_g - other.f_g) >= LEVEL):
        return False
    apart = np.subtract(*(np.zeros(len(known)) if of is None else of for of in told))
    near = bool(np.all(np.abs(apart[levels >= 0]) <= WIDEST_DEGC))
    return near and all(abs(np.mean(apart[levels == k])) <= ELSEWHERE_DEGC for k in set(levels[levels >= 0].tolist()))


@dataclass(frozen=True)
class UnitFinding:
    """One unit: log odds that anything is missing, p-value, q-value over the fleet, what leads, what may as well."""

    statistic: float
    p_value: float
    q_value: float
    leader: str
    share: float
    rivals: Sequence[tuple[str, float]] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """What leads, or may: no order of them is certain but the alphabet's."""
        return tuple(sorted([self.leader, *(name for name, _ in self.rivals)]))


@dataclass(frozen=True)
class SharedFinding:
    """What a `fraction` of a fleet lacks, or as `few`: the leading name, its share, rivals, p-value of any in several.

    `follows`: beside values of the base that follow temperature, so that none of these can be missing for that.
    """

    name: str
    share: float
    p_value: float
    fraction: float
    few: float
    follows: bool
    rivals: Sequence[tuple[str, float]] = ()


@dataclass(frozen=True)
class Asked:
    """The n names that are asked about, log odds (n,), whether values follow temperature, and which look alike."""

    names: Sequence[str]
    log_odds: FloatArray
    follows: bool
    alike: Mapping[str, Sequence[str]]

    def statistic(self, by_name: FloatArray) -> FloatArray:
        """Return the log odds that anything is missing, (u,), by what `weigh` says of u units, (n, u)."""
        return log_sum(by_name + self.log_odds[:, None])

    def findings(self, by_name: FloatArray) -> list[UnitFinding]:
        """Return what is found of each unit, by what `weigh` says of all of them, (n, u)."""
        posterior, statistic = by_name + self.log_odds[:, None], self.statistic(by_name)
        p_values, likely = _ville(statistic), [self._likely(share) for share in np.exp(posterior - statistic).T]
        numbers = (each.tolist() for each in (statistic, p_values, false_discovery(p_values)))
        return list(map(UnitFinding, *numbers, *([of[k] for of in likely] for k in range(3))))

    def _likely(self, share: FloatArray) -> tuple[str, float, list[tuple[str, float]]]:
        """Return the leader of the names by their shares (n,), its share, and what as well may be it."""
        leader, *others = sorted(zip(self.names, share.tolist(), strict=True), key=lambda each: -each[1])
        same = self.alike.get(leader[0], ())
        return *leader, [each for each in others if each[1] > 1.0 - CERTAIN or each[0] in same]

    def mixed(self, by_name: FloatArray) -> FloatArray:
        """Return log evidence that some fraction lacks a name, and that some unit does alone, (k + 1, n).

        `weigh` says (n, u). Each unit has an amplitude of its own: a whole fleet's is the sum over its pieces.
        """
        rest = ((p, np.log1p(-p) if p < 1.0 else -np.inf) for p in FRACTIONS)
        some = [np.logaddexp(none, np.log(p) + by_name).sum(axis=1) for p, none in rest]
        return np.array([*some, log_sum(by_name.T)])

    def in_common(self, mixed: FloatArray, units: int) -> SharedFinding:
        """Return the effect that not one alone of so many units lacks: `mixed` says of m pieces, (m, k + 1, n)."""
        posterior = mixed[:, :-1].sum(axis=0) + self.log_odds - np.log(len(FRACTIONS))
        statistic = float(log_sum(posterior.reshape(-1, 1))[0])
        alone = float(log_sum((mixed[:, -1] + self.log_odds).reshape(-1, 1))[0]) - np.log(units)
        share = np.exp(posterior - statistic)
        p_value, of_names = float(_ville(np.array([statistic - max(alone, 0.0)]))[0]), share.sum(axis=0)
        leader = int(np.argmax(of_names))
        of = share[:, leader] / of_names[leader]
        fraction, likely = FRACTIONS[int(np.argmax(of))], np.flatnonzero((of > 1.0 - CERTAIN) | (of == of.max()))
        name, whole, rivals = self._likely(self._as_of_one(of_names, leader, max(fraction * units, 1.0)))
        return SharedFinding(name, whole, p_value, fraction, FRACTIONS[likely[0]], self.follows, rivals)

    def _as_of_one(self, share: FloatArray, leader: int, units: float) -> FloatArray:
        """Return shares (n,) of which those of names that look like the leader differ as in one of so many units.

        What parts them is how usual each is at its size: of many units that is known no better than of one.
        """
        same = [k for k, name in enumerate(self.names) if k == leader or name in self.alike.get(self.names[leader], ())]
        odds, out = self.log_odds[same], share.copy()
        log = odds + (np.log(np.maximum(share[same], 1e-300)) - odds) / units
        out[same] = share[same].sum() * np.exp(log - log_sum(log[:, None])[0])
        return out


@dataclass(frozen=True)
class Screen:
    """One layout: how units stood and, by sensor, the search with points of the noise, at `few` of which all begin."""

    stood: Stood
    found: Mapping[int, SensorSearch]
    few: int | None = GLANCED

    @classmethod
    def of(cls, units: Campaign | Sequence[Campaign], model: Model | str) -> "Screen":
        """Lay the search out for units of one layout: the first gives the columns, many of them say what noise is.

        Raises `InputError` where a unit's layout differs.
        """
        fleet = [units] if isinstance(units, Campaign) else list(units)
        if not fleet:
            raise InputError("a screen needs at least one unit")
        problem = pose(fleet[0], fitting_campaign(model, fleet[0]), (*BASE_EFFECTS, *EFFECTS))
        stood = Stood({number: sensor.collects.conditions for number, sensor in problem.sensors.items()})
        few = GLANCED if len(fleet) >= NOISY_UNITS else None
        laid = [cls(stood, stand := searches(problem, (), VARIANCE_EFFECTS), few)]
        if may_be_calibrated(problem):
            laid.append(cls(stood, searches(problem, (), VARIANCE_EFFECTS, stand), few))
        if all(term.is_mistake for search in laid[0].found.values() for term in search.terms):
            few_rows = "too few rows to test anything by; a screen needs several runs of each unit"
            raise InputError(f"{fleet[0].title}: {few_rows}")
        evenly = np.unique(np.linspace(0, len(fleet) - 1, NOISY_UNITS).astype(np.int64))
        some = [laid[0].rates(fleet[i]) for i in evenly]
        likelier = max(laid, key=lambda each: each._log_evidence(some[:: NOISY_UNITS // ASKED_UNITS]))
        likelier._adapt(some)
        return likelier

    def _adapt(self, units: Sequence[Sequence[FloatArray]]) -> None:
        """Take the noise that some units leave probable, and ask for no mistakes in the data."""
        of_block = iter(zip(*units, strict=True))
        for search in self.found.values():
            search.terms = [term for term in search.terms if not term.is_mistake]
            for block in search.blocks:
                block.choose([np.zeros((len(block.y), 0))], next(of_block))
                block.scanned = np.append(block.scanned, np.setdiff1d(np.arange(len(block.points)), block.scanned))
            search.forget()

    def _log_evidence(self, units: Sequence[Sequence[FloatArray]]) -> float:
        """Return how probable some units are together, log, in the noise that they leave probable."""
        self._adapt(units)
        of_block, total = list(zip(*units, strict=True)), 0.0
        for block, data in zip((b for search in self.found.values() for b in search.blocks), of_block, strict=True):
            for rates in data:
                block.measure(rates / block.unit)
                total += float(log_sum(block.beside.log_null() + block.points.log_prior))
        by_name = self._by_name([np.column_stack(own) for own in of_block], None)
        return total + float(np.sum(np.logaddexp(0.0, self.asked.statistic(by_name))))

    def units(self, campaigns: Sequence[Campaign]) -> list[UnitFinding]:
        """Screen units with this layout; raises `InputError` for a unit whose layout differs."""
        return self.asked.findings(self.weigh([self.rates(each) for each in campaigns]))

    def rates(self, campaign: Campaign) -> list[FloatArray]:
        """Return what a unit is weighed by: its rates (N,) in every block; raises `InputError` for another layout."""
        if not self.stood.like(campaign):
            raise InputError(f"{campaign.title}: it is laid out otherwise than the screen")
        return self.in_blocks(beside_the_earth(campaign), campaign.title)

    def in_blocks(self, values: Mapping[int, FloatArray], title: str) -> list[FloatArray]:
        """Return rates less the earth's (n, c) of each sensor by block; raises `InputError` where one is missing."""
        own = [block.block for search in self.found.values() for block in search.blocks]
        found = [values[block.sensor][block.rows, block.channel] for block in own]
        if not all(np.all(np.isfinite(each)) for each in found):
            raise InputError(f"{title}: rows are missing that the screen's layout has")
        return found

    @cached_property
    def asked(self) -> Asked:
        """The names, and their log odds: those of the sensor in which each is likeliest."""
        odds: dict[str, float] = {}
        for search in self.found.values():
            of_name: dict[str, list[float]] = {}
            for term in search.terms:
                of_name.setdefault(term.name, []).append(term.log_odds)
            for name, every in of_name.items():
                odds[name] = max(odds.get(name, -np.inf), float(np.logaddexp.reduce(every)))
        follows = any(block.noise.calibrated for search in self.found.values() for block in search.blocks)
        return Asked(list(odds), np.array(list(odds.values())), follows, names_alike(self.found.values()))

    def weigh(self, units: Sequence[Sequence[FloatArray]]) -> FloatArray:
        """Log Bayes factor of each of n names in each of u units, (n, u), whose `rates` these are, (N,) each."""
        parts = [np.zeros((len(self.asked.names), 0))]
        for first in range(0, len(units), TOGETHER):
            data = [np.column_stack(each) for each in zip(*units[first : first + TOGETHER], strict=True)]
            parts.append(by_name := self._by_name(data, self.few))
            again = np.flatnonzero(self.asked.statistic(by_name) > ASKED_AGAIN)
            if len(again) and self.few is not None:
                by_name[:, again] = self._by_name([rates[:, again] for rates in data], None)
            for i in np.flatnonzero(self.asked.statistic(by_name) > CALLED).tolist():
                by_name[:, i] = self._by_its_own_noise([rates[:, i] for rates in data])
        return np.concatenate(parts, axis=1)

    def _by_its_own_noise(self, rates: Sequence[FloatArray]) -> FloatArray:
        """Log Bayes factor of each name (n,) in one unit, at the points that its own rates (N,) by block leave."""
        found, first = {}, 0
        for number, search in self.found.items():
            own = list(rates[first : first + len(search.blocks)])
            first += len(search.blocks)
            factors = search.scan_many([each[:, None] for each in own], GLANCED)[:, 0]
            leading = np.argsort(-(factors + search.log_odds))[:LEADING]
            blocks = [replace(each) for each in search.blocks]
            for b, (block, values) in enumerate(zip(blocks, own, strict=True)):
                parts = [part.columns for j in leading if (part := search.terms[j].parts[b]) is not None]
                block.choose([np.zeros((len(block.y), 0)), *parts], [values])
            found[number] = SensorSearch(blocks, search.terms)
        return replace(self, found=found)._by_name([each[:, None] for each in rates], None)[:, 0]

    def _by_name(self, data: Sequence[FloatArray], most: int | None) -> FloatArray:
        """Log Bayes factor of each name whatever its shape, (names, m), of rates (N, m) by block, at `most` points."""
        names, first = self.asked.names, 0
        total = np.zeros((len(names), data[0].shape[1]))
        for search in self.found.values():
            blocks, first = data[first : first + len(search.blocks)], first + len(search.blocks)
            if not search.terms:
                continue  # this sensor has too few rows to test anything by
            of_units = search.scan_many(blocks, most)
            own, odds = np.array([names.index(term.name) for term in search.terms]), search.log_odds[:, None]
            order = np.argsort(own, kind="stable")
            places, starts = np.unique(own[order], return_index=True)
            whole = np.logaddexp.reduceat(odds[order], starts, axis=0)
            total[places] += np.logaddexp.reduceat((of_units + odds)[order], starts, axis=0) - whole
        return total


def _ville(log_odds: FloatArray) -> FloatArray:
    """Of units without an effect at most this share reaches such odds (Ville's inequality)."""
    return np.asarray(1.0 / (1.0 + np.exp(np.clip(log_odds, -50.0, 700.0))))
