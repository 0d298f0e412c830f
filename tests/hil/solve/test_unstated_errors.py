"""Rates without standard errors: the residuals of all runs tell the noise of each, or nothing does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, Collects
from hil.solve import repeats, solve_campaign
from hil.solve.beside_terms import beside_usual
from hil.solve.wrong_rows import wrong_rows
from tests.hil.analysis.thermal.nights import triad_night
from tests.hil.solve.runs_of_a_unit import campaign as runs_at_their_temperatures
from tests.hil.solve.runs_of_a_unit import repeated, with_rates


def without_errors(
    seed: int,
    runs: int,
    noise: float | tuple[float, float],
    scatter: float,
    positions: tuple[int, ...] = (0, 1, 2, 0),
) -> Campaign:
    """Return runs of positions 1-2-3-1, three at a temperature, of a unit that does not follow it, without errors."""
    rows, rng = repeated(runs, 3, positions).sensors[2], np.random.default_rng(seed)
    k = np.array([[58.0, -20.0, 5.0], [20.0, 58.0, 9.0]])
    own = np.repeat(rng.normal(0.0, scatter, (runs, 2)), len(positions), axis=0)
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
    by = "residuals" if told else "differences beside bias and MU"
    assert said.startswith(f"repeats scatter as their {by} say")
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


@pytest.mark.parametrize("positions", [(0, 1, 2), (0, 1, 2, 0)])
def test_channels_without_errors_have_each_its_own_noise(positions: tuple[int, ...]) -> None:
    """By residuals or by what runs differ by: of both together a value of the quiet one was known as the noisy one's.

    Where few degrees of freedom tell that of each, all together do.
    """
    for runs, noise in ((12, (0.3, 3.0)), (12, (1.0, 1.0)), (2, (1.0, 1.0))):
        made = without_errors(1, runs, noise, 0.0, positions)
        shown = repeats(made, solve_campaign(made))[2]
        assert runs == 2 or shown.left.deg_per_hr == pytest.approx(noise, rel=0.4)
        assert (shown.left.deg_per_hr[0] == shown.left.deg_per_hr[1]) == (runs == 2)
        assert (shown.of_each[1]["BB"] > 4.0 * shown.of_each[1]["BA"]) == (noise[1] == 3.0)


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
@pytest.mark.parametrize(
    ("scatter", "noise", "positions"),
    [(0.0, 1.0, (0, 1, 2, 0)), (2.0, 1.0, (0, 1, 2, 0)), (0.0, (0.3, 3.0), (0, 1, 2, 0)), (2.0, (0.3, 3.0), (0, 1, 2))],
)
def test_intervals_of_means_of_rates_without_errors_hold_the_units_model(
    scatter: float,
    noise: float | tuple[float, float],
    positions: tuple[int, ...],
    seeds: int,
    low: float,
    high: float,
) -> None:
    """Three runs at each of four temperatures: of means weighed by each run's own two residuals 85 % did."""
    truth = {"BA": 0.0, "BB": 0.0, "GSA": 58.0, "GSB": -20.0, "MUA": -9.0, "MUB": 5.0}
    inside = []
    for seed in range(seeds):
        made = without_errors(seed, 12, noise, scatter, positions)
        for mean in repeats(made, solve_campaign(made))[2].means:
            inside += [abs(of.value - truth[name]) <= of.half_width for name, of in mean.values.items()]
    assert low <= np.mean(inside) <= high


def test_noise_that_only_repeats_tell_is_said_to_be_larger_where_it_is() -> None:
    """Four poses leave a triad no residuals: at 1.2 in the cold and .3 elsewhere the usual .93 had stood, unsaid."""
    rng = np.random.default_rng(5)
    rows = triad_night(rng, {}).sensors[1].rows(np.arange(96) % 6 < 4)
    cold = rows.conditions.run <= 8
    conditions = replace(rows.conditions, columns={"temperature_degC": np.where(cold, -20.0, 40.0)})
    noise = np.where(cold, 1.2, 0.3)[:, None]
    rates = noise * rng.normal(size=rows.rates_deg_per_hr.shape)
    made = Campaign("bare", "", {1: Collects(conditions, rates, np.full(rates.shape, np.nan))})
    shown = repeats(made, solve_campaign(made))
    assert shown[1].left.deg_per_hr == pytest.approx(np.sqrt(np.mean(noise**2)), rel=0.4)
    (said,) = (each for each in shown[1].sentences() if "as large at -20.0 °C as at 40.0 °C" in each)
    assert said.startswith("differences beside bias and MU are ")
    *_, assumed = beside_usual(made, shown, lambda of: np.full(of.w_channels_deg_per_hr.shape, 0.93))
    assert not assumed


@pytest.mark.parametrize(("runs", "assumed"), [(1, True), (2, False)])
def test_noise_is_assumed_only_where_nothing_tells_it(runs: int, assumed: bool) -> None:
    """One run of three collects leaves nothing, and repeats nothing: a map of it takes the usual noise."""
    made = without_errors(3, runs, 1.0, 0.0, (0, 1, 2))
    shown = repeats(made, solve_campaign(made))
    laid, _, told = beside_usual(made, shown, lambda of: np.full(of.w_channels_deg_per_hr.shape, 0.93))
    assert (2 in told) is assumed
    assert np.all(laid.sensors[2].rates_se_deg_per_hr == 0.93) == assumed


@pytest.mark.parametrize(("channel", "off"), [(0, 0.0), (0, 15.0), (1, 15.0)])
def test_a_channel_without_errors_that_is_noisier_accuses_nothing_and_hides_nothing(channel: int, off: float) -> None:
    """All were taken to be as noisy: of the noisy channel good rates were left out, of the quiet one wrong ones not."""
    right, others = 0, 0
    for seed in range(6):
        made = without_errors(seed, 18, (0.3, 3.0), 0.5, (0, 1, 2))
        rates = made.sensors[2].rates_deg_per_hr.copy()
        rates[13, channel] += off * (0.3, 3.0)[channel]
        left_out = [row for row in wrong_rows(with_rates(made, rates))[2].rows if row.done == "left out"]
        right += any(14 in row.collects for row in left_out)
        others += any(14 not in row.collects for row in left_out)
    assert right == 0 if not off else right >= 5
    assert others == 0
