"""The standard error covers the true mean, whatever the correlation, and costs little where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from procedures.averaging import average_series

N = 1200
TIME_S = np.arange(N) / 20.0


def _ar1(rng, n, c, rho):
    drive = rng.standard_normal((n, c)) * np.sqrt(1.0 - rho * rho)
    drive[0] = rng.standard_normal(c)
    return lfilter([1.0], [1.0, -rho], drive, axis=0)


@pytest.mark.parametrize("rho", [-0.5, 0.0, 0.1, 0.3, 0.6, 0.8, 0.9])
def test_the_stated_error_covers_the_true_mean_near_nominal(rho):
    """95 % intervals of 3000 series of 1200 samples of AR(1) noise cover zero in 93 to 97 % of them."""
    average = average_series(TIME_S, _ar1(np.random.default_rng(17), N, 3000, rho))
    assert 0.93 <= np.mean(np.abs(average.mean) < 1.96 * average.se) <= 0.97
    assert np.sqrt(np.mean(average.se**2)) == pytest.approx(average.mean.std(), rel=0.06)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_a_slope_is_significant_as_often_as_it_should_be(rho):
    """The slope's own error covers: 5 % of steady series exceed 1.96 of it, hardly any 4 of it."""
    average = average_series(TIME_S, _ar1(np.random.default_rng(18), N, 3000, rho))
    z = np.abs(average.slope_per_s / average.slope_se_per_s)
    assert 0.03 <= np.mean(z > 1.96) <= 0.07
    assert np.mean(z > 4.0) <= 0.001


def test_white_noise_gets_sigma_over_root_n_with_little_added_scatter():
    """On average within 2 % of sigma/sqrt(n); scatter of the error under 7 %, the best possible being 2 %."""
    average = average_series(TIME_S, 3.0 * np.random.default_rng(19).standard_normal((N, 3000)))
    assert average.se.mean() == pytest.approx(3.0 / np.sqrt(N), rel=0.02)
    assert average.se.std() / average.se.mean() < 0.07
    assert np.mean(np.abs(average.inflation - 1.0) < 0.01) > 0.97


def test_a_slow_process_below_much_white_noise_is_not_missed():
    """White noise of 1 over AR(1) of 0.5 with rho 0.9: sigma/sqrt(n) would be half of the truth."""
    rng = np.random.default_rng(20)
    values = rng.standard_normal((N, 3000)) + 0.5 * _ar1(rng, N, 3000, 0.9)
    average = average_series(TIME_S, values)
    assert np.mean(np.abs(average.mean) < 1.96 * average.se) > 0.88
    assert np.sqrt(np.mean(average.se**2)) > 0.85 * average.mean.std()
    naive = values.std(axis=0) / np.sqrt(N)
    assert np.mean(np.abs(average.mean) < 1.96 * naive) < 0.75


def test_a_wander_too_slow_for_an_autoregression_shows_in_the_batches():
    """0.2 of rho 0.98 below white noise of 1: half of the error comes from it; most of that is recovered."""
    rng = np.random.default_rng(25)
    values = rng.standard_normal((N, 2000)) + 0.2 * _ar1(rng, N, 2000, 0.98)
    average = average_series(TIME_S, values)
    assert np.sqrt(np.mean(average.se**2)) > 0.7 * average.mean.std()


def test_a_random_walk_gets_an_error_many_times_that_of_independent_samples():
    """Nothing within a collect tells a walk from its mean; the error says at least that it is no white noise."""
    average = average_series(TIME_S, np.cumsum(np.random.default_rng(21).standard_normal((N, 500)), axis=0))
    assert np.quantile(average.inflation, 0.05) > 10.0
    assert np.median(average.n / average.inflation**2) < 5.0


def test_noise_that_takes_itself_back_is_never_overrated():
    """Quantised angle makes rates whose mean is far better than sigma/sqrt(n): the error is less, and still covers."""
    angle = np.random.default_rng(22).standard_normal((N + 1, 1000))
    average = average_series(TIME_S, np.diff(angle, axis=0))
    assert np.median(average.inflation) < 0.3
    assert np.mean(np.abs(average.mean) < 1.96 * average.se) > 0.95


def test_channels_are_averaged_each_by_itself():
    """A column's result does not depend on its neighbours."""
    rng = np.random.default_rng(23)
    values = np.column_stack([rng.standard_normal(N), _ar1(rng, N, 1, 0.9)[:, 0], rng.standard_normal(N) * 100.0])
    together = average_series(TIME_S, values)
    for i in range(3):
        alone = average_series(TIME_S, values[:, [i]])
        for name in ("mean", "se", "sd", "slope_per_s", "slope_se_per_s", "half_difference", "half_difference_se"):
            assert getattr(together, name)[i] == pytest.approx(getattr(alone, name)[0], rel=1e-9), name


def test_a_drift_is_reported_and_is_not_mistaken_for_noise():
    """Slope and difference of the halves are those that were put in; the mean's error stays that of the noise."""
    noise = np.random.default_rng(24).standard_normal((N, 200))
    average = average_series(TIME_S, noise + 0.5 * TIME_S[:, None])
    assert average.slope_per_s.mean() == pytest.approx(0.5, abs=0.001)
    assert average.half_difference.mean() == pytest.approx(0.5 * 30.0, rel=0.01)
    assert average.half_difference_se.mean() == pytest.approx(2.0 / np.sqrt(N), rel=0.03)
    assert average.se.mean() == pytest.approx(1.0 / np.sqrt(N), rel=0.03)
    assert np.all(average.slope_per_s > 10.0 * average.slope_se_per_s)


def test_missing_samples_leave_mean_and_slope_right():
    """The slope uses the times, not the row numbers."""
    kept = np.delete(np.arange(N), slice(300, 500))
    average = average_series(TIME_S[kept], (2.0 + 0.5 * TIME_S[kept])[:, None])
    assert average.slope_per_s[0] == pytest.approx(0.5)


def test_a_constant_has_no_error_and_few_samples_have_none_that_is_known():
    """Zero and NaN are different statements."""
    constant = average_series(TIME_S, np.full((N, 1), 4.0))
    assert (constant.mean[0], constant.se[0], constant.slope_per_s[0]) == (4.0, 0.0, 0.0)
    two = average_series(TIME_S[:2], np.array([[1.0], [3.0]]))
    assert two.mean[0] == 2.0
    assert np.isnan(two.se[0])
    assert np.isnan(average_series(TIME_S[:0], np.empty((0, 1))).mean[0])


@pytest.mark.parametrize("n", [3, 4, 5, 8, 10, 20, 40])
def test_short_series_have_a_finite_error(n):
    """From three samples on there is something to say."""
    average = average_series(np.arange(n) / 20.0, np.random.default_rng(n).standard_normal((n, 50)))
    assert np.isfinite(average.se).all()
    assert (average.se > 0.0).all()


def test_shapes_that_do_not_fit_and_values_that_are_not_finite_are_refused():
    """A wrong average is worse than none."""
    with pytest.raises(ValueError, match="do not fit"):
        average_series(TIME_S, np.zeros((N - 1, 1)))
    with pytest.raises(ValueError, match="not finite"):
        average_series(TIME_S, np.full((N, 1), np.nan))
