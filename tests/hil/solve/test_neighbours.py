"""Temperatures tell of each other: of runs that differ at one, those are right that lie between what others show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.solve import solve_campaign
from hil.solve.wrong_rows import USED, wrong_rows
from procedures.verdict import Verdict
from tests.hil.reconcile.hidden_effects import campaign_of, lay_out

AT = (-30.0, -14.0, -6.0, 6.0, 24.0, 38.0, 49.0, 60.0)


def night(seed: int, each: int, bias: dict[int, float], *, bend: float = 2.0) -> Campaign:
    """Settled runs of collects 1-2-3 whose values bend over temperature, with so much more bias of RA in some runs."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, AT, each, ("1", "2", "3"))
    rows.temperature = rows.setpoint + rng.normal(0.0, 0.05, len(rows))
    t, (fa, fb, fs) = (rows.setpoint - 20.0) / 40.0, rows.f.T
    gs, mu = 60.0 + 9.0 * t, 4.0 + 5.0 * t - bend * t**2
    own = 20.0 - 6.0 * t + bend * t**2 + np.array([bias.get(run, 0.0) for run in rows.run.tolist()])
    rates = np.stack([own + gs * fa - 25.0 * fb + mu * fs, -5.0 + 8.0 * t + 25.0 * fa + gs * fb - mu * fs], 1)
    rates += rows.w[:, :2] + rng.normal(0.0, 0.5, rates.shape)
    return campaign_of(rows, rates + rng.normal(0.0, 0.8, (rows.run.max() + 1, 2))[rows.run], stated=0.5)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("each", "wrong"), [(3, (10, 11)), (3, (23, 24)), (2, (8,)), (2, (1,))])
def test_of_runs_that_differ_those_are_wrong_that_other_temperatures_contradict(
    each: int, wrong: tuple[int, ...], seed: int
) -> None:
    """Two of three alike, and one of two: by themselves they accuse the third, or cannot tell which it is."""
    one = night(seed, each, dict.fromkeys(wrong, 60.0))
    found = wrong_rows(one)[2]
    assert {(row.run, row.done) for row in found.rows} == {(run, USED) for run in wrong}
    assert found.another == {"BA": frozenset(wrong)}
    doubted = {run: of.reason for of in solve_campaign(one) if of.verdict is Verdict.MARGINAL for run in of.runs}
    assert {*wrong} <= doubted.keys()
    if len(wrong) > 1:  # of one alone nobody knows whether all after it are as it was
        assert {*wrong} == doubted.keys()
        assert not any("jump" in why for why in doubted.values())


@pytest.mark.parametrize("bend", [2.0, 20.0])
@pytest.mark.parametrize("each", [2, 3])
def test_a_temperature_at_which_all_runs_are_others_accuses_none(each: int, bend: float) -> None:
    """It is the unit's value there; and what bends everywhere bends more than most at some temperature."""
    alike = {each * 3 + k: 60.0 for k in range(1, each + 1)}
    assert [wrong_rows(night(seed, each, alike, bend=bend))[2].rows for seed in range(3)] == [()] * 3


def test_a_run_alone_at_its_temperature_is_told_by_its_neighbours_as_far_as_these_are_near() -> None:
    """Farther off than any other it may be the unit that bends there: nobody can tell, which is said."""
    for off, told in ((60.0, {12: ("BA",)}), (0.0, {})):
        one = night(4, 3, {12: off})
        rows = one.sensors[2].rows(~np.isin(one.sensors[2].conditions.run, (10, 11)))
        found = wrong_rows(replace(one, sensors={2: rows}))[2]
        assert (found.rows, found.not_compared) == ((), told)


def test_of_runs_that_all_contradict_each_other_the_one_that_is_left_is_no_pass() -> None:
    """One temperature at which rates are noisy: two runs were left out, and the third was as good as any."""
    one, rng = night(1, 3, {}), np.random.default_rng(2)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    here = np.isin(one.sensors[2].conditions.run, (13, 14, 15))
    rates[here] += rng.normal(0.0, 25.0, (here.sum(), 2))
    noisy = replace(one, sensors={2: replace(one.sensors[2], rates_deg_per_hr=rates)})
    assert {run: of.verdict is Verdict.PASS for of in solve_campaign(noisy) for run in of.runs} == {
        run: run not in (13, 14, 15) for run in range(1, 25)
    }


@pytest.mark.parametrize("seed", [1, 4, 19])
def test_a_jump_between_two_runs_of_a_temperature_accuses_neither(seed: int) -> None:
    """All before it are as the one, all after it as the other."""
    found = wrong_rows(night(seed, 2, dict.fromkeys(range(8, 17), 20.0)))[2]
    assert found.another == {}
    assert all("cannot tell" in row.why for row in found.rows)


@pytest.mark.parametrize("seed", range(3))
def test_what_bends_at_a_temperature_that_has_one_run_accuses_none(seed: int) -> None:
    """A resonance, of 20 deg/hr, at the only run there."""
    one = night(seed, 3, dict.fromkeys((10, 11, 12), 20.0))
    rows = one.sensors[2].rows(~np.isin(one.sensors[2].conditions.run, (10, 11)))
    assert wrong_rows(replace(one, sensors={2: rows}))[2].rows == ()


@pytest.mark.parametrize("seed", range(3))
def test_rates_that_are_wrong_alike_at_one_position_of_two_runs_accuse_these(seed: int) -> None:
    """In the order 1-2-3 that is MU, too: each was asked for by itself, and so the third was wrong."""
    one = night(seed, 3, {})
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[np.isin(one.sensors[2].conditions.run, (10, 11)) & (one.sensors[2].conditions.position == "3"), 0] += 60.0
    found = wrong_rows(replace(one, sensors={2: replace(one.sensors[2], rates_deg_per_hr=rates)}))[2]
    assert {(row.run, row.channels) for row in found.rows} == {(10, ("RA",)), (11, ("RA",))}
