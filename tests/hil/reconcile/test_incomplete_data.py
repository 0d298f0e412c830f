"""Data as laboratories bring it: rows missing, a sensor measured once, sizes off every grid, columns nearly alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, Collects
from hil.model import load_model
from hil.model.effects.catalogue import effect_by_id
from hil.model.effects.history import place_in_run
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.outcome.page import page
from hil.reconcile.outcome.sentences import summary
from hil.reconcile.proof.experiment import repeated
from hil.reconcile.search.problem import pose
from procedures.verdict import Judgement, Verdict
from tests.hil.analysis.thermal.nights import rotor_night
from tests.hil.reconcile.hidden_effects import (
    EIGHT,
    ROTOR,
    Rows,
    base_rates,
    both,
    campaign_of,
    hidden_campaign,
    lay_out,
    noise,
)
from tests.hil.reconcile.test_unrecorded import names, with_columns

NOT_GOOD = Judgement(Verdict.INCONCLUSIVE, "moved")


def ids(result: Reconciliation) -> list[str]:
    """Ids in the order found."""
    return [effect.id for effect in result.effects]


def only(campaign: Campaign, rows: np.ndarray) -> Campaign:
    """The campaign with some of its rows."""
    collects = campaign.sensors[2]
    conditions = collects.conditions.rows(np.flatnonzero(rows))
    own = Collects(conditions, collects.rates_deg_per_hr[rows], collects.rates_se_deg_per_hr[rows])
    return replace(campaign, sensors={2: own})


def values(result: Reconciliation, effect: int = 0) -> dict[str, tuple[float, float]]:
    """Value and standard error of each parameter of one effect."""
    return {p["name"]: (p["value"], p["se"]) for p in result.effects[effect].parameters}


def mass_unbalance(rows: Rows) -> np.ndarray:
    """RA += MUB fS, RB -= MUA fS with MUA = 14, MUB = -20 deg/hr/g."""
    return np.stack([-20.0 * rows.f[:, 2], -14.0 * rows.f[:, 2]], 1)


def test_a_missing_first_collect_does_not_move_the_others() -> None:
    """Places in the run are those of the positions elsewhere, and k is counted in whole collects."""
    rows = lay_out(np.random.default_rng(1))
    conditions = campaign_of(rows, base_rates(rows)).sensors[2].conditions
    late = replace(conditions, start_s=conditions.start_s + 12.0 * (rows.order == 2))
    kept = np.flatnonzero(~((rows.run == 3) & (rows.order == 0)) & ~((rows.run == 5) & (rows.order == 1)))
    np.testing.assert_array_equal(place_in_run(late.rows(kept), 90.0), rows.order[kept])


@pytest.mark.slow
def test_drift_with_first_collects_missing_is_still_the_class_of_drift() -> None:
    """Drift by order and an even g² term are one in the order 1-2-3-4, rows missing or not."""
    full = hidden_campaign(7, lambda r: both(r.order - 1.5, 2.5, -2.0))
    conditions = full.sensors[2].conditions
    kept = ~((conditions.position == "1") & (conditions.run % 4 == 0))
    result = reconcile(only(full, kept), "matrix-6-thermal", prove=False)
    assert result.verdict == "ambiguous"
    assert {"drift", "k2"} <= names(result)


@pytest.mark.slow
def test_large_drift_on_a_bench_that_is_not_punctual_stays_ambiguous() -> None:
    """Sizes at which the last thousandth of a column shows do not part names whose columns are idealised anyway."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng)
    late = replace(rows, start_s=rows.start_s + np.round(rng.uniform(-15.0, 15.0, len(rows))))
    rates = base_rates(rows) + noise(rows, rng) + both(rows.order + 0.02 * rng.normal(size=len(rows)), 11.0, -12.0)
    result = reconcile(campaign_of(late, rates), "matrix-6-thermal", prove=False)
    assert result.verdict == "ambiguous"
    assert {"drift", "k2"} <= names(result)


