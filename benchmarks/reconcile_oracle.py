"""What nobody could beat on the sealed cases: a search that is told the noise's covariance and the true column.

    python -m benchmarks.reconcile_oracle

Its threshold holds 5 % over the same candidates as the product's search. What it misses is a limit of the data; what
the product misses beyond that is the price of not knowing the noise, or the product's own.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from scipy import stats

from benchmarks.blind.cases import Noise, base_columns, make_case, noise_covariance, write_case
from benchmarks.blind.jobs import SETTINGS, SIZES, visible
from benchmarks.blind.night import Design
from hil.campaign.reader import read_campaign
from hil.model import load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS
from hil.reconcile.search.problem import pose

_ALPHA, _SAME, _LEAST_KEPT = 0.05, 0.95, 0.04
_NULLS, _DRAWS = 1500, 200


def shares(design: Design, model: str, seed: int) -> dict[float, list[tuple[float, float]]]:
    """Per size: the shares detected, and detected with the true name first, one pair for each visible effect."""
    case, rng = make_case(seed, (), 1.0, model=model, design=design), np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as scratch:
        campaign = read_campaign(write_case(case, Path(scratch) / "case"))
    white = np.kron(np.eye(2), np.linalg.inv(np.linalg.cholesky(noise_covariance(case.night, Noise()))))
    basis, _ = np.linalg.qr(white @ base_columns(case.night, model))

    def beside(rows: np.ndarray) -> np.ndarray:
        return np.asarray(rows - basis @ (basis.T @ rows))

    spans: list[tuple[str, np.ndarray]] = []
    for candidate in pose(campaign, load_model(model), (*BASE_EFFECTS, *EFFECTS)).candidates:
        columns = white @ np.concatenate([candidate.columns[:, channel, :] for channel in (0, 1)])
        columns = columns[:, np.any(columns, axis=0)]
        left, kept, _ = np.linalg.svd(beside(columns / np.linalg.norm(columns, axis=0)), full_matrices=False)
        if np.any(kept > _LEAST_KEPT):
            spans.append((candidate.name, left[:, kept > _LEAST_KEPT]))

    def surprise(data: np.ndarray) -> np.ndarray:
        """Minus log of each candidate's p-value, (candidates, data sets)."""
        return np.array([-stats.chi2.logsf(np.sum((s.T @ data) ** 2, axis=0), s.shape[1]) for _, s in spans])

    threshold = np.quantile(surprise(beside(rng.standard_normal((len(white), _NULLS)))).max(axis=0), 1.0 - _ALPHA)
    out: dict[float, list[tuple[float, float]]] = {d: [] for d in SIZES}
    for name in visible(design, model):
        signal = make_case(seed, (name,), 1.0, model=model, design=design).signals[0]
        true = beside(white @ signal.T.ravel())
        true = true / np.linalg.norm(true)
        same = {name, *(n for n, s in spans if np.linalg.norm(s.T @ true) > _SAME)}
        others = np.array([n not in same for n, _ in spans])
        errors = beside(rng.standard_normal((len(white), _DRAWS)))
        for d in SIZES:
            data = d * true[:, None] + errors
            own = -stats.chi2.logsf((true @ data) ** 2, 1)
            found = own > threshold
            first = found & (own > surprise(data)[others].max(axis=0))
            out[d].append((float(found.mean()), float(first.mean())))
    return out


def main() -> None:
    """Print the mean over all designs and their visible effects, one line per size."""
    everything = [shares(design, model, seed) for seed, (design, model) in enumerate(SETTINGS, start=1)]
    print("| d | finds something | true class first | effects |\n|---|---|---|---|")
    for d in SIZES:
        pairs = np.array([pair for part in everything for pair in part[d]])
        print(f"| {d:g} | {pairs[:, 0].mean():.3f} | {pairs[:, 1].mean():.3f} | {len(pairs)} |")


if __name__ == "__main__":
    main()
