"""What a measured campaign shows of its own noise is what an effect must exceed to be seen in it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hil.campaign import Campaign, Collects
from hil.design.visibility.document import _seen_better, campaign_document, visibility_document, visibility_text
from hil.design.visibility.map import NoiseLevel, Sight, visibility
from hil.model import Model, built_in_model
from hil.model.effects.catalogue import NO_EARTH_RATE
from hil.model.forms import default_form, gs_columns
from hil.solve.temperatures import same_temperature
from tests.hil.model.effect_conditions import campaign, of_each_position, triad_poses
from tests.hil.solve.runs_of_a_unit import campaign as runs_at_their_temperatures
from tests.hil.solve.runs_of_a_unit import repeated, up_and_down, with_rates


@pytest.mark.slow
def test_a_campaign_is_mapped_with_its_own_errors_and_gaps() -> None:
    """Rates that were not measured tell nothing: half the rows, about √2 in the smallest size; stated errors count."""
    conditions = campaign()
    errors = np.full((len(conditions), 2), 0.5)
    rates = of_each_position(conditions)
    whole = Campaign("t", "s", {2: Collects(conditions, rates, errors)})
    halved = rates.copy()
    halved[conditions.run % 2 == 0] = np.nan
    half = Campaign("t", "s", {2: Collects(conditions, halved, errors)})
    matrix_6 = built_in_model("matrix-6")
    assert smallest(half, matrix_6, "GS_T") / smallest(whole, matrix_6, "GS_T") == pytest.approx(np.sqrt(2.0), rel=0.15)
    unstated = Campaign("t", "s", {2: Collects(conditions, rates, np.full_like(rates, np.nan))})
    assumed = Campaign("t", "s", {2: Collects(conditions, rates, np.full_like(rates, NoiseLevel().collect_deg_per_hr))})
    assert smallest(unstated, matrix_6, "GS_T") == pytest.approx(smallest(assumed, matrix_6, "GS_T"))


def mapped(one: Campaign) -> Any:
    """Return the effects that can be asked about in a campaign."""
    return campaign_document(one, changes=())["effects"]


def smallest(one: Campaign, model: Model, name: str) -> float:
    """Return the smallest visible size of an effect in a campaign."""
    effects: Any = campaign_document(one, model, changes=())["effects"]
    return float(next(each["smallest_visible"]["value"] for each in effects if each["id"] == name))


@pytest.mark.slow
def test_what_repeats_scatter_by_is_what_an_effect_must_exceed() -> None:
    """Runs whose bias scatters: the map says by how much, and effects on the bias must be larger to be seen."""
    conditions = campaign()
    rng = np.random.default_rng(1)
    rates = rng.normal(0.0, 0.5, (len(conditions), 2))
    moved = rates + rng.normal(0.0, 8.0, (conditions.run.max() + 1, 2))[conditions.run]
    errors = np.full_like(rates, 0.5)
    quiet, loud = (Campaign("t", "s", {2: Collects(conditions, each, errors)}) for each in (rates, moved))
    maps: list[Any] = [campaign_document(one, built_in_model("matrix-6"), ())["sensors"] for one in (quiet, loud)]
    assert maps[0]["2"]["noise"]["run_bias_deg_per_hr"] < 0.5
    assert maps[1]["2"]["noise"]["run_bias_deg_per_hr"] == pytest.approx(8.0, rel=0.4)
    matrix_6 = built_in_model("matrix-6")
    assert smallest(loud, matrix_6, "ageing") > 5.0 * smallest(quiet, matrix_6, "ageing")
    in_one = Campaign("t", "s", {2: Collects(conditions, np.stack([rates[:, 0], moved[:, 1]], 1), errors)})
    (of_one, *_) = campaign_document(in_one, matrix_6, ())["sensors"].values()  # type: ignore[attr-defined]
    assert of_one["noise"]["run_scatter"]["BA"] < 0.5 < 4.0 < of_one["noise"]["run_scatter"]["BB"]
    assert smallest(in_one, matrix_6, "ageing") < 1.3 * smallest(quiet, matrix_6, "ageing")  # the other is as quiet


@pytest.mark.slow
def test_residuals_that_repeats_contradict_are_no_noise_of_a_form_of_biases_alone() -> None:
    """One channel: what it feels of g is the same in every run. And no change shows effects at none of their size."""
    one = runs_at_their_temperatures(8, 2, seed=7, scatter=1.0)
    rows = one.sensors[2]
    alone = replace(rows.conditions, sensor=replace(rows.conditions.sensor, channels={"RA": "A"}))
    single = Collects(alone, rows.rates_deg_per_hr[:, :1], rows.rates_se_deg_per_hr[:, :1])
    found: Any = campaign_document(replace(one, sensors={2: single}), changes=())
    assert found["sensors"]["2"]["noise"]["collect_deg_per_hr"] < 2.0
    few: Any = campaign_document(runs_at_their_temperatures(2, 1, seed=5, scatter=1.0))
    assert min(change["size_ratio"] for change in few["changes"]) > 0.05


@pytest.mark.slow
def test_what_a_second_visit_to_a_temperature_differs_by_is_no_noise() -> None:
    """Hysteresis is to be found in it: the noise that it has to exceed is what the runs of one visit differ by."""
    one = up_and_down(5, scatter=1.0)
    down = np.array([-1.0, 1.0, 1.0, -1.0, -1.0])[(one.sensors[2].conditions.run - 1) // 2]
    levels = []
    for size in (0.0, 20.0):
        measured = with_rates(one, one.sensors[2].rates_deg_per_hr + size * down[:, None])
        found: Any = campaign_document(measured, changes=())
        levels.append(found["sensors"]["2"]["noise"]["run_bias_deg_per_hr"])
    assert levels[1] == pytest.approx(levels[0])


@pytest.mark.slow
def test_what_a_drift_makes_of_another_order_of_collects_is_no_noise() -> None:
    """Every other run backwards, by a drift of which GS has one sign or the other: it is to be found in that."""
    one = runs_at_their_temperatures(24, 4, seed=5, scatter=1.0)
    rows = one.sensors[2]
    forth = np.tile(np.repeat([True, False], 3), 12)
    at = np.where(forth, [0, 2, 1] * 24, [2, 0, 1] * 24)  # 1-3-2, then 2-3-1
    start_s = rows.conditions.start_s - 600.0 * (np.arange(72) % 3) + 600.0 * at
    drifting = replace(
        rows,
        conditions=replace(rows.conditions, start_s=start_s),
        rates_deg_per_hr=rows.rates_deg_per_hr + 2.9 * at[:, None],
    )
    noise = campaign_document(replace(one, sensors={2: drifting}), changes=())["noise"]
    assert noise["run_gs_deg_per_hr_per_g"] < 1.0  # type: ignore[index]
    every = runs_at_their_temperatures(24, 4, seed=5, scatter=1.0).sensors[2]
    of_gs = gs_columns(every.conditions) @ np.random.default_rng(1).normal(0.0, 5.0, 2)
    changing = of_gs * np.random.default_rng(2).normal(0.0, 1.0, 25)[every.conditions.run][:, None]
    varied = replace(every, rates_deg_per_hr=every.rates_deg_per_hr + changing)
    noise = campaign_document(replace(one, sensors={2: varied}), changes=())["noise"]
    assert noise["run_gs_deg_per_hr_per_g"] > 2.0  # type: ignore[index]


@pytest.mark.slow
def test_standard_errors_that_are_too_small_are_no_scatter_from_run_to_run() -> None:
    """GS, which nothing but white noise moves, tells it from a bias of its own in each run."""
    for offset in (0.0, 2.0):
        one = runs_at_their_temperatures(24, 3, seed=5, scatter=offset)
        small = replace(one.sensors[2], rates_se_deg_per_hr=0.25 * one.sensors[2].rates_se_deg_per_hr)
        found: Any = campaign_document(replace(one, sensors={2: small}), changes=())
        noise = found["sensors"]["2"]["noise"]
        assert noise["collect_deg_per_hr"] == pytest.approx(0.7, rel=0.2)
        assert noise["run_bias_deg_per_hr"] == pytest.approx(offset, abs=0.4)
        assert noise["run_mu_deg_per_hr_per_g"] < 0.6


def four_runs(seed: int) -> Campaign:
    """Return four runs 1-2-3-1 at one temperature, a quarter of an hour apart, of a unit that knows its power-on."""
    one = repeated(4, 4, (0, 1, 2, 0), seed=seed)
    rows = one.sensors[2]
    start_s = 900.0 + 80.0 * np.arange(16) + 900.0 * (rows.conditions.run - 1)
    columns = {**rows.conditions.columns, "time_since_power_on_s": start_s}
    return replace(
        one, sensors={2: replace(rows, conditions=replace(rows.conditions, start_s=start_s, columns=columns))}
    )


@pytest.mark.slow
def test_a_size_that_nobody_has_seen_is_not_seen_in_these_collects() -> None:
    """An ageing of 190 deg/hr/day had stood there as a size: an hour at one temperature does not tell it."""
    found: Any = campaign_document(four_runs(3), changes=())
    text = visibility_text(found)
    far = next(line for line in text.splitlines() if line.startswith("Not seen in these collects, not even 10 times"))
    named = far.partition(": ")[2].split(", ")
    assert "ageing" in named
    for effect in found["effects"]:
        easiest, most = effect["smallest_visible"]["easiest"]["value"], effect["smallest_visible"]["typical"][1]
        if effect["visible"] and (not effect["in_sight"]):
            assert (effect["id"] in named) == (easiest is None or easiest > 10.0 * most)
            assert (f"\n  {effect['id']} " in text) == (effect["id"] not in named)


def test_what_acts_on_values_is_asked_with_those_that_the_night_shows() -> None:
    """A triad's G that grows in proportion was "taken up by the model" in a night in which reconcile found it."""
    conditions = triad_poses()
    form = default_form(conditions)
    values = np.array([4.0 if name in ("GXX", "GYY", "GZZ") else 0.0 for name in form.names])
    rates = form.columns(conditions) @ values + np.random.default_rng(1).normal(0.0, 0.1, (len(conditions), 3))
    night = Campaign("t", "s", {1: Collects(conditions, rates, np.full_like(rates, 0.1))})
    (gain,) = (each for each in mapped(night) if each["id"] == "g_gain")
    assert (gain["visible"], gain["found_as"]) == (True, "g_sensitivity")
    planned: Any = visibility_document({1: conditions}, "planned", changes=())["sensors"]
    assert "needs values" in planned["1"]["cannot_be_asked"]["g_gain"]
    still = replace(conditions, w_deg_per_hr=np.zeros_like(conditions.w_deg_per_hr))
    told = visibility(still, values=dict.fromkeys(form.names, 4.0))
    assert told.reasons["misalign"] == NO_EARTH_RATE


