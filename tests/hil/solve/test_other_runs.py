"""What the other runs of a campaign say of each collect, and what other records say of its rows."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Collects, FloatArray
from hil.campaign.plausibility import judged_by_its_records
from hil.solve import repeats, solve_campaign
from hil.solve.whitened import Whitened
from hil.solve.wrong_rows import LEFT_OUT, USED, wrong_rows
from procedures.verdict import Verdict
from procedures.words import numbered
from tests.hil.solve.runs_of_a_unit import F_G, K, campaign, repeated, with_column, with_rates


@pytest.mark.slow
@pytest.mark.parametrize("per_temperature", [1, 3])
def test_sound_campaigns_are_left_alone(per_temperature: int) -> None:
    """Scatter of bias, a slope with temperature, few runs: no row is taken for it, and hardly a run is looked at."""
    doubted = 0
    for seed in range(20):
        for runs in (1, 2, 3, 9):
            made = campaign(runs, per_temperature, seed)
            assert not [row for row in wrong_rows(made)[2].rows if row.done != USED]
            assert judged_by_its_records(made).contradicted == {}
            doubted += any(each.verdict is not Verdict.PASS for each in solve_campaign(made))
    assert doubted <= 1


@pytest.mark.parametrize("per_temperature", [1, 3])
def test_exchanged_collects_are_no_pass(per_temperature: int) -> None:
    """The rates of positions 1 and 2 of run 5."""
    made = campaign(per_temperature=per_temperature)
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rates[[12, 13]] = rates[[13, 12]]
    solved = {each.run: each for each in solve_campaign(with_rates(made, rates))}
    assert solved[5].verdict is Verdict.FAIL
    assert "collects 13–14, at positions 1 and 2, look exchanged" in solved[5].reason
    assert all(each.verdict is Verdict.PASS for run, each in solved.items() if run != 5)


@pytest.mark.parametrize("seed", range(6))
def test_a_rate_that_is_off_is_left_out_where_each_temperature_was_met_once(seed: int) -> None:
    """A unit's bias and MU follow temperature: what is off that, and in one collect, is no run's."""
    made = campaign(9, 1, seed, scatter=1.0)
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rates[13, 0] += 40.0
    found = wrong_rows(with_rates(made, rates))[2].rows
    assert [(row.run, row.collects, row.channels, row.done) for row in found] == [(5, (14,), ("RA",), LEFT_OUT)]


@pytest.mark.parametrize("seed", range(4))
def test_a_rate_that_is_off_is_no_pass_where_what_all_runs_share_follows_temperature(seed: int) -> None:
    """Six temperatures, each met once, over which GS changes by a third: it follows a curve, and so hides no row."""
    made = campaign(6, 1, seed, scatter=2.0)
    rows = made.sensors[2]
    steady = np.where([True, True, False], K, 0.0)
    warmer = rows.conditions.columns["temperature_degC"][:, None] / 300.0
    follows = rows.rates_deg_per_hr + warmer * (rows.conditions.f_g @ steady.T)
    assert wrong_rows(with_rates(made, follows))[2].rows == ()
    row = (6, 7, 9, 10)[seed]  # no other row tells MU beside the third of a run
    follows[row, 0] += 40.0
    solved = {each.run: each.verdict for each in solve_campaign(with_rates(made, follows))}
    assert solved[1 + row // 3] is not Verdict.PASS


@pytest.mark.parametrize("seed", range(3))
def test_a_gs_that_differs_from_run_to_run_accuses_no_collect(seed: int) -> None:
    """As a bias and MU do: it is what the unit does, and one rate that is off among these is told all the same."""
    made = campaign(24, 3, seed, scatter=1.0)
    rows = made.sensors[2]
    d, e = np.repeat(np.random.default_rng(seed).normal(0.0, 20.0, (2, 24)), 3, axis=1)
    f_a, f_b = rows.conditions.f_g[:, 0], rows.conditions.f_g[:, 1]
    rates = rows.rates_deg_per_hr + np.stack([d * f_a + e * f_b, d * f_b - e * f_a], axis=1)
    assert wrong_rows(with_rates(made, rates))[2].rows == ()
    rates[14, 0] += 40.0
    assert [row.run for row in wrong_rows(with_rates(made, rates))[2].rows] == [5]


def test_one_collect_far_off_and_turned_signs_are_no_pass() -> None:
    """What has a cause FAILs; what has none is INCONCLUSIVE, with its size."""
    made = campaign()
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rates[14, 0] += 300.0
    rates[18:21] *= -1.0
    solved = {each.run: each for each in solve_campaign(with_rates(made, rates))}
    assert solved[5].verdict is Verdict.INCONCLUSIVE
    assert "collect 15: RA is +" in solved[5].reason
    assert solved[7].verdict is Verdict.FAIL
    assert "the signs look turned" in solved[7].reason
    assert sum(each.verdict is not Verdict.PASS for each in solved.values()) == 2


@pytest.mark.parametrize(("runs", "off"), [(9, 200.0), (6, 500.0), (6, 100.0)])
def test_a_run_with_another_bias_is_marginal(runs: int, off: float) -> None:
    """All its collects are off by the same: a unit does that, and somebody should look. It hides behind no other."""
    made = campaign(runs)
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rates[12:15] += off
    found = wrong_rows(with_rates(made, rates))[2].judged
    assert {run: each.verdict for run, each in found.items()} == {5: Verdict.MARGINAL}
    assert "its bias was another" in found[5].reason


def test_a_run_with_another_mu_is_marginal_and_used() -> None:
    """By 60 deg/hr/g it was left out, as off in what neither a bias nor MU moves; by 30 it was not."""
    made = repeated(12, 3, (0, 1, 2, 2))
    rows = made.sensors[2]
    mu = 60.0 * (rows.conditions.run == 5)[:, None] * rows.conditions.f_g[:, 2:]
    found = wrong_rows(with_rates(made, rows.rates_deg_per_hr + mu * [1.0, 0.0]))[2]
    assert [(row.run, row.done) for row in found.rows] == [(5, USED)]
    assert "its MU was another" in found.judged[5].reason
    assert found.another == {"MUB": {5}}


@pytest.mark.parametrize(("kind", "others"), [("BA", (5, 17)), ("MUB", (5, 17)), ("BA", (5, 17, 29))])
def test_runs_that_are_others_are_in_no_mean(kind: str, others: tuple[int, ...]) -> None:
    """What runs scatter by had them in it, for no one jump explains two: ± 17 deg/hr on all, where 2 was true."""
    made = repeated(12 * len(others), 3, (0, 1, 2, 2))
    rows = made.sensors[2]
    by = 60.0 * np.isin(rows.conditions.run, others) * (1.0 if kind == "BA" else rows.conditions.f_g[:, 2])
    torn = with_rates(made, rows.rates_deg_per_hr + by[:, None] * [1.0, 0.0])
    shown, sound = (repeats(of, solve_campaign(of))[2] for of in (torn, made))
    place = shown.names.index(kind)
    assert shown.between.alone[kind] == {*others}
    assert shown.spread.observed[place] < 1.5 * sound.spread.observed[place]
    for mean in shown.means:
        assert shown.runs_of(mean, kind) == tuple(run for run in mean.runs if run not in others)


def test_a_run_at_another_heading_is_no_other_and_one_whose_w_says_so_falsely_is() -> None:
    """Rates are compared less the earth rate: they follow it, and where they do not the run's bias seems another."""
    made = campaign(scatter=1.0)
    rows = made.sensors[2]
    w = rows.conditions.w_deg_per_hr.copy()
    w[12:15, 1] *= -1.0
    turned = replace(rows, conditions=replace(rows.conditions, w_deg_per_hr=w))
    followed = rows.rates_deg_per_hr + (w - rows.conditions.w_deg_per_hr)[:, :2]
    assert not wrong_rows(replace(made, sensors={2: replace(turned, rates_deg_per_hr=followed)}))[2].judged
    (judged,) = wrong_rows(replace(made, sensors={2: turned}))[2].judged.items()
    assert (judged[0], judged[1].verdict) == (5, Verdict.MARGINAL)


