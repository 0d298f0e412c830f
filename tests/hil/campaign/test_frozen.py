"""A channel that shows one value over and over measures nothing, from whichever collect on, errors stated or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.campaign.plausibility import judged_by_its_records
from hil.solve import solve_campaign
from procedures.verdict import Verdict
from tests.hil.solve.runs_of_a_unit import campaign, repeated, with_rates


def _as_filed(one: Campaign, rates: np.ndarray, *, stated: bool) -> Campaign:
    one = with_rates(one, rates)
    errors = one.sensors[2].rates_se_deg_per_hr * (1.0 if stated else np.nan)
    return judged_by_its_records(replace(one, sensors={2: replace(one.sensors[2], rates_se_deg_per_hr=errors)}))


@pytest.mark.parametrize("stated", [True, False], ids=["errors stated", "no errors"])
@pytest.mark.parametrize("level", [24.8495, -312.481, 391.207])
@pytest.mark.parametrize("first", [17, 18, 19, 20])
def test_a_channel_that_freezes_in_the_middle_of_a_night_measures_nothing_from_then_on(
    first: int, level: float, *, stated: bool
) -> None:
    """Without errors its runs had passed, and healthy ones were accused; at an end of its range it was clipped."""
    one = campaign(12, 3, seed=1, scatter=2.0)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[first:, 1] = level
    frozen = _as_filed(one, rates, stated=stated)
    run = one.sensors[2].conditions.run[first]
    assert {run for run, _ in frozen.contradicted} == {*range(run, 13)}
    assert all(f"RB: every rate is exactly {level}" in each.reason for each in frozen.contradicted.values())
    assert not any("clipped" in words for words in frozen.warnings)
    verdicts = {each.run: each.verdict for each in solve_campaign(frozen)}
    assert {run for run, verdict in verdicts.items() if verdict is Verdict.PASS} == {*range(1, run)}


@pytest.mark.parametrize("digit", [0.01, 0.1, 1.0, 5.0])
@pytest.mark.parametrize("seed", range(4))
def test_averages_in_coarse_steps_are_not_frozen(digit: float, seed: int) -> None:
    """A quiet unit shows one position alike, there and back, and in one run after the other."""
    for one in (campaign(12, 3, seed=seed), repeated(12, 3, (0, 1, 2, 1, 0), seed=seed), repeated(12, 3, (0, 0, 1, 1))):
        quiet = np.median(one.sensors[2].rates_deg_per_hr.reshape(12, -1, 2), axis=0)
        rates = np.tile(quiet, (12, 1)) + np.random.default_rng(seed).normal(0.0, 0.02, (12 * len(quiet), 2))
        assert _as_filed(one, np.round(rates / digit) * digit, stated=False).contradicted == {}


@pytest.mark.parametrize("order", [(0, 0, 0), (0, 1, 2), (0, 0, 0, 1, 1, 1, 2, 2, 2)])
def test_a_quiet_unit_is_not_frozen(order: tuple[int, ...]) -> None:
    """In one pose, in poses that it does not feel, or in the first pose of a night that ended there.

    Its bias is another in each run, in which it shows one value: in the steps in which that is written.
    """
    one = repeated(12, 3, order)
    rows, run = one.sensors[2], one.sensors[2].conditions.run
    quiet = np.repeat(np.median(rows.rates_deg_per_hr.reshape(12, -1, 2), axis=0)[::3], 3, axis=0)
    rates = np.tile(quiet, (12, 1)) + np.random.default_rng(4).normal(0.0, 3.0, (12, 2))[run - 1]
    rates += np.random.default_rng(5).normal(0.0, 0.015, rates.shape)
    there = rows.rows((run < 12) | (np.arange(len(run)) < 11 * len(order) + 3))
    ended = replace(one, sensors={2: there})
    assert _as_filed(ended, np.round(rates[: len(there)], 1), stated=False).contradicted == {}


def test_a_rate_of_0_is_one_in_coarse_steps_though_the_channel_dies_later() -> None:
    """Of a value that has no digits no single collect is known to be dead."""
    one = campaign(12, 3, seed=1)
    rates = np.round(one.sensors[2].rates_deg_per_hr)
    rates[4, 1], rates[18:, 1] = 0.0, 0.0
    for stated in (True, False):
        assert {run for run, _ in _as_filed(one, rates, stated=stated).contradicted} == {*range(7, 13)}
