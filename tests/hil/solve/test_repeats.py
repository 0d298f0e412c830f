"""What repeats show is in every uncertainty, and the stated intervals hold the truth as often as they say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.analysis.thermal.document import thermal_document
from hil.analysis.thermal.fit import fit_thermal
from hil.campaign import Campaign, Collects
from hil.solve import repeats, solve_campaign
from hil.solve.omissions import in_words, what_is_wrong
from hil.solve.repeats import SensorRepeats
from hil.solve.uncertain import Spread, Uncertain, means_at
from procedures.verdict import Judgement, Verdict
from tests.hil.analysis.thermal.nights import PUBLISHED_DEGC, RUN_TO_RUN, rotor_night, scaled
from tests.hil.solve.runs_of_a_unit import campaign as runs_at_their_temperatures
from tests.hil.solve.runs_of_a_unit import repeated, with_rates

TRUTH = {
    "BA": (20.0, 5.0),
    "BB": (-5.0, 30.0),
    "GSA": (55.0, 10.0),
    "GSB": (-25.0, -4.0),
    "MUA": (5.0, 10.0),
    "MUB": (0.0, 0.0),
}


def night(seed: int, run_to_run: dict[str, float], degC: tuple[float, ...] = PUBLISHED_DEGC) -> Campaign:
    """Return the published night of a unit whose parameters are lines against temperature."""
    curves = {name: (lambda t, c=c: c[0] + c[1] * scaled(t)) for name, c in TRUTH.items()}
    return rotor_night(np.random.default_rng(seed), curves, run_to_run=run_to_run, temperatures_degC=degC)


def held(seed: int, run_to_run: dict[str, float]) -> tuple[list[bool], list[bool]]:
    """Return, for every mean and for every single run, whether its interval holds the unit's model."""
    one = night(seed, run_to_run)
    solutions = solve_campaign(one)
    shown = repeats(one, solutions)[2]
    means, singles = [], []
    for mean in shown.means:
        for name, found in mean.values.items():
            truth = TRUTH[name][0] + TRUTH[name][1] * scaled(mean.temperature_degC)
            means.append(abs(found.value - truth) <= found.half_width)
    for solution in solutions:
        at = next(mean.temperature_degC for mean in shown.means if solution.run in mean.runs)
        for name, found in shown.of_run(solution).items():
            singles.append(abs(found.value - TRUTH[name][0] - TRUTH[name][1] * scaled(at)) <= found.half_width)
    return means, singles


