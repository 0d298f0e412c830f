"""What differs from run to run is noise only where no parameter of a run makes it, and the run had settled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtrc

from hil.campaign import Campaign, FloatArray
from hil.model.forms import default_form
from hil.solve import repeats, solve_campaign
from hil.solve.asked import Asked
from hil.solve.repeats import SensorRepeats
from hil.solve.residuals import FAIL_PROBABILITY, LACKS, MOVED, Changes, changes
from hil.solve.whitened import Whitened
from hil.solve.wrong_rows import wrong_rows
from procedures.verdict import Verdict
from tests.hil.solve.runs_of_a_unit import campaign, repeated, up_and_down, with_column, with_rates


def of_errors(made: Campaign, times: float = 1.0, more: FloatArray | float = 0.0) -> Campaign:
    """Return a campaign whose rates are `more`, with `times` the standard errors of what each is measured by."""
    rows = made.sensors[2]
    rates, errors = rows.rates_deg_per_hr + more, np.full(rows.rates_deg_per_hr.shape, 0.7 * times)
    return replace(made, sensors={2: replace(rows, rates_deg_per_hr=rates, rates_se_deg_per_hr=errors)})


def another_gsa_in_each_run(made: Campaign, seed: int, name: str = "GSA") -> FloatArray:
    """Return by what rates (n, c) differ where GSA (or what is named) scatters from run to run by 5 deg/hr/g."""
    rows = made.sensors[2].conditions
    form, gsa = default_form(rows), np.random.default_rng(seed).normal(0.0, 5.0, rows.run.max() + 1)
    return form.columns(rows)[..., form.names.index(name)] * gsa[rows.run][:, None]


def seen(made: Campaign) -> SensorRepeats:
    """Return what repeats show."""
    return repeats(made, solve_campaign(made))[2]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_another_parameter_that_changes_from_run_to_run_makes_no_standard_error_too_small(seed: int) -> None:
    """It scatters as bias and MU do: what rates of one run differ by among themselves is as large as stated."""
    made = repeated(12, 3, (0, 1, 2, 0, 1, 2), seed)
    shown = seen(of_errors(made, more=another_gsa_in_each_run(made, seed)))
    assert {*shown.times_of.values()} == {1.0}
    assert "GSA by " in shown.sentences()[0]


def test_errors_that_hold_beside_no_parameter_are_too_small_whatever_else_changes() -> None:
    """By as much as what none of a run's parameters makes says."""
    made = repeated(12, 3, (0, 1, 2, 0, 1, 2))
    for more in (0.0, another_gsa_in_each_run(made, 0)):
        shown = seen(of_errors(made, 0.2, more))
        assert [*shown.times_of.values()] == pytest.approx([5.0] * 2, rel=0.5)
        assert all(said.endswith("differ in beside their parameters") for said in shown.noise_in_words)


@pytest.mark.parametrize("order", [(0, 1, 2, 1, 0), (0, 1, 2)])
def test_a_stated_uncertainty_is_made_of_the_noise_that_shows_whether_errors_are_too_small_or_too_large(
    order: tuple[int, ...],
) -> None:
    """As that of the budget is: by errors that are five times too large each ± had been, and no less."""
    made = repeated(30, 5, order)
    right, small, large = (seen(of_errors(made, times)) for times in (1.0, 0.2, 5.0))
    assert {each.verdict for each in solve_campaign(of_errors(made, 100.0))} == {Verdict.PASS}, "as well measured"
    for name in ("GSA", "GSB"):  # BA of three collects takes what differs
        assert large.means[0].values[name].sd == pytest.approx(right.means[0].values[name].sd, rel=0.35)
        assert small.means[0].values[name].sd == pytest.approx(right.means[0].values[name].sd, rel=0.35)


def test_what_repeats_scatter_by_within_chance_is_said_beside_the_standard_error_that_includes_it() -> None:
    """Nothing was said of a ± of 3.3 beside noise of .5 but by how much standard errors are too small."""
    made = of_errors(repeated(6, 2, (0, 1, 2)), 0.3)
    of_run = np.zeros((2, 7))
    of_run[1, 1:] = [-2.4, 2.4, -1.8, 1.8, -2.2, 2.2]
    rows = made.sensors[2]
    shown = seen(with_rates(made, rows.rates_deg_per_hr + of_run.T[rows.conditions.run]))
    bb = shown.names.index("BB")
    assert not shown.by_noise.certain[bb]
    assert shown.noise_in_words
    (said,) = (each for each in shown.sentences() if each.startswith("repeats scatter as"))
    assert f"though by more: BB by {shown.spread.observed[bb]:.3g} deg/hr (" in said
    assert said.endswith("each ± includes that")
    assert np.all((shown.spread.beyond == 0.0) | (shown.spread.beyond > 1e-3)), "the rest of arithmetic is no scatter"


