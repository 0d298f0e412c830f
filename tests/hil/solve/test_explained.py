"""Labels exchanged between collects of a run: told where all rates then agree, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, Collects, Conditions, Sensor
from hil.model.effects.prior import COMMON
from hil.reconcile import reconcile
from hil.solve import repeats, solve_campaign
from hil.solve.asked import _in_common
from hil.solve.causes import Cause
from hil.solve.explained import explanations
from hil.solve.wrong_rows import LEFT_OUT, MENDED, USED, as_at, treated, wrong_rows
from procedures.verdict import Verdict
from procedures.words import numbered
from tests.hil.model.effect_conditions import TRIAD
from tests.hil.solve.runs_of_a_unit import campaign, repeated, with_rates


def triads(seed: int, runs: int = 8) -> Campaign:
    """Six poses, two runs at each temperature, a bias of each run, white noise of 1 deg/hr as stated."""
    rng, f = np.random.default_rng(seed), np.tile(np.repeat(np.eye(3), 2, axis=0), (runs, 1))
    f[1::2] *= -1.0
    run, k = np.repeat(np.arange(1, runs + 1), 6), np.arange(6 * runs)
    temperature = 20.0 * ((run - 1) // 2) - 20.0
    bias = [100.0, -50.0, 30.0] + np.outer(temperature, [0.5, 0.2, -0.3]) + rng.normal(0.0, 1.0, (runs, 3))[run - 1]
    rates = bias + f @ rng.normal(0.0, 30.0, (3, 3)) + rng.normal(0.0, 1.0, f.shape)
    labels = np.array(["X+", "X-", "Y+", "Y-", "Z+", "Z-"] * runs)
    columns = {"temperature_degC": temperature + 5.0, "setpoint_degC": temperature}
    at = Conditions(TRIAD, k + 1, run, labels, 600.0 * k, np.full(len(k), 60.0), f, np.zeros(f.shape), columns)
    return Campaign("triad", "", {1: Collects(at, rates, np.ones(f.shape))})


@pytest.mark.parametrize("pair", [(6, 8), (7, 9), (30, 35)])
def test_labels_exchanged_in_a_run_that_has_no_neighbours_show_in_its_residuals(pair: tuple[int, int]) -> None:
    """Of two pairs that explain them alike, that which agrees with the other runs; no sound run is accused for it."""
    one = triads(51)
    rates = one.sensors[1].rates_deg_per_hr.copy()
    rates[list(pair)] = rates[list(pair[::-1])]
    (row,) = wrong_rows(with_rates(one, rates, 1))[1].rows
    assert (row.collects, row.done) == ((pair[0] + 1, pair[1] + 1), MENDED)
    solved = solve_campaign(with_rates(one, rates, 1))
    assert {s.runs[0] for s in solved if s.verdict is Verdict.FAIL} == {row.run}


def test_labels_exchanged_in_two_runs_each_at_another_place_are_the_one_way_to_explain_them() -> None:
    """The same sort of mistake may be made twice; met from either run it is still one way."""
    one = triads(1).sensors[1]
    rates = one.rates_deg_per_hr.copy()
    rates[[8, 10, 27, 29]] = rates[[10, 8, 29, 27]]
    (way,) = next(explanations(replace(one, rates_deg_per_hr=rates))).ways
    assert sorted((cause.what, cause.rows) for cause in way) == [("exchanged", (8, 10)), ("exchanged", (27, 29))]


@pytest.mark.slow
def test_nothing_else_is_called_an_exchange() -> None:
    """Not a sound run, a wrong rate or collect, a drift; and a run that is all there is does not say which pair."""
    for seed in range(6):  # every row and channel that is spoiled
        one, rng = triads(seed), np.random.default_rng(seed)
        for spoil in (0.0, 300.0, -25.0):
            rates = one.sensors[1].rates_deg_per_hr.copy()
            rates[6 + seed % 6, seed % 3] += spoil
            rates[12:18] += spoil / 10.0 * np.arange(6)[:, None]
            rates[24 + seed % 6] += spoil * rng.normal(size=3)
            assert not any(row.done == MENDED for row in wrong_rows(with_rates(one, rates, 1))[1].rows), (seed, spoil)
        alone = one.sensors[1].rows(np.arange(6))
        rates = alone.rates_deg_per_hr[[2, 1, 0, 3, 4, 5]]
        named = wrong_rows(Campaign("t", "", {1: replace(alone, rates_deg_per_hr=rates)}))[1].rows
        assert {row.done for row in named} <= {USED}


@pytest.mark.slow
@pytest.mark.parametrize("pair", [(0, 1), (0, 2), (1, 2)])
def test_the_same_labels_exchanged_in_most_runs_of_a_temperature_accuse_not_the_sound_one(
    pair: tuple[int, int],
) -> None:
    """Each hides behind the other: one exchange in the third run makes all three agree, but with no other temperature.

    Two at once do both; which of three are wrong, and at which temperature, is no matter. Where it is not certain, all
    of them are used.
    """
    mended = 0
    for seed in range(6):
        made, rng = campaign(9, 3, seed=seed, scatter=1.0), np.random.default_rng(seed)
        rates = made.sensors[2].rates_deg_per_hr.copy()
        runs = (3 * rng.integers(3) + rng.choice([1, 2, 3], 2, replace=False)).tolist()
        for run in runs:
            own = [3 * run - 3 + place for place in pair]
            rates[own] = rates[own[::-1]]
        found = {row.run: row.done for row in wrong_rows(with_rates(made, rates))[2].rows if row.done != USED}
        assert found.keys() <= set(runs), seed
        mended += found == dict.fromkeys(runs, MENDED)
    assert mended >= 5


@pytest.mark.slow
def test_what_a_run_contradicts_within_itself_no_agreement_of_most_makes_right() -> None:
    """At one temperature, collects there and back: two of three runs have the same two labels exchanged."""
    for seed in range(6):
        made = repeated(3, 3, (0, 2, 1, 0, 1, 2, 0), seed)
        rates = made.sensors[2].rates_deg_per_hr.copy()
        for run in (0, 2):
            own = [7 * run + 1, 7 * run + 2]
            rates[own] = rates[own[::-1]]
        found = wrong_rows(with_rates(made, rates))[2].rows
        assert sorted((row.run, row.collects, row.done) for row in found) == [
            (1, (2, 3), MENDED),
            (3, (16, 17), MENDED),
        ]


@pytest.mark.parametrize(
    ("runs", "per_temperature", "run", "pair"),
    [(4, 2, 1, (0, 1)), (4, 2, 4, (0, 2)), (4, 1, 1, (0, 2)), (6, 2, 6, (1, 2))],
)
def test_labels_by_whose_exchange_all_runs_agree_are_exchanged(
    runs: int, per_temperature: int, run: int, pair: tuple[int, int]
) -> None:
    """Few runs, of which no three repeat each other: those at the other temperatures say whose labels are wrong."""
    made = campaign(runs, per_temperature, seed=1, scatter=2.0)
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rows = [3 * run - 3 + place for place in pair]
    rates[rows] = rates[rows[::-1]]
    wrong = with_rates(made, rates)
    assert [(row.run, row.collects, row.done) for row in wrong_rows(wrong)[2].rows] == [
        (run, (rows[0] + 1, rows[1] + 1), MENDED)
    ]
    np.testing.assert_array_equal(treated(wrong).sensors[2].rates_deg_per_hr, made.sensors[2].rates_deg_per_hr)
    verdicts = {each.run: each.verdict for each in solve_campaign(wrong)}
    assert verdicts == dict.fromkeys(verdicts, Verdict.PASS) | {run: Verdict.FAIL}


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(2), range(2, 20)])
def test_one_rate_far_off_among_few_runs_exchanges_nothing(seeds: range) -> None:
    """Nor does what changes with temperature more than it usually does."""
    for seed in seeds:
        for runs, per_temperature in ((3, 1), (4, 2), (8, 1)):
            made, rng = campaign(runs, per_temperature, seed=seed, scatter=2.0), np.random.default_rng(seed)
            rates = made.sensors[2].rates_deg_per_hr.copy()
            rates[rng.integers(len(rates)), rng.integers(2)] += 300.0
            assert not any(row.done == MENDED for row in wrong_rows(with_rates(made, rates))[2].rows)
            warmer = rng.normal(0.0, 8.0, runs)[(made.sensors[2].conditions.run - 1) // per_temperature]
            rates = made.sensors[2].rates_deg_per_hr + warmer[:, None] * made.sensors[2].conditions.f_g[:, :1]
            assert not any(row.done == MENDED for row in wrong_rows(with_rates(made, rates))[2].rows)


THERE_AND_BACK = (0, 1, 2, 5, 2, 1, 0)


@pytest.mark.parametrize("pair", [(1, 3), (3, 5), (0, 2), (4, 6)])
def test_in_a_run_that_is_all_there_is_an_exchange_is_told_from_a_wrong_collect(pair: tuple[int, int]) -> None:
    """Without one collect the rest may agree as well; that it is off by just what an exchange makes is no chance."""
    one = repeated(1, 1, THERE_AND_BACK, seed=3)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[list(pair)] = rates[list(pair[::-1])]
    (row,) = wrong_rows(with_rates(one, rates))[2].rows
    assert (row.collects, row.done) == ((pair[0] + 1, pair[1] + 1), MENDED)


def test_what_may_be_either_of_two_exchanges_is_neither() -> None:
    """Positions that were taken twice, or two runs: each way rates agree; both are said, and nothing is moved."""
    both, twice = repeated(1, 1, THERE_AND_BACK, seed=3), campaign(2, 2, seed=1)
    for one, pair, said in ((both, (0, 1), ("1–2", "6–7")), (twice, (3, 5), ("1, 3", "4, 6"))):
        rates = one.sensors[2].rates_deg_per_hr.copy()
        rates[list(pair)] = rates[list(pair[::-1])]
        found = wrong_rows(with_rates(one, rates))[2]
        assert {row.done for row in found.rows} == {USED}
        assert all(f"collects {numbers}, at positions" in row.why for row in found.rows for numbers in said)
        assert all(row.why.count("look exchanged") == len(said) for row in found.rows)
        np.testing.assert_array_equal(found.collects.rates_deg_per_hr, rates)
        assert {found.judged[run].verdict for run in one.sensors[2].conditions.run.tolist()} == {Verdict.INCONCLUSIVE}


def test_channels_exchanged_in_a_run_are_put_right() -> None:
    """RA stands in RB's place in all its collects."""
    one = campaign(12, 3, seed=1, scatter=2.0)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[12:15] = rates[12:15, ::-1]
    (row,) = wrong_rows(with_rates(one, rates))[2].rows
    assert (row.run, row.done) == (5, MENDED)
    assert "RA and RB look exchanged" in row.why
    np.testing.assert_array_equal(
        treated(with_rates(one, rates)).sensors[2].rates_deg_per_hr, one.sensors[2].rates_deg_per_hr
    )