def test_noise_that_is_larger_at_one_temperature_is_said_to_be() -> None:
    """One number stood for all of them, where hil budget had four times as much at -20 °C."""
    one = runs_at_their_temperatures(9, 4, seed=1)
    rows = one.sensors[2]
    loud = same_temperature(rows.conditions) == 0
    errors = np.where(loud[:, None], 2.0, 0.5) * np.ones((1, 2))
    rates = rows.rates_deg_per_hr + np.random.default_rng(1).normal(0.0, 1.0, errors.shape) * errors
    made = replace(one, sensors={2: replace(rows, rates_deg_per_hr=rates, rates_se_deg_per_hr=errors)})
    noise: Any = campaign_document(made, changes=())["noise"]
    assert all(
        2.0 < noise["at_one_temperature_deg_per_hr"][c] / noise["channels_deg_per_hr"][c] < 6.0 for c in ("RA", "RB")
    )
    assert "at one temperature)" in visibility_text(campaign_document(made, changes=()))


@pytest.mark.parametrize(("visible", "better"), [(True, True), (False, False)])
def test_of_two_sensors_the_size_is_that_of_the_one_that_sees_smaller_ones(visible: bool, better: bool) -> None:
    """It had been that of which more is left beside the model, be it the restless one: 21.6 for 6.3."""
    quiet, restless = (
        cast(Sight, SimpleNamespace(visible=visible, kept=kept, least=least))
        for kept, least in ((0.5, 1.0), (0.9, 3.0))
    )
    assert _seen_better(quiet, restless) == better
    assert _seen_better(restless, quiet) != better