def test_a_run_is_judged_beside_the_noise_that_its_sensors_repeats_show() -> None:
    """Where errors of one channel are a third of what repeats show no run FAILs; by what all lack each does."""
    made = of_errors(repeated(12, 3, (0, 1, 2, 0, 1, 2)))
    rows = made.sensors[2]
    small = replace(made, sensors={2: replace(rows, rates_se_deg_per_hr=rows.rates_se_deg_per_hr * [1.0, 1.0 / 3.0])})
    solved = solve_campaign(small)
    assert {each.verdict for each in solved} == {Verdict.PASS}
    assert all("the standard errors, those of RB " in each.reason for each in solved)
    assert any(float(chdtrc(each.degrees_of_freedom, each.chi_square)) < FAIL_PROBABILITY / 24 for each in solved)
    between = np.tile([1.0, 1.0, 1.0, -1.0, -1.0, -1.0], 12)[:, None] * [0.0, 12.0]  # of two collects in one pose
    for each in solve_campaign(with_rates(small, rows.rates_deg_per_hr + between)):
        assert each.exceeds_errors
        assert ", in RB " in each.reason
        assert ", even with those of RB " in each.reason


def test_a_folder_whose_errors_are_too_small_is_accused_as_seldom_as_one_whose_errors_hold() -> None:
    """All runs together are judged beside that noise, too: else each would be by itself, and one of twelve is odd."""
    made = [repeated(12, 3, (0, 1, 2, 0, 1, 2), seed) for seed in range(9)]
    accused, usual = (
        sum(any(each.verdict is not Verdict.PASS for each in solve_campaign(of_errors(one, share))) for one in made)
        for share in (1.0 / 3.0, 1.0)
    )
    assert accused <= usual + 1 <= 2


def noisy_in_the_cold(times: float, seed: int, order: tuple[int, ...] = (0, 1, 2, 0, 1, 2)) -> Campaign:
    """Return twelve runs of six collects whose averages scatter by so many times more at the first setpoint."""
    made = repeated(12, 3, order, seed)
    rows = made.sensors[2]
    cold = (rows.conditions.run <= 3)[:, None]
    more = np.random.default_rng(100 + seed).normal(0.0, np.sqrt(times**2 - 1.0), rows.rates_deg_per_hr.shape) * cold
    return with_rates(made, rows.rates_deg_per_hr + more)


@pytest.mark.parametrize(("times", "seed"), [(2.5, 1), (2.5, 3), (3.0, 3)])
def test_no_sound_collect_is_left_out_where_all_are_noisier_at_a_temperature(times: float, seed: int) -> None:
    """By the noise of all others two of eighteen were; one that is far off even there is."""
    noisy = noisy_in_the_cold(times, seed)
    assert wrong_rows(noisy)[2].rows == ()
    rates = noisy.sensors[2].rates_deg_per_hr.copy()
    rates[8] += 60.0
    assert (9,) in [wrong.collects for wrong in wrong_rows(with_rates(noisy, rates))[2].rows]


def test_values_of_a_noisy_temperature_do_not_jump_nor_is_one_run_another() -> None:
    """Of thirty nights fourteen had a parameter that jumps, or a run in which one is another, by eight of its ±."""
    nights = [noisy_in_the_cold(4.8, seed, (0, 1, 2, 0)) for seed in range(10)]
    assert [each.between.jumps for night in nights for each in solve_campaign(night)[:1]] == [{}] * 10


def test_of_four_collects_a_run_noise_of_a_temperature_is_weighed_against_rows_that_are_wrong() -> None:
    """By itself none of three such runs tells its noise: of eight nights seven lost sound collects, and four a run."""
    nights = [noisy_in_the_cold(3.8, seed, (0, 1, 2, 0)) for seed in range(8)]
    assert [wrong_rows(each)[2].rows for each in nights] == [()] * 8
    assert sum(each.verdict is Verdict.FAIL for night in nights for each in solve_campaign(night)) <= 1
    rates = nights[0].sensors[2].rates_deg_per_hr.copy()
    rates[5] += 60.0
    assert [wrong.collects for wrong in wrong_rows(with_rates(nights[0], rates))[2].rows] == [(6,)]
    rates[5] += 1e6  # so far off that nothing being wrong is no number any more
    assert [wrong.collects for wrong in wrong_rows(with_rates(nights[0], rates))[2].rows] == [(6,)]
    quiet = [repeated(12, 3, (0, 1, 2, 0), seed) for seed in range(8)]
    for each in quiet:  # a rate that is far off in the quiet is no noise of its temperature
        each.sensors[2].rates_deg_per_hr[5] += 8.0
    assert [[wrong.collects for wrong in wrong_rows(each)[2].rows] for each in quiet] == [[(6,)]] * 8