@pytest.mark.slow
def test_two_channels_of_a_triad_exchanged_in_a_run_are_put_right_by_solve_and_search() -> None:
    """They were left out: of two channels it was asked whether they were exchanged, of three not."""
    one = triads(4)
    rates = one.sensors[1].rates_deg_per_hr.copy()
    rates[12:18] = rates[12:18, [0, 2, 1]]
    torn = with_rates(one, rates, 1)
    (row,) = wrong_rows(torn)[1].rows
    assert (row.run, row.done, row.channels) == (3, MENDED, ("GY", "GZ"))
    assert "GY and GZ look exchanged" in row.why
    np.testing.assert_array_equal(treated(torn).sensors[1].rates_deg_per_hr, one.sensors[1].rates_deg_per_hr)
    (found,) = reconcile(torn, "triad-12", prove=False).rows
    assert (found["run"], found["done"], found["channels"]) == (3, MENDED, ["GY", "GZ"])
    assert "GY and GZ look exchanged" in found["why"]


@pytest.mark.parametrize("runs", [2, 3, 12])
def test_errors_that_are_too_small_by_as_much_in_every_run_accuse_none(runs: int) -> None:
    """Two runs of seven collects say it of each other and of themselves; chi-square is another matter."""
    for seed in range(10):
        one = repeated(runs, runs, THERE_AND_BACK, seed=seed)
        small = replace(one, sensors={2: replace(one.sensors[2], rates_se_deg_per_hr=np.full((7 * runs, 2), 0.1))})
        assert wrong_rows(small)[2].rows == ()


