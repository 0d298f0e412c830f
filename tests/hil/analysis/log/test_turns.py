"""Turns between poses calibrate the gyros: by how much, about which axes, and what gravity does not see."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.analysis.log.poses import campaign_of_log
from hil.analysis.log.reading import read_log
from hil.analysis.log.static import StaticTest, static_stretches
from hil.analysis.log.turns import Turns, fit_turns
from hil.files.columns import Columns
from tests.hil.analysis.log.simulated import BIAS_DEG_PER_HR, TURNING, Simulated, simulate


def turns_of(one: Simulated) -> Turns | None:
    """Fit to the turns of a log whose poses are known."""
    log = read_log(Columns(Path("log"), one.columns()))
    stretches, _ = static_stretches(log, StaticTest())
    rest = np.array([log.rates_deg_per_hr[each.rows].mean(axis=0) for each in stretches])
    return fit_turns(log, stretches, one.f_g, rest)


def test_scale_factors_and_misalignment_come_back_from_the_turns() -> None:
    """Not transposed, and to a thousandth of what they are; what is left is the noise of the integral."""
    found = turns_of(simulate(18))
    assert found is not None
    assert np.all(np.abs(found.values - TURNING.ravel()) < 4.0 * found.sd)
    assert found.sd.max() < 2e-4
    assert found.missed_deg < 0.05
    assert found.turns == tuple(range(1, 18))


@pytest.mark.slow
def test_stated_intervals_of_the_gyros_hold_over_many_logs() -> None:
    """95 % intervals hold nine values in 93 to 97 % of 20 logs; a sixth narrower they hold 90 %, as much wider 98 %."""
    inside = []
    for seed in range(20):
        found = turns_of(simulate(18, seed=seed))
        assert found is not None
        inside.append(np.abs(found.values - TURNING.ravel()) <= found.half)
    assert 0.93 <= np.mean(inside) <= 0.97


def test_a_turn_about_the_vertical_tells_no_scale_factor() -> None:
    """Gravity does not see it; whether it leaks into the other two channels, gravity does see."""
    hz, rest, carry, times = 100.0, 300, 150, 9
    speed = np.concatenate([np.zeros(rest), 3600.0 * 60.0 * np.sin(np.pi * np.arange(carry) / carry)])
    z = np.concatenate([np.tile(speed, times), np.zeros(rest)])
    rng = np.random.default_rng(2)
    n = len(z)
    rates = BIAS_DEG_PER_HR + np.outer(z, [0.01, -0.02, 1.0]) + 20.0 * rng.normal(size=(n, 3))
    acc = [0.0, 0.0, 1.0] + 0.002 * rng.normal(size=(n, 3))
    found = turns_of(
        Simulated(np.tile([0.0, 0.0, 1.0], (times + 1, 1)), np.arange(n) / hz, rates, acc, [], np.array([]))
    )
    assert found is not None
    parameters = found.document()["parameters"]
    assert {name for name, of in parameters.items() if of["told"]} == {"D_XZ", "D_YZ"}
    assert parameters["D_XZ"]["value"] == pytest.approx(-0.01, abs=0.002)
    assert parameters["D_YZ"]["value"] == pytest.approx(0.02, abs=0.002)
    assert "invisible to gravity" in found.sentences[0]


@pytest.mark.slow
def test_rates_that_are_not_those_of_the_turns_are_told() -> None:
    """rad/s taken for deg/s, deg/s for rad/s, or a channel whose sign is turned: no parameters, and what may be wrong.

    Rates that are too large wind a unit round so often that some D brings it to any end.
    """
    for gain in ([1 / 57.3] * 3, [57.3] * 3, [1.0, -1.0, 1.0]):
        one = simulate(7)
        one.rates *= gain
        found = turns_of(one)
        assert found is not None
        assert found.astray
        assert found.document()["parameters"] == {}
        assert "the unit, a sign or the order of the gyros' columns is wrong" in found.sentences[0]


def test_too_few_turns_and_gaps_between_poses_tell_nothing() -> None:
    """Four turns are eight equations for nine unknowns; what happened in a gap nobody knows."""
    assert turns_of(simulate(5)) is None
    one = simulate(7)
    for start in one.starts[1:]:
        one.t_s[start - 75 :] += 1.0
    assert turns_of(one) is None
    made = campaign_of_log(read_log(Columns(Path("log"), one.columns())), StaticTest())
    assert made.document["accelerometer"]["gyros"] is None
    assert "gyros: too few turns" in made.campaign.notes
