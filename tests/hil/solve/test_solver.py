"""Weighted least squares in batches, and what it refuses to know."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.model.equation import Orientation, pickoff_rates, rotor_matrix
from hil.solve import solve

NAMES = ("BA", "BB", "GSA", "GSB", "MUA", "MUB")
THETA_DEG = {"1": -90.0, "2": 90.0, "3": 0.0, "4": 180.0}
TRUTH = np.array([22.08, -37.83, 46.8, -19.8, -37.23, -7.53])


def design(gravity: object, labels: str = "123") -> np.ndarray:
    """Design (2 n, 6) of collects at the report's angles, made by probing the equation itself."""
    rows = []
    for label in labels:
        f_g = Orientation.from_rotation_about_2(label, THETA_DEG[label]).components(np.asarray(gravity))
        probes = np.eye(6)
        rows.append(np.array([pickoff_rates(p[:2], rotor_matrix(*p[2:]), f_g, np.zeros(2)) for p in probes]).T)
    return np.concatenate(rows)


@pytest.mark.parametrize("gravity", [(1.0, 0, 0), (0.8, 0, 0.6), (0.6, 0, -0.8)])
def test_the_condition_number_is_one_plus_root_two_wherever_g_lies_in_the_1_3_plane(gravity: tuple[float, ...]) -> None:
    """Tilting by G3 at constant |G| moves variance between MU and GS but not the conditioning."""
    solution = solve(design(gravity), np.zeros(6), 1.0)
    assert float(solution.condition_number) == pytest.approx(1 + np.sqrt(2))


@pytest.mark.parametrize(
    ("angle_deg", "expected", "precision"),
    [(np.rad2deg(np.arcsin(0.3)), 2.68, 0.01), (60, 5.9, 0.05), (80, 17.3, 0.05)],
)
def test_conditioning_falls_as_g_leans_to_axis_2(angle_deg: float, expected: float, precision: float) -> None:
    """G2 = 0.3 g gives 2.68, 60 degrees 5.9, 80 degrees 17.3."""
    angle = np.deg2rad(angle_deg)
    solution = solve(design((np.cos(angle), np.sin(angle), 0.0)), np.zeros(6), 1.0)
    assert float(solution.condition_number) == pytest.approx(expected, abs=precision)


@pytest.mark.parametrize(
    ("labels", "bias", "gs", "mu"),
    [
        ("123", 0.71, 0.71, 1.22),
        ("13231", 0.61, 0.61, 0.94),
        ("132231", 0.50, 0.50, 0.87),
        ("1234", 0.50, 0.71, 0.71),
        ("12344321", 0.35, 0.50, 0.50),
    ],
)
def test_richer_sequences_have_the_standard_errors_of_the_notes(labels: str, bias: float, gs: float, mu: float) -> None:
    """Per unit noise; a fourth collect nearly halves that of MU."""
    solution = solve(design((1.0, 0, 0), labels), np.zeros(2 * len(labels)), 1.0)
    np.testing.assert_allclose(solution.se, [bias, bias, gs, gs, mu, mu], atol=0.006)


def test_unequal_noise_is_weighted_like_numpys_least_squares_of_scaled_rows() -> None:
    """Values and covariance agree with numpy.linalg on the rows divided by their noise."""
    rng = np.random.default_rng(0)
    rows, sigma = design((0.99, 0.05, -0.1), "12341"), rng.uniform(0.3, 3.0, 10)
    observed = rows @ TRUTH + sigma * rng.normal(size=10)
    solution = solve(rows, observed, sigma)
    scaled = rows / sigma[:, None]
    np.testing.assert_allclose(solution.values, np.linalg.lstsq(scaled, observed / sigma)[0], rtol=1e-10)
    np.testing.assert_allclose(solution.covariance, np.linalg.inv(scaled.T @ scaled), rtol=1e-10, atol=1e-14)
    assert float(solution.chi_square) == pytest.approx(np.sum(((observed - rows @ solution.values) / sigma) ** 2))
    assert int(solution.degrees_of_freedom) == 4


def test_rows_that_are_whitened_before_are_generalised_least_squares() -> None:
    """Correlated noise C, whitened by the inverse of its Cholesky factor, gives (AᵀC⁻¹A)⁻¹AᵀC⁻¹y."""
    rng = np.random.default_rng(1)
    rows = design((0.99, 0.05, -0.1), "1234")
    root = rng.normal(size=(8, 8))
    noise = root @ root.T + np.eye(8)
    observed = rows @ TRUTH + rng.normal(size=8)
    weight = np.linalg.inv(noise)
    expected = np.linalg.inv(rows.T @ weight @ rows)
    whiten = np.linalg.inv(np.linalg.cholesky(noise))
    solution = solve(whiten @ rows, whiten @ observed, 1.0)
    np.testing.assert_allclose(solution.covariance, expected, rtol=1e-8)
    np.testing.assert_allclose(solution.values, expected @ rows.T @ weight @ observed, rtol=1e-8)


