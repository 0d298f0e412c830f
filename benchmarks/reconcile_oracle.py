"""What nobody could beat on the sealed cases: a search that is told the noise's covariance and the true columns.

    python -m benchmarks.reconcile_oracle
    python -m benchmarks.reconcile_oracle --pairs 120

Its threshold holds 5 % over the same candidates as the product's search. What it misses is a limit of the data; what
the product misses beyond that is the price of not knowing the noise, or the product's own. Of two effects each must
stand beside the other, and no two others explain as much: a second candidate is grown from each of the best firsts.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import stats

from benchmarks.blind.cases import Noise, base_columns, make_case, noise_covariance, write_case
from benchmarks.blind.jobs import SETTINGS, SIZES, Job, doubles, visible
from benchmarks.blind.night import Design
from hil.campaign.reader import read_campaign
from hil.model import load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS
from hil.reconcile.search.problem import pose

_ALPHA, _SAME, _LEAST_KEPT = 0.05, 0.95, 0.04
_NULLS, _DRAWS = 1500, 200
_FIRSTS = 30


@dataclass(frozen=True)
class Known:
    """What is known of a night: what whitens its rows, the base's columns, the candidates' spans, and the threshold."""

    white: np.ndarray
    basis: np.ndarray
    spans: list[tuple[str, np.ndarray]]
    threshold: float

    def seen(self, signal: np.ndarray) -> np.ndarray:
        """Return what the base leaves of a signal (n, c), in units of the noise."""
        rows = self.white @ signal.T.ravel()
        return np.asarray(rows - self.basis @ (self.basis.T @ rows))

    def errors(self, draws: int, rng: np.random.Generator) -> np.ndarray:
        """Return noise beside the base, (rows, draws)."""
        rows = rng.standard_normal((len(self.white), draws))
        return np.asarray(rows - self.basis @ (self.basis.T @ rows))

    def same(self, name: str, true: np.ndarray) -> set[str]:
        """Return the names that are as good for a unit column `true`."""
        return {name, *(n for n, s in self.spans if np.linalg.norm(s.T @ true) > _SAME)}


def known(design: Design, model: str, seed: int) -> Known:
    """Lay out a night and find the threshold that holds 5 % over all candidates."""
    case, rng = make_case(seed, (), 1.0, model=model, design=design), np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as scratch:
        campaign = read_campaign(write_case(case, Path(scratch) / "case"))
    white = np.kron(np.eye(2), np.linalg.inv(np.linalg.cholesky(noise_covariance(case.night, Noise()))))
    basis, _ = np.linalg.qr(white @ base_columns(case.night, model))
    out = Known(white, basis, [], 0.0)
    for candidate in pose(campaign, load_model(model), (*BASE_EFFECTS, *EFFECTS)).candidates:
        columns = white @ np.concatenate([candidate.columns[:, channel, :] for channel in (0, 1)])
        columns = columns[:, np.any(columns, axis=0)] / np.linalg.norm(columns[:, np.any(columns, axis=0)], axis=0)
        left, kept, _ = np.linalg.svd(columns - basis @ (basis.T @ columns), full_matrices=False)
        if np.any(kept > _LEAST_KEPT):
            out.spans.append((candidate.name, left[:, kept > _LEAST_KEPT]))
    nulls = surprise(out.spans, out.errors(_NULLS, rng)).max(axis=0)
    return replace(out, threshold=float(np.quantile(nulls, 1.0 - _ALPHA)))


def surprise(spans: Sequence[tuple[str, np.ndarray]], data: np.ndarray) -> np.ndarray:
    """Minus log of each candidate's p-value, (candidates, data sets)."""
    return np.array([-stats.chi2.logsf(np.sum((s.T @ data) ** 2, axis=0), s.shape[1]) for _, s in spans])


def shares(design: Design, model: str, seed: int) -> dict[float, list[tuple[float, float]]]:
    """Per size: the shares detected, and detected with the true name first, one pair for each visible effect."""
    night, rng = known(design, model, seed), np.random.default_rng(seed)
    out: dict[float, list[tuple[float, float]]] = {d: [] for d in SIZES}
    for name in visible(design, model):
        true = night.seen(make_case(seed, (name,), 1.0, model=model, design=design).signals[0])
        true = true / np.linalg.norm(true)
        same = night.same(name, true)
        others = np.array([n not in same for n, _ in night.spans])
        errors = night.errors(_DRAWS, rng)
        for d in SIZES:
            data = d * true[:, None] + errors
            own = -stats.chi2.logsf((true @ data) ** 2, 1)
            found = own > night.threshold
            first = found & (own > surprise(night.spans, data)[others].max(axis=0))
            out[d].append((float(found.mean()), float(first.mean())))
    return out


def both(job: Job) -> tuple[bool, bool]:
    """Whether each of two effects stands beside the other, and whether no two others explain as much."""
    case = make_case(job.seed, job.hidden, job.d, model=job.model, design=job.design)
    night = known(job.design, job.model, job.seed)
    signals = [night.seen(signal) for signal in case.signals]
    data = sum(signals) + night.errors(1, np.random.default_rng([job.seed, 2]))[:, 0]
    true, _ = np.linalg.qr(np.stack(signals, axis=1))
    stand = [one - other * (other @ one) / (other @ other) for one, other in (signals, signals[::-1])]
    seen = all(-stats.chi2.logsf((own @ data) ** 2 / (own @ own), 1) > night.threshold for own in stand)
    explained = -stats.chi2.logsf(np.sum((true.T @ data) ** 2), 2)
    same = [night.same(name, own / np.linalg.norm(own)) for name, own in zip(job.hidden, signals, strict=True)]
    gains = surprise(night.spans, data[:, None])[:, 0]
    for i in np.argsort(-gains)[:_FIRSTS]:
        first, span = night.spans[i]
        left = data - span @ (span.T @ data)
        known_by = np.sum((span.T @ data) ** 2)
        for second, further in night.spans:
            if first == second or all({first, second} & own for own in same):
                continue
            own, _ = np.linalg.qr(further - span @ (span.T @ further))
            gain = known_by + np.sum((own.T @ left) ** 2)
            if -stats.chi2.logsf(gain, span.shape[1] + own.shape[1]) > explained:
                return seen, False
    return seen, seen


def main() -> None:
    """Print the mean over all designs and their visible effects, one line per size; or that of pairs of effects."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, help="so many pairs of effects, d = 8 each, those of the sealed cases")
    if count := parser.parse_args().pairs:
        found = np.array([both(job) for job in doubles(count)])
        seen, right = found.mean(axis=0)
        print(f"of {count} pairs each stands beside the other: {seen:.2f}; the right two: {right:.2f}")
        return
    everything = [shares(design, model, seed) for seed, (design, model) in enumerate(SETTINGS, start=1)]
    print("| d | finds something | true class first | effects |\n|---|---|---|---|")
    for d in SIZES:
        pairs = np.array([pair for part in everything for pair in part[d]])
        print(f"| {d:g} | {pairs[:, 0].mean():.3f} | {pairs[:, 1].mean():.3f} | {len(pairs)} |")


if __name__ == "__main__":
    main()