def test_a_wrong_pose_fails_its_run_alone_with_its_row() -> None:
    """Collect 15 lay as in position 2; the rates are what they are."""
    made = campaign()
    columns = made.sensors[2].conditions.columns
    shown = {f"accelerometer_{axis}_g": columns[f"accelerometer_{axis}_g"].copy() for axis in "ABS"}
    for axis, value in zip("ABS", F_G[1], strict=True):
        shown[f"accelerometer_{axis}_g"][14] = value
    judged = with_column(made, **shown)
    assert {key: each.verdict for key, each in judged.contradicted.items()} == {(5, 2): Verdict.FAIL}
    assert (
        "collect 15: position 3 was asked for, but the unit lies as in position 2" in judged.contradicted[5, 2].reason
    )
    assert any("collect 15" in warning for warning in judged.warnings)
    assert judged_by_its_records(judged).contradicted == judged.contradicted  # read back, it is said once


def test_a_latitude_that_w_does_not_have_fails() -> None:
    """Ten degrees: the vertical component of w is 2 deg/hr off."""
    judged = judged_by_its_records(replace(campaign(), site={"latitude_deg": 44.6}))
    assert len(judged.contradicted) == 9
    assert "w along the vertical is 8.541, where 10.461 to 10.661 belongs" in judged.contradicted[1, 2].reason