@pytest.mark.parametrize(
    ("seeds", "low", "high"), [(3, 0.9, 0.99), pytest.param(60, 0.93, 0.97, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("run_to_run", [RUN_TO_RUN, {}], ids=["run to run", "white"])
def test_intervals_of_means_and_of_single_runs_hold_the_units_model(
    run_to_run: dict[str, float], seeds: int, low: float, high: float
) -> None:
    """Stated 95 %, over whole nights, whether anything changes from run to run or not."""
    found = [held(seed, run_to_run) for seed in range(seeds)]
    for kind in (0, 1):
        share = np.mean([of[kind] for of in found])
        assert low <= share <= high, ("mean", "single run")[kind]


@pytest.mark.parametrize(("freedom", "sizes"), [((8, 8), (1.0, 1.0)), ((4, 16), (2.0, 1.0)), ((3, 3), (1.0, 4.0))])
def test_the_difference_of_two_means_is_beyond_its_interval_by_chance(
    freedom: tuple[int, int], sizes: tuple[float, float]
) -> None:
    """4.6 % at k = 2, however well each of the two is known."""
    rng, beyond = np.random.default_rng(4), 0
    for _ in range(3000):
        one, other = (
            Uncertain(rng.normal(0.0, size), size * np.sqrt(rng.chisquare(nu) / nu), nu, nu + 1, "deg/hr")
            for size, nu in zip(sizes, freedom, strict=True)
        )
        difference = one.less(other)
        beyond += abs(difference.value) > difference.expanded(2.0)
    assert 0.033 < beyond / 3000 < 0.059


def test_what_the_same_runs_tell_of_two_means_is_told_once() -> None:
    """Their difference has no more degrees of freedom than either; of an exact one it has those of the other."""
    one, exact = Uncertain(3.0, 4.0, 5.0, 3, "deg/hr"), Uncertain(1.0, 0.0, math.inf, 2, "deg/hr")
    assert one.less(one, told_together=True) == Uncertain(0.0, math.hypot(4.0, 4.0), 5.0, 3, "deg/hr")
    assert one.less(exact) == Uncertain(2.0, 4.0, 5.0, 2, "deg/hr")
    assert one.less(one).freedom == pytest.approx(10.0)
    seldom = Uncertain(2.0, 3.0, 6.0, 3, "deg/hr", beyond=4.0)
    assert one.less(seldom) == Uncertain(1.0, math.sqrt(16.0 + 16.0 / 3.0 + 9.0), 5.0, 3, "deg/hr")
    assert seldom.less(one).sd == one.less(seldom).sd


def test_what_standard_errors_do_not_know_is_in_the_mean_of_three() -> None:
    """MU that changes by 4 from run to run: a mean of three is known to 2.3, not to the 0.65 of standard errors."""
    one = night(3, RUN_TO_RUN)
    solutions = solve_campaign(one)
    shown = repeats(one, solutions)[2]
    mean = shown.means[0].values["MUB"]
    alone = np.mean([s.parameters["MUB"].se for s in solutions]) / np.sqrt(3)
    assert alone < 0.7
    assert mean.sd == pytest.approx(np.hypot(RUN_TO_RUN["MUB"], 1.1) / np.sqrt(3), rel=0.35)
    assert "MUB by" in shown.sentences()[0]
    assert "every run counts as a repeat" not in shown.sentences()[0]
    rows = one.sensors[2]
    bare = replace(rows, conditions=replace(rows.conditions, columns={}))
    without = repeats(replace(one, sensors={2: bare}), solutions)[2]
    assert "no temperature was recorded, so that every run counts as a repeat" in without.sentences()[0]


def test_where_residuals_alone_widen_an_interval_it_is_said() -> None:
    """Of single runs: of which parameters, and how many times; where runs repeat each other, those say more."""
    rows = runs_at_their_temperatures(2, 2, scatter=0.0).sensors[2]  # each position twice, in one run
    alone = replace(rows, conditions=replace(rows.conditions, run=np.ones(len(rows), np.int64)))
    one = replace(runs_at_their_temperatures(), sensors={2: alone})
    rates = rows.rates_deg_per_hr + 2.0 * np.outer((1, -1, 1, -1, 1, -1), (1.0, 0.0))
    shown = repeats(with_rates(one, rates), solve_campaign(with_rates(one, rates)))[2]
    wider = [name for name, times in zip(shown.names, shown.spread.factor.tolist(), strict=True) if times > 1.05]
    (said,) = shown.widened
    assert wider
    assert all(name in said for name in wider)
    assert shown.sentences()[1:] == [said]
    three = runs_at_their_temperatures(6, 3)
    assert repeats(three, solve_campaign(three))[2].widened == []


def test_where_nothing_was_repeated_standard_errors_stand_and_it_is_said() -> None:
    """One run at each of three temperatures: the standard error is the deviation, and the interval is normal."""
    one = night(4, {}, (-20.0, 20.0, 60.0))
    rows = one.sensors[2]
    first = rows.rows(np.isin(rows.conditions.run, [1, 4, 7]))
    alone = Campaign(one.title, one.source, {2: first})
    solutions = solve_campaign(alone)
    shown = repeats(alone, solutions)[2]
    for solution, mean in zip(solutions, shown.means, strict=True):
        for name, each in solution.parameters.items():
            assert mean.values[name].sd == each.se
            assert mean.values[name].half_width == pytest.approx(1.96 * (each.se or 0.0), rel=1e-3)
    assert "no parameter was told twice at one temperature" in shown.sentences()[0]


def test_residuals_beyond_the_standard_errors_widen_them() -> None:
    """Rates three times as noisy as stated, with residuals left: the deviations grow threefold; without, unknown."""
    one = night(5, {})
    rows = one.sensors[2]
    rng = np.random.default_rng(0)
    noisy = rows.rates_deg_per_hr + rng.normal(0.0, 3.0 * 0.93, rows.rates_deg_per_hr.shape)
    whole = Campaign(one.title, one.source, {2: Collects(rows.conditions, noisy, rows.rates_se_deg_per_hr)})
    solutions = solve_campaign(whole, "collins-4")  # two residuals are left in each run
    factor = repeats(whole, solutions)[2].spread.factor
    assert np.all(factor > 2.5)


def test_a_channel_that_is_noisier_than_stated_widens_no_other() -> None:
    """Where residuals tell: what the sound channel tells is as sure as beside one that is sound, too."""
    one = repeated(12, 3, (0, 1, 2, 1, 0), seed=4)
    noise = np.random.default_rng(9).normal(0.0, 4.0, (60, 1)) * [[0.0, 1.0]]
    beside = with_rates(one, one.sensors[2].rates_deg_per_hr + noise)
    sound, noisy = (repeats(each, solve_campaign(each))[2] for each in (one, beside))
    for name in sound.names:
        half, wider = (each.means[0].values[name].half_width for each in (sound, noisy))
        assert wider > 1.5 * half if name in ("BB", "GSB", "MUA") else wider == pytest.approx(half)
    assert noisy.spread.factor[[1, 3, 4]] == pytest.approx([4.0] * 3, rel=0.2)
    assert noisy.noise_times == pytest.approx([1.0, 4.0], rel=0.2)


def test_a_spread_is_pooled_over_temperatures_and_never_less_than_standard_errors() -> None:
    """Two groups of three, by hand; and of values that scatter less than their errors the errors stand."""
    values = np.array([[1.0], [2.0], [3.0], [11.0], [11.0], [14.0]])
    group = np.array([0, 0, 0, 1, 1, 1])
    spread = Spread.of(values, np.full((6, 1), 0.5), group)
    assert spread.observed[0] == pytest.approx(np.sqrt((2.0 + 6.0) / 4.0))
    assert spread.beyond[0] == pytest.approx(np.sqrt(2.0 - 0.25))
    assert spread.sd(np.full((6, 1), 0.5))[0, 0] == pytest.approx(np.sqrt(2.0))
    quiet = Spread.of(values, np.full((6, 1), 5.0), group)
    assert quiet.beyond[0] == 0.0
    assert quiet.sd(np.full((6, 1), 5.0))[0, 0] == 5.0
    assert quiet.freedom[0] == pytest.approx(3 * spread.degrees[0])  # what stated errors explain is known better
    loud = Spread.of(values, np.array([0.6, 0.6, 0.6, 0.5, 0.5, 0.5])[:, None], group)
    assert loud.beyond[0] < loud.observed[0]
    unsure = Spread.of(values, np.array([0.6, 0.6, 0.6, 0.3, 0.3, 0.3])[:, None], group)
    assert unsure.beyond[0] < unsure.observed[0]  # though those of small errors scatter more than all do
    known = np.array([[0.1], [0.1], [0.1], [0.2], [0.2], [0.2]])  # far less than they scatter by: all tell alike
    assert Spread.of(values, known, group).beyond[0] == pytest.approx(np.sqrt(2.0 - 0.025), rel=0.01)


@pytest.mark.slow
def test_what_scatters_in_the_cold_only_is_said_and_judged_by_no_limit() -> None:
    """One temperature of four at which the averages scatter by 6 deg/hr, .7 elsewhere; none is said of even scatter."""
    even = runs_at_their_temperatures(16, 4, seed=27, scatter=2.0)
    rates = even.sensors[2].rates_deg_per_hr.copy()
    rates[:12] += np.random.default_rng(127).normal(0.0, 6.0, (12, 2))
    for one, cold in ((even, False), (with_rates(even, rates), True)):
        shown = repeats(one, solve_campaign(one))[2]
        where = [said for said in shown.sentences() if "more at some temperatures than at others" in said]
        assert bool(where) is cold
        assert all("at -20.0 °C" in said and "hil scatter" not in said for said in where)
        assert not any("too small" in said for said in shown.sentences())  # standard errors hold elsewhere
        assert bool(shown.uneven[shown.names.index("MUA")]) is cold


def test_what_noise_explains_at_all_temperatures_scatters_more_at_none() -> None:
    """Runs of one temperature that agree by chance, or were copied, make no others noisy."""
    one = runs_at_their_temperatures(16, 4, seed=27, scatter=0.0)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    first = rates[:12].reshape(4, 3, 2)
    first += 0.99 * (first.mean(axis=0) - first)
    shown = repeats(close := with_rates(one, rates), solve_campaign(close))[2]
    assert shown.spread.uneven.any()
    assert not shown.uneven_in_words


@pytest.mark.slow
def test_repeats_share_few_degrees_of_freedom_where_one_temperature_has_most_of_the_scatter() -> None:
    """As many as all repeats have where they scatter alike, those of one temperature's estimate where it is alone."""
    alike = np.tile([[-1.0], [0.0], [1.0]], (8, 1))
    alone = np.where(np.arange(24)[:, None] < 3, 100.0 * alike, alike)
    group = np.repeat(np.arange(8), 3)
    found = [Spread.of(values, np.full((24, 1), np.nan), group) for values in (alike, alone)]
    assert [int(each.degrees[0]) for each in found] == [16, 16]
    assert [float(each.shared[0]) for each in found] == pytest.approx([16.0, 4.0], rel=0.01)


@pytest.mark.slow
def test_even_scatter_is_seldom_called_uneven() -> None:
    """Of 66 sound campaigns at most 1 in 33, whether or not runs differ."""
    found = 0
    for seed in range(33):
        for scatter in (0.0, 2.0):
            one = runs_at_their_temperatures(16, 4, seed=1000 + seed, scatter=scatter)
            found += repeats(one, solve_campaign(one))[2].spread.uneven.any()
    assert found <= 2


@pytest.mark.parametrize(("times", "said"), [(0.25, "times too small"), (1.0, "scatter as"), (4.0, "times too large")])
def test_standard_errors_that_repeats_contradict_are_said_to_be_wrong(times: float, said: str) -> None:
    """By about how much, from what neither bias nor MU moves; a bias of its own in each run changes nothing of that."""
    for offset in (0.0, 2.0):
        one = runs_at_their_temperatures(24, 3, seed=5, scatter=offset)
        errors = replace(one.sensors[2], rates_se_deg_per_hr=times * one.sensors[2].rates_se_deg_per_hr)
        stated = replace(one, sensors={2: errors})
        shown = repeats(stated, solve_campaign(stated))[2]
        assert [*shown.times_of.values()] == pytest.approx([1.0 / times] * 2, rel=0.3)
        assert said in " ".join(shown.sentences()) or (offset > 0.0 and times == 1.0)


def test_one_doubted_collect_makes_no_standard_error_too_small() -> None:
    """By how much they are is asked of the runs that nothing is said against."""
    one = runs_at_their_temperatures(24, 3, seed=0, scatter=1.0)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[15:18, 0] += 60.0
    doubted = replace(one, sensors={2: replace(one.sensors[2], rates_deg_per_hr=rates)})
    assert [each["done"] for each in what_is_wrong(doubted)["rows"]] == ["used"]
    assert {*repeats(doubted, solve_campaign(doubted))[2].times_of.values()} == {1.0}


def test_runs_in_which_the_unit_had_not_settled_make_no_repeats_scatter() -> None:
    """Their first collects are at another temperature than their last, by which their values differ from repeats'."""
    one = runs_at_their_temperatures(12, 3, seed=4, scatter=0.5)
    rows = one.sensors[2].conditions
    first = (rows.run % 3 == 1)[:, None]
    drifted = one.sensors[2].rates_deg_per_hr + first * np.tile([[-6.0, 4.0], [6.0, -4.0], [0.0, 0.0]], (12, 1))
    for to_come_degC, said in ((12.0, False), (0.0, True)):
        columns = {**rows.columns, "temperature_degC": rows.columns["temperature_degC"] - to_come_degC * first[:, 0]}
        unsettled = replace(one.sensors[2], rates_deg_per_hr=drifted, conditions=replace(rows, columns=columns))
        soaked = replace(one, sensors={2: unsettled})
        words = " ".join(repeats(soaked, solve_campaign(soaked))[2].sentences())
        assert ("GSA by " in words) is said, to_come_degC


def test_residuals_that_repeats_do_not_share_are_no_noise() -> None:
    """A drift that is the same in every run: it says nothing of standard errors, and no mean averages it."""
    made = repeated(12, 3, (0, 1, 2, 3, 4, 5, 0), drift=6.0)
    errors = np.full_like(made.sensors[2].rates_deg_per_hr, 0.7)  # of what collects of one position do not share
    drifting = replace(made, sensors={2: replace(made.sensors[2], rates_se_deg_per_hr=errors)})
    shown = repeats(drifting, solve_campaign(drifting))[2]
    assert np.all(np.asarray(shown.spread.common) > 3.0)
    assert shown.spread.factor == pytest.approx(1.0)
    for mean in shown.means:
        assert all(value.sd > 0.99 * shown.of_each[mean.runs[0]][name] for name, value in mean.values.items())
    assert {*shown.times_of.values()} == {1.0}
    assert np.all(shown.noise_times < 2.0)
    assert "the same in every run, and no noise" in shown.sentences()[-1]


@pytest.mark.slow
@pytest.mark.parametrize(("drift", "times"), [(2.0, 1.0), (0.0, 1.0), (0.0, 0.2), (2.0, 0.2)])
def test_standard_errors_are_too_small_only_where_what_is_left_differs_from_run_to_run(
    drift: float, times: float
) -> None:
    """What moves the mean alone, of one channel, is never put down to them, and noise always is."""
    for seed in range(8):
        one = repeated(6, 6, (0, 1, 2, 0), seed)
        one = with_rates(one, one.sensors[2].rates_deg_per_hr + np.tile(np.arange(4.0), 6)[:, None] * [0.0, drift])
        errors = replace(one.sensors[2], rates_se_deg_per_hr=times * one.sensors[2].rates_se_deg_per_hr)
        made = replace(one, sensors={2: errors})
        shown = repeats(made, solve_campaign(made))[2]
        said = " ".join(shown.sentences())
        assert ("too small" in said) is (times < 1.0)
        assert drift or times < 1.0 or shown.noise_times.max() <= 1.0
        assert not drift or times < 1.0 or "the same in every run, and no noise" in said


@pytest.mark.parametrize(("runs", "per_temperature"), [(2, 2), (6, 6), pytest.param(12, 3, marks=pytest.mark.slow)])
def test_sound_repeats_are_seldom_said_to_scatter_more_and_those_that_do_are(runs: int, per_temperature: int) -> None:
    """Once in a hundred, however many parameters are asked; what scatters by twice its noise is said, and by what."""
    said = {}
    for scatter in (0.0, 2.0):
        for seed in range(12):
            one = runs_at_their_temperatures(runs, per_temperature, seed=50 + seed, scatter=scatter)
            said[scatter, seed] = repeats(one, solve_campaign(one))[2].sentences()[0]
    more = [scatter for (scatter, _), words in said.items() if "scatter more" in words]
    assert more.count(0.0) <= 1
    assert more.count(2.0) >= (10 if runs > 2 else 2)
    freedom = runs - runs // per_temperature
    assert any(f"say, as far as {freedom} degree" in words for words in said.values())
    assert all("deg/hr (0." in words and " by noise)" in words for words in said.values() if "BA by" in words)


@pytest.mark.slow
def test_a_run_that_its_records_contradict_widens_no_other_and_is_in_no_mean() -> None:
    """With it or without its collects, the others' means and uncertainties are the same; and it is said."""
    one = night(0, RUN_TO_RUN)
    rows = one.sensors[2]
    rates = rows.rates_deg_per_hr + np.where(rows.conditions.run == 5, 8.0, 0.0)[:, None]
    contradicted = {(5, 2): Judgement(Verdict.FAIL, "collect 13: the unit lay otherwise")}
    with_it = replace(one, sensors={2: replace(rows, rates_deg_per_hr=rates)}, contradicted=contradicted)
    without = replace(one, sensors={2: rows.rows(rows.conditions.run != 5)})
    found, told = (repeats(each, solve_campaign(each))[2] for each in (with_it, without))
    assert found.document()["means"] == told.document()["means"]
    assert found.document()["runs_not_used"] == [5]
    assert any("run 5 FAILed" in sentence for sentence in in_words(what_is_wrong(with_it)))
    (thermal,), (alone,) = (thermal_document(fit_thermal(each))["sensors"] for each in (with_it, without))
    assert thermal["parameters"] == alone["parameters"]
    every = replace(with_it, contradicted={(run, 2): contradicted[5, 2] for run in range(1, 25)})
    assert repeats(every, solve_campaign(every))[2].not_used == ()


def test_one_large_standard_error_makes_no_other_run_surer() -> None:
    """What repeats show beyond standard errors shows in the runs that these hold close."""
    one = runs_at_their_temperatures(24, 3, scatter=5.0)
    errors = one.sensors[2].rates_se_deg_per_hr.copy()
    errors[12, 0] = 50.0
    poor = replace(one, sensors={2: replace(one.sensors[2], rates_se_deg_per_hr=errors)})
    told, beside = (repeats(each, solve_campaign(each))[2].of_each[13] for each in (one, poor))
    assert beside == pytest.approx(told, rel=0.25)


def test_each_parameter_is_known_by_the_runs_that_tell_it() -> None:
    """One that is hardly known, or not told, adds nothing to what the others show of a parameter, nor its interval."""
    values = 500.0 * np.random.default_rng(0).normal(size=(9, 3))
    errors, group = np.ones_like(values), np.repeat([0, 1, 2], 3)
    every = Spread.of(values, errors, group)
    values[::3, 1], errors[::3, 2] = np.nan, 1e6
    spread = Spread.of(values, errors, group)
    units, at = dict.fromkeys("ABC", "deg/hr"), [(float(k), ()) for k in range(3)]
    shown = SensorRepeats.of(units, spread, means_at(units, values, errors, group, at, spread))
    fewer = Spread.of(*(np.delete(each, np.s_[::3], axis=0) for each in (values, errors, group)))
    assert shown.spread.freedom == pytest.approx([every.freedom[0], fewer.freedom[1], fewer.freedom[2]], rel=1e-3)
    assert shown.spread.freedom[0] > 1.9 * shown.spread.freedom[2]
    assert "(3 to 6 degrees of freedom" in shown.sentences()[0]
    assert shown.sentences()[0].endswith("what noise does not explain (hil reconcile asks what it follows)")


@pytest.mark.parametrize("times", [1.0, 0.1, 10.0])
def test_one_large_standard_error_makes_no_other_too_large(times: float) -> None:
    """Runs at four temperatures, right to one: what they differ by is asked in each run's own error."""
    one = runs_at_their_temperatures(36, 9, seed=3, scatter=0.0)
    errors = times * one.sensors[2].rates_se_deg_per_hr
    errors[21:24] *= 300.0
    made = replace(one, sensors={2: replace(one.sensors[2], rates_se_deg_per_hr=errors)})
    assert [*repeats(made, solve_campaign(made))[2].times_of.values()] == pytest.approx([1.0 / times] * 2, rel=0.3)


def test_no_noise_is_larger_than_the_uncertainty_that_holds_it() -> None:
    """Of a run that is known less than others, where what differs from run to run shows errors that are too small."""
    one = runs_at_their_temperatures(24, 3, seed=5, scatter=0.0)
    errors = 0.2 * one.sensors[2].rates_se_deg_per_hr
    errors[12:15] *= 1.6
    made = replace(one, sensors={2: replace(one.sensors[2], rates_se_deg_per_hr=errors)})
    solutions = solve_campaign(made)
    shown = repeats(made, solutions)[2]
    assert shown.noise_times == pytest.approx([5.0] * 2, rel=0.3)
    for each in solutions:
        noise = shown.by_noise.factor * [of.se for of in each.parameters.values()]
        assert np.all([*shown.of_each[each.runs[0]].values()] >= noise * (1.0 - 1e-9))


def test_it_is_said_that_errors_are_taken_as_large_as_residuals_show_them() -> None:
    """Two runs at each of two temperatures tell by nothing else how large noise is: not as standard errors say."""
    one = repeated(4, 2, (0, 1, 2, 0), seed=1)
    made = replace(one, sensors={2: replace(one.sensors[2], rates_se_deg_per_hr=np.full((16, 2), 0.4))})
    shown = repeats(made, solve_campaign(made))[2]
    assert {*shown.times_of.values()} == {1.0}
    said = shown.sentences()[0]
    assert said.startswith("repeats scatter as their standard errors times what residuals and repeats show (RA ")
    assert ") say, as far as 2 degrees of freedom can tell" in said
