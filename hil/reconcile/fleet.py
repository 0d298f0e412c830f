"""Screen many units that were measured in the same way.

Is anything missing, in which of them, in all of them?

    screen = Screen.of(campaign, "matrix-6", alpha=0.05)      # tables of the layout and of the null, once
    findings = screen.units(campaigns)                        # milliseconds per unit
    shared = screen.shared(campaigns)                         # one effect in the whole fleet

Units whose layout differs (a missing row, another order) need a screen of their own. Discoveries over units are held
to a false discovery rate; what a screening finds is worth a full `reconcile`, nothing more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import Campaign, FloatArray, IntArray
from hil.effects.catalogue import BASE_EFFECTS, EFFECTS
from hil.errors import InputError
from hil.model import Model, load_model
from hil.reconcile.blocks import Block
from hil.reconcile.evidence import NoiseTable, _log_sum
from hil.reconcile.hypotheses import Evidence, Hypothesis, build_evidence, hypotheses
from hil.reconcile.problem import pose

_POINTS = 24
_NULL_DRAWS = 2000


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
class Screen:
    """Tables of one layout: blocks, evidence on a fixed noise grid, and the null statistics, sorted."""

    model: Model
    blocks: Sequence[Block]
    found: Sequence[Hypothesis]
    evidence: Evidence
    null: FloatArray

    @classmethod
    def of(cls, campaign: Campaign, model: Model | str, *, draws: int = _NULL_DRAWS, seed: int = 0) -> Screen:
        """Build the tables from the layout of one unit's campaign (its base gives the columns that need one)."""
        chosen = load_model(model) if isinstance(model, str) else model
        problem = pose(campaign, chosen, (*BASE_EFFECTS, *EFFECTS))
        found = hypotheses(problem.candidates, problem.blocks)
        tables = [_spread(NoiseTable.of(block)) for block in problem.blocks]
        evidence = build_evidence(found, problem.blocks, tables, [() for _ in problem.blocks], keep_all=True)
        rng = np.random.default_rng(seed)
        y = [table.simulate(block.y, draws, rng) for table, block in zip(evidence.blocks, problem.blocks, strict=True)]
        screen = cls(chosen, problem.blocks, found, evidence, np.zeros(0))
        return replace(screen, null=np.sort(_log_sum(screen._posterior(y))))

    def units(self, campaigns: Sequence[Campaign]) -> list[UnitFinding]:
        """Screen units with this layout; raises `InputError` for a unit whose layout differs."""
        posterior = self._posterior(self._rates(campaigns))
        statistic = _log_sum(posterior)
        p_values = (1.0 + len(self.null) - np.searchsorted(self.null, statistic)) / (1.0 + len(self.null))
        q_values = _false_discovery(np.asarray(p_values, dtype=np.float64))
        out = []
        for i, campaign in enumerate(campaigns):
            name, share = self._leader(posterior[:, i])
            out.append(
                UnitFinding(campaign.title, float(statistic[i]), float(p_values[i]), float(q_values[i]), name, share)
            )
        return out

    def shared(self, campaigns: Sequence[Campaign]) -> tuple[str, float]:
        """Return the name that the whole fleet speaks for, and its log evidence summed over units against no effect."""
        posterior = self._posterior(self._rates(campaigns))
        prior = np.array([h.log_prior for h in self.found])
        totals: dict[str, list[FloatArray]] = {}
        for hypothesis, values in zip(self.found, posterior - prior[:, None], strict=True):
            totals.setdefault(hypothesis.name, []).append(values)
        evidence = {name: float(np.sum(_log_sum(np.array(rows)) - np.log(len(rows)))) for name, rows in totals.items()}
        best = max(evidence, key=lambda name: evidence[name])
        return best, evidence[best]

    def _posterior(self, y: Sequence[FloatArray]) -> FloatArray:
        factors, _ = self.evidence.log_factors(y)
        return np.asarray(factors + np.array([h.log_prior for h in self.found])[:, None])

    def _leader(self, posterior: FloatArray) -> tuple[str, float]:
        weights = np.exp(posterior - posterior.max())
        shares: dict[str, float] = {}
        for hypothesis, weight in zip(self.found, weights / weights.sum(), strict=True):
            shares[hypothesis.name] = shares.get(hypothesis.name, 0.0) + float(weight)
        name = max(shares, key=lambda n: shares[n])
        return name, shares[name]

    def _rates(self, campaigns: Sequence[Campaign]) -> list[FloatArray]:
        out = []
        for block in self.blocks:
            columns = []
            for campaign in campaigns:
                collects = campaign.sensors.get(block.sensor)
                if collects is None or len(collects.conditions) <= block.rows.max():
                    raise InputError(f"{campaign.title}: sensor {block.sensor} is laid out otherwise than the screen")
                rates = collects.rates_deg_per_hr - collects.conditions.w_channels_deg_per_hr
                values = rates[block.rows, block.channel]
                if not np.all(np.isfinite(values)):
                    raise InputError(f"{campaign.title}: rows are missing that the screen's layout has")
                columns.append(values)
            out.append(np.array(columns).T)
        return out


def _spread(table: NoiseTable) -> NoiseTable:
    """Keep a few noise points that cover the grid: evenly over the prior's order, the most probable first."""
    order = np.argsort(-table.grid.log_prior)
    chosen: IntArray = np.unique(order[np.linspace(0, len(order) - 1, min(_POINTS, len(order))).astype(np.int64)])
    return table.take(chosen)


def _false_discovery(p_values: FloatArray) -> FloatArray:
    """Benjamini–Hochberg q-values."""
    order = np.argsort(p_values)
    scaled = p_values[order] * len(p_values) / np.arange(1, len(p_values) + 1)
    q = np.minimum.accumulate(scaled[::-1])[::-1]
    out = np.empty_like(q)
    out[order] = np.minimum(q, 1.0)
    return out
