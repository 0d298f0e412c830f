"""How well the report's three collects are conditioned: the physics notes' §B.1 and §B.2, from the six equations."""

from __future__ import annotations

import numpy as np
import pytest

from hil.model.earth import Site
from hil.solve import solve
from tests.hil.solve.closed_covariances import contractor_covariance, matrix_covariance

NAMES = ["BA", "BB", "GSA", "GSB", "MUA", "MUB"]


def design(gravity: np.ndarray) -> np.ndarray:
    """The six equations as printed (row 6 corrected), columns BA, BB, GSA, GSB, MUA, MUB."""
    g1, g2, g3 = gravity
    rows = [
        [1, 0, -g1, g2, 0, g3],
        [0, 1, g2, g1, -g3, 0],
        [1, 0, g1, g2, 0, -g3],
        [0, 1, g2, -g1, g3, 0],
        [1, 0, g3, g2, 0, g1],
        [0, 1, g2, -g3, -g1, 0],
    ]
    return np.array(rows, dtype=np.float64)


@pytest.mark.parametrize("gravity", [[1.0, 0.0, 0.0], [0.9, 0.0, 0.4], [0.95, 0.2, -0.1]])
def test_the_determinant_is_minus_four_times_the_fourth_power_of_the_gravity_in_the_plane(gravity: list[float]) -> None:
    """The determinant is ±4 (G1² + G3²)²: G2 is nowhere in it (its sign is the order of the columns)."""
    g1, _, g3 = gravity
    assert abs(np.linalg.det(design(np.array(gravity)))) == pytest.approx(4.0 * (g1**2 + g3**2) ** 2)


def test_the_singular_values_at_1_g_and_their_independence_of_g3() -> None:
    """1.8478, 1.4142 and 0.7654, each twice; a tilt in the 1-3 plane changes none of them."""
    expected = [1.8478, 1.8478, 1.4142, 1.4142, 0.7654, 0.7654]
    for angle in (0.0, 0.3, 1.0):
        singular = np.linalg.svd(design(np.array([np.cos(angle), 0.0, np.sin(angle)])), compute_uv=False)
        np.testing.assert_allclose(singular, expected, atol=5e-5)


def test_g2_worsens_the_condition_number_as_published() -> None:
    """2.414 level, 2.68 with G2 = 0.3 g, 5.9 at 60 degrees and 17.3 at 80."""
    for g2, expected in ((0.0, 2.414), (0.3, 2.68), (np.sin(np.pi / 3), 5.9), (np.sin(np.deg2rad(80.0)), 17.3)):
        assert np.linalg.cond(design(np.array([np.sqrt(1.0 - g2**2), g2, 0.0]))) == pytest.approx(expected, rel=0.003)


@pytest.mark.parametrize("g", [0.5, 0.9, 1.0])
def test_the_eigenvalues_of_the_normal_matrix_are_the_published_ones(g: float) -> None:
    """2g² and (3 + g² ± sqrt(g⁴ - 2g² + 9))/2, each twice."""
    matrix = design(np.array([g, 0.0, 0.0]))
    root = np.sqrt(g**4 - 2 * g**2 + 9)
    expected = sorted([2 * g**2, (3 + g**2 + root) / 2, (3 + g**2 - root) / 2] * 2)
    np.testing.assert_allclose(np.linalg.eigvalsh(matrix.T @ matrix), expected, rtol=1e-9)


@pytest.mark.parametrize("gravity", [[1.0, 0.0, 0.0], [0.99, 0.02, -0.05], [0.9, 0.3, 0.2]])
def test_the_closed_covariance_is_the_solvers(gravity: list[float]) -> None:
    """All thirty-six entries for unit noise, §B.2."""
    g = np.array(gravity)
    solution = solve(design(g), np.zeros(6), 1.0, names=NAMES)
    np.testing.assert_allclose(solution.covariance, matrix_covariance(g), atol=1e-12)


def test_the_matrix_bias_is_quieter_and_the_total_in_navigation_is_not() -> None:
    """Variances: bias 0.5, MU 1.5, contractor's bias 1.0; BA + MUB, the navigation total, 1.0 again."""
    level = np.array([1.0, 0.0, 0.0])
    covariance = matrix_covariance(level)
    np.testing.assert_allclose(np.diag(covariance), [0.5, 0.5, 0.5, 0.5, 1.5, 1.5])
    total = np.array([1.0, 0, 0, 0, 0, 1.0])
    assert total @ covariance @ total == pytest.approx(1.0)
    contractor = contractor_covariance(level, np.eye(6))
    np.testing.assert_allclose(np.diag(contractor), [1.0, 1.0, 0.5, 0.5])
    tilted = np.array([0.95, 0.1, 0.3])
    bias = 1.0 + (0.1**2 + 0.3**2) / (2 * 0.95**2)
    np.testing.assert_allclose(np.diag(contractor_covariance(tilted, np.eye(6)))[:2], bias)


def test_a_blunder_in_the_sign_of_the_earth_rate_is_as_large_as_published() -> None:
    """Twice W1 is 17.1 deg/hr at 34.6 N; twice the horizontal part at most 24.8."""
    w1 = Site(34.6, 0.0).earth_rate_deg_per_hr()[0]
    level = [np.abs(Site(34.6, heading).earth_rate_deg_per_hr()[1:]).max() for heading in np.arange(0.0, 360.0, 5.0)]
    assert 2 * w1 == pytest.approx(17.1, abs=0.05)
    assert 2 * max(level) == pytest.approx(24.8, abs=0.05)
