"""The form is judged by the temperature that was left out, and noise is called noise at the stated rate."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from hil.analysis.thermal.choice import (
    FALSE_ALARM,
    MONOTONE,
    TABLE,
    Choice,
    Form,
    candidate_forms,
    monotone,
    polynomial,
)
from hil.campaign import FloatArray
from tests.hil.analysis.thermal.nights import PUBLISHED_DEGC, scaled

T = np.array(PUBLISHED_DEGC)
UNIT = np.eye(len(T))


def _form(name: str, weight: FloatArray) -> Form:
    return next(each for each in candidate_forms(T, weight, 5) if each.name == name)


@pytest.mark.parametrize("order", [0, 1, 2, 3, 4, 5])
def test_a_polynomial_is_judged_by_fits_that_did_not_see_the_temperature(order: int) -> None:
    """The held-out errors are those of refitting without each temperature, weights included."""
    rng = np.random.default_rng(order)
    values, weight = rng.normal(size=(3, len(T))), rng.uniform(0.5, 2.0, len(T))
    found = polynomial(T, weight, order).held_out(values)
    for left in range(len(T)):
        shown = np.arange(len(T)) != left
        for row in range(3):
            fit = np.polynomial.polynomial.polyfit(
                scaled(T[shown]), values[row, shown], order, w=np.sqrt(weight[shown])
            )
            expected = values[row, left] - np.polynomial.polynomial.polyval(scaled(T[left]), fit)
            assert found[row, left] == pytest.approx(expected, abs=1e-8)


def test_a_table_is_judged_by_interpolation_and_holds_its_ends() -> None:
    """Between its neighbours PCHIP, beyond the last temperature the last value."""
    values = np.random.default_rng(1).normal(size=len(T))
    found = _form(TABLE, UNIT.diagonal()).held_out(values)
    inner = PchipInterpolator(np.delete(T, 3), np.delete(values, 3))(T[3])
    assert found[3] == pytest.approx(values[3] - inner)
    assert found[-1] == pytest.approx(values[-1] - values[-2])


def test_monotone_is_isotonic_regression_in_the_better_direction() -> None:
    """Beside scipy's, both ways, with weights."""
    rng = np.random.default_rng(2)
    values, weight = rng.normal(size=(20, 8)) - np.linspace(0, 2, 8), rng.uniform(0.5, 2.0, 8)
    for row, found in zip(values, monotone(values, weight), strict=True):
        tried = [isotonic_regression(row, weights=weight, increasing=up).x for up in (True, False)]
        better = min(tried, key=lambda each: float(weight @ (row - each) ** 2))
        np.testing.assert_allclose(found, better, atol=1e-12)
    assert _form(MONOTONE, weight).order is None


def test_few_temperatures_allow_few_forms() -> None:
    """Three allow a line, two nothing but a constant."""
    assert [form.name for form in candidate_forms(T[:3], np.ones(3), 5)] == ["constant", "linear"]
    assert [form.name for form in candidate_forms(T[:2], np.ones(2), 5)] == ["constant"]


def others_than_constant(campaigns: int) -> int:
    """Count the campaigns of pure noise in which another form is chosen."""
    rng = np.random.default_rng(3)
    noises = (rng.normal(size=len(T)) for _ in range(campaigns))
    return sum(Choice(T, noise, UNIT, highest_order=5, draws=199).form.order != 0 for noise in noises)


def test_values_without_temperature_dependence_are_called_constant() -> None:
    """In most of ten campaigns of pure noise."""
    assert others_than_constant(10) <= 2


@pytest.mark.slow
def test_values_without_temperature_dependence_are_called_constant_at_the_stated_rate() -> None:
    """In 150 campaigns of pure noise some other form is chosen in 5 %, give or take what 150 can tell."""
    others = others_than_constant(150)
    assert others <= 150 * FALSE_ALARM + 3 * np.sqrt(150 * FALSE_ALARM)
    assert others >= 2  # the rate is used, not undercut


@pytest.mark.parametrize(("campaigns", "least"), [(10, 7), pytest.param(30, 24, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("name", "curve"),
    [
        ("linear", lambda u: 6.0 * u),
        ("quadratic", lambda u: 8.0 * u**2 + 4.0 * u),
        ("cubic", lambda u: 14.0 * (4 * u**3 - 3 * u)),
    ],
)
def test_the_right_order_is_found(name: str, curve: object, campaigns: int, least: int) -> None:
    """In at least 80 of 100 campaigns in which the curve stands well above the noise."""
    rng = np.random.default_rng(4)
    truth = curve(scaled(T))  # type: ignore[operator]
    found = Counter(
        Choice(T, truth + rng.normal(size=len(T)), UNIT, highest_order=5, draws=199).form.name for _ in range(campaigns)
    )
    assert found[name] >= least, found


def test_the_size_of_the_noise_does_not_decide() -> None:
    """A covariance that is a hundred times too small gives the same chance that the constant is enough."""
    values = 2.0 * scaled(T) + np.random.default_rng(5).normal(size=len(T))
    chances = [Choice(T, values, factor * UNIT, highest_order=5).chance_of_constant for factor in (1.0, 0.01)]
    assert chances[0] == pytest.approx(chances[1])


def test_rounding_is_no_dependence() -> None:
    """Values that differ in the sixteenth digit are constant."""
    values = 1e-15 * np.arange(len(T), dtype=np.float64)
    assert Choice(T, values, UNIT, highest_order=5).form.order == 0


def test_what_predicts_worse_beats_nothing_however_seldom_noise_would_make_it_lose_by_less() -> None:
    """A line that four values miss by more than their noise stays: monotone misses what is left out by three times."""
    values = np.array([7.10, 11.44, 16.48, 20.71])
    found = Choice(np.array([-20.0, 0.0, 23.0, 50.0]), values, 0.29**2 * np.eye(4), highest_order=3)
    assert found.steps[-1]["chance"] < FALSE_ALARM
    assert found.errors[MONOTONE] > 2.0 * found.errors["linear"]
    assert found.form.name == "linear"