@pytest.mark.slow
def test_a_time_constant_between_the_points_of_the_grid_leaves_nothing_behind() -> None:
    """A strong warm-up of 28 min (the grid has 20 and 40): one effect, its size and time constant right."""
    result = reconcile(
        hidden_campaign(
            7, lambda r: both(np.exp(-(r.start_s - 3300.0) / 1680.0), 120.0, -150.0), temperatures=EIGHT[::2]
        ),
        "matrix-6-thermal",
        prove=False,
    )
    assert ids(result) == ["warmup"]
    assert result.effects[0].shape["tau_min"] == pytest.approx(28.0, rel=0.12)
    at_first = np.exp(-3390.0 / 60.0 / result.effects[0].shape["tau_min"])
    assert values(result)["W_A"][0] * at_first == pytest.approx(120.0 * np.exp(-90.0 / 1680.0), rel=0.05)


@pytest.mark.slow
def test_the_same_effect_of_two_sensors_is_one_whatever_each_one_s_median() -> None:
    """A reference that each sensor's rows give (the nominal voltage) does not part one effect into two."""
    first = hidden_campaign(7, lambda r: both(r.supply - 28.0, 14.0, -13.0)).sensors[2]
    second = hidden_campaign(8, lambda r: both(r.supply - 28.0, 12.0, -16.0)).sensors[2]
    moved = replace(second.conditions, sensor=replace(ROTOR, number=1))
    assert np.median(moved.columns["supply_V"]) != np.median(first.conditions.columns["supply_V"])
    both_sensors = {1: Collects(moved, second.rates_deg_per_hr, second.rates_se_deg_per_hr), 2: first}
    result = reconcile(
        Campaign("two", "test, simulated", both_sensors, simulated=True), "matrix-6-thermal", prove=False
    )
    assert ids(result) == ["supply"]
    assert list(result.effects[0].sensors) == [1, 2]


@pytest.mark.slow
def test_values_that_follow_temperature_are_found_not_calibrated_away() -> None:
    """Bias and GS on straight lines beside constants: both are named; the form per temperature is no verdict."""

    def warm(rows: Rows) -> np.ndarray:
        t = rows.temperature - 20.0
        gain = 0.03 * t * rows.f[:, 0]
        return both(t, 0.2, -0.18) + np.stack([gain, 0.9 * gain], 1)

    result = reconcile(hidden_campaign(5, warm, thermal=False), "matrix-6", prove=False)
    assert result.verdict != "none"
    assert "bias_T" in {n for effect in result.effects for n in (effect.id, *(r.id for r in effect.confusable_with))}


@pytest.mark.slow
def test_a_scale_factor_beside_constants_has_the_size_that_it_has() -> None:
    """de/dT acts on the whole rates: the part that the base can imitate is not taken from the base."""
    slope = 1500e-6

    def grows(rows: Rows) -> np.ndarray:
        return base_rates(rows, thermal=False) * (slope * (rows.temperature - 25.0))[:, None]

    result = reconcile(hidden_campaign(7, grows, thermal=False, quiet=0.5), "matrix-6", prove=False)
    assert ids(result)[0] == "scale"
    assert all(effect.acts_on == "scatter" for effect in result.effects[1:])  # runs are correlated
    value, error = values(result)["de_dT"]
    assert abs(value - 1e6 * slope) < 3.0 * error


@pytest.mark.slow
def test_an_earth_rate_that_is_half_wrong_is_no_wrong_sign() -> None:
    """A sign is wrong or right: half of the change, however well it fits, is not `frame`."""
    headings = (30.0, 120.0, 210.0)
    campaign = hidden_campaign(
        7, lambda r: np.stack([np.zeros(len(r)), -0.5 * 2.0 * r.w[:, 1]], 1), headings=headings, quiet=0.5
    )
    result = reconcile(campaign, "matrix-6-thermal", prove=False)
    assert result.effects
    assert result.effects[0].id != "frame" or result.effects[0].kind == "ambiguous"


def without(campaign: Campaign, *columns: str) -> Reconciliation:
    """What is said where some conditions were not recorded."""
    unknown = with_columns(campaign, **dict.fromkeys(columns))
    return reconcile(unknown, "matrix-6-thermal", prove=False)