@pytest.mark.slow
def test_a_channel_that_is_noisier_than_the_others_exchanges_nothing() -> None:
    """By how much is its own: for all channels alike, so large noise in one is nothing but a mistake in the others."""
    found = []
    for seed in range(12):
        one = triads(seed)
        noise = np.random.default_rng(900 + seed).normal(0.0, 3.0, (48, 1)) * [[1.0, 0.0, 0.0]]
        found += wrong_rows(with_rates(one, one.sensors[1].rates_deg_per_hr + noise, 1))[1].rows
    assert [each for each in found if each.done != USED] == []


def test_one_rate_off_in_one_of_three_runs_makes_no_errors_too_small() -> None:
    """Twenty standard errors off, with two that agree beside it: that run is no PASS, and its two rates are named."""
    one = campaign(3, 3, seed=4, scatter=1.0)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[4, 0] += 14.0
    solved = solve_campaign(with_rates(one, rates))
    assert [each.verdict is Verdict.PASS for each in solved] == [True, False, True]
    assert "collect 5: RA is +" in solved[1].reason
    assert "too small" not in " ".join(repeats(with_rates(one, rates), solved)[2].sentences())


def test_rates_that_nothing_explains_are_no_measurement() -> None:
    """Hundreds of their standard errors from anything: whatever they are, no run of them is a PASS."""
    one = campaign(3, 3)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[:, 0] = np.random.default_rng(0).uniform(-500.0, 500.0, len(rates))
    assert {each.verdict for each in solve_campaign(with_rates(one, rates))} == {Verdict.INCONCLUSIVE}