def test_whatever_the_noise_is_something_is_wrong_or_nothing() -> None:
    """Probabilities over all that the noise of one temperature may be make one."""
    for seed in range(3):
        asked = Asked(Whitened(noisy_in_the_cold(3.8, seed, (0, 1, 2, 0)).sensors[2]))
        nothing, found = asked.weighed()
        assert nothing + sum(p for _, p in found) == pytest.approx(1.0)


def test_noise_that_is_larger_at_one_temperature_is_that_of_its_runs_and_said() -> None:
    """Twice as large in the cold, whatever standard errors say: no run there FAILs, and those elsewhere gain none."""
    failed = []
    for seed in range(4):
        solved = solve_campaign(noisy := noisy_in_the_cold(2.0, seed))
        shown = repeats(noisy, solved)[2]
        failed += [each.run for each in solved if each.verdict is Verdict.FAIL]
        where = [said for said in shown.cautions if "differ by more at some temperatures than at others" in said]
        assert where
        assert all("their standard errors at -20.0 °C: no one ± " in said for said in where)
        larger = np.array([each.differ.larger_in(each.runs) for each in solved])
        assert larger[:3].max() > 1.5
        assert larger[3:].max() == 1.0
    assert failed == []


def test_where_nothing_parts_noise_from_another_parameter_both_are_said() -> None:
    """Three collects have no rate more than parameters; and all of these differ."""
    made = campaign(12, 3)
    every = sum(another_gsa_in_each_run(made, seed, name) for seed, name in enumerate(("GSA", "MUA", "MUB")))
    (said,) = seen(of_errors(made, more=every)).noise_in_words
    assert said.endswith("differ in beside bias and MU, or another value of the unit changes")


@pytest.mark.parametrize("bias", [0.0, 3.0])
def test_noise_of_collects_would_be_in_mu_too(bias: float) -> None:
    """A drift of its own in each run makes GS of the order 1-3-2: errors were called too small, though MU agrees."""
    made = campaign(12, 3, scatter=bias)
    shown = seen(of_errors(made, more=another_gsa_in_each_run(made, 0)))
    assert not shown.noise_in_words
    assert "GSA by " in shown.sentences()[0]


def test_a_run_that_had_not_settled_makes_no_other_less_sure() -> None:
    """What its residuals show is what the unit went through: the others' errors are as stated, and nothing is alike."""
    made = repeated(12, 3, (0, 1, 2, 0, 1, 2))
    rows = made.sensors[2].conditions
    first, place = rows.run % 3 == 1, np.tile(np.arange(6.0), 12)
    moved = np.where(first, 5.0 - place, 0.0)
    columns = {**rows.columns, "temperature_degC": rows.columns["temperature_degC"] + moved}
    soaked = replace(made, sensors={2: replace(made.sensors[2], conditions=replace(rows, columns=columns))})
    shown = seen(of_errors(soaked, more=2.0 * moved[:, None]))
    assert shown.noise_times == pytest.approx([1.0, 1.0])
    assert not shown.same_times
    assert not shown.noise_in_words
    for each in solve_campaign(of_errors(soaked, more=6.0 * moved[:, None])):
        assert (MOVED in each.reason) is (each.run % 3 == 1), "measured again, and settled, it may lack nothing"
        assert LACKS not in each.reason


