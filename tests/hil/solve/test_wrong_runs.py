"""What is wrong with runs as a whole: another bias, nothing that holds, several at once, the other sensor's rates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, Collects
from hil.campaign.plausibility import judged_by_its_records
from hil.solve import repeats, solve_campaign
from hil.solve.wrong_rows import LEFT_OUT, MENDED, USED, wrong_rows
from procedures.verdict import Judgement, Verdict
from tests.hil.reconcile.hidden_effects import base_rates, campaign_of, lay_out, noise
from tests.hil.solve.runs_of_a_unit import campaign, repeated, with_rates
from tests.hil.solve.test_wrong_rows import made


def test_a_run_with_another_bias_is_used_and_named() -> None:
    """All three collects of run 5 off by the same: its bias is in no mean, nor in others' ±; all else is."""
    good = made("good")
    rows = good.sensors[2]
    rates = rows.rates_deg_per_hr + 60.0 * np.outer(rows.conditions.run == 5, (1.0, 0.0))
    moved = with_rates(good, rates)
    found = wrong_rows(moved)[2]
    assert ([(row.run, row.done) for row in found.rows], found.apart) == ([(5, USED)], set())
    shown, sound = (repeats(of, solve_campaign(of))[2] for of in (moved, good))
    values, usual = (of.means[1].values for of in (shown, sound))
    assert (values["BA"].runs, values["GSA"].runs) == (usual["BA"].runs - 1, usual["GSA"].runs)
    assert values["BA"].sd < 2.0 * usual["BA"].sd


def test_a_run_of_which_nothing_holds_is_in_no_mean_and_widens_no_other() -> None:
    """RA of run 5 in another unit: the other runs' means and ± are those that they have without it."""
    one = campaign(12, 3, seed=4, scatter=1.0)
    run, rates = one.sensors[2].conditions.run, one.sensors[2].rates_deg_per_hr.copy()
    rates[run == 5, 0] /= 60.0
    wrong = with_rates(one, rates)
    found = wrong_rows(wrong)[2]
    assert ([(row.run, row.done) for row in found.rows], found.apart) == ([(5, LEFT_OUT)], {5})
    without = replace(one, sensors={2: one.sensors[2].rows(run != 5)})
    shown, alone = (repeats(each, solve_campaign(each))[2] for each in (wrong, without))
    assert shown.not_used == (5,)
    assert not any(5 in mean.runs for mean in shown.means)
    np.testing.assert_allclose(shown.spread.beyond, alone.spread.beyond, rtol=1e-6)
    solved = {each.run: each for each in solve_campaign(wrong)}
    assert solved[5].verdict is Verdict.INCONCLUSIVE
    assert "in no mean" in solved[5].reason
    assert {each.verdict for run, each in solved.items() if run != 5} == {Verdict.PASS}
    known = replace(wrong, verdicts={5: Judgement(Verdict.FAIL, "frames were lost")})  # of which that is said already
    assert (wrong_rows(known)[2].rows, wrong_rows(known)[2].apart) == ((), {5})
    assert {each.run: each.reason for each in solve_campaign(known)}[5].startswith("frames were lost")
    assert "in no mean" not in {each.run: each.reason for each in solve_campaign(known)}[5]


def test_a_channel_that_stands_at_one_number_in_many_runs_measured_nothing() -> None:
    """A round one, that every run of the second half shows: the other channel turns with the unit, and is used."""
    one = repeated(8, 4, (0, 1, 2, 3, 4))
    rates, late = one.sensors[2].rates_deg_per_hr.round(4), one.sensors[2].conditions.run > 4
    rates[late, 0] = -7.25
    judged = judged_by_its_records(with_rates(one, rates))
    assert judged.warnings == ("collects 21–40: sensor 2: RA: every rate is exactly -7.25: nothing was measured",)
    assert sorted(judged.contradicted) == [(run, 2) for run in range(5, 9)]
    for each in (of for of in solve_campaign(judged) if of.run is not None and of.run > 4):
        assert each.verdict is Verdict.FAIL
        assert "more than one does not agree" not in each.reason
        assert [name for name, of in each.parameters.items() if of.value is not None] == ["BB", "GSB", "MUA"]
    rates[3, 0] = -7.25  # as a limit is shown beside other numbers
    assert not any("exactly" in each for each in judged_by_its_records(with_rates(one, rates)).warnings)


@pytest.mark.parametrize(("seed", "of_a", "of_b"), [(2, 30.0, -40.0), (7, 30.0, -40.0), (6, 25.0, 25.0)])
def test_two_things_that_are_both_true_are_both_told(seed: int, of_a: float, of_b: float) -> None:
    """Another bias of A in run 2 and of B in run 9: each alone explains much, and neither makes the other needless."""
    one = campaign(12, 3, seed=seed, scatter=1.0)
    run, off = one.sensors[2].conditions.run, one.sensors[2].rates_deg_per_hr.copy()
    off[run == 2, 0] += of_a
    off[run == 9, 1] += of_b
    found = wrong_rows(with_rates(one, off))[2]
    assert sorted((row.run, row.channels, row.done) for row in found.rows) == [
        (2, ("RA",), USED),
        (9, ("RB",), USED),
    ]
    assert not any("cannot tell which" in row.why or "; or " in row.why for row in found.rows)


