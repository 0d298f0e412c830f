"""The report's closed forms against the solver, and against each other."""

from __future__ import annotations

import numpy as np
import pytest

from hil.analysis.published.reproduction import contractor_error, seven_biases
from hil.model.equation import RD_GC_86_1_SENSOR_2, pickoff_rates, rotor_matrix
from hil.solve import solve
from tests.hil.solve.closed_covariances import contractor_covariance, matrix_covariance
from tests.hil.solve.closed_forms import contractor_solution, matrix_solution

SEEDS = range(4)


def draw(seed: int, tilt: float = 0.3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return arbitrary parameters (6,), G (3,) with G1 the largest, and W (3,)."""
    rng = np.random.default_rng(seed)
    return rng.normal(0, 40, 6), np.array([1.0, 0, 0]) + rng.normal(0, tilt, 3), rng.normal(0, 10, 3)


def rates_of(truth: np.ndarray, gravity: np.ndarray, earth: np.ndarray) -> np.ndarray:
    """Rates (3, 2) by the one equation."""
    k = rotor_matrix(*truth[2:])
    rows = [RD_GC_86_1_SENSOR_2[label] for label in "123"]
    return np.array([pickoff_rates(truth[:2], k, row.components(gravity), row.components(earth)[:2]) for row in rows])


def design_of(gravity: np.ndarray) -> np.ndarray:
    """Printed matrix of the report (rows by collect and channel), columns in the order BA, BB, GSA, GSB, MUA, MUB.

    Transcribed from page 3: columns there are MUA, MUB, BA, BB, GSA, GSB.
    """
    g1, g2, g3 = gravity
    printed = np.array(
        [
            [0, g3, 1, 0, -g1, g2],
            [-g3, 0, 0, 1, g2, g1],
            [0, -g3, 1, 0, g1, g2],
            [g3, 0, 0, 1, g2, -g1],
            [0, g1, 1, 0, g3, g2],
            [-g1, 0, 0, 1, g2, -g3],
        ]
    )
    return printed[:, [2, 3, 4, 5, 0, 1]]


def earth_of(earth: np.ndarray) -> np.ndarray:
    """Earth rate in the six equations, as printed on the left-hand side (row 6 with RB, corrected)."""
    w1, w2, w3 = earth
    return np.array([-w1, w2, w1, w2, w3, w2])


@pytest.mark.parametrize("seed", SEEDS)
def test_the_printed_matrix_inverts_the_one_equation(seed: int) -> None:
    """Rates made by the equation, solved with the report's printed (corrected) matrix, give the parameters back."""
    truth, gravity, earth = draw(seed)
    observed = rates_of(truth, gravity, earth).reshape(-1) - earth_of(earth)
    np.testing.assert_allclose(solve(design_of(gravity), observed, 1.0).values, truth, rtol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_matrix_solution_is_the_solvers_for_noisy_rates(seed: int) -> None:
    """(11), (12), (A-23)-(A-26) are the least-squares solution of six equations, whatever the rates."""
    _, gravity, earth = draw(seed)
    rates = np.random.default_rng(seed + 100).normal(0, 50, (3, 2))
    solved = solve(design_of(gravity), rates.reshape(-1) - earth_of(earth), 1.0)
    np.testing.assert_allclose(matrix_solution(rates, gravity, earth), solved.values, rtol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_every_entry_of_the_closed_covariance_is_the_solvers(seed: int) -> None:
    """All 36 entries, cross terms and zeros included, for arbitrary G."""
    _, gravity, _ = draw(seed)
    solved = solve(design_of(gravity), np.zeros(6), 1.0)
    np.testing.assert_allclose(matrix_covariance(gravity), solved.covariance, atol=1e-12, rtol=1e-9)


def test_at_one_g_the_variances_are_those_of_the_notes() -> None:
    """BA, BB 0.5, GS 0.5, MU 1.5 sigma²; BA with MUB -1/2, BB with MUA +1/2."""
    covariance = matrix_covariance([1.0, 0.0, 0.0])
    np.testing.assert_allclose(np.diagonal(covariance), [0.5, 0.5, 0.5, 0.5, 1.5, 1.5])
    assert covariance[0, 5] == -0.5
    assert covariance[1, 4] == 0.5


@pytest.mark.parametrize("seed", SEEDS)
def test_the_contractors_error_is_exact(seed: int) -> None:
    """Contractor's minus true parameters, for arbitrary tilt: the G3 terms are there too."""
    truth, gravity, earth = draw(seed)
    contractor = contractor_solution(rates_of(truth, gravity, earth), gravity, earth)
    np.testing.assert_allclose(contractor - truth[:4], contractor_error(gravity, truth[4], truth[5]), atol=1e-9)


def test_level_the_contractors_bias_is_off_by_mu() -> None:
    """The report's statement: BA by +MUB G1, BB by -MUA G1, GS not at all."""
    np.testing.assert_allclose(contractor_error(np.array([1.0, 0, 0]), mua=-37.23, mub=-7.53), [-7.53, 37.23, 0, 0])


@pytest.mark.parametrize("seed", SEEDS)
def test_the_contractors_covariance_is_propagated(seed: int) -> None:
    """White noise: var B = 1 + (G2² + G3²)/(2 G1²), var GS = 1/(2 G1²); and it agrees with 40 000 draws."""
    _, gravity, earth = draw(seed, tilt=0.1)
    g1, g2, g3 = gravity
    covariance = contractor_covariance(gravity, np.eye(6))
    bias, gs = 1 + (g2**2 + g3**2) / (2 * g1**2), 1 / (2 * g1**2)
    np.testing.assert_allclose(np.diagonal(covariance), [bias, bias, gs, gs])
    draws = contractor_solution(np.random.default_rng(seed).normal(size=(40_000, 3, 2)), gravity, earth)
    np.testing.assert_allclose(np.cov(draws.T), covariance, atol=0.04)


def test_the_contractors_covariance_takes_correlated_noise() -> None:
    """A noise common to all collects goes into the bias alone, with its full size."""
    common = np.kron(np.ones((3, 3)), np.eye(2))
    covariance = contractor_covariance([1.0, 0.0, 0.0], common)
    np.testing.assert_allclose(covariance, np.diag([1.0, 1.0, 0.0, 0.0]), atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_seven_ways_to_the_bias_differ_as_the_audit_says(seed: int) -> None:
    """(A-27)-(A-33) with true parameters are BA + {0, MUB G3, -MUB G3, MUB G1, 0, 0, 0}."""
    truth, gravity, earth = draw(seed)
    found = seven_biases(rates_of(truth, gravity, earth), gravity, earth, truth[2], truth[3], truth[5])
    g1, _, g3 = gravity
    expected = truth[0] + truth[5] * np.array([0, g3, -g3, g1, 0, 0, 0])
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_28_and_a_29_average_to_a_27_whatever_gsa_and_w1(seed: int) -> None:
    """With the contractor's own GSA all three agree: a check of published tables that needs no parameters."""
    truth, gravity, earth = draw(seed)
    rates = rates_of(truth, gravity, earth)
    anything = seven_biases(rates, gravity, earth, 123.0, truth[3], 0.0)
    assert (anything[1] + anything[2]) / 2 == pytest.approx(anything[0])
    own = contractor_solution(rates, gravity, earth)
    same = seven_biases(rates, gravity, earth, own[2], own[3], 0.0)
    np.testing.assert_allclose(same[:3], same[0], rtol=1e-9)
    assert same[3] == pytest.approx(own[0])


def test_closed_forms_take_batches() -> None:
    """Leading dimensions of rates, G and W broadcast."""
    rates = np.random.default_rng(3).normal(size=(7, 3, 2))
    gravity = np.array([1.0, 0.01, -0.02])
    batch = matrix_solution(rates, gravity, np.zeros(3))
    assert batch.shape == (7, 6)
    np.testing.assert_allclose(batch[4], matrix_solution(rates[4], gravity, np.zeros(3)))
