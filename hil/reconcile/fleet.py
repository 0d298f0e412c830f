"""Screen many units that were measured in the same way.

Is anything missing, in which of them, in all of them?

    screen = Screen.of(campaigns, "matrix-6")           # the layout: terms and noise, once
    findings = screen.units(campaigns)                  # milliseconds per unit
    shared = screen.shared(campaigns)                   # one effect that many of the fleet have

Units whose layout differs (a missing row, another order, other temperatures) need a screen of their own; what an effect
follows (supply, temperature) is taken from the first unit. Discoveries over units are held to a false discovery rate;
what a screening finds is worth a full `reconcile`, nothing more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import Campaign, Conditions, FloatArray
from hil.errors import InputError
from hil.model import Model, load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, VARIANCE_EFFECTS
from hil.reconcile.proof.places import false_discovery
from hil.reconcile.search.evidence import log_sum
from hil.reconcile.search.layout import searches
from hil.reconcile.search.problem import pose
from hil.reconcile.search.sets import BlockSearch, SensorSearch
from hil.solve.temperatures import ELSEWHERE_DEGC, same_temperature

NOISY_UNITS = 40
"""So many units, evenly over the fleet, say what noise is: one alone knows its own too badly to judge others by."""
FRACTIONS = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Of the fleet, the shares that may have a shared effect."""
SAME_G = 0.05
"""Units whose accelerations differ by more stood in other positions."""


@dataclass(frozen=True)
class UnitFinding:
    """One unit of a fleet: log odds that something is missing, p-value, q-value over the fleet, the leading name."""

    title: str
    statistic: float
    p_value: float
    q_value: float
    leader: str
    share: float


@dataclass(frozen=True)
class SharedFinding:
    """What a fleet has in common: the leading name with its share, log evidence for any name, and its p-value.

    `fraction` is the share of the units that the leading name is most probably missing from.
    """

    name: str
    share: float
    log_evidence: float
    p_value: float
    fraction: float


@dataclass(frozen=True)
class Screen:
    """One layout: its model, conditions and, by sensor, the search with the points of the noise that units have."""

    model: Model
    conditions: Mapping[int, Conditions]
    found: Mapping[int, SensorSearch]

    @classmethod
    def of(cls, units: Campaign | Sequence[Campaign], model: Model | str) -> Screen:
        """Lay the search out for units of one layout: the first gives the columns, many of them say what noise is.

        Raises `InputError` where a unit's layout differs.
        """
        fleet = [units] if isinstance(units, Campaign) else list(units)
        if not fleet:
            raise InputError("a screen needs at least one unit")
        chosen = load_model(model) if isinstance(model, str) else model
        problem = pose(fleet[0], chosen, (*BASE_EFFECTS, *EFFECTS))
        conditions = {number: sensor.collects.conditions for number, sensor in problem.sensors.items()}
        found = searches(problem, (), VARIANCE_EFFECTS)
        some = [fleet[i] for i in np.unique(np.linspace(0, len(fleet) - 1, NOISY_UNITS).astype(np.int64))]
        for search in found.values():
            search.terms = [term for term in search.terms if not term.is_mistake]
            for block in search.blocks:
                block.choose([np.zeros((len(block.y), 0))], [_rates(unit, block, conditions) for unit in some])
                block.scanned = np.arange(len(block.points))  # what a screen calls is not weighed again
            search.forget()
        return cls(chosen, conditions, found)

    def units(self, campaigns: Sequence[Campaign]) -> list[UnitFinding]:
        """Screen units with this layout; raises `InputError` for a unit whose layout differs."""
        names, by_name, odds = self._by_name(campaigns)
        posterior = by_name + odds[:, None]
        statistic = log_sum(posterior)
        p_values = _ville(statistic)
        q_values = false_discovery(p_values)
        leaders = np.argmax(posterior, axis=0)
        return [
            UnitFinding(
                campaign.title,
                float(statistic[i]),
                float(p_values[i]),
                float(q_values[i]),
                names[leader],
                float(np.exp(posterior[leader, i] - statistic[i])),
            )
            for i, (campaign, leader) in enumerate(zip(campaigns, leaders.tolist(), strict=True))
        ]

    def shared(self, campaigns: Sequence[Campaign]) -> SharedFinding:
        """Test whether one effect is missing from many units, each with an amplitude of its own.

        The evidence for a name is that of a mixture: in some fraction of the units it is missing, in the others nothing
        is. Raises `InputError` for a unit whose layout differs.
        """
        names, by_name, odds = self._by_name(campaigns)
        mixed = [np.logaddexp(np.log1p(-p) if p < 1.0 else -np.inf, np.log(p) + by_name) for p in FRACTIONS]
        posterior = np.array(mixed).sum(axis=2) + odds - np.log(len(FRACTIONS))
        statistic = float(log_sum(posterior.reshape(-1, 1))[0])
        share = np.exp(posterior - statistic)
        leader = int(np.argmax(share.sum(axis=0)))
        fraction = FRACTIONS[int(np.argmax(share[:, leader]))]
        p_value = float(_ville(np.array([statistic]))[0])
        return SharedFinding(names[leader], float(share[:, leader].sum()), statistic, p_value, fraction)

    def _by_name(self, campaigns: Sequence[Campaign]) -> tuple[list[str], FloatArray, FloatArray]:
        """Names, log Bayes factor of each in each unit whatever its shape (names, units), and log odds (names,)."""
        names = list(dict.fromkeys(term.name for search in self.found.values() for term in search.terms))
        total, prior = np.zeros((len(names), len(campaigns))), np.full(len(names), -np.inf)
        for search in self.found.values():
            odds = search.log_odds
            of_units = np.array([self._scanned(search, campaign) for campaign in campaigns]).T
            for i, name in enumerate(names):
                own = [j for j, term in enumerate(search.terms) if term.name == name]
                if own:
                    whole = log_sum(odds[own][:, None])[0]
                    total[i] += log_sum(of_units[own] + odds[own][:, None]) - whole
                    prior[i] = max(prior[i], float(whole))
        return names, total, prior

    def _scanned(self, search: SensorSearch, campaign: Campaign) -> FloatArray:
        for block in search.blocks:
            block.measure(_rates(campaign, block, self.conditions) / block.unit)
        return search.scan(())


