"""Data as laboratories bring it: rows missing, a sensor measured once, sizes off every grid, columns nearly alike."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hil.campaign import Campaign, Collects
from hil.campaign.plausibility import judged_by_its_records
from hil.model import load_model
from hil.model.effects.catalogue import EFFECTS, VARIANCE_EFFECTS, effect_by_id
from hil.model.effects.history import place_in_run
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.outcome.page import page
from hil.reconcile.outcome.sentences import what_to_do
from hil.reconcile.proof.experiment import repeated
from hil.reconcile.proof.held_out import Predicted, _together
from hil.reconcile.result import FoundEffect, Solved
from hil.reconcile.scattering import what_scatters
from hil.reconcile.search.layout import searches
from hil.reconcile.search.posterior import Found, Posterior
from hil.reconcile.search.problem import pose
from hil.solve import solve_campaign
from procedures.verdict import Judgement, Verdict
from tests.hil.audit.folders import FOLDERS
from tests.hil.reconcile.hidden_effects import (
    ROTOR,
    Rows,
    base_rates,
    both,
    campaign_of,
    hidden_campaign,
    lay_out,
    noise,
)
from tests.hil.reconcile.test_names import on_the_mean
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


@pytest.mark.slow
def test_a_sensor_that_was_measured_once_does_not_silence_the_other() -> None:
    """What has too few rows for a test is left out of it, and the result says which."""
    full = hidden_campaign(7, mass_unbalance, thermal=False, mu=False)
    other = full.sensors[2]
    once = other.conditions.run == 1
    conditions = replace(other.conditions.rows(np.flatnonzero(once)), sensor=replace(ROTOR, number=1))
    second = Collects(conditions, other.rates_deg_per_hr[once], other.rates_se_deg_per_hr[once])
    result = reconcile(replace(full, sensors={1: second, 2: other}), "collins-4")
    assert [(effect.id, effect.kind) for effect in on_the_mean(result)] == [("MU_real", "named")]
    assert result.effects[0].sensors == [2]
    assert any("sensor 1, RA and RB" in note or "sensor 1, RA" in note for note in result.notes)


@pytest.mark.slow
def test_a_run_that_fails_by_its_records_is_not_searched() -> None:
    """Its averages are off by a thousand, and nothing is found in them; that it is left out is said."""
    full = hidden_campaign(7, mass_unbalance, thermal=False, mu=False)
    rates = full.sensors[2].rates_deg_per_hr + 1000.0 * (full.sensors[2].conditions.run == 3)[:, None]
    spoiled = replace(full, sensors={2: replace(full.sensors[2], rates_deg_per_hr=rates)})
    lost = replace(spoiled, verdicts={3: Judgement(Verdict.FAIL, "frames were lost")})
    result = reconcile(lost, "collins-4")
    assert [effect.id for effect in on_the_mean(result)] == ["MU_real"]
    assert result.rows == []
    assert result.document()["runs_not_used"] == {"2": [3]}
    assert result.notes[0].startswith("sensor 2: run 3 FAILed by what was recorded: in no mean")


@pytest.mark.slow
def test_what_was_mended_is_in_no_value_of_the_model() -> None:
    """Labels exchanged in one run, and one rate off by 300: the model that is written is that of the sound campaign."""
    sound = reconcile(FOLDERS["good"](), "matrix-6", prove=False)
    expected = [each["after"] for each in sound.values]
    assert {each["name"] for each in sound.values} == {"BA", "BB"}
    for name in ("labels exchanged", "one rate far off"):
        found = reconcile(FOLDERS[name](), "matrix-6", prove=False)
        assert found.rows, name
        np.testing.assert_allclose([each["after"] for each in found.values], expected, atol=1.0, err_msg=name)
        for parameter, curve in found.model_after.sensors[2].items():
            assert curve.at(20.0) == pytest.approx(sound.model_after.sensors[2][parameter].at(20.0), abs=1.0), name


def test_sets_are_compared_where_they_foretell_the_same_rows() -> None:
    """Beside the second set one row of fold 1 is out of reach, and that of fold 0 is not: fold 0 alone counts."""

    def told(*rows: int) -> Predicted:
        return Predicted(np.array(rows), -1.0 * len(rows), np.full(len(rows), 2.0), np.eye(len(rows)))

    posterior = SimpleNamespace(searches={2: SimpleNamespace(blocks=[SimpleNamespace(y=np.zeros(6))])})
    sets = [Found({2: (term,)}, frozenset(), -1.0) for term in (0, 1)]
    first, second = ((2, 0, (term,), frozenset[str]()) for term in (0, 1))
    known = {first: {0: told(0, 1, 2), 1: told(3, 4)}, second: {0: told(0, 1, 2), 1: told(3)}}
    held = _together(cast("Posterior", posterior), sets, known)
    assert held is not None
    assert held.rows.tolist() == [3]
    known[first] = {1: told(3, 4)}
    assert _together(cast("Posterior", posterior), sets, known) is None


def test_what_accelerometers_exchange_is_likelier_than_any_other_exchange() -> None:
    """For each sensor of the body, also for one whose rates are too noisy to tell."""
    problem = pose(FOLDERS["labels exchanged in a body"](), load_model("matrix-6"), ())
    for number, search in searches(problem, EFFECTS, ()).items():
        odds = {
            tuple(np.flatnonzero(np.any(term.candidate.columns != 0.0, axis=(1, 2)))): term.log_odds
            for term in search.terms
            if term.name == "swap" and term.candidate.shape["run"] == 5.0
        }
        assert max(odds, key=lambda rows: odds[rows]) == (12, 13), number
        assert odds[12, 13] == pytest.approx(np.log(1e4))
        assert sorted(odds.values())[-2] < 0.0


def test_a_sensor_of_which_every_run_fails_says_nothing_of_another() -> None:
    """Its thermometer shows one number all night: a bias that follows temperature would be ageing, of the other too."""
    both = FOLDERS["two sensors"]()
    columns = both.sensors[1].conditions.columns
    columns = {**columns, "temperature_degC": np.full_like(columns["temperature_degC"], 21.3)}
    stuck = replace(both.sensors[1], conditions=replace(both.sensors[1].conditions, columns=columns))
    found = what_scatters(judged_by_its_records(replace(both, sensors={1: stuck, 2: both.sensors[2]})))
    assert {each["sensor"] for each in found.noise} == {2}
    assert found.moves == ("bias_T",)
    assert "sensor 1: every run FAILed by what was recorded: no number of it is to be used" in found.sentences()


def test_nothing_that_could_be_tested_is_said_to_be_so() -> None:
    """One run alone: none, and the first words are that it means nothing."""
    full = hidden_campaign(7, mass_unbalance, thermal=False, mu=False)
    alone = only(full, full.sensors[2].conditions.run == 1)
    result = reconcile(replace(alone, verdicts={1: NOT_GOOD, 2: NOT_GOOD}, missing=["run 2"]), "matrix-6")
    assert (result.doubtful, result.without["missing"]) == ({"INCONCLUSIVE": [1]}, ["run 2"])
    assert {each["observed_deg_per_hr"] for each in what_scatters(FOLDERS["one run"]()).noise} == {None}
    result = replace(result, doubtful={}, without={}, left=Solved())
    assert result.verdict == "none"
    assert not result.tested
    assert not result.document()["tested"]
    assert what_to_do(result) == ("untested", "Take more runs before anything is concluded.")
    assert "Nobody has to act" not in page(result)
    assert "nothing but noise" not in page(result)
    told = what_to_do(replace(result, without={"missing": ["run 2"]}, doubtful={"FAIL": [1]}))[1]
    assert "what is missing of the measurement" in told
    assert "not measured well (hil report says why): run 1 (FAIL)" in told
    assert what_to_do(replace(result, tested=True, left=Solved({}, [1])))[0] == "scatter"
    told = what_to_do(replace(result, tested=True, left=Solved({}, [1], small=True)))[1]
    assert "State the standard errors that repeats" in told
    swap, drift = (
        FoundEffect("swap", "", 1.0, "named", sensors=[2], mends_labels=True),
        FoundEffect("drift", "", 1.0, "named", sensors=[2]),
    )
    found = replace(result, tested=True, verdict="named", effects=[swap, drift])
    assert what_to_do(found)[1].startswith("First see to what the record has wrong of labels and signs (below).")
    assert "First see to" not in what_to_do(replace(found, effects=[swap]))[1]
    told = what_to_do(replace(found, effects=[drift], without={"runs_used_though_failed": {"2": [1]}}))[1]
    assert told == "Use nothing of sensor 2: every run FAILed by what was recorded."
    told = what_to_do(replace(found, effects=[drift], without={"runs_used_though_failed": {"1": [1]}}))[1]
    assert told.startswith("Use nothing of sensor 1: every run FAILed by what was recorded. Use the improved model")
    quiet = replace(result, tested=True, **dict.fromkeys(("solved", "left"), Solved({"INCONCLUSIVE": [1, 2]})))
    assert what_to_do(quiet)[1].startswith("First see to what hil solve does not pass (hil report says why): runs 1–2")
    assert "Nobody has to act" not in what_to_do(quiet)[1]
    assert what_to_do(replace(quiet, doubtful={"FAIL": [1, 2]}))[1].count("runs 1–2") == 1
    failed = replace(result, contradicted=(3, 4))
    assert what_to_do(failed)[1].startswith("First see to what its own records contradict (notes): runs 3–4. Take")


@pytest.mark.slow
def test_what_scatters_beyond_standard_errors_is_no_rest_for_anybody() -> None:
    """`hil solve` FAILs the run for it, and nobody can say from it alone that the mean lacks something."""
    rows = hidden_campaign(4, lambda rows: np.zeros((len(rows.start_s), 2)), runs_each=1)
    rates = rows.sensors[2].rates_deg_per_hr + np.random.default_rng(3).normal(0.0, 4.0, (len(rows.sensors[2]), 2))
    loose = replace(rows, sensors={2: replace(rows.sensors[2], rates_deg_per_hr=rates)})
    for each, kind in ((rows, "none"), (loose, "scatter")):
        result = reconcile(each, "matrix-6-thermal", prove=False)
        failed = {s.verdict for s in solve_campaign(each) if "times what" in s.reason}
        assert result.verdict == "none"
        assert (what_to_do(result)[0], failed == {Verdict.FAIL}) == (kind, kind == "scatter")
        assert ("Nobody has to act" in page(result)) == (kind == "none")


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
        hidden_campaign(7, lambda r: both(np.exp(-(r.start_s - 3300.0) / 1680.0), 120.0, -150.0)),
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


def test_a_wrong_rate_that_was_left_out_is_something_to_see_to() -> None:
    """Nothing is missing from the model, but somebody has to look at collect 11."""
    campaign = hidden_campaign(4)
    campaign.sensors[2].rates_deg_per_hr[10, 0] += 60.0
    told = what_to_do(reconcile(campaign, "matrix-6-thermal", prove=False))[1]
    assert told.startswith("First see to ")
    assert "what is left out (below): collect 11. The model itself lacks nothing that can be told." in told


def test_what_scatters_from_run_to_run_is_not_told_from_temperature_where_nothing_was_repeated() -> None:
    """One run at each temperature: an MU that is another in each run is one that is another at each temperature."""
    asked = {}
    for runs_each in (1, 2):
        campaign = hidden_campaign(3, runs_each=runs_each)
        search = searches(pose(campaign, load_model("matrix-6"), EFFECTS), EFFECTS, VARIANCE_EFFECTS)[2]
        asked[runs_each] = {kind.effect.id for own in search.blocks for kind in own.noise.kinds}
    assert asked[2] - asked[1] == {"MU_rr"}
