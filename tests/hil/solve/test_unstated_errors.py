"""Rates without standard errors: the residuals of all runs tell the noise of each, or nothing does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, Collects
from hil.solve import repeats, solve_campaign
from hil.solve.beside_terms import beside_usual
from tests.hil.analysis.thermal.nights import triad_night
from tests.hil.solve.runs_of_a_unit import campaign as runs_at_their_temperatures
from tests.hil.solve.runs_of_a_unit import repeated, with_rates


def without_errors(seed: int, runs: int, noise: float | tuple[float, float], scatter: float) -> Campaign:
    """Return runs of positions 1-2-3-1, three at a temperature, of a unit that does not follow it, without errors."""
    rows, rng = repeated(runs, 3, (0, 1, 2, 0)).sensors[2], np.random.default_rng(seed)
    k = np.array([[58.0, -20.0, 5.0], [20.0, 58.0, 9.0]])
    own = np.repeat(rng.normal(0.0, scatter, (runs, 2)), 4, axis=0)
    rates = rows.conditions.f_g @ k.T + rows.conditions.w_channels_deg_per_hr + own + rng.normal(0.0, noise, own.shape)
    return Campaign("bare", "", {2: Collects(rows.conditions, rates, np.full(rates.shape, np.nan))})


def campaign_of_four_collects() -> Campaign:
    """Return rates that the model makes exactly, without standard errors: two of eight are left over."""
    rows = runs_at_their_temperatures(2, 2, scatter=0.0).sensors[2].rows(np.array([0, 1, 2, 5]))
    f = rows.conditions.f_g.copy()
    f[3] *= -1.0
    label = np.array(["1", "2", "3", "4"])
    conditions = replace(rows.conditions, f_g=f, run=np.ones(4, dtype=np.int64), position=label, columns={})
    rates = f @ np.array([[58.0, -20.0, 5.0], [20.0, 58.0, 9.0]]).T + conditions.w_channels_deg_per_hr
    return Campaign("four", "", {2: Collects(conditions, rates, np.full((4, 2), np.nan))})


@pytest.mark.parametrize(("positions", "told"), [((0, 1, 2), False), ((0, 1, 2, 0, 1, 2), True)])
def test_of_rates_without_standard_errors_it_is_said_what_tells_their_noise(
    positions: tuple[int, ...], told: bool
) -> None:
    """Residuals, where there are any; nothing is as standard errors say that nobody stated."""
    one = runs_at_their_temperatures(6, 3, seed=2, scatter=0.0).sensors[2]
    rng = np.random.default_rng(3)
    rows = one.rows(np.concatenate([[3 * run + k for k in positions] for run in range(6)]))
    rows = replace(
        rows,
        conditions=replace(rows.conditions, collect=np.arange(1, len(rows.conditions) + 1)),
        rates_deg_per_hr=rows.conditions.w_channels_deg_per_hr + rng.normal(0.0, 0.5, rows.rates_deg_per_hr.shape),
        rates_se_deg_per_hr=np.full(rows.rates_deg_per_hr.shape, np.nan),
    )
    made = Campaign("t", "", {2: rows})
    said, *_ = repeats(made, solve_campaign(made))[2].sentences()
    assert said.startswith("repeats scatter as their residuals say" if told else "repeats scatter and have neither")
    assert "standard errors say" not in said


@pytest.mark.parametrize("seed", range(3))
def test_residuals_that_are_larger_at_one_temperature_are_said(seed: int) -> None:
    """One noise of both temperatures is in every ±: too small in the cold, too large elsewhere."""
    for times in (1.0, 12.0):
        made = without_errors(seed, 12, 0.9, 0.5)
        rows = made.sensors[2]
        cold = (rows.conditions.run <= 3)[:, None]
        more = (
            np.random.default_rng(seed).normal(0.0, 0.9 * np.sqrt(times**2 - 1.0), rows.rates_deg_per_hr.shape) * cold
        )
        shown = repeats(one := with_rates(made, rows.rates_deg_per_hr + more), solve_campaign(one))[2]
        told = [said for said in shown.sentences() if said.startswith("residuals are ")]
        assert len(told) == (times > 1.0)
        assert all("as large at -20.0 °C as at " in said and said.endswith("no one ± holds at each") for said in told)


@pytest.mark.slow
def test_one_run_whose_noise_its_residuals_tell_has_an_interval_of_students() -> None:
    """Two degrees of freedom: the normal's 1.96 held the truth in 79 %."""
    one = campaign_of_four_collects()
    inside, freedom = [], []
    for seed in range(60):
        rows, rng = one.sensors[2], np.random.default_rng(seed)
        rates = rows.rates_deg_per_hr + rng.normal(0.0, 1.0, rows.rates_deg_per_hr.shape)
        made = Campaign("one", "", {2: replace(rows, rates_deg_per_hr=rates)})
        (solved,) = solve_campaign(made)
        (exact,) = solve_campaign(Campaign("one", "", {2: rows}))
        found = repeats(made, [solved])[2]
        freedom += [round(each.freedom, 6) for each in found.means[0].values.values()]
        for name, each in found.of_run(solved).items():
            truth = exact.parameters[name].value
            assert truth is not None
            inside.append(abs(each.value - truth) <= each.half_width)
    assert 0.89 < np.mean(inside) < 0.99
    assert np.mean(np.array(freedom) == 2.0) > 0.95  # of the others chance makes two noises