@pytest.mark.slow
def test_a_history_that_could_not_be_asked_about_withholds_hysteresis() -> None:
    """Without slope and time since the setpoint, what stands off after each step may be any of four."""
    temperatures = (20.0, 60.0, 6.0, 49.0, -7.0, 38.0, -30.0, 55.0)

    def remembers(rows: Rows) -> np.ndarray:
        return both(np.sign(rows.setpoint - 20.0), 9.0, -8.0)

    campaign = hidden_campaign(7, remembers, temperatures=temperatures)
    known = reconcile(campaign, "matrix-6-thermal", prove=False)
    assert known.effects[0].id == "hyst"
    assert not [
        r
        for r in known.effects[0].confusable_with
        if r.id in {"soak_insufficient", "bias_Tdot"} and r.probability > 0.1
    ]
    unknown = without(campaign, "dTdt_degC_per_min", "time_since_setpoint_s")
    assert unknown.effects[0].kind == "ambiguous"
    assert {"hyst", "soak_insufficient", "bias_Tdot"} <= names(unknown)
    assert unknown.effects[0].probability < 0.5


@pytest.mark.slow
def test_a_first_run_that_is_off_may_be_a_warm_up_where_nothing_tells() -> None:
    """Without the times since power-on and setpoint, a step after the first run is no jump for certain."""
    campaign = hidden_campaign(7, lambda r: both(r.run == 1, 14.0, -12.0))
    result = without(campaign, "time_since_power_on_s", "time_since_setpoint_s")
    assert result.effects[0].id == "jump"
    assert result.effects[0].kind == "ambiguous"
    assert {"warmup", "soak_insufficient"} <= names(result)


@pytest.mark.slow
def test_what_has_died_away_before_the_first_row_is_not_asked_about() -> None:
    """Power on a day before: no warm-up of any time constant can be made of the last digits."""
    rows = lay_out(np.random.default_rng(2))
    rates = base_rates(rows) + noise(rows, np.random.default_rng(4))
    rates[:4] += (6.0, -5.4)
    campaign = with_columns(campaign_of(rows, rates), time_since_power_on_s=rows.start_s + 86400.0)
    problem = pose(campaign, load_model("matrix-6-thermal"), [effect_by_id("warmup")])
    taus = {c.shape["tau_min"] for c in problem.candidates if c.name == "warmup"}
    assert not taus & {3.0, 5.0, 8.0, 12.0, 20.0}
    result = reconcile(campaign, "matrix-6-thermal", prove=False)
    assert "warmup" not in ids(result)


def test_the_power_of_a_repeated_experiment_is_that_of_all_its_repeats() -> None:
    """So many repeats are asked for that they suffice, and the power says so; what adds nothing is not repeated."""
    assert repeated(9.0)[0] == 1
    assert repeated(2.0)[0] == 5
    assert repeated(2.0)[1] > repeated(9.0)[1] > 0.6
    assert repeated(0.5)[0] == 0
    assert repeated(0.5)[1] < 0.1


def test_a_run_that_has_only_begun_lacks_nothing_before_its_first_collect() -> None:
    """Its first position is also the last of a whole run; the twin asks in the middle of one."""
    there_and_back = np.array(["1", "3", "4", "2", "4", "3", "1"])
    one = hidden_campaign(7, mass_unbalance, thermal=False, mu=False).sensors[2].conditions.rows(np.arange(14))
    asked = replace(
        one,
        collect=np.arange(14),
        run=np.repeat([1, 2], 7),
        position=np.tile(there_and_back, 2),
        start_s=np.concatenate([100.0 * np.arange(7), 5000.0 + 100.0 * np.arange(7)]),
    )
    for kept, places in ((8, [0]), (10, [0, 1, 2])):
        begun = place_in_run(asked.rows(np.arange(kept)), 100.0)
        np.testing.assert_array_equal(begun[7:], places)
    without_its_first = place_in_run(asked.rows(np.delete(np.arange(14), 7)), 100.0)
    np.testing.assert_array_equal(without_its_first[7:], np.arange(1, 7))


@pytest.mark.slow
def test_what_was_held_out_of_few_runs_are_collects() -> None:
    """Two runs tell nothing of a third: each collect is predicted from the others, and sentence and page say so."""
    curves = {"MUA": lambda t: 30.0 + 0.0 * t, "MUB": lambda t: -25.0 + 0.0 * t}
    rng, places = np.random.default_rng(2), ("1", "3", "2", "2", "3", "1")
    few = {"temperatures_degC": (20.0,), "runs": 2, "run_to_run": {}, "positions": places}
    result = reconcile(rotor_night(rng, curves, **few), "collins-4")
    assert any("on collects that were held out" in said for said in summary(result))
    assert "each collect predicted from the others" in page(result)
