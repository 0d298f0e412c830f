"""How large an effect may be: the whole range of a gyro of unknown technology, and sizes in one axis alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp

from hil.campaign import Campaign, Collects, Conditions
from hil.model import load_model
from hil.model.effects.base import Parameter
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, VARIANCE_EFFECTS
from hil.reconcile import reconcile
from hil.reconcile.search.layout import searches
from hil.reconcile.search.problem import pose
from tests.hil.reconcile.hidden_effects import TRIAD

SIX = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)


def of_axes(*slopes: float, seed: int = 2) -> Campaign:
    """Return two runs of six positions at each of three temperatures, of a triad whose biases follow these, or not."""
    rng, n = np.random.default_rng(seed), 36
    run = np.repeat(np.arange(1, 7), 6)
    temperature = np.array([0.0, 25.0, 50.0])[(run - 1) // 2]
    f = np.tile(SIX, (6, 1))
    rates = 30.0 + 5.0 * f + rng.normal(0.0, 1.0, (n, 3))
    rates += np.outer(temperature - 25.0, slopes)
    positions = np.tile([f"{axis}-{way}" for axis in "xyz" for way in ("up", "down")], 6)
    columns = {"temperature_degC": temperature, "setpoint_degC": temperature}
    times = 3600.0 * run + 240.0 * np.tile(np.arange(6.0), 6)
    known = Conditions(TRIAD, np.arange(1, n + 1), run, positions, times, np.full(n, 120.0), f, 0.0 * f, columns)
    return Campaign("made", "", {1: Collects(known, rates, np.full(rates.shape, 1.0))}, simulated=True)


def test_a_typical_range_ends_where_it_says() -> None:
    """The bottom of one that spans the technologies was taken for a hundredth of its top."""
    assert Parameter("b1", "deg/hr/degC", (0.005, 30.0)).bounds == (0.005, 30.0)
    assert Parameter("k", "deg/hr/g^2", (0.0, 1.0)).bounds == (0.01, 1.0)


@pytest.mark.slow
def test_a_bias_of_one_axis_that_follows_temperature_is_no_offset_of_runs() -> None:
    """Axes that do not follow it paid more than the one that does brought in: it was called an offset of each run."""
    found = {each.id: each.probability for each in reconcile(of_axes(0.4, 0.0, 0.0), "triad-12", prove=False).effects}
    assert found.get("bias_T", 0.0) > 0.5
    assert reconcile(of_axes(0.0, 0.0, 0.0), "triad-12", prove=False).verdict == "none"


@pytest.mark.slow
def test_no_value_is_as_sure_as_the_smallest_that_it_may_be() -> None:
    """Of a slope that hardly shows, all sizes below its error are as probable; by the likeliest it was surer."""
    off = []
    for seed in (1, 2, 5):  # of six nights farthest off: of errors two thirds as large each would tell
        found = reconcile(of_axes(0.4, 0.01, -0.3, seed=seed), "triad-12", prove=False).effects
        (slope,) = [of for each in found if each.id == "bias_T" for of in each.parameters if of["name"] == "b1_Y"]
        off.append((slope["value"] - 0.01) / slope["se"])
        assert slope["se"] > 0.003  # six rates of 1 deg/hr at each end of 50 °C tell 0.008
    assert max(map(abs, off)) < 2.5


@pytest.mark.slow
def test_of_one_run_in_six_poses_something_is_left_over() -> None:
    """Two rates of each channel are: too few to call a drift missing, however large, and enough to speak of it."""
    campaign = of_axes(0.0, 0.0, 0.0)
    one = campaign.sensors[1].rows(campaign.sensors[1].conditions.run == 1)
    drift = 30.0 * np.outer(np.arange(6) - 2.5, [0.0, 1.0, 0.0])
    quiet, moved = (
        reconcile(replace(campaign, sensors={1: rows}), "triad-12", prove=False)
        for rows in (one, replace(one, rates_deg_per_hr=one.rates_deg_per_hr + drift))
    )
    assert quiet.tested
    assert quiet.verdict == "none"
    assert not any("not called missing" in note for note in quiet.notes)
    assert moved.verdict == "none"
    assert any("(drift): " in note and "not called missing" in note for note in moved.notes)


def in_one_axis() -> Campaign:
    """Return 0.8 deg/hr/°C in one axis of a triad of a technology in which slopes are large."""
    campaign = of_axes(0.8, 0.0, 0.0)
    rows = campaign.sensors[1]
    known = replace(rows.conditions, sensor=replace(rows.conditions.sensor, technology="MEMS"))
    return replace(campaign, sensors={1: replace(rows, conditions=known)})


@pytest.mark.slow
def test_what_one_axis_shows_needs_not_be_in_all_three() -> None:
    """Three had to have such a slope: that of one was noise of runs."""
    (found,) = reconcile(in_one_axis(), "triad-12", prove=False).effects
    assert found.id == "bias_T"
    assert found.probability > 0.7
    of = {each["name"]: (each["value"], each["se"]) for each in found.parameters}
    assert of["b1_X"][0] > 0.75
    assert all(abs(value) < 3.0 * se < 0.1 for name, (value, se) in of.items() if name != "b1_X")


def test_what_is_in_one_axis_is_proposed_as_it_is_weighed() -> None:
    """The quick look at all terms does not ask for it in the other two either."""
    problem = pose(in_one_axis(), load_model("triad-12"), (*BASE_EFFECTS, *EFFECTS))
    search = searches(problem, EFFECTS, VARIANCE_EFFECTS)[1]
    scanned = search.scan(())
    j = max((k for k, term in enumerate(search.terms) if term.name == "bias_T"), key=lambda k: scanned[k])
    alone, with_it = (sum(logsumexp(of) for of in own) for own in search.evidence([(), (j,)]))
    assert scanned[j] == pytest.approx(with_it - alone, abs=1.0)
