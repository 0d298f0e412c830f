"""Screen many units that were measured in the same way.

Is anything missing, in which of them, in all of them?

    screen = Screen.of(campaigns, "matrix-6")           # tables of the layout and of the null, once
    findings = screen.units(campaigns)                  # milliseconds per unit
    shared = screen.shared(campaigns)                   # one effect that many of the fleet have

Units whose layout differs (a missing row, another order, other temperatures) need a screen of their own; what an effect
follows (supply, temperature) is taken from the first unit. Discoveries over units are held to a false discovery rate;
what a screening finds is worth a full `reconcile`, nothing more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import Campaign, Conditions, FloatArray, IntArray
from hil.errors import InputError
from hil.model import Model, load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS
from hil.reconcile.search.evidence import BlockEvidence
from hil.reconcile.search.hypotheses import Evidence, Hypothesis, build_evidence, hypotheses
from hil.reconcile.search.problem import pose
from hil.reconcile.search.scan import TAIL, false_discovery, tail_of
from hil.solve.likelihood import NoiseTable, log_sum
from hil.solve.rows import Block
from hil.solve.temperatures import ELSEWHERE_DEGC, same_temperature

_POINTS = 48  # noise models: fewer, and units with an unusual noise are found too often
_NULL_DRAWS = 2000
_NOISY_UNITS = 200  # so many units, evenly over the fleet, say what noise is
_AT_ONCE = 500  # units weighed together: memory, not speed
_FLEETS = 1000
_FRACTIONS = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Of the fleet, the shares that may have a shared effect."""
_SAME_G = 0.05


@dataclass(frozen=True)
class UnitFinding:
    """One unit of a fleet: its statistic, p-value, q-value over the fleet, and the leading name with its share."""

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
    """Tables of one layout: blocks, evidence on a fixed noise grid, and what it says of simulated units without effect.

    `null` (draws,) are their statistics, sorted; `null_names` (names, draws) their log evidence for each name, and
    `null_source` (draws,) which of the units their noise is from.
    """

    model: Model
    blocks: Sequence[Block]
    conditions: dict[int, Conditions]
    found: Sequence[Hypothesis]
    evidence: Evidence
    null: FloatArray
    null_names: FloatArray
    null_source: IntArray

    @classmethod
    def of(
        cls, units: Campaign | Sequence[Campaign], model: Model | str, *, draws: int = _NULL_DRAWS, seed: int = 0
    ) -> Screen:
        """Build the tables from units of one layout: the first gives the columns, all of them say what noise is.

        The statistic without a missing effect is simulated from the noise of up to two hundred of the units: one alone
        knows its noise too badly to judge the others by. Raises `InputError` where a unit's layout differs.
        """
        fleet = [units] if isinstance(units, Campaign) else list(units)
        if not fleet:
            raise InputError("a screen needs at least one unit")
        chosen = load_model(model) if isinstance(model, str) else model
        problem = pose(fleet[0], chosen, (*BASE_EFFECTS, *EFFECTS))
        found = hypotheses(problem.candidates, problem.blocks)
        conditions = {number: sensor.collects.conditions for number, sensor in problem.sensors.items()}
        some = [fleet[i] for i in np.unique(np.linspace(0, len(fleet) - 1, _NOISY_UNITS).astype(np.int64))]
        rates = _rates(some, problem.blocks, conditions)
        every = [BlockEvidence(block, NoiseTable.of(block), (), keep_all=True) for block in problem.blocks]
        tables = [_likely(noise, y) for noise, y in zip(every, rates, strict=True)]
        evidence = build_evidence(found, problem.blocks, tables, [() for _ in problem.blocks], keep_all=True)
        none = np.zeros(0)
        screen = cls(chosen, problem.blocks, conditions, found, evidence, none, none, none.astype(np.int64))
        source = np.sort(np.arange(draws) % len(some))
        simulated = _without_effect(every, rates, source, np.random.default_rng(seed))
        posterior = screen._weighed(simulated)
        null = np.sort(log_sum(posterior))
        return replace(screen, null=null, null_names=screen._by_name(posterior), null_source=source)

    @property
    def names(self) -> list[str]:
        """The names that are asked about, in the order found."""
        return list(dict.fromkeys(h.name for h in self.found))

    def units(self, campaigns: Sequence[Campaign]) -> list[UnitFinding]:
        """Screen units with this layout; raises `InputError` for a unit whose layout differs."""
        posterior = self._weighed(_rates(campaigns, self.blocks, self.conditions))
        statistic = log_sum(posterior)
        p_values = _p_values(self.null, statistic)
        q_values = false_discovery(p_values)
        by_name = self._by_name(posterior) + self._log_names()[:, None]
        leaders = np.argmax(by_name, axis=0)
        names = self.names
        return [
            UnitFinding(
                campaign.title,
                float(statistic[i]),
                float(p_values[i]),
                float(q_values[i]),
                names[leader],
                float(np.exp(by_name[leader, i] - statistic[i])),
            )
            for i, (campaign, leader) in enumerate(zip(campaigns, leaders.tolist(), strict=True))
        ]

    def shared(self, campaigns: Sequence[Campaign], *, seed: int = 0) -> SharedFinding:
        """Test whether one effect is missing from many units, each with an amplitude of its own.

        The evidence for a name is that of a mixture: in some fraction of the units it is missing, in the others nothing
        is. What fleets of as many units without an effect come to is resampled from the simulated units, and the noises
        that these have from one another: they are known no better than their number allows. Raises `InputError` for a
        unit whose layout differs.
        """
        of_units = self._by_name(self._weighed(_rates(campaigns, self.blocks, self.conditions)))
        prior = self._log_names()[None, :] - np.log(len(_FRACTIONS))
        whole = _mixed(of_units).sum(axis=2)
        rng = np.random.default_rng(seed)
        sizes = np.bincount(self.null_source)
        taken = rng.multinomial(len(sizes), np.full(len(sizes), 1.0 / len(sizes)), size=_FLEETS) / len(sizes)
        each = (taken / sizes)[:, self.null_source]
        counts = np.array([rng.multinomial(len(campaigns), share) for share in each], dtype=np.float64)
        fleets = _mixed(self.null_names) @ counts.T
        null = np.sort(log_sum((fleets + prior[..., None]).reshape(-1, _FLEETS)))
        posterior = whole + prior
        statistic = float(log_sum(posterior.reshape(-1, 1))[0])
        share = np.exp(posterior - statistic)
        leader = int(np.argmax(share.sum(axis=0)))
        fraction = _FRACTIONS[int(np.argmax(share[:, leader]))]
        name, belief = self.names[leader], float(share[:, leader].sum())
        return SharedFinding(name, belief, statistic, float(_p_values(null, np.array([statistic]))[0]), fraction)

    def _weighed(self, y: Sequence[FloatArray]) -> FloatArray:
        """Log evidence of each hypothesis with its prior, shape (h, units), from rates per block (N, units)."""
        prior = np.array([h.log_prior for h in self.found])
        starts = range(0, y[0].shape[1], _AT_ONCE)
        parts = [self.evidence.log_factors([rates[:, i : i + _AT_ONCE] for rates in y])[0] for i in starts]
        return np.asarray(np.hstack(parts) + prior[:, None])

    def _by_name(self, posterior: FloatArray) -> FloatArray:
        """Log evidence for each name whatever its shape, against no effect, shape (names, units)."""
        members = [[i for i, h in enumerate(self.found) if h.name == name] for name in self.names]
        return np.array([log_sum(posterior[own]) for own in members]) - self._log_names()[:, None]

    def _log_names(self) -> FloatArray:
        """Log prior of each name, its shapes together, shape (names,)."""
        prior = np.array([h.log_prior for h in self.found])
        return np.array([log_sum(prior[[h.name == name for h in self.found]][:, None])[0] for name in self.names])