def test_without_accelerations_the_pose_is_assumed_and_said_to_be() -> None:
    """The solution says what was not measured."""
    made = campaign(runs=1)
    rows = made.sensors[2]
    columns = {name: v for name, v in rows.conditions.columns.items() if "accelerometer" not in name}
    bare = replace(made, sensors={2: replace(rows, conditions=replace(rows.conditions, columns=columns))})
    said = "the pose was not measured (no accelerations): that the unit lay as each position says"
    assert said in solve_campaign(bare)[0].assumed
    assert said not in solve_campaign(made)[0].assumed


def test_a_contradiction_is_named_by_its_own_sensors_collects() -> None:
    """Two sensors collected together have collects of their own numbers; what one of them shows is not the other's."""
    made = campaign(runs=2)
    first = made.sensors[2]
    columns = {name: (1.2 if "accel" in name else 1.0) * values for name, values in first.conditions.columns.items()}
    third = replace(first.conditions.sensor, number=3)
    other = replace(first.conditions, sensor=third, collect=np.arange(101, 107), columns=columns)
    both = replace(
        made, sensors={2: first, 3: replace(first, conditions=other, rates_deg_per_hr=first.rates_deg_per_hr + 1.0)}
    )
    assert judged_by_its_records(both).warnings == (
        "collects 101–106: sensor 3: its accelerometers show 1.20 times what gravity is: |f| is not 1 g",
    )


def test_orientation_tables_of_one_body_agree() -> None:
    """One sensor's axes may stand anyhow to the other's, but as they do they stand in every position."""
    made = campaign(runs=2)
    first = made.sensors[2]
    third = replace(first.conditions, sensor=replace(first.conditions.sensor, number=3), collect=np.arange(11, 17))
    bare = {n: replace(c, columns={}, w_deg_per_hr=np.zeros((6, 3))) for n, c in ((2, first.conditions), (3, third))}

    def said(f_g: FloatArray, **changes: bool) -> tuple[str, ...]:
        rows = {2: replace(first, conditions=bare[2])}
        rows[3] = Collects(replace(bare[3], f_g=f_g), first.rates_deg_per_hr + 1.0, first.rates_se_deg_per_hr)
        return tuple(judged_by_its_records(replace(made, sensors=rows, **changes)).warnings)

    turned = first.conditions.f_g[:, [2, 0, 1]] * [1.0, -1.0, 1.0]
    assert said(turned) == ()
    turned[[2, 5]] = [0.0, -1.0, 0.0]
    (told,) = said(turned)
    assert told.startswith("collects 1, 3–4, 6, 11, 13–14, 16: between positions 1 and 3 f turns by different angles")
    assert said(turned, centrifuge=True) == ()