def test_a_missing_row_is_as_if_it_had_never_been() -> None:
    """NaN in the data equals leaving row and noise out; its residual is NaN."""
    rng = np.random.default_rng(2)
    rows = design((0.99, 0.05, -0.1), "12341")
    observed = rows @ TRUTH + rng.normal(size=10)
    sigma = rng.uniform(0.7, 1.4, 10)
    kept = np.delete(np.arange(10), [3, 8])
    observed[[3, 8]] = np.nan
    found = solve(rows, observed, sigma)
    less = solve(rows[kept], observed[kept], sigma[kept])
    np.testing.assert_allclose(found.values, less.values, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, less.covariance, rtol=1e-9)
    assert int(found.degrees_of_freedom) == 2
    np.testing.assert_array_equal(np.isnan(found.residuals), np.isnan(observed))


def test_without_stated_noise_it_comes_from_the_residuals() -> None:
    """The covariance is scaled by the residual variance; an exact fit of six by six has none, and says NaN."""
    rng = np.random.default_rng(3)
    rows = design((1.0, 0, 0), "1234")
    observed = rows @ TRUTH + 0.9 * rng.normal(size=8)
    solution = solve(rows, observed)
    variance = np.sum(solution.residuals**2) / 2
    np.testing.assert_allclose(solution.covariance, variance * np.linalg.inv(rows.T @ rows), rtol=1e-9, atol=1e-12)
    six = solve(rows[:6], observed[:6])
    assert np.all(np.isnan(six.covariance))
    assert np.all(np.isfinite(six.values))
    assert np.isnan(float(six.residual_rms))


def test_a_batch_gives_what_each_member_gives_alone() -> None:
    """Distinct designs, noise and missing rows, over two leading dimensions, including members that lack rank."""
    rng = np.random.default_rng(4)
    gravities = np.array([1.0, 0, 0]) + rng.normal(0, 0.1, (3, 4, 3))
    rows = np.array([[design(gravity, "1234") for gravity in line] for line in gravities])
    observed = rng.normal(0, 50, (3, 4, 8))
    sigma = rng.uniform(0.5, 2.0, (3, 4, 8))
    observed[0, 1, 4] = observed[1, 2, 0] = np.nan
    observed[2, 3, 4:] = np.nan  # Collects 1 and 2 only
    batch = solve(rows, observed, sigma, names=NAMES)
    for index in np.ndindex(3, 4):
        alone = solve(rows[index], observed[index], sigma[index], names=NAMES)
        np.testing.assert_allclose(batch.values[index], alone.values, rtol=1e-9)
        np.testing.assert_allclose(batch.covariance[index], alone.covariance, rtol=1e-9, atol=1e-12)
        assert batch.condition_number[index] == pytest.approx(float(alone.condition_number))
    assert batch.rank.tolist() == [[6] * 4, [6] * 4, [6, 6, 6, 4]]


def test_one_design_serves_a_batch_of_observations() -> None:
    """A shared design and noise broadcast over draws."""
    rows = design((1.0, 0.001, -0.016))
    draws = TRUTH @ rows.T + 0.9 * np.random.default_rng(5).normal(size=(50, 6))
    batch = solve(rows, draws, 0.9)
    assert batch.covariance.shape == (50, 6, 6)
    np.testing.assert_allclose(batch.values[17], solve(rows, draws[17], 0.9).values, rtol=1e-12)


@given(st.lists(st.sampled_from("1234"), min_size=1, max_size=6), st.integers(0, 2**32 - 1))
def test_no_set_of_collects_ever_gives_a_wrong_number(labels: list[str], seed: int) -> None:
    """Without noise every value that is given is the truth; what is not given is named."""
    truth = np.random.default_rng(seed).normal(0, 50, 6)
    rows = design((0.99987, 0.001, -0.016), "".join(labels))
    solution = solve(rows, rows @ truth, 0.9, names=NAMES)
    given_values = ~np.isnan(solution.values)
    np.testing.assert_allclose(solution.values[given_values], truth[given_values], atol=0.02)
    named = " ".join(solution.observability.sentences)
    for name, is_given in zip(NAMES, given_values, strict=True):
        assert is_given != (name in named)
    assert (int(solution.rank) == 6) == bool(given_values.all())


