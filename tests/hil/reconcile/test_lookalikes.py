"""What looks the same in these collects is listed beside a name, and weighed, however little it is believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.model import load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, VARIANCE_EFFECTS
from hil.reconcile import reconcile
from hil.reconcile.search.layout import searches
from hil.reconcile.search.lookalikes import exchanged, lookalikes
from hil.reconcile.search.posterior import log_weights, weigh
from hil.reconcile.search.problem import pose
from tests.hil.analysis.thermal.nights import triad_night
from tests.hil.reconcile.hidden_effects import base_rates, both, campaign_of, lay_out, noise


@pytest.mark.slow
def test_what_looks_the_same_is_listed_however_little_it_is_believed() -> None:
    """Of four collects in their order a k2 is a drift and an index error: ten thousand to one is what was known before.

    Beside three more effects the search had passed two of them over, and called the first certain.
    """
    rows = lay_out(np.random.default_rng(1), (0.0, 25.0, 50.0), 3)
    rng, warm, even = np.random.default_rng(11), rows.temperature - 25.0, rows.f[:, 2] ** 2
    rates = base_rates(rows, thermal=False) + both(even, 6.0, 5.0) + both(0.5 * warm, 1.0, -1.0)
    rates = rates + both(warm * rows.f[:, 0], -0.25, 0.1) + noise(rows, rng, run_bias=0.0)
    rates = rates + (5.0 * rng.normal(size=(rows.run.max() + 1, 2)))[rows.run] * rows.f[:, 2:3]
    result = reconcile(campaign_of(rows, rates), "matrix-6", prove=False)
    drift = next(effect for effect in result.effects if effect.id == "drift")
    alike = {rival.id: rival for rival in drift.confusable_with if rival.overlap > 0.99}
    assert {"k2", "index"} <= alike.keys()
    assert alike["index"].probability < 0.001
    assert drift.kind == "ambiguous"
    assert drift.probability + sum(rival.probability for rival in alike.values()) == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_what_looks_the_same_is_found_by_its_columns_and_not_by_its_name() -> None:
    """And a set weighs what it does among others, whatever it is weighed with."""
    rows = lay_out(np.random.default_rng(1), (25.0,), 4)
    rates = base_rates(rows, thermal=False) + both(rows.f[:, 2] ** 2, 6.0, 5.0) + noise(rows, np.random.default_rng(2))
    one = campaign_of(rows, rates)
    second = one.sensors[2]
    other = replace(second.conditions, sensor=replace(second.conditions.sensor, number=1))
    two = replace(one, sensors={1: replace(second, conditions=other), 2: second})
    problem = pose(two, load_model("matrix-6"), (*BASE_EFFECTS, *EFFECTS))
    posterior = weigh(searches(problem, EFFECTS, VARIANCE_EFFECTS))
    search, lead = posterior.searches[2], posterior.sets[0].terms[2]
    (drift,) = (j for j in lead if search.terms[j].name == "drift")
    assert {search.terms[j].name for j in lookalikes(search, lead)[drift]} == {"k2", "index"}
    instead = exchanged([lead], {drift: [0]})
    assert instead == [tuple(sorted({0, *lead} - {drift}))]
    alone, _ = log_weights(posterior.searches, {n: [lead] for n in (1, 2)})
    among, _ = log_weights(posterior.searches, {n: [(), lead] for n in (1, 2)})
    np.testing.assert_allclose(alone[0, 0], among[1, 1], atol=1e-9)


@pytest.mark.slow
def test_what_looks_the_same_is_kept_where_nobody_believes_it() -> None:
    """Six hundred deg/hr: no index error is so large, and that it is none the data do not say."""
    rows = lay_out(np.random.default_rng(1), (25.0,), 4)
    hidden = both(rows.f[:, 2] ** 2, 600.0, 480.0)
    rates = base_rates(rows, thermal=False) + hidden + noise(rows, np.random.default_rng(2))
    result = reconcile(campaign_of(rows, rates), "matrix-6", prove=False)
    (effect,) = result.effects
    assert (effect.id, effect.kind) == ("drift", "ambiguous")
    alike = {rival.id: rival.probability for rival in effect.confusable_with if rival.overlap > 0.99}
    assert {"index", "k2"} <= alike.keys()
    assert alike["index"] < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("gsb", "named"), [(25.0, ["a"]), (-25.0, ["GSA1", "GSB1"])])
def test_gs_that_follows_temperature_in_proportion_is_no_scale_factor(gsb: float, named: list[str]) -> None:
    """GSA and GSB that change by the same share had been a scale factor of eight times the largest usual size."""
    rows = lay_out(np.random.default_rng(1), (-10.0, 20.0, 50.0), 2)
    warm = rows.temperature - 25.0
    hidden = both(0.004 * warm * rows.f[:, 0], 60.0, gsb) + both(0.5 * warm, 1.0, -1.0)
    rates = base_rates(rows, thermal=False) + hidden + noise(rows, np.random.default_rng(11), run_bias=0.0)
    result = reconcile(campaign_of(rows, rates), "matrix-6", prove=False)
    effect = next(effect for effect in result.effects if effect.id == "GS_T")
    assert effect.kind == "named"
    assert [parameter["name"] for parameter in effect.parameters] == named
    value, error = effect.parameters[0]["value"], effect.parameters[0]["se"]
    assert value == pytest.approx(0.004 if len(named) == 1 else 0.24, abs=3.0 * error)


@pytest.mark.slow
@pytest.mark.parametrize(("times", "share"), [(1.0, 0.0025), (10.0, 0.0075)])
def test_a_triads_sensitivity_that_follows_temperature_in_proportion_is_no_scale_factor(
    times: float, share: float
) -> None:
    """One share for each channel, and not nine values: of these little shows, and a scale of twice the usual led.

    It is a share of what G is at the middle of the night, and the written model says so.
    """
    g = {"GXX": 3.9, "GXY": -2.4, "GXZ": 1.2, "GYX": 0.7, "GYY": 4.9, "GYZ": -3.2, "GZX": -1.5, "GZY": 2.0, "GZZ": 5.9}
    curves = {name: lambda t, at=times * at: at * (1.0 + share * (t - 25.0)) for name, at in g.items()}
    for name, (at, slope) in {"BX": (10.0, 0.22), "BY": (-8.0, 0.13), "BZ": (23.0, -0.28)}.items():
        curves[name] = lambda t, at=at, slope=slope: at + slope * (t - 25.0)
    night, without_noise = (triad_night(np.random.default_rng(5), curves, white) for white in (0.3, 0.0))
    result = reconcile(night, "triad-12", prove=False)
    assert {effect.id for effect in result.effects} == {"g_sensitivity", "bias_T"}
    (found,) = (effect for effect in result.effects if effect.id == "g_sensitivity")
    assert [parameter["name"] for parameter in found.parameters] == ["a_X", "a_Y", "a_Z"]
    middle = share / (1.0 + share * (found.shapes[1].values["about_degC"] - 25.0))
    for of in found.parameters:
        assert of["value"] == pytest.approx(middle, abs=3.0 * of["se"])
    assert result.model_after is not None
    told = result.model_after.rates(night.sensors[1].conditions)
    np.testing.assert_allclose(told, without_noise.sensors[1].rates_deg_per_hr, atol=0.5)