@pytest.mark.parametrize("off", [2.0, 5.0, 11.0, 40.0])
def test_a_collect_that_scatter_hardly_explains_is_left_out(off: float) -> None:
    """Beyond the false alarms that are allowed, with its row; what scatter explains is used."""
    made = campaign(16, 8, scatter=1.0)
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rates[25, 1] -= off
    solved = {each.run: each for each in solve_campaign(with_rates(made, rates))}
    assert (solved[9].verdict is Verdict.INCONCLUSIVE) is (off > 2.0)
    assert ("collect 26: RB is -" in solved[9].reason) is (off > 2.0)
    assert all(each.verdict is Verdict.PASS for run, each in solved.items() if run != 9)


@pytest.mark.parametrize(
    ("runs", "per_temperature", "alone"),
    [(1, 1, [1]), (2, 2, [1, 2]), (3, 1, [1, 2, 3]), (4, 1, []), (9, 1, []), (9, 3, []), (8, 3, []), (7, 3, [7])],
)
def test_runs_that_cannot_be_compared_say_so(runs: int, per_temperature: int, alone: list[int]) -> None:
    """Two in all, three temperatures, one that nobody repeats where others are repeated: among what was assumed."""
    told = {each.run: " ".join(each.assumed) for each in solve_campaign(campaign(runs, per_temperature))}
    said = f"{numbered('run', alone)} cannot be compared with others"
    assert [run for run, text in told.items() if said in text] == alone
    assert sum("cannot be compared" in text for text in told.values()) == len(alone)


def test_what_cannot_be_compared_is_said_in_one_sentence_with_and_without_residuals() -> None:
    """Of two runs, one with every collect twice and one with each once, and so no residual: said of both, once."""
    one = campaign(3, 3)
    rows = one.sensors[2]
    runs = replace(rows, conditions=replace(rows.conditions, run=np.minimum(rows.conditions.run, 2)))
    solutions = solve_campaign(replace(one, sensors={2: runs}))
    assert len({each.degrees_of_freedom > 0 for each in solutions}) == 2
    assert len({text for each in solutions for text in each.assumed if "cannot be compared" in text}) == 1


def test_of_a_run_of_which_only_a_part_cannot_be_compared_it_is_said_which() -> None:
    """Channel B of the only run that repeats it was not measured: channel A is compared."""
    one = campaign(8, 3)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[21:, 1] = np.nan
    said = [text for each in solve_campaign(with_rates(one, rates)) for text in each.assumed if "compared" in text]
    assert [text.partition(" cannot be compared")[0] for text in said] == ["BB and MUA of run 7"]


def test_one_rate_that_fits_with_minus_by_chance_is_no_turned_sign() -> None:
    """A sign is that of a whole run; what stands out is the rate."""
    one = campaign(6, 2, seed=11, scatter=2.0)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[8, 1] += 60.0
    reasons = " ".join(each.reason for each in solve_campaign(with_rates(one, rates)))
    assert "signs look turned" not in reasons
    assert "collect 9" in reasons


def test_a_drift_through_every_run_accuses_no_collect() -> None:
    """A position that is taken again at the end of a run is compared with its like in other runs."""
    found = wrong_rows(repeated(12, 3, (0, 1, 2, 3, 4, 5, 0), drift=6.0))[2]
    assert not found.judged
    assert not found.not_compared


@pytest.mark.slow
def test_mu_of_each_run_accuses_no_collect() -> None:
    """What collects 3 scatter by is judged by themselves: in two of a hundred sound campaigns one was left out."""
    for seed in range(20):
        made = campaign(15, 3, seed, scatter=0.0)
        mu = np.random.default_rng(seed).normal(0.0, 5.0, (15, 2))
        rates = made.sensors[2].rates_deg_per_hr + np.where(np.arange(45) % 3 == 2, 1.0, 0.0)[:, None] * mu.repeat(3, 0)
        assert not wrong_rows(with_rates(made, rates))[2].judged


