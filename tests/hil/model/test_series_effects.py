"""Tests within a collect find what is there, say how large, and keep quiet on noise at the stated rate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from hil.campaign import FloatArray, Series
from hil.model.effects.catalogue import SERIES_EFFECTS
from hil.model.effects.inside import SeriesEffect
from hil.model.effects.series import (
    Bursts,
    JumpInCollect,
    Lattice,
    Ramp,
    Saturation,
    SettlingInCollect,
    Tone,
    equal_spread,
    lattice_step,
)
from tests.hil.model.effect_conditions import ROTOR

T = np.arange(1200) * 0.05  # 60 s at 20 Hz
SIGMA = 5.0


def series(rng: np.random.Generator, *, added: FloatArray | float = 0.0, noise: FloatArray | None = None) -> Series:
    """Return a collect whose first channel has something added, and whose second is noise."""
    rates = 20.0 + (SIGMA * rng.standard_normal((len(T), 2)) if noise is None else noise)
    rates[:, 0] += added
    return Series(T, rates)


@pytest.mark.slow
@pytest.mark.parametrize("effect", SERIES_EFFECTS, ids=lambda effect: effect.id)
def test_false_alarms_on_white_noise_stay_at_the_stated_rate(effect: SeriesEffect) -> None:
    """At p < 5 % at most about 5 % of noise-only channels are flagged (600 channels: 8 % would be chance 1 in 1000)."""
    rng = np.random.default_rng(5)
    p_values = [finding.p_value for _ in range(300) for finding in effect.test(series(rng), ROTOR)]
    assert np.mean(np.array(p_values) < 0.05) < 0.08


@pytest.mark.parametrize("effect", [SettlingInCollect(), Ramp(), JumpInCollect()], ids=lambda effect: effect.id)
def test_false_alarms_stay_rare_on_filtered_noise(effect: SeriesEffect) -> None:
    """Samples that are correlated over half a second do not count as independent."""
    rng = np.random.default_rng(6)
    p_values = []
    for _ in range(150):
        noise = lfilter([0.1], [1.0, -0.9], SIGMA * rng.standard_normal((len(T) + 200, 2)), axis=0)[200:]
        p_values += [finding.p_value for finding in effect.test(series(rng, noise=noise), ROTOR)]
    assert np.mean(np.array(p_values) < 0.01) < 0.03


def test_settling_is_found_with_its_size_and_time_constant() -> None:
    """30 deg/hr dying away in 5 s; the quiet channel stays quiet."""
    found, quiet = SettlingInCollect().test(series(np.random.default_rng(1), added=30.0 * np.exp(-T / 5.0)), ROTOR)
    assert found.p_value < 1e-6
    assert found.estimates["S_deg_per_hr"] == pytest.approx(30.0, rel=0.25)
    assert 3.0 < found.estimates["tau_s"] < 8.0
    assert quiet.p_value > 0.01
    assert found.sentence.startswith("RA: begins +")


def test_ramp_is_found_with_its_slope_and_sign() -> None:
    """-6 deg/hr per minute."""
    found, _ = Ramp().test(series(np.random.default_rng(2), added=-6.0 * T / 60.0), ROTOR)
    assert found.p_value < 1e-6
    assert found.estimates["slope_deg_per_hr_per_min"] == pytest.approx(-6.0, abs=1.5)


def test_step_is_found_where_it_is() -> None:
    """8 deg/hr at 35 s, and it is a step rather than a settling."""
    stepped = series(np.random.default_rng(3), added=8.0 * (T > 35.0))
    found, _ = JumpInCollect().test(stepped, ROTOR)
    settling, _ = SettlingInCollect().test(stepped, ROTOR)
    assert found.p_value < 1e-6
    assert found.p_value < settling.p_value
    assert found.estimates["J_deg_per_hr"] == pytest.approx(8.0, abs=2.0)
    assert found.estimates["t_s"] == pytest.approx(35.0, abs=2.0)


def test_tone_is_found_with_frequency_and_amplitude() -> None:
    """2 deg/hr at 1.37 Hz under noise of 5 deg/hr, with a tenth of the samples missing."""
    rng = np.random.default_rng(4)
    whole = series(rng, added=2.0 * np.cos(2.0 * np.pi * 1.37 * T + 1.0))
    kept = rng.random(len(T)) > 0.1
    found, quiet = Tone().test(Series(T[kept], whole.rates_deg_per_hr[kept]), ROTOR)
    assert found.p_value < 1e-4
    assert found.estimates["frequency_hz"] == pytest.approx(1.37, abs=0.02)
    assert found.estimates["a_deg_per_hr"] == pytest.approx(2.0, abs=0.7)
    assert quiet.p_value > 0.01


def test_coarse_lattice_is_found_and_fine_printing_is_not() -> None:
    """Steps of 10 deg/hr under noise of 5 matter; the same numbers printed to 0.01 do not."""
    rng = np.random.default_rng(7)
    plain = series(rng).rates_deg_per_hr
    coarse, fine = 10.0 * np.round(plain / 10.0), np.round(plain, 2)
    found, _ = Lattice().test(Series(T, coarse), ROTOR)
    assert found.p_value == 0.0
    assert found.estimates["step_deg_per_hr"] == pytest.approx(10.0)
    assert all(finding.p_value == 1.0 for finding in Lattice().test(Series(T, fine), ROTOR))
    assert lattice_step(plain[:, 0]) == 0.0


def test_saturation_is_a_pile_at_the_limit_and_a_coarse_lattice_is_not() -> None:
    """Values clipped two standard deviations out pile up; quantised noise has no pile."""
    rng = np.random.default_rng(8)
    plain = series(rng).rates_deg_per_hr
    found, _ = Saturation().test(Series(T, np.minimum(plain, 20.0 + 2.0 * SIGMA)), ROTOR)
    assert found.p_value < 1e-9
    assert found.estimates["limit_deg_per_hr"] == pytest.approx(30.0)
    assert found.estimates["samples"] > 10
    assert all(finding.p_value > 0.01 for finding in Saturation().test(Series(T, 2.0 * np.round(plain / 2.0)), ROTOR))


def test_bursts_are_a_change_of_noise_whatever_level_and_slope_do() -> None:
    """Three times the noise for 10 s is found; a step and a ramp under steady noise are not."""
    rng = np.random.default_rng(9)
    louder = series(rng).rates_deg_per_hr
    louder[400:600, 0] += 3.0 * SIGMA * rng.standard_normal(200)
    found, _ = Bursts().test(Series(T, louder), ROTOR)
    assert found.p_value < 1e-6
    assert found.estimates["variance_ratio"] > 4.0
    steady, _ = Bursts().test(series(rng, added=20.0 * (T > 30.0) + T), ROTOR)
    assert steady.p_value > 0.01


def test_equality_of_spread_is_levenes_test() -> None:
    """The p-value agrees with scipy's."""
    rng = np.random.default_rng(10)
    parts = [rng.standard_normal(50) * scale for scale in (1.0, 1.2, 0.9)]
    assert equal_spread(parts) == pytest.approx(stats.levene(*parts, center="median").pvalue, rel=1e-9)


@pytest.mark.parametrize("effect", SERIES_EFFECTS, ids=lambda effect: effect.id)
def test_a_series_that_is_too_short_cannot_be_asked(effect: SeriesEffect) -> None:
    """Too few samples give no p-value, not a wrong one; empty cells do not count as samples."""
    rates = np.full((40, 2), np.nan)
    rates[:10] = np.arange(20.0).reshape(10, 2)
    for finding in effect.test(Series(np.arange(40.0), rates), ROTOR):
        assert np.isnan(finding.p_value)
        assert "too few" in finding.sentence


@pytest.mark.parametrize("effect", SERIES_EFFECTS, ids=lambda effect: effect.id)
def test_a_series_that_never_changes_is_no_alarm_but_a_lattice(effect: SeriesEffect) -> None:
    """A stuck channel has no tone, ramp or burst; that every value is the same is said by quant alone."""
    stuck = Series(T, np.full((len(T), 2), 12.5))
    for finding in effect.test(stuck, ROTOR):
        assert (finding.p_value < 0.5) == (effect.id == "quant")
