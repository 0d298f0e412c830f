"""Two sensors in one unit: a common cause is found whatever parameters it enters through, and chance is not named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, Collects, Conditions, Sensor
from hil.model.earth import Site
from hil.model.equation import Orientation, pickoff_rates, rotor_matrix
from hil.solve import solve_campaign
from hil.solve.both_sensors import BothSensors, _of_exchanged, _of_normal, common_and_differential

SITE = Site(34.6, 30.0)
SIGNED = {
    1: {"1": ("+2", "+3", "+1"), "2": ("+2", "-3", "-1"), "3": ("+2", "+1", "-3")},  # A where the other has B
    2: {"1": ("-1", "+2", "+3"), "2": ("+1", "+2", "-3"), "3": ("+3", "+2", "+1")},
}
ORIENTATIONS = {
    number: {label: Orientation.from_signed_axes(label, *axes) for label, axes in table.items()}
    for number, table in SIGNED.items()
}
TRUTH = {
    1: np.array([-18.0, 24.0, -54.0, 31.0, 14.0, 21.0]),
    2: np.array([22.0, -38.0, 47.0, -20.0, -37.0, -7.5]),
}


def night(
    seed: int,
    rate_of_base: float = 0.0,
    common_bias: float = 0.0,
    runs: int = 24,
    sigma: float = 0.9,
    own_bias: float = 0.0,
) -> Campaign:
    """A unit with two sensors, three runs at each temperature.

    In each run the base turns about axis 2 by `rate_of_base` x N(0, 1) deg/hr, and BA of both sensors moves by
    the same `common_bias` x N(0, 1), and every bias by an `own_bias` x N(0, 1) of its own.
    """
    rng = np.random.default_rng(seed)
    labels = list("123") * runs
    run = np.repeat(np.arange(1, runs + 1), 3)
    earth = SITE.earth_rate_deg_per_hr()
    turning = rate_of_base * rng.standard_normal(runs + 1)[run]
    shift = common_bias * rng.standard_normal(runs + 1)[run]
    sensors = {}
    for number, table in ORIENTATIONS.items():
        f_g = np.array([table[label].components(SITE.gravity_g()) for label in labels])
        w = np.array([table[label].components(earth) for label in labels])
        base = turning[:, None] * np.array([table[label].components([0.0, 1.0, 0.0]) for label in labels])
        truth = TRUTH[number]
        rates = pickoff_rates(truth[:2], rotor_matrix(*truth[2:]), f_g, (w + base)[:, :2])
        rates[:, 0] += shift
        rates += sigma * rng.standard_normal(rates.shape)
        rates += own_bias * rng.standard_normal((runs + 1, 2))[run]
        rows = Conditions(
            Sensor(number, ("A", "B", "S"), {"RA": "A", "RB": "B"}),
            collect=np.arange(1, len(run) + 1),
            run=run,
            position=np.array(labels),
            start_s=np.arange(len(run)) * 120.0,
            duration_s=np.full(len(run), 60.0),
            f_g=f_g,
            w_deg_per_hr=w,
            columns={"temperature_degC": 10.0 * ((run - 1) // 3)},
        )
        sensors[number] = Collects(rows, rates, np.full(rates.shape, sigma))
    return Campaign("both", "test", sensors)


def both_of(campaign: Campaign) -> BothSensors:
    """What the two sensors have in common."""
    found = common_and_differential(campaign)
    assert found is not None
    return found


def test_common_and_differential_are_half_the_sum_and_the_difference() -> None:
    """Of the true parameters, where nothing scatters; their errors are those of independent noise."""
    found = both_of(night(1, sigma=1e-6))
    assert [each.runs for each in found.common.means][:2] == [(1, 2, 3), (4, 5, 6)]
    for i, name in enumerate(("BA", "BB", "GSA", "GSB", "MUA", "MUB")):
        assert found.common.means[0].values[name].value == pytest.approx((TRUTH[1][i] + TRUTH[2][i]) / 2, abs=1e-4)
        assert found.differential.means[0].values[name].value == pytest.approx(TRUTH[2][i] - TRUTH[1][i], abs=1e-4)
    noisy = both_of(night(1))
    differential, common = (of.means[0].values["BA"].sd for of in (noisy.differential, noisy.common))
    assert differential == pytest.approx(0.9 * np.sqrt((0.5 + 0.5) / 3), rel=0.3)
    assert common == pytest.approx(0.5 * differential, rel=0.3)


def test_the_same_bias_in_both_is_common() -> None:
    """A common BA is found by its name, its correlation covers 1, and the common part scatters more than the other."""
    found = both_of(night(2, common_bias=6.0))
    assert (found.shared[0].first, found.shared[0].second) == ("BA", "BA")
    assert f"p = {found.asked * found.shared[0].p:.1g} of {found.asked} pair" in found.sentences()[0]
    low = found.correlations["BA"][1]
    assert low is not None
    assert low > 0.8
    assert "common cause" in found.sentences()[0]
    assert found.common.spread.observed[0] > 3.0 * found.differential.spread.observed[0]


def test_a_turning_base_is_common_although_it_enters_through_different_parameters() -> None:
    """Axis 2 is the A axis of sensor 1 and the B axis of sensor 2: BA of the one goes with BB of the other."""
    found = both_of(night(3, rate_of_base=8.0))
    assert {(pair.first, pair.second) for pair in found.shared} == {("BA", "BB")}


@pytest.mark.slow
def test_a_run_that_is_noisy_in_both_makes_nothing_common() -> None:
    """Of values as they are it was all of a correlation: 0.9 in some pair of nearly every night."""
    for seed in range(3):
        one = night(seed, runs=12)
        noisy = {n: np.where(rows.conditions.run == 5, 20.0, 1.0)[:, None] for n, rows in one.sensors.items()}
        truth = {n: rows.rates_deg_per_hr for n, rows in night(seed, runs=12, sigma=0.0).sensors.items()}
        sensors = {
            n: replace(
                rows,
                rates_deg_per_hr=truth[n] + noisy[n] * (rows.rates_deg_per_hr - truth[n]),
                rates_se_deg_per_hr=noisy[n] * rows.rates_se_deg_per_hr,
            )
            for n, rows in one.sensors.items()
        }
        assert both_of(replace(one, sensors=sensors)).shared == ()


def noisy_somewhere(one: Campaign, seed: int) -> Campaign:
    """The same night, but at its first temperature every rate is off by up to 15 deg/hr, in either sensor its own."""
    rng, sensors = np.random.default_rng(seed), {}
    for number, rows in one.sensors.items():
        here = (rows.conditions.columns["temperature_degC"] == 0.0)[:, None]
        off = np.where(here, rng.uniform(-15.0, 15.0, rows.rates_deg_per_hr.shape), 0.0)
        sensors[number] = replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + off)
    return replace(one, sensors=sensors)


@pytest.mark.slow
def test_a_temperature_that_is_noisy_in_both_makes_nothing_common() -> None:
    """Three runs were all of a correlation of sixteen degrees of freedom; what is common shows there, too."""
    found = [both_of(noisy_somewhere(night(seed, own_bias=3.0), seed)) for seed in range(6)]
    assert sum(bool(each.shared) for each in found) <= 1
    found = [both_of(noisy_somewhere(night(seed, common_bias=9.0), seed)) for seed in range(3)]
    assert all(("BA", "BA") in {(pair.first, pair.second) for pair in each.shared} for each in found)


@pytest.mark.slow
def test_sensors_with_nothing_in_common_are_seldom_said_to_have() -> None:
    """In 20 nights of biases that scatter independently some pair of those is named in about one night of twenty."""
    found = [both_of(night(seed, runs=12, own_bias=6.0)) for seed in range(20)]
    assert all(each.asked >= 4 for each in found)
    assert sum(bool(each.shared) for each in found) <= 4


def test_of_what_noise_explains_nothing_is_looked_for_in_common() -> None:
    """BA of the one moves as BA of the other does by noise alone, as chance may have it: that has no cause."""
    one = night(2)
    by_noise = np.array([each.parameters["BA"].value for each in solve_campaign(one, sensor=2)]) - TRUTH[2][0]
    rows = one.sensors[1]
    moved = rows.rates_deg_per_hr + np.outer(8.0 * by_noise[rows.conditions.run - 1], [1.0, 0.0])
    found = both_of(replace(one, sensors={**one.sensors, 1: replace(rows, rates_deg_per_hr=moved)}))
    assert (found.correlations["BA"][1] or 0.0) > 0.8
    assert found.shared == ()


def test_one_sensor_or_no_repeats_are_no_comparison() -> None:
    """A single sensor gives None; a single run gives values and no correlation."""
    campaign = night(4, runs=1)
    assert common_and_differential(replace(campaign, sensors={2: campaign.sensors[2]})) is None
    found = both_of(campaign)
    assert found.degrees_of_freedom == 0
    assert found.correlations["BA"][1] is None
    assert "too few repeats" in found.sentences()[0]


def test_pairs_of_runs_are_exchanged_in_few_ways() -> None:
    """Of three temperatures with two runs each eight ways tell nothing rare, however alike the two sensors are."""
    apart = np.repeat([1.0, -2.0, 0.5], 2) * np.tile([1.0, -1.0], 3)
    away = np.tile(apart[:, None], (2, 1, 6))
    assert _of_normal(np.full((6, 6), 0.999), 3).max() < 0.05
    assert np.allclose(_of_exchanged(away, np.repeat([0, 1, 2], 2)), 0.25, atol=0.02)


def test_what_chance_does_in_one_of_fifty_nights_is_no_common_cause() -> None:
    """Each bias moves by itself, BB of the one and BA of the other alike by chance: .004 of one of four pairs."""
    both = both_of(night(4, own_bias=4.0))
    assert (both.asked, both.shared) == (4, ())
    assert "nothing certainly moves together" in both.sentences()[0]