def _rates(
    campaigns: Sequence[Campaign], blocks: Sequence[Block], conditions: Mapping[int, Conditions]
) -> list[FloatArray]:
    """Rates less the earth's in each block, (N, units); raises `InputError` for a unit that is laid out otherwise."""
    for campaign in campaigns:
        for number, known in conditions.items():
            collects = campaign.sensors.get(number)
            if collects is None or not _alike(known, collects.conditions):
                raise InputError(f"{campaign.title}: sensor {number} is laid out otherwise than the screen")
    out = []
    for block in blocks:
        columns = []
        for campaign in campaigns:
            collects = campaign.sensors[block.sensor]
            rates = collects.rates_deg_per_hr - collects.conditions.w_channels_deg_per_hr
            values = rates[block.rows, block.channel]
            if not np.all(np.isfinite(values)):
                raise InputError(f"{campaign.title}: rows are missing that the screen's layout has")
            columns.append(values)
        out.append(np.array(columns).T)
    return out


def _without_effect(
    every: Sequence[BlockEvidence], rates: Sequence[FloatArray], source: IntArray, rng: np.random.Generator
) -> list[FloatArray]:
    """Simulate units without an effect, by the noise of the units `source` (draws,): rates per block, (N, draws)."""
    return [
        np.hstack([noise.simulate(y[:, i], int((source == i).sum()), rng) for i in np.unique(source)])
        for noise, y in zip(every, rates, strict=True)
    ]


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
        and bool(np.all(np.abs(known.f_g - other.f_g) < _SAME_G))
    )


def _p_values(null: FloatArray, statistic: FloatArray) -> FloatArray:
    """Probabilities of log evidence this large without an effect: counted, and beyond the ninth decile exponential.

    The tail has no end, so that a few units among ten thousand can be found. It falls no faster than by e for each unit
    of log evidence, which is what evidence that is right about the noise does.
    """
    start, mean_excess = tail_of(null)
    counted = (1.0 + len(null) - np.searchsorted(null, statistic)) / (1.0 + len(null))
    beyond = TAIL * np.exp(-np.maximum(statistic - start, 0.0) / max(mean_excess, 1.0))
    return np.asarray(np.where(statistic <= start, counted, beyond))


def _mixed(log_evidence: FloatArray) -> FloatArray:
    """Log evidence of each unit for each name in a fleet of which a fraction has it, (fractions, names, units)."""
    return np.array([np.logaddexp(np.log1p(-p) if p < 1.0 else -np.inf, np.log(p) + log_evidence) for p in _FRACTIONS])


def _likely(every: BlockEvidence, y: FloatArray) -> NoiseTable:
    """Keep the noise points that the units `y` (N, units) make most probable, and as many again of all kinds.

    A unit of which something is missing looks noisier than it is: what the others are like is what it is judged by.
    """
    _, _, log_null = every.projection.log_null(y, every.prior)
    probable = np.argsort(-np.exp(log_null - log_sum(log_null)).mean(axis=1))[: _POINTS // 2]
    by_prior = np.argsort(-every.noise.grid.log_prior)
    spread = by_prior[np.linspace(0, len(by_prior) - 1, min(_POINTS // 2, len(by_prior))).astype(np.int64)]
    return every.noise.take(np.unique(np.concatenate([probable, spread])))