def test_of_many_runs_of_which_nothing_holds_few_are_set_apart() -> None:
    """Where more than a fifth are wrong nobody knows which are: the rest are named together, and used."""
    one = campaign(12, 3, seed=4, scatter=1.0)
    run, rates = one.sensors[2].conditions.run, one.sensors[2].rates_deg_per_hr.copy()
    rng = np.random.default_rng(1)
    rates[np.isin(run, (2, 4, 6, 8, 11))] *= rng.uniform(-2.0, 2.0, (15, 2))
    found = wrong_rows(with_rates(one, rates))[2]
    assert len(found.apart) <= 3
    assert any(row.done == USED for row in found.rows)


@pytest.mark.slow
def test_rates_of_the_other_sensor_are_put_right_in_both() -> None:
    """The sensors' leads exchanged in run 5: the values of both are theirs again, and neither run passes."""
    sound = two_units()
    one, two = (sound.sensors[n].rates_deg_per_hr.copy() for n in (1, 2))
    here = sound.sensors[1].conditions.run == 5
    one[here], two[here] = two[here], one[here]
    mixed = with_rates(with_rates(sound, one, 1), two, 2)
    for number, found in wrong_rows(mixed).items():
        np.testing.assert_array_equal(found.collects.rates_deg_per_hr, sound.sensors[number].rates_deg_per_hr)
        (row,) = found.rows
        assert (row.run, row.done) == (5, MENDED)
        assert "other sensor's" in row.why
    assert {s.verdict for s in solve_campaign(mixed) if s.run == 5} == {Verdict.FAIL}
    assert all(found.rows == () for found in wrong_rows(sound).values())
    rows = mixed.sensors[1]
    lay = np.where(here, np.roll(rows.conditions.position, 1), rows.conditions.position)
    otherwise_laid = replace(rows, conditions=replace(rows.conditions, position=lay))
    for found in wrong_rows(replace(mixed, sensors={**mixed.sensors, 1: otherwise_laid})).values():
        assert not any("other sensor's" in row.why for row in found.rows)


def test_a_run_that_is_only_noisy_has_its_own_rates_whatever_hides_in_the_quiet_sensors_noise() -> None:
    """Another run of the other, which FAILs by its records, made its noise large enough to take these rates for its.

    The other's rates of run 5, quiet and nearly the same, agree better with all; these are none that it may have.
    """
    one = noisy_beside_quiet()
    turned = one.sensors[1].rates_deg_per_hr * np.where(one.sensors[1].conditions.run == 9, -3.0, 1.0)[:, None]
    mixed = replace(with_rates(one, turned, 1), contradicted={(9, 1): Judgement(Verdict.FAIL, "its sign is turned")})
    assert not any("other sensor's" in row.why for row in wrong_rows(mixed)[2].rows)


def noisy_beside_quiet() -> Campaign:
    """Two sensors with the same values, of which the second is noisier, and most of all, as it says, in run 5."""
    one, rng = campaign(12, 3, seed=4, scatter=1.0), np.random.default_rng(7)
    rows, sensors = one.sensors[2], {}
    for number, usual in ((1, 0.2), (2, 5.0)):
        errors = np.broadcast_to(np.where(rows.conditions.run == 5, 8.0, 1.0)[:, None] * usual, (len(rows), 2))
        rates = rows.rates_deg_per_hr + errors * rng.normal(size=errors.shape)
        sensor = replace(rows.conditions.sensor, number=number)
        sensors[number] = Collects(replace(rows.conditions, sensor=sensor), rates, errors.copy())
    return replace(one, sensors=sensors)


def two_units() -> Campaign:
    """Two sensors of one unit that are like each other, but not the same."""
    one = campaign(12, 3, seed=4, scatter=1.0)
    rows = one.sensors[2]
    rng = np.random.default_rng(6)
    other = 0.8 * rows.rates_deg_per_hr + 4.0 + rng.normal(0.0, 0.5, rows.rates_deg_per_hr.shape)
    sensor = replace(rows.conditions.sensor, number=1)
    first = Collects(replace(rows.conditions, sensor=sensor), other, rows.rates_se_deg_per_hr)
    return replace(one, sensors={1: first, 2: rows})


def _with_mu_restless_at(degC: float, seed: int) -> Campaign:
    """Return a night of four temperatures at one of which MU differs from run to run by ten times as much."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, (-30.0, 0.0, 30.0, 60.0), 3, ("1", "2", "3"))
    size = np.where(np.arange(-1, rows.run.max()) // 3 == (-30.0, 0.0, 30.0, 60.0).index(degC), 10.0, 1.0)
    mu = (rng.normal(size=(2, len(size))) * size)[:, rows.run]
    rates = base_rates(rows) + noise(rows, rng, sigma=0.5, run_bias=1.0)
    return campaign_of(rows, rates + np.stack([mu[1], -mu[0]], 1) * rows.f[:, 2:], stated=0.5)


@pytest.mark.parametrize("seed", [4, 7])
def test_an_mu_that_differs_more_at_one_temperature_accuses_no_rate(seed: int) -> None:
    """What repeats there are apart by is usual there, however much less those of other temperatures are."""
    found = wrong_rows(_with_mu_restless_at(-30.0, seed))[2].rows
    assert [row for row in found if row.done == LEFT_OUT] == []