def test_collects_1_and_2_alone_leave_mu_unseen_and_give_the_rest() -> None:
    """Level, the bias and GS are known from two collects; MUA and MUB are named."""
    rows = design((1.0, 0, 0), "12")
    solution = solve(rows, rows @ TRUTH, 0.9, names=NAMES)
    np.testing.assert_allclose(solution.values[:4], TRUTH[:4])
    assert np.all(np.isnan(solution.values[4:]))
    assert solution.observability.sentences == ("MUA is not seen", "MUB is not seen")
    assert np.isinf(float(solution.condition_number))


def test_one_collect_sees_only_mixtures_and_says_which() -> None:
    """In Collect 3 the bias and MU act together: their sum is seen, their difference is not."""
    rows = design((1.0, 0, 0), "3")
    solution = solve(rows, rows @ TRUTH, 0.9, names=NAMES)
    assert np.all(np.isnan(solution.values))
    assert "BA + MUB is seen, BA - MUB is not" in solution.observability.sentences
    assert "BB - MUA is seen, BB + MUA is not" in solution.observability.sentences
    assert "GSA is not seen" in solution.observability.sentences
    seen = {text: (value, se) for text, value, se in solution.combinations()}
    assert seen["BA + MUB"] == pytest.approx((TRUTH[0] + TRUTH[5], 0.9))


def test_mixed_members_of_a_tilted_pair_are_given_as_a_combination() -> None:
    """With G3 = -16 mrad, Collects 1 and 2 see GSA + 0.016 MUB: a value for GSA alone would be wrong by that."""
    rows = design((0.99987, 0, -0.016), "12")
    solution = solve(rows, rows @ TRUTH, 0.9, names=NAMES)
    assert np.isnan(solution.values[2])
    seen = {text: value for text, value, _ in solution.combinations()}
    assert seen["GSA + 0.016 MUB"] == pytest.approx(TRUTH[2] + 0.016 / 0.99987 * TRUTH[5])


def test_combinations_of_large_columns_are_in_the_parameters_own_units() -> None:
    """At one temperature, 30 degrees from the reference, value, slope and curvature are seen as one sum."""
    solution = solve([[1.0, 30.0, 900.0]] * 3, [7.0, 8.0, 9.0], 1.0, names=("B", "B1", "B2"))
    ((text, value, se),) = solution.combinations()
    assert text == "0.00111 B + 0.0333 B1 + B2"
    assert value == pytest.approx(8.0 / 900)
    assert se == pytest.approx(1 / np.sqrt(3) / 900)
    assert np.all(np.isnan(solution.values))


LONGLEY = """
60323 83.0 234289 2356 1590 107608 1947
61122 88.5 259426 2325 1456 108632 1948
60171 88.2 258054 3682 1616 109773 1949
61187 89.5 284599 3351 1650 110929 1950
63221 96.2 328975 2099 3099 112075 1951
63639 98.1 346999 1932 3594 113270 1952
64989 99.0 365385 1870 3547 115094 1953
63761 100.0 363112 3578 3350 116219 1954
66019 101.2 397469 2904 3048 117388 1955
67857 104.6 419180 2822 2857 118734 1956
68169 108.4 442769 2936 2798 120445 1957
66513 110.8 444546 4681 2637 121950 1958
68655 112.6 482704 3813 2552 123366 1959
69564 114.2 502601 3931 2514 125368 1960
69331 115.7 518173 4806 2572 127852 1961
70551 116.9 554894 4007 2827 130081 1962
"""
LONGLEY_CERTIFIED = {
    "b0": (-3482258.63459582, 890420.383607373),
    "b1": (15.0618722713733, 84.9149257747669),
    "b2": (-0.358191792925910e-01, 0.334910077722432e-01),
    "b3": (-2.02022980381683, 0.488399681651699),
    "b4": (-1.03322686717359, 0.214274163161675),
    "b5": (-0.511041056535807e-01, 0.226073200069370),
    "b6": (1829.15146461355, 455.478499142212),
}


def test_longley_agrees_with_the_certified_values_to_nine_digits() -> None:
    """NIST StRD's ill-conditioned regression: coefficients and standard errors, noise from the residuals."""
    data = np.array(LONGLEY.split(), dtype=float).reshape(16, 7)
    rows = np.column_stack([np.ones(16), data[:, 1:]])
    solution = solve(rows, data[:, 0], names=tuple(LONGLEY_CERTIFIED))
    certified = np.array(list(LONGLEY_CERTIFIED.values()))
    np.testing.assert_allclose(solution.values, certified[:, 0], rtol=1e-9)
    np.testing.assert_allclose(solution.se, certified[:, 1], rtol=1e-9)