def test_channels_without_errors_of_which_one_is_noisier_than_chance_makes_it_have_each_its_own_noise() -> None:
    """Of both together a value of the quiet one had an error as large as the noisy one's."""
    alike, apart = without_errors(1, 12, 1.0, 0.0), without_errors(1, 12, (0.3, 3.0), 0.0)
    noise = repeats(alike, solve_campaign(alike))[2].left_deg_per_hr
    assert noise[0] == noise[1] == pytest.approx(1.0, rel=0.3)
    shown = repeats(apart, solve_campaign(apart))[2]
    assert shown.left_deg_per_hr == pytest.approx([0.3, 3.0], rel=0.4)
    assert shown.of_each[1]["BB"] > 4.0 * shown.of_each[1]["BA"]


def test_of_rates_without_errors_each_run_is_known_by_the_residuals_of_all() -> None:
    """Runs that are alike weigh alike, however small their own residuals; one that has none is known, and less."""
    made = without_errors(4, 3, 1.0, 0.0)
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rates[11] = np.nan
    solutions = solve_campaign(with_rates(made, rates))
    small, large = sorted(each.residual_rms_deg_per_hr for each in solutions[:2] if each.residual_rms_deg_per_hr)
    assert large > 1.5 * small
    shown = repeats(with_rates(made, rates), solutions)[2]
    assert shown.of_each[1] == pytest.approx(shown.of_each[2])
    assert all(shown.of_each[3][name] > 1.02 * shown.of_each[1][name] for name in ("BA", "GSA", "MUB"))
    assert np.asarray(shown.spread.residuals) == pytest.approx(4.0)
    few, many = (next(each.by_noise(2.0)["BA"].se for each in solutions[run:]) for run in (2, 0))
    assert few == pytest.approx(2.0 * np.sqrt(1.0 / 2.0))  # by two collects, one with A down and one with A up
    assert many == pytest.approx(2.0 * np.sqrt((1.0 + 0.5) / 4.0))  # one of them twice


@pytest.mark.parametrize("recorded", [True, False])
def test_where_nobody_knows_the_temperature_what_gs_differs_by_is_no_noise(recorded: bool) -> None:
    """Stated errors are right and GSA follows the temperature: recorded or not, none is said to be too small."""
    one = runs_at_their_temperatures(12, 3, seed=4)
    rows, own = one.sensors[2], one.sensors[2].conditions
    gs = 0.2 * own.columns["temperature_degC"][:, None] * own.f_g[:, :2]
    columns = {name: of for name, of in own.columns.items() if recorded or not name.endswith("degC")}
    made = replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + gs, conditions=replace(own, columns=columns))
    follows = replace(one, sensors={2: made})
    shown = repeats(follows, solve_campaign(follows))[2]
    assert {*shown.times_of.values()} == {1.0}
    assert any("GSA by" in each and "no temperature was recorded" in each for each in shown.sentences()) is not recorded


@pytest.mark.parametrize(
    ("seeds", "low", "high"), [(8, 0.9, 0.99), pytest.param(100, 0.93, 0.97, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(("scatter", "noise"), [(0.0, 1.0), (2.0, 1.0), (0.0, (0.3, 3.0))])
def test_intervals_of_means_of_rates_without_errors_hold_the_units_model(
    scatter: float, noise: float | tuple[float, float], seeds: int, low: float, high: float
) -> None:
    """Three runs at each of four temperatures: of means weighed by each run's own two residuals 85 % did."""
    truth = {"BA": 0.0, "BB": 0.0, "GSA": 58.0, "GSB": -20.0, "MUA": -9.0, "MUB": 5.0}
    inside = []
    for seed in range(seeds):
        made = without_errors(seed, 12, noise, scatter)
        for mean in repeats(made, solve_campaign(made))[2].means:
            inside += [abs(of.value - truth[name]) <= of.half_width for name, of in mean.values.items()]
    assert low <= np.mean(inside) <= high


def test_noise_that_only_repeats_tell_is_larger_where_it_is_larger() -> None:
    """Four poses leave a triad no residuals: at 1.2 in the cold and .3 elsewhere the usual .93 had stood at both."""
    rng = np.random.default_rng(5)
    rows = triad_night(rng, {}).sensors[1].rows(np.arange(96) % 6 < 4)
    cold = rows.conditions.run <= 8
    conditions = replace(rows.conditions, columns={"temperature_degC": np.where(cold, -20.0, 40.0)})
    noise = np.where(cold, 1.2, 0.3)[:, None]
    rates = noise * rng.normal(size=rows.rates_deg_per_hr.shape)
    made = Campaign("bare", "", {1: Collects(conditions, rates, np.full(rates.shape, np.nan))})
    shown = repeats(made, solve_campaign(made))
    campaign, *_ = beside_usual(made, shown, lambda of: np.full(of.w_channels_deg_per_hr.shape, 0.93))
    np.testing.assert_allclose(campaign.sensors[1].rates_se_deg_per_hr / noise, 1.0, rtol=0.4)
