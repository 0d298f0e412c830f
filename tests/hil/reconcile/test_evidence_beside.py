"""One number in two blocks, and rows that are held out: by the joint density, and by a refit without them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.special import gammaln, logsumexp
from scipy.stats import multivariate_normal, norm

from hil.campaign import Conditions, FloatArray
from hil.model import load_model
from hil.model.effects.base import Base
from hil.model.effects.data import Mislabelled
from hil.reconcile.proof.held_out import Rows, by_run
from hil.reconcile.search.fitted import fitted_block
from hil.reconcile.search.layout import searches
from hil.reconcile.search.problem import pose
from hil.reconcile.search.sets import SensorSearch
from tests.hil.reconcile.hidden_effects import both, hidden_campaign
from tests.hil.reconcile.test_evidence import Usual, covariance_of, search, term

__all__ = ["search"]  # the fixture


def joint(search: SensorSearch, chosen: tuple[int, ...]) -> float:
    """Log evidence of all blocks with one amplitude that is tied, laid out on a line, and exchanges beside it."""
    (tied,) = (j for j in chosen if search.terms[j].ties)
    along, by_block = np.linspace(-400.0, 400.0, 80001), []
    for b, own in enumerate(search.blocks):
        beside = null_space(own.block.base.T)
        freedom, total = beside.shape[1], np.full(len(along), -np.inf)
        volume = -0.5 * np.linalg.slogdet(own.block.base.T @ own.block.base)[1]
        columns = {j: beside.T @ part.columns[:, 0] / own.unit for j in chosen if (part := search.terms[j].parts[b])}
        column = columns.pop(tied)
        known = np.column_stack([np.zeros(freedom), *(x * search.terms[j].scale for j, x in columns.items())])
        right = np.array(
            [0.0, *(search.terms[j].amplitudes[b][0].deviation[0] / search.terms[j].scale[0] for j in columns)]
        )
        y = beside.T @ own.y - known.sum(axis=1)
        for t in range(len(own.points)):
            covariance = beside.T @ covariance_of(own, t) @ beside + (known * right**2) @ known.T
            root = np.linalg.cholesky(covariance)
            left, x = np.linalg.solve(root, np.column_stack([y, column])).T
            squares = left @ left - 2.0 * along * (x @ left) + along**2 * (x @ x)
            for a, strength, weight in own.scales:
                log = a * np.log(strength) + gammaln(a + 0.5 * freedom) - gammaln(a) + np.log(weight)
                log += own.points.log_prior[t] + volume - np.log(np.diag(root)).sum()
                total = np.logaddexp(total, log - (a + 0.5 * freedom) * np.log(strength + 0.5 * squares))
        by_block.append(total)
    prior = [
        log_weight + norm.logpdf(along, a.mean[0], size * a.deviation[0])
        for a in search.terms[tied].amplitudes[0]
        for size, log_weight in zip(a.sizes, a.log_weights, strict=True)
    ]
    return float(logsumexp(sum(by_block) + logsumexp(prior, axis=0)) + np.log(along[1] - along[0]))


class Together(Usual):
    """One that both channels have in common."""

    id = "together"

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        """Return volts above 28, in both channels."""
        return super().columns(conditions, base, shape).sum(axis=2, keepdims=True)


@pytest.mark.parametrize("runs", [(), (5, 6)])
@pytest.mark.parametrize(
    ("sizes", "within"),
    [
        ((40.0, 41.0), 0.5),
        ((40.0, -40.0), 6.5),
        pytest.param((8.0, -3.0), 1.0, marks=pytest.mark.slow),
        pytest.param((0.0, 0.0), 0.5, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("calibrated", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_one_number_in_two_blocks_has_the_evidence_that_a_joint_density_says(
    runs: tuple[int, ...], sizes: tuple[float, float], within: float, *, calibrated: bool
) -> None:
    """Where blocks agree, where they contradict each other, and beside labels that are exchanged, or are not put right.

    Sizes that none of the blocks likes best are not tried: what they contradict most may be that much less probable.
    """
    hidden = lambda r: both(r.supply - 28.0, *sizes)  # noqa: E731
    campaign = hidden_campaign(421, hidden, temperatures=(-10.0, 23.0, 50.0), runs_each=3, positions=("1", "2", "3"))
    rates = campaign.sensors[2].rates_deg_per_hr
    rates[[12, 13, 15, 16]] = rates[[13, 12, 16, 15]]
    problem = pose(campaign, load_model("matrix-6-thermal"), (Together(),))
    stand = searches(problem, (Mislabelled(),), ())
    search = (searches(problem, (Mislabelled(),), (), stand) if calibrated else stand)[2]
    exchanges = [
        next(j for j, t in enumerate(search.terms) if t.candidate.shape == {"run": run, "exchange": 0}) for run in runs
    ]
    chosen = (term(search, "together"), *exchanges)
    found = sum(logsumexp(own) for own in search.evidence([chosen])[0])
    assert found == pytest.approx(joint(search, chosen), abs=within)


@pytest.mark.parametrize("scatter", ["", "MU_rr", "markov"])
def test_what_is_held_out_is_predicted_as_by_a_refit_without_it(search: SensorSearch, scatter: str) -> None:
    """Each error and density: base and effect refitted to the others by least squares."""
    block = fitted_block(search, (term(search, "usual"),), frozenset(scatter.split()), 0)
    own, folds = block.search.block, by_run(block)
    noise = block.scale * block.search.noise.unit * covariance_of(block.search, block.at)
    design = np.hstack([own.base, block.columns])
    weight = np.concatenate([np.zeros(own.base.shape[1]), block.weighed.prior()[1] ** -2])
    rows, seen = Rows(block.search, set()), 0
    for fold, predicted in rows.runs(block):
        out, rest = np.flatnonzero(folds == fold), np.flatnonzero(folds != fold)
        if len(predicted.error) != len(out):
            continue  # what the others say nothing about is left out of the fold
        order = np.argsort(predicted.rows)
        assert np.array_equal(predicted.rows[order], out)
        carried = noise[np.ix_(out, rest)] @ np.linalg.inv(noise[np.ix_(rest, rest)])
        inverse = np.linalg.inv(noise[np.ix_(rest, rest)])
        spread = np.linalg.inv(design[rest].T @ inverse @ design[rest] + np.diag(weight))
        values = spread @ design[rest].T @ inverse @ own.y[rest]
        error = own.y[out] - design[out] @ values - carried @ (own.y[rest] - design[rest] @ values)
        new = design[out] - carried @ design[rest]
        covariance = noise[np.ix_(out, out)] - carried @ noise[np.ix_(rest, out)] + new @ spread @ new.T
        np.testing.assert_allclose(predicted.error[order], error, rtol=1e-3, atol=1e-3)
        density = multivariate_normal.logpdf(error, np.zeros(len(out)), covariance)
        assert predicted.log_density == pytest.approx(density, abs=0.01)
        seen += 1
    assert seen >= 4