def test_a_solution_prints_itself_readably() -> None:
    """One solution with its errors; a batch by its size."""
    rows = design((1.0, 0, 0))
    assert repr(solve(rows, rows @ TRUTH, 0.9, names=NAMES)).startswith("<BA = 22.08 ± 0.64, BB = -37.83 ± 0.64")
    assert repr(solve(rows, np.zeros((5, 6)), 0.9, names=NAMES)) == "<5 solutions for BA, BB, GSA, GSB, MUA, MUB>"


def test_nothing_measured_knows_nothing() -> None:
    """All rows missing: no value, no covariance, rank 0."""
    solution = solve(design((1.0, 0, 0)), np.full(6, np.nan), 0.9, names=NAMES)
    assert np.all(np.isnan(solution.values))
    assert int(solution.rank) == 0
    assert len(solution.observability.sentences) == 6


def test_an_ill_conditioned_problem_keeps_its_digits() -> None:
    """Condition 10⁷ goes through the singular values: nine digits remain, where normal equations have two."""
    rng = np.random.default_rng(6)
    left, _ = np.linalg.qr(rng.normal(size=(20, 4)))
    right, _ = np.linalg.qr(rng.normal(size=(4, 4)))
    rows = left @ np.diag([1.0, 1e-2, 1e-4, 1e-7]) @ right.T
    truth = np.array([1.0, -2.0, 3.0, -4.0])
    solution = solve(rows, rows @ truth, 1.0)
    np.testing.assert_allclose(solution.values, truth, rtol=1e-7)
    assert float(solution.condition_number) == pytest.approx(1e7, rel=1e-3)


def test_a_tolerance_declares_what_is_hardly_excited_unseen() -> None:
    """A direction excited by 10⁻⁴ of the rest is solved by default and refused at a tolerance of 10⁻³."""
    rows = np.array([[1.0, 0.0], [1.0, 1e-4], [1.0, -1e-4]])
    assert int(solve(rows, np.zeros(3), 1.0).rank) == 2
    coarse = solve(rows, np.zeros(3), 1.0, names=("B", "K"), rank_tolerance=1e-3)
    assert coarse.observability.sentences == ("K is not seen",)
    assert np.isinf(float(coarse.condition_number))


def test_noise_does_not_make_a_parameter_unseen() -> None:
    """What is excited but measured badly has a value and a large error: orientations decide what is seen."""
    solution = solve([[1.0, 0.0], [1.0, 1.0]], [2.0, 5.0], [1e-3, 1e3], rank_tolerance=1e-3)
    np.testing.assert_allclose(solution.values, [2.0, 3.0])
    np.testing.assert_allclose(solution.se, [1e-3, 1e3])


def test_the_fast_path_keeps_its_digits_too() -> None:
    """Condition 10³, where unrefined normal equations would lose six digits of sixteen."""
    rng = np.random.default_rng(12)
    left, _ = np.linalg.qr(rng.normal(size=(40, 8, 4)))
    right, _ = np.linalg.qr(rng.normal(size=(40, 4, 4)))
    rows = left @ (np.array([1.0, 0.1, 0.01, 0.001])[:, None] * right)
    truth = rng.normal(size=(40, 4))
    found = solve(rows, np.einsum("nmp,np->nm", rows, truth), 1.0).values
    assert np.abs(found - truth).max() < 2e-12


def test_large_columns_do_not_hide_small_ones() -> None:
    """A quadratic over 100 degrees, ΔT² up to 10⁴, leaves the bias seen at a tolerance of a thousandth."""
    delta = np.linspace(-50.0, 100.0, 12)
    rows = np.stack([np.ones(12), delta, delta**2], -1)
    assert int(solve(rows, np.zeros(12), 1.0, rank_tolerance=1e-3).rank) == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"observed": np.zeros(5)}, "do not fit"),
        ({"design": np.full((6, 6), np.nan)}, "not finite"),
        ({"observed": np.full(6, np.inf)}, "infinity"),
        ({"sigma": 0.0}, "positive"),
        ({"sigma": -1.0}, "positive"),
        ({"sigma": np.full(6, np.nan)}, "positive"),
        ({"names": ("BA",)}, "1 names for 6"),
    ],
)
def test_bad_input_is_refused(change: dict[str, object], message: str) -> None:
    """Shapes that do not fit, values that are not finite and noise that is not positive."""
    good: dict[str, object] = {"design": design((1.0, 0, 0)), "observed": np.zeros(6), "sigma": 1.0}
    given_input = good | change
    rows, observed = given_input.pop("design"), given_input.pop("observed")
    with pytest.raises(ValueError, match=message):
        solve(rows, observed, **given_input)  # type: ignore[arg-type]