def _ville(log_odds: FloatArray) -> FloatArray:
    """Of units without an effect at most this share reaches such odds (Ville's inequality)."""
    return np.asarray(1.0 / (1.0 + np.exp(np.clip(log_odds, -50.0, 700.0))))


def _rates(campaign: Campaign, search: BlockSearch, conditions: Mapping[int, Conditions]) -> FloatArray:
    """Rates less the earth's in a block, (N,); raises `InputError` for a unit that is laid out otherwise."""
    block = search.block
    collects = campaign.sensors.get(block.sensor)
    if collects is None or not _alike(conditions[block.sensor], collects.conditions):
        raise InputError(f"{campaign.title}: sensor {block.sensor} is laid out otherwise than the screen")
    rates = collects.rates_deg_per_hr - collects.conditions.w_channels_deg_per_hr
    values = rates[block.rows, block.channel]
    if not np.all(np.isfinite(values)):
        raise InputError(f"{campaign.title}: rows are missing that the screen's layout has")
    return np.asarray(values)


def _alike(known: Conditions, other: Conditions) -> bool:
    """Whether two units stood in the same positions, in the same runs, at the same temperatures."""
    if len(known) != len(other) or known.sensor.channels != other.sensor.channels:
        return False
    warm, warm_too = known.columns.get("temperature_degC"), other.columns.get("temperature_degC")
    if (warm is None) != (warm_too is None):
        return False
    number = same_temperature(known)
    same_warmth = np.array_equal(number, same_temperature(other)) and (
        warm is None
        or warm_too is None
        or all(abs(np.nanmean((warm - warm_too)[number == k])) <= ELSEWHERE_DEGC for k in set(number[number >= 0]))
    )
    in_order = [np.unique(rows.run, return_inverse=True)[1] for rows in (known, other)]
    return (
        same_warmth
        and bool(np.all(in_order[0] == in_order[1]))
        and bool(np.all(np.abs(known.f_g - other.f_g) < SAME_G))
    )