@pytest.mark.parametrize("unlike", [0.0, 0.3])
def test_what_runs_do_to_their_parameters_is_no_noise_though_errors_are_not_alike(unlike: float) -> None:
    """A run's own bias and MU, however large, leave nothing of themselves where errors differ from rate to rate."""
    squares, freedom = np.zeros((2, 2))
    for seed in range(8):
        one, rng = campaign(12, 3, seed=seed, scatter=30.0), np.random.default_rng(seed)
        rows = one.sensors[2]
        errors = rows.rates_se_deg_per_hr * np.exp(unlike * rng.normal(size=rows.rates_se_deg_per_hr.shape))
        more = np.sqrt(np.maximum(errors**2 - rows.rates_se_deg_per_hr**2, 0.0)) * rng.normal(size=errors.shape)
        errors = np.maximum(errors, rows.rates_se_deg_per_hr)
        rows = replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + more, rates_se_deg_per_hr=errors)
        found = changes(rows, set(rows.conditions.run.tolist()))
        squares, freedom = squares + found.squares, freedom + found.freedom
    assert freedom == pytest.approx([64.0, 64.0])  # of 8 nights, 4 temperatures, 3 runs of 6 rates: less 4 and common 2
    assert squares / freedom == pytest.approx([1.0, 1.0], abs=0.45)


@pytest.mark.parametrize(("own_degC", "fails"), [(-15.0, True), (-3.5, False)])
def test_a_run_that_had_not_settled_repeats_none_that_had(own_degC: float, fails: bool) -> None:
    """It stayed at another temperature: in no mean at its setpoint, and in no ± of those that were there."""
    made = campaign(9, 3, scatter=0.5)
    rows = made.sensors[2]
    sixth = rows.conditions.run == 6
    rates = rows.rates_deg_per_hr + 40.0 * sixth[:, None]
    temperature_degC = np.where(sixth, own_degC, rows.conditions.columns["temperature_degC"])
    late = with_column(with_rates(made, rates), temperature_degC=temperature_degC)
    shown = repeats(late, solve_campaign(late))[2]
    assert [mean.runs for mean in shown.means if mean.runs] == [(1, 2, 3), (4, 5), (7, 8, 9)]
    assert np.all(shown.spread.observed[:2] < 2.0)
    said = "run 6: the soak had not ended, and none repeats a run of which it had: in no mean"
    assert (said in shown.sentences()) is not fails  # a run that fails by its records is named with these
    assert not repeats(made, solve_campaign(made))[2].in_no_mean


@pytest.mark.parametrize(("by", "seeds", "told"), [(20.0, range(1), 1), (0.0, range(12), 0)])
def test_what_visits_to_a_temperature_differ_by_is_said_of_every_uncertainty(
    by: float, seeds: range, told: int
) -> None:
    """A bias that the way to 25 °C moves was in a ± that no command doubted; visits that agree are not doubted."""
    found = []
    for seed in seeds:
        one = up_and_down(seed)
        run, setpoint_degC = one.sensors[2].conditions.run, one.sensors[2].conditions.columns["setpoint_degC"]
        rates = one.sensors[2].rates_deg_per_hr.copy()
        rates[:, 0] += by * (setpoint_degC == 25.0) * np.where(run <= 5, 1.0, -1.0)
        made = with_rates(one, rates)
        found += [said for said in repeats(made, solve_campaign(made))[2].sentences() if "between visits" in said]
    assert len(found) == told
    assert all(said.startswith("BA differs between visits to one temperature by more than runs") for said in found)


def test_what_scatters_at_a_temperature_that_was_visited_once_hides_no_difference_of_visits() -> None:
    """A bias that moves between the two runs at 50 °C, and stays, is seen at the temperatures that were met again."""
    made = up_and_down(3, scatter=1.0)
    run = made.sensors[2].conditions.run
    moved = with_rates(made, made.sensors[2].rates_deg_per_hr + np.outer(np.where(run > 5, 25.0, 0.0), [1.0, 0.0]))
    assert "BA" in seen(moved).of_visits
    assert "BA" not in seen(made).of_visits


@pytest.mark.parametrize(
    ("squares", "freedom", "times"),
    [
        ([1.0, 0.2], [6.0, 6.0], [0.316, 0.316]),  # of the one alone nobody is sure
        ([7.0, 0.2], [6.0, 6.0], [1.0, 0.183]),  # and here it is as stated
        ([0.2, 0.3], [6.0, 6.0], [0.183, 0.224]),
        ([1.4, 1.2], [6.0, 6.0], [0.465, 0.465]),
        ([50.0, 5.0], [6.0, 6.0], [2.887, 1.0]),
        ([7.0, 5.0], [6.0, 6.0], [1.0, 1.0]),
        ([0.0, 0.2], [0.0, 6.0], [1.0, 0.183]),
    ],
)
def test_of_few_runs_all_channels_tell_together_what_one_is_not_sure_of(squares, freedom, times) -> None:
    """Standard errors four times too large in both: one had been said, and the other's ± stayed as wide as stated."""
    assert Changes(np.array(squares), np.array(freedom)).times == pytest.approx(times, abs=1e-3)
