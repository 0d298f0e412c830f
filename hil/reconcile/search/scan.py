"""The search: is anything missing, what is it called, is anything else missing.

The statistic is the evidence for all hypotheses together against the base alone. Its distribution without a missing
effect is simulated on the campaign's own layout and noise, so that the rate of false alarms of the whole search is the
stated one. What is detected is named by its share of the evidence; then it joins the base and the search begins again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import FloatArray
from hil.reconcile.search.hypotheses import Evidence, Hypothesis, build_evidence
from hil.solve.likelihood import NoiseTable, log_sum
from hil.solve.rows import Block

TAIL = 0.1
RESOLVED = 1e-6  # a few hundred draws say nothing about rarer chances


@dataclass(frozen=True)
class Scan:
    """One pass over all hypotheses with a given base: log Bayes factors (h,), evidence for anything, shares by name."""

    hypotheses: Sequence[Hypothesis]
    log_factors: FloatArray
    unit_factors: Sequence[FloatArray]
    statistic: float
    shares: Mapping[str, float]
    evidence: Evidence

    def best(self, name: str) -> tuple[Hypothesis, FloatArray]:
        """Return the most probable shape and form of a name, and the log Bayes factors of its units."""
        _, hypothesis, units = self.forms(name)[0]
        return hypothesis, units

    def forms(self, name: str) -> list[tuple[float, Hypothesis, FloatArray]]:
        """Return every shape and form of a name with its log evidence and its units' log Bayes factors, best first."""
        own = [
            (float(self.log_factors[i]) + h.log_prior, h, self.unit_factors[i])
            for i, h in enumerate(self.hypotheses)
            if h.name == name
        ]
        return sorted(own, key=lambda form: -form[0])


@dataclass(frozen=True)
class Search:
    """The campaign's layout for the search: blocks as the base has them now, and their noise tables, made once.

    `rich` are models of the means of each block, each (N, p).
    """

    blocks: Sequence[Block]
    noise: Sequence[NoiseTable]
    rich: Sequence[Sequence[FloatArray]]
    hypotheses: Sequence[Hypothesis]

    def with_base(self, extra: Sequence[FloatArray | None]) -> Search:
        """Return the search with further base columns, (N, p), per block."""
        blocks = [b if e is None else b.with_base(e) for b, e in zip(self.blocks, extra, strict=True)]
        return Search(blocks, self.noise, self.rich, self.hypotheses)

    def with_hypothesis(self, hypothesis: Hypothesis) -> Search:
        """Return the search with one more hypothesis, which has its own share of the prior."""
        return Search(self.blocks, self.noise, self.rich, [*self.hypotheses, hypothesis])

    def scan(self) -> Scan:
        """Weigh every hypothesis against the present base."""
        evidence = build_evidence(self.hypotheses, self.blocks, self.noise, self.rich)
        factors, units = evidence.log_factors([block.y[:, None] for block in self.blocks])
        prior = np.array([h.log_prior for h in self.hypotheses])
        posterior = factors[:, 0] + prior
        statistic = float(log_sum(posterior))
        shares: dict[str, float] = {}
        for hypothesis, value in zip(self.hypotheses, np.exp(posterior - statistic), strict=True):
            shares[hypothesis.name] = shares.get(hypothesis.name, 0.0) + float(value)
        ordered = dict(sorted(shares.items(), key=lambda item: -item[1]))
        return Scan(self.hypotheses, factors[:, 0], [u[:, 0] for u in units], statistic, ordered, evidence)


def null_statistics(scan: Scan, blocks: Sequence[Block], draws: int, rng: np.random.Generator) -> FloatArray:
    """Simulate the statistic without a missing effect on this layout, shape (draws,), sorted."""
    y = [table.simulate(block.y, draws, rng) for table, block in zip(scan.evidence.blocks, blocks, strict=True)]
    factors, _ = scan.evidence.log_factors(y)
    prior = np.array([h.log_prior for h in scan.hypotheses])
    return np.sort(log_sum(factors + prior[:, None]))


def level(null: FloatArray, alpha: float) -> float:
    """Return what the statistic exceeds with probability `alpha` without a missing effect, from simulated values (m,).

    The tail beyond the ninth decile is taken as exponential, so that a few hundred draws are enough.
    """
    if alpha >= TAIL:
        return float(np.quantile(null, 1.0 - alpha))
    start, mean_excess = tail_of(null)
    return start + mean_excess * float(np.log(TAIL / alpha))


def p_value(null: FloatArray, statistic: float) -> float:
    """Return how probable so large a statistic is without a missing effect, as `level` counts, (m,) draws, or 1e-6."""
    start, mean_excess = tail_of(null)
    if statistic <= start or mean_excess <= 0.0:
        return float((1 + np.sum(null >= statistic)) / (1 + len(null)))
    return float(np.clip(TAIL * np.exp(-(statistic - start) / mean_excess), RESOLVED, 1.0))


def false_discovery(p_values: FloatArray) -> FloatArray:
    """Benjamini–Hochberg q-values, (k,) from (k,), as `scipy.stats` gives them, which takes 0.4 s to load."""
    order = np.argsort(p_values)
    scaled = p_values[order] * len(p_values) / np.arange(1, len(p_values) + 1)
    q = np.minimum.accumulate(scaled[::-1])[::-1]
    out = np.empty_like(q)
    out[order] = np.minimum(q, 1.0)
    return out


def tail_of(null: FloatArray) -> tuple[float, float]:
    """Where the tail of values (n,) begins, and how far its values lie beyond that on average."""
    start = float(np.quantile(null, 1.0 - TAIL))
    beyond = null[null > start] - start
    return start, float(np.mean(beyond)) if len(beyond) else 0.0
