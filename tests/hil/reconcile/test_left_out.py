"""What is left out of a search, and what somebody has to see to before its verdict is relied upon."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hil.campaign import Campaign, Collects
from hil.campaign.plausibility import judged_by_its_records
from hil.model import load_model
from hil.model.effects.catalogue import EFFECTS
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.outcome.page import page
from hil.reconcile.outcome.sentences import what_to_do
from hil.reconcile.proof.held_out import Predicted, _together
from hil.reconcile.result import FoundEffect, Solved
from hil.reconcile.scattering import what_scatters
from hil.reconcile.search.layout import searches
from hil.reconcile.search.posterior import Found, Posterior
from hil.reconcile.search.problem import pose
from hil.solve import solve_campaign
from hil.solve.wrong_rows import wrong_rows
from procedures.verdict import Judgement, Verdict
from tests.hil.audit.folders import FOLDERS
from tests.hil.model.effect_conditions import triad_poses
from tests.hil.reconcile.hidden_effects import ROTOR, Rows, hidden_campaign
from tests.hil.reconcile.test_names import on_the_mean

NOT_GOOD = Judgement(Verdict.INCONCLUSIVE, "moved")


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
    once = (other.conditions.run == 1) & np.isin(other.conditions.position, ("1", "2"))
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


@pytest.mark.slow
def test_a_sensor_of_which_every_run_fails_says_nothing_of_another() -> None:
    """Its thermometer shows one number all night: a bias that follows temperature would be ageing, of the other too."""
    both = FOLDERS["two sensors"]()
    columns = both.sensors[1].conditions.columns
    columns = {**columns, "temperature_degC": np.full_like(columns["temperature_degC"], 21.3)}
    stuck = replace(both.sensors[1], conditions=replace(both.sensors[1].conditions, columns=columns))
    found = what_scatters(judged_by_its_records(replace(both, sensors={1: stuck, 2: both.sensors[2]})))
    assert {each["sensor"] for each in found.answer.noise} == {2}
    assert found.moves == ("bias_T",)
    assert "sensor 1: every run FAILed by what was recorded: no number of it is to be used" in found.sentences()


@pytest.mark.slow
def test_nothing_that_could_be_tested_is_said_to_be_so() -> None:
    """One run alone: none, and the first words are that it means nothing."""
    full = hidden_campaign(7, mass_unbalance, thermal=False, mu=False, positions=("1", "2", "3"))
    alone = only(full, full.sensors[2].conditions.run == 1)
    result = reconcile(replace(alone, verdicts={1: NOT_GOOD, 2: NOT_GOOD}, missing=["run 2"]), "matrix-6")
    assert (result.doubtful, result.without["missing"]) == ({"INCONCLUSIVE": [1]}, ["run 2"])
    assert {each["observed_deg_per_hr"] for each in what_scatters(FOLDERS["one run"]()).answer.noise} == {None}
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
    both = Solved(shown={1: None, 2: None})
    found = replace(result, tested=True, verdict="named", effects=[swap, drift], solved=both)
    assert what_to_do(found)[1].startswith("First see to what the record has wrong of labels and signs (below).")
    assert "First see to" not in what_to_do(replace(found, effects=[swap]))[1]
    for calibration in ("one set", "per temperature"):
        useless = replace(found, calibration=calibration, without={"runs_used_though_failed": {"2": [1]}})
        told = what_to_do(replace(useless, effects=[drift], solved=Solved(temperatures=5)))[1]
        assert told == "Use nothing of sensor 2: every run FAILed by what was recorded."
    told = what_to_do(replace(found, effects=[drift], without={"runs_used_though_failed": {"1": [1]}}))[1]
    assert told.startswith(
        "Use nothing of sensor 1: every run FAILed by what was recorded. For sensor 2: Use the improved model"
    )
    quiet = replace(result, tested=True, **dict.fromkeys(("solved", "left"), Solved({"INCONCLUSIVE": {"2": [1, 2]}})))
    assert what_to_do(quiet)[1].startswith("First see to what hil solve does not pass (hil report says why): runs 1–2")
    assert "Nobody has to act" not in what_to_do(quiet)[1]
    assert what_to_do(replace(quiet, doubtful={"FAIL": [1, 2]}))[1].count("runs 1–2") == 1
    before, after = Solved({"FAIL": {"1": [], "2": [1, 3]}}), Solved({"INCONCLUSIVE": {"1": [1, 3], "2": [1, 3]}})
    told = what_to_do(replace(quiet, solved=before, left=after, doubtful={"INCONCLUSIVE": [1, 3]}))[1]
    explained = "runs 1, 3 of sensor 2 (FAIL by hil solve, no longer with what is known taken off)"
    assert told.startswith(
        f"First see to what was not measured well (hil report says why): runs 1, 3 (INCONCLUSIVE), {explained}"
    )
    one_of_two = Solved({"FAIL": {"1": [], "2": [1, 2]}}, beyond_errors=[1, 2])
    told = what_to_do(replace(result, tested=True, solved=one_of_two, left=one_of_two))[1]
    assert "scatter more than their standard errors say: runs 1–2 of sensor 2 (FAIL)." in told
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
        assert ("lacks nothing that can be told" in page(result)) == (kind == "none")
    of = loose.sensors[2].conditions
    heavy = replace(of, f_g=of.f_g * np.where(of.run == 2, 1.05, 1.0)[:, None])
    off = reconcile(
        replace(loose, sensors={2: replace(loose.sensors[2], conditions=heavy)}), "matrix-6-thermal", prove=False
    )
    first = "First see to what hil solve does not pass (hil report says why): run"
    assert f"{first} 1 (FAIL)" in what_to_do(result)[1]
    assert f"{first}s 1–2 (FAIL)" in what_to_do(off)[1]  # residuals are not all that it says of them


@pytest.mark.slow
def test_by_how_much_a_collect_is_off_is_one_number_in_the_words_of_hil_solve() -> None:
    """What all others show of it: how large mistakes usually are is no part of that."""
    poses = triad_poses(every_column=False)
    rates = poses.w_channels_deg_per_hr + np.random.default_rng(3).normal(0.0, 2.0, (24, 3))
    rates[16] += [60.0, -40.0, 0.0]
    seen = Collects(poses, rates, np.full(rates.shape, 2.0))
    one = Campaign("triad", "", {poses.sensor.number: seen})
    (search,) = reconcile(one, "triad-12", prove=False).rows
    (quick,) = wrong_rows(one)[poses.sensor.number].rows
    assert (search["collects"], search["why"]) == ([*quick.collects], quick.why)


@pytest.mark.slow
@pytest.mark.parametrize(("collect", "too"), [(11, ""), (12, "; or MUB of run 4 is another")])
def test_beside_values_that_follow_temperature_a_collect_is_off_by_what_hil_solve_says(collect: int, too: str) -> None:
    """The search, which knows how they do, and what is usual, had another size of the same row, beside what solve says.

    `hil scatter` says it, too, and what it may be as well. Nothing is missing from the model, but somebody has to look.
    """
    one = hidden_campaign(4, temperatures=(-10.0, 23.0, 50.0), positions=("1", "2", "3"), runs_each=3)
    one.sensors[2].rates_deg_per_hr[collect - 1, 0] += 60.0
    (quick,) = wrong_rows(one)[2].rows
    result = reconcile(one, "matrix-6-thermal", prove=False)
    for (search,) in (result.rows, what_scatters(one).document()["rows"]):
        assert (search["collects"], search["why"]) == ([collect], quick.why)
        assert quick.why.endswith(too or "from what all others show")
    (size,) = wrong_rows(one)[2].off_deg_per_hr.values()
    assert [each["size_deg_per_hr"] for each in result.outliers] == [size]
    told = what_to_do(result)[1]
    assert told.startswith("First see to ")
    assert f"what is left out (below): collect {collect}. The model itself lacks nothing that can be told." in told