def test_a_sound_collect_beside_wrong_ones_is_not_accused() -> None:
    """Who stood out from what was wrong itself stands out no more when that is left out."""
    made = campaign(12, 3, seed=28, scatter=2.0)
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rates[[21, 22]], rates[18, 0] = rates[[22, 21]], rates[18, 0] + 200.0
    found = wrong_rows(with_rates(made, rates))[2]
    assert set(found.judged) == {7, 8}


def test_the_sign_of_one_channel_is_turned_in_every_collect_of_its_run() -> None:
    """Also in those that are near 0, where it hardly shows; the other channel is kept."""
    made = campaign(12, 3, seed=3)
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rates[12:15, 0] *= -1.0
    found = wrong_rows(with_rates(made, rates))[2]
    assert found.judged[5].verdict is Verdict.FAIL
    assert "the sign of RA looks turned" in found.judged[5].reason
    np.testing.assert_array_equal(found.collects.rates_deg_per_hr, made.sensors[2].rates_deg_per_hr)


def test_a_rate_that_is_missing_makes_no_other_doubted() -> None:
    """What the collects of its position scatter by is told by the others."""
    made = campaign(12, 3, seed=5, scatter=0.0)
    mu = np.random.default_rng(5).normal(0.0, 4.0, (12, 2))
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rates[2::3] += mu
    rates[[11, 14, 17]] = np.nan
    assert not wrong_rows(with_rates(made, rates))[2].judged


@pytest.mark.slow
def test_another_bias_of_which_one_collect_alone_stands_far_out_is_the_whole_runs() -> None:
    """The others are off by the same, a little less: no collect is left out, and from a size on it is told."""
    made = campaign(12, 3, seed=2, scatter=2.0)
    rates, told = made.sensors[2].rates_deg_per_hr.copy(), []
    for off in np.arange(15.0, 60.0, 3.0):
        moved = rates.copy()
        moved[12:15] += off
        found = wrong_rows(with_rates(made, moved))[2]
        assert {(row.run, row.collects, row.done) for row in found.rows} <= {(5, (13, 14, 15), USED)}
        told.append(any("its bias was another" in each.reason for each in found.judged.values()))
    assert told == sorted(told)
    assert 10 <= sum(told) < len(told)


def test_rates_that_one_mistake_moved_are_what_the_next_is_asked_of() -> None:
    """Beside a change of one run, what a further change adds to the squares is by the same quadratic form."""
    rates = Whitened(campaign(9, 3, seed=1).sensors[2])
    change = np.random.default_rng(1).normal(0.0, 5.0, 6)
    form, score = rates.of(4)
    after = rates.moved(4, change, rates.squares + 2.0 * change @ score + change @ form @ change)
    np.testing.assert_allclose(after.of(4)[1], score + form @ change, atol=1e-9)
    np.testing.assert_allclose(after.of(4)[0], form)
    assert not np.allclose(after.of(5)[1], rates.of(5)[1])


def test_a_life_is_compared_run_by_run() -> None:
    """Of 600 runs each is held against its neighbours without a table of all collects by all."""
    life = campaign(600, per_temperature=60)
    table = 8 * len(life.sensors[2]) ** 2  # bytes
    wrong_rows(life)[2]
    tracemalloc.start()
    try:
        wrong_rows(life)[2]
        assert tracemalloc.get_traced_memory()[1] < table / 4
    finally:
        tracemalloc.stop()


def test_the_rows_of_each_run_are_found_in_any_order() -> None:
    """All of them, each once, in their order; of no rows there are none."""
    mixed = campaign(4).sensors[2].conditions.rows(np.array([9, 0, 4, 1, 10, 3, 2]))
    assert {run: mixed.collect[rows].tolist() for run, rows in mixed.of_each_run.items()} == {
        1: [1, 2, 3],
        2: [5, 4],
        4: [10, 11],
    }
    assert not mixed.rows(np.zeros(len(mixed), bool)).of_each_run
