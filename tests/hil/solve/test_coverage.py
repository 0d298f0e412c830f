"""Stated intervals cover the truth as often as they say, and one wrong sign is enough to stop that."""

from __future__ import annotations

import numpy as np
import pytest

from hil.model.earth import Site
from hil.model.equation import Orientation, pickoff_rates, rotor_matrix
from hil.solve import Solution, solve
from tests.hil.solve.closed_covariances import contractor_covariance
from tests.hil.solve.closed_forms import contractor_solution

NAMES = ("BA", "BB", "GSA", "GSB", "MUA", "MUB")
RUNS = 20_000
SITE = Site.from_gravity(34.6, 30.0, 0.001, -0.016)
THETA_DEG = {"1": -90.0, "2": 90.0, "3": 0.0, "4": 180.0}
K_SIGNS = {("RA", "GSA"): (0, 0), ("RA", "GSB"): (0, 1), ("RA", "MUB"): (0, 2)}
K_SIGNS |= {("RB", "GSB"): (1, 0), ("RB", "GSA"): (1, 1), ("RB", "MUA"): (1, 2)}


LEANING = Site.from_gravity(34.6, 30.0, 0.3, -0.2)
"""On a level bench fB is 0 in every collect, and a wrong sign of what it multiplies does nothing at all."""


def geometry(labels: str, site: Site = SITE) -> tuple[np.ndarray, np.ndarray]:
    """Return f (n, 3) and w about A and B (n, 2)."""
    turned = [Orientation.from_rotation_about_2(label, THETA_DEG[label]) for label in labels]
    f_g = np.array([each.components(site.gravity_g()) for each in turned])
    return f_g, np.array([each.components(site.earth_rate_deg_per_hr())[:2] for each in turned])


def draw_truth(rng: np.random.Generator) -> np.ndarray:
    """Return parameters of many units, (RUNS, 6)."""
    return rng.normal(0, [20, 20, 60, 60, 20, 20], (RUNS, 6))


def simulate(
    truth: np.ndarray,
    sigma: np.ndarray,
    labels: str,
    site: Site = SITE,
    k_sign: np.ndarray | float = 1.0,
    w_sign: np.ndarray | float = 1.0,
) -> np.ndarray:
    """Rates (RUNS, n, 2) with white noise; `k_sign` (2, 3) and `w_sign` (n, 2) may spoil a sign."""
    f_g, w = geometry(labels, site)
    k = rotor_matrix(*truth[:, 2:].T)[:, None] * k_sign
    rates = pickoff_rates(truth[:, None, :2], k, f_g, w * w_sign)
    return rates + sigma * np.random.default_rng(11).normal(size=rates.shape)


def solved(rates: np.ndarray, sigma: np.ndarray | None, labels: str, site: Site = SITE) -> Solution:
    """Solve all runs with the right signs; the design is that of the one equation."""
    f_g, w = geometry(labels, site)
    probes = np.eye(6)[:, None]
    k = rotor_matrix(*np.moveaxis(probes[..., 2:], -1, 0))
    design = pickoff_rates(probes[..., :2], k, f_g, np.zeros(2)).reshape(6, -1).T
    noise = None if sigma is None else np.broadcast_to(sigma, rates.shape).reshape(len(rates), -1)
    return solve(design, (rates - w).reshape(len(rates), -1), noise, names=NAMES)


def coverage(solution: Solution, truth: np.ndarray, factor: float = 1.959964) -> np.ndarray:
    """Share of runs whose interval holds the truth, per parameter."""
    return np.mean(np.abs(solution.values - truth) < factor * solution.se, axis=0)


@pytest.mark.parametrize("labels", ["123", "132", "1234", "132231"])
def test_95_percent_intervals_cover_95_percent_per_parameter(labels: str) -> None:
    """20 000 runs with unequal noise that is stated: between 93 and 97 % for each of the six."""
    rng = np.random.default_rng(7)
    sigma = rng.uniform(0.5, 2.0, (len(labels), 2))
    truth = draw_truth(rng)
    rates = simulate(truth, sigma, labels)
    found = coverage(solved(rates, sigma, labels), truth)
    assert np.all((found > 0.93) & (found < 0.97)), found


def test_intervals_from_residuals_cover_with_students_factor() -> None:
    """Without stated noise, ten residuals: Student's 2.228 in place of 1.96."""
    truth = draw_truth(np.random.default_rng(8))
    rates = simulate(truth, np.array(0.9), "12344321")
    found = coverage(solved(rates, None, "12344321"), truth, factor=2.228139)
    assert np.all((found > 0.93) & (found < 0.97)), found


def test_the_chi_square_of_the_residuals_has_its_distribution() -> None:
    """With two degrees of freedom: mean 2, and 5 % above 5.99, so that MARGINAL and FAIL mean what they say."""
    truth = draw_truth(np.random.default_rng(9))
    rates = simulate(truth, np.array(0.9), "1234")
    chi_square = solved(rates, np.array(0.9), "1234").chi_square
    assert chi_square.mean() == pytest.approx(2.0, abs=0.05)
    assert np.mean(chi_square > 5.991) == pytest.approx(0.05, abs=0.006)


def test_the_contractors_intervals_cover_when_mu_is_zero_and_not_when_it_is_real() -> None:
    """His covariance is right; his model is not."""
    rng = np.random.default_rng(10)
    gravity, earth = SITE.gravity_g(), SITE.earth_rate_deg_per_hr()
    se = 0.9 * np.sqrt(np.diagonal(contractor_covariance(gravity, np.eye(6))))
    for mu, low, high in ((0.0, 0.93, 0.97), (1.0, 0.0, 0.2)):
        truth = draw_truth(rng)
        truth[:, 4:] *= mu
        rates = simulate(truth, np.array(0.9), "123")
        values = contractor_solution(rates, gravity, earth)
        bias = np.mean(np.abs(values - truth[:, :4]) < 1.959964 * se, axis=0)[:2]
        assert np.all((bias > low) & (bias < high)), bias


def least_coverage(**spoilt: np.ndarray) -> float:
    """Return the coverage of the worst parameter on the leaning bench, with a sign spoilt or none."""
    truth = draw_truth(np.random.default_rng(7))
    rates = simulate(truth, np.array(0.9), "123", LEANING, **spoilt)
    return float(coverage(solved(rates, np.array(0.9), "123", LEANING), truth).min())


def test_with_every_sign_right_nothing_is_caught() -> None:
    """The two tests below can tell right from wrong."""
    assert least_coverage() > 0.93


@pytest.mark.parametrize("term", K_SIGNS)
def test_a_flipped_sign_of_a_sensitivity_is_caught(term: tuple[str, str]) -> None:
    """Six of the twelve terms: with any sign of K wrong, some parameter's intervals cover less than 93 %."""
    k_sign = np.ones((2, 3))
    k_sign[K_SIGNS[term]] = -1.0
    assert least_coverage(k_sign=k_sign) < 0.93


@pytest.mark.parametrize("term", list(np.ndindex(3, 2)))
def test_a_flipped_sign_of_an_earth_rate_is_caught(term: tuple[int, int]) -> None:
    """The other six: the earth rate of each collect about each axis."""
    w_sign = np.ones((3, 2))
    w_sign[term] = -1.0
    assert least_coverage(w_sign=w_sign) < 0.93