def of_two_sensors(seed: int, exchanged: tuple[int, ...], felt: float = 1.0) -> tuple[Campaign, int, tuple[int, int]]:
    """Two temperatures, three runs of three collects at each; of a run two collects exchanged in those sensors.

    Of what the second sensor feels of a pose the first feels a share.
    """
    rng = np.random.default_rng(seed)
    f = np.tile([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], (6, 1))
    run, bad, sensors = np.repeat(np.arange(6), 3), int(rng.integers(6)), {}
    first, second = sorted(rng.choice(3, 2, replace=False).tolist())
    k = {1: [[8.0, -3.2, 3.0], [3.2, 8.0, 4.0]], 2: [[-6.4, 2.4, -2.0], [-2.4, -6.4, 5.0]]}
    for number, own in k.items():
        sensor = Sensor(number, ("A", "B", "S"), {"RA": "A", "RB": "B"})
        columns = {"temperature_degC": np.where(run < 3, -20.0, 60.0)}
        conditions = Conditions(
            sensor, np.arange(1, 19), run + 1, np.tile([*"123"], 6), 90.0 * np.arange(18), np.full(18, 60.0), f,
            np.zeros((18, 3)), columns,
        )  # fmt: skip
        bias, mu = rng.normal(size=(2, 6, 2))
        rates = (
            (felt if number == 1 else 1.0) * f @ np.array(own).T
            + bias[run]
            + mu[run] * f[:, 2:]
            + 0.7 * rng.normal(size=(18, 2))
        )
        if number in exchanged:
            rates[[3 * bad + first, 3 * bad + second]] = rates[[3 * bad + second, 3 * bad + first]]
        sensors[number] = Collects(conditions, rates, np.full((18, 2), 0.7))
    collects = (3 * bad + first + 1, 3 * bad + second + 1)
    return Campaign("two sensors", "test", sensors, simulated=True), bad + 1, collects


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_labels_are_a_collects_which_two_sensors_have_in_common(seed: int) -> None:
    """What one sensor alone could not tell both tell together, and the same; a sound one is left alone."""
    campaign, run, collects = of_two_sensors(seed, (1, 2))
    for found in wrong_rows(campaign).values():
        assert [(each.run, each.collects, each.done) for each in found.rows] == [(run, collects, MENDED)]
    in_one, *_ = of_two_sensors(seed, (1,))
    assert wrong_rows(in_one)[2].rows == ()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_one_sensor_is_certain_of_is_put_right_in_one_that_hardly_feels_it(seed: int) -> None:
    """Whoever has the labels of one corrected by what is said of it is told of the other's in the same sentence."""
    campaign, run, collects = of_two_sensors(seed, (1, 2), 0.1)
    for number, found in wrong_rows(campaign).items():
        (wrong,) = found.rows
        assert (wrong.run, wrong.collects, wrong.done) == (run, collects, MENDED)
        assert wrong.why.endswith(
            f"; the same of {numbered('collect', collects)} of sensor {3 - number}, recorded with them"
        )


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_accelerometers_that_one_sensor_contradicts_exchange_nothing_in_another(seed: int) -> None:
    """How the unit lay is the body's: labels of a sensor that hardly feels it are not turned where the other's stay."""
    campaign, _, collects = of_two_sensors(seed, (), 0.1)
    for found in wrong_rows(replace(campaign, exchanged={1: [collects], 2: [collects]})).values():
        assert found.rows == ()


def test_the_other_sensor_can_say_no_more_than_that_labels_are_mostly_exchanged_for_both() -> None:
    """However sure it is of its own; and where its labels are right those here hardly are not."""
    prior = float(np.log(1e-3))
    mostly, seldom = np.log(COMMON / (1.0 - COMMON)), np.log(1.0 - COMMON)
    assert prior + _in_common(prior, 500.0) == pytest.approx(mostly)
    assert _in_common(prior, -500.0) == pytest.approx(seldom)
    assert _in_common(prior, None) == 0.0
    assert seldom < _in_common(prior, -1.0) < 0.1 < _in_common(prior, 1.0) < mostly - prior


def test_a_collect_that_was_made_at_another_position_is_said_to_show_that_one() -> None:
    """The unit was not turned: three channels that are off are none, and of what no position shows none is named."""
    sound = repeated(12, 3, (0, 1, 2, 0, 1, 2))
    rates = sound.sensors[2].rates_deg_per_hr
    for shown, words in (
        (rates[9], "; it shows what position 1 does: the unit may have lain there"),
        (rates[8] + 40.0, ""),
    ):
        moved = rates.copy()
        moved[8] = shown  # the third collect of run 2, as its fourth, which repeats the first
        (wrong,) = wrong_rows(with_rates(sound, moved))[2].rows
        assert (wrong.run, wrong.collects, wrong.done) == (2, (9,), LEFT_OUT)
        assert wrong.why.partition(" from what all others show")[2] == words
    assert as_at(sound.sensors[2].rows(np.arange(7)), Cause("collect", 2, (6,))) == "", "its run has no other collect"
