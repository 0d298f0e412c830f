"""What is done with the curves afterwards: another night is corrected by them, and they are believed no further."""

from __future__ import annotations

import csv
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.published.table import read_published_table
from hil.analysis.thermal.document import parameter_in_words, thermal_document, verdict_in_words
from hil.analysis.thermal.files import autopilot_files
from hil.analysis.thermal.fit import SensorFit, fit_thermal
from hil.campaign import Campaign
from hil.campaign.writer import write_campaign
from hil.cli.app import run
from hil.model import Model, load_model, save_model
from hil.reconcile import reconcile
from hil.solve import repeats, solve_campaign
from hil.solve.document import first_in_words
from procedures.verdict import Judgement, Verdict
from tests.hil.analysis.thermal.nights import PUBLISHED_DEGC, Curve, rotor_night, scaled, triad_night

ROTOR: dict[str, Curve] = {
    "BA": lambda t: 20.0 + 15.0 * scaled(t),
    "BB": lambda t: -5.0 + 40.0 * scaled(t),
    "GSA": lambda t: 55.0 + 10.0 * scaled(t),
    "MUB": lambda t: 20.0 * scaled(t) ** 2,
}
BIASES: dict[str, Curve] = {
    "BX": lambda t: 50.0 + 90.0 * scaled(t),
    "BY": lambda t: -20.0 + 120.0 * scaled(t) ** 2,
    "BZ": lambda t: 10.0 + 60.0 * (4 * scaled(t) ** 3 - 3 * scaled(t)),
}
DEG_PER_HR = np.pi / 180.0 / 3600.0


def values(text: str) -> dict[str, float]:
    """Read a parameter file: tab-separated with a type, or name and value."""
    rows = [line.split() for line in text.splitlines() if line and not line.startswith("#")]
    return {row[-3] if len(row) == 5 else row[0]: float(row[-2] if len(row) == 5 else row[1]) for row in rows}


def px4_offset(parameters: dict[str, float], axis: int, degC: np.ndarray) -> np.ndarray:
    """As PX4 does: temperature held within its limits, a cubic from TREF, rad/s; it is subtracted."""
    held = np.clip(degC, parameters["TC_G0_TMIN"], parameters["TC_G0_TMAX"]) - parameters["TC_G0_TREF"]
    return np.asarray(sum(parameters[f"TC_G0_X{power}_{axis}"] * held**power for power in range(4)))


def ardupilot_offset(parameters: dict[str, float], axis: str, degC: np.ndarray) -> np.ndarray:
    """As ArduPilot does: held within its limits, three powers from 35 °C, 1e-6 rad/s, all without the constant."""
    held = np.clip(degC, parameters["INS_TCAL1_TMIN"], parameters["INS_TCAL1_TMAX"]) - 35.0
    return np.asarray(sum(1e-6 * parameters[f"INS_TCAL1_GYR{power}_{axis}"] * held**power for power in (1, 2, 3)))


def rms(rates: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(rates**2)))


@pytest.fixture(scope="module")
def triad() -> SensorFit:
    """A three-axis triad's biases against temperature."""
    return fit_thermal(triad_night(np.random.default_rng(13), BIASES)).sensors[1]


@pytest.mark.slow
def test_the_parameter_files_take_the_bias_off_another_night(triad: SensorFit) -> None:
    """Applied as the autopilots do to a night that the fit never saw, what remains is its noise of 2 deg/hr."""
    px4, ardupilot = map(values, autopilot_files(triad).values())
    other = triad_night(np.random.default_rng(99), BIASES).sensors[1]
    degC, measured = other.conditions.columns["temperature_degC"], other.rates_deg_per_hr * DEG_PER_HR
    assert rms(measured) > 60.0 * DEG_PER_HR
    near_25 = np.argsort(np.abs(degC - 25.0))[:12]
    for axis, letter in enumerate("XYZ"):
        assert rms(measured[:, axis] - px4_offset(px4, axis, degC)) < 2.5 * DEG_PER_HR
        # The board finds its own offset at the temperature of its gyro calibration.
        own = measured[near_25, axis].mean()
        change = ardupilot_offset(ardupilot, letter, degC) - ardupilot_offset(ardupilot, letter, degC[near_25].mean())
        assert rms(measured[:, axis] - change - own) < 3.0 * DEG_PER_HR


@pytest.mark.slow
def test_the_parameter_files_reach_no_further_than_what_was_measured(triad: SensorFit) -> None:
    """Their limits are the lowest and highest temperature; beyond, the autopilots hold the value at the limit."""
    low, high = triad.layout.range_degC
    px4, ardupilot = map(values, autopilot_files(triad).values())
    for name, parameters in (("TC_G0", px4), ("INS_TCAL1", ardupilot)):
        assert parameters[f"{name}_TMIN"] == pytest.approx(low, abs=0.051)
        assert parameters[f"{name}_TMAX"] == pytest.approx(high, abs=0.051)
    assert px4_offset(px4, 2, np.array(90.0)) == px4_offset(px4, 2, np.array(high))


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    """The curves of a night, written and read back."""
    path = tmp_path_factory.mktemp("thermal") / "model.yaml"
    save_model(fit_thermal(rotor_night(np.random.default_rng(1), ROTOR, run_to_run={})).model(), path)
    return load_model(path)


@pytest.mark.slow
def test_reconcile_finds_nothing_missing_beside_the_curves_of_the_same_unit(model: Model) -> None:
    """On another night of the same unit: no verdict but none, and its values hold as they stand."""
    night = rotor_night(np.random.default_rng(2), ROTOR, run_to_run={})
    document = reconcile(night, model).document()
    assert document["verdict"] == "none"
    assert document["gap"]["before"] == pytest.approx(document["gap"]["noise_floor"], rel=0.1)
    assert not any("as they stand are off" in note for note in document.get("notes", []))


@pytest.mark.slow
@pytest.mark.parametrize("command", ["reconcile", "budget"])
def test_no_command_reckons_with_the_curves_beyond_their_range(
    model: Model, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A night that goes to 85 °C is refused with the range, status 2, and nothing is written."""
    save_model(model, tmp_path / "thermal.yaml")
    hot = rotor_night(np.random.default_rng(3), ROTOR, temperatures_degC=(20.0, 50.0, 85.0), run_to_run={})
    write_campaign(hot, tmp_path / "hot")
    out = ["--out", str(tmp_path / "out")] if command == "reconcile" else []
    assert run([command, str(tmp_path / "hot"), "--model", str(tmp_path / "thermal.yaml"), *out]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "is outside" in said
    assert "Traceback" not in said
    assert not (tmp_path / "out").exists()


def nested_error(temperature: np.ndarray, means: np.ndarray) -> tuple[float, float]:
    """Return the rms error at left-out temperatures: of a constant, and of the order chosen without each, by hand."""

    def left_out(t: np.ndarray, y: np.ndarray, order: int) -> np.ndarray:
        rest = [np.delete(np.arange(len(t)), place) for place in range(len(t))]
        return np.array([y[i] - np.polyval(np.polyfit(t[r], y[r], order), t[i]) for i, r in enumerate(rest)])

    chosen = []
    for place in range(len(temperature)):
        t, y = np.delete(temperature, place), np.delete(means, place)
        order = min(range(4), key=lambda o: rms(left_out(t, y, o)))
        chosen.append(means[place] - np.polyval(np.polyfit(t, y, order), temperature[place]))
    return rms(left_out(temperature, means, 0)), rms(np.array(chosen))


@pytest.mark.slow
def test_on_table_1_only_bb_is_confirmed_by_temperatures_that_did_not_choose_its_form(reference: Path) -> None:
    """BA's line and MUA's cubic were chosen by the very temperatures that they then predict; reckoned again by hand."""
    with (reference / "table1.csv").open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    sensor = fit_thermal(read_published_table(reference / "table1.csv")).sensors[2]
    for name, confirmed in (("BA", False), ("BB", True), ("MUA", False), ("MUB", False)):
        own = [row for row in rows if row["parameter"] == f"{name}2_matrix"]
        degC = (np.array([float(row["temperature_F"]) for row in own]) - 32.0) / 1.8
        constant, modelled = nested_error(degC, np.array([float(row["mean_printed"]) for row in own]))
        assert (modelled < 0.8 * constant) == confirmed
        found = sensor.parameters[name]
        assert found.is_confirmed == confirmed
        assert (found.improvement.modelled < 0.8 * found.improvement.constant) == confirmed
    words = parameter_in_words(sensor.parameters["MUA"])
    assert "by 5.21 deg/hr/g, a constant by 19.3" in words
    assert "by 17.1: not confirmed" in words


@pytest.mark.slow
def test_what_nothing_repeats_is_said_to_be_dependence_or_scatter() -> None:
    """One run at each temperature, and the unit scatters from run to run: the notes say what that looks like."""
    once = fit_thermal(rotor_night(np.random.default_rng(4), {}, runs=1)).sensors[2]
    assert any("measured twice: what the curves leave is taken for noise" in note for note in once.notes)
    often = fit_thermal(rotor_night(np.random.default_rng(4), {}, runs=2)).sensors[2]
    assert not any("measured twice" in note for note in often.notes)
    back = (*PUBLISHED_DEGC, *PUBLISHED_DEGC[-2::-1])
    both = fit_thermal(rotor_night(np.random.default_rng(4), {}, temperatures_degC=back, runs=1)).sensors[2]
    assert not any("measured twice" in note for note in both.notes)


def test_few_temperatures_are_said_to_choose_and_to_judge_at_once() -> None:
    """With four there are too few left to choose a form without the one that is predicted: nothing is confirmed."""
    steep: dict[str, Curve] = {"BB": lambda t: 90.0 * scaled(t)}
    four = fit_thermal(rotor_night(np.random.default_rng(5), steep, temperatures_degC=PUBLISHED_DEGC[::2]))
    (sensor,) = thermal_document(four)["sensors"]
    assert sensor["parameters"]["BB"]["finding"] == "modelled"
    assert sensor["parameters"]["BB"]["confirmed"] is False
    assert sensor["parameters"]["BB"]["improvement"]["form_chosen_anew"] is False
    assert "too few temperatures to confirm the forms" in sensor["verdict"]["words"]


@pytest.mark.parametrize(
    ("command", "there", "model"),
    [
        ("thermal", "reconciliation.json", "matrix-6"),
        ("reconcile", "thermal.json", "matrix-6"),
        ("reconcile", "mine.txt", "matrix-6"),
        ("reconcile", "reconciliation.json", "out/model.yaml"),
    ],
)
def test_one_result_does_not_take_the_place_of_another(
    command: str, there: str, model: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both commands write model.yaml: where one is that the command did not make, or begins with, nothing changes."""
    write_campaign(small_night(rotor_night), tmp_path / "campaign")
    (tmp_path / "out").mkdir()
    for name in (there, "model.yaml"):
        (tmp_path / "out" / name).write_text("kept\n")
    from_model = ["--model", str(tmp_path / model) if "/" in model else model]
    assert run([command, str(tmp_path / "campaign"), *from_model, "--out", str(tmp_path / "out")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "name a new folder" in said or "name another folder" in said
    assert {path.read_text() for path in (tmp_path / "out").iterdir()} == {"kept\n"}
    assert len(list((tmp_path / "out").iterdir())) == 2


def small_night(make: Callable[..., Campaign]) -> Campaign:
    """Three temperatures, one run each."""
    return make(np.random.default_rng(6), {}, temperatures_degC=(0.0, 20.0, 40.0), runs=1, run_to_run={})


@pytest.mark.slow
def test_a_step_is_no_line_and_one_outlying_temperature_is_no_polynomial() -> None:
    """A line through a step leaves a misfit, which is said; of one temperature far off no form is made."""
    step: dict[str, Curve] = {
        "BA": lambda t: np.where(t > 0.0, 20.0, -20.0),
        "BB": lambda t: 20.0 + 35.0 * (np.abs(t - 23.4) < 4.0),
    }
    found = fit_thermal(rotor_night(np.random.default_rng(8), step)).sensors[2].parameters
    assert "does not go through all values within their noise" in parameter_in_words(found["BA"])
    assert found["BB"].finding == "undescribed"
    assert found["BB"].form == "constant"


def test_table_1s_steepest_segment_is_that_of_the_soaks_bound(reference: Path) -> None:
    """BB from 6.1 to 19.7 °F: 1.85 deg/hr per °C; MU aside nothing in the table is steeper. The cold end: 1.57."""
    with (reference / "table1.csv").open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    slopes = {}
    for name in ("BA2_matrix", "BB2_matrix"):
        own = [row for row in rows if row["parameter"] == name]
        degC = (np.array([float(row["temperature_F"]) for row in own]) - 32.0) / 1.8
        slopes[name] = np.abs(np.diff([float(row["mean_printed"]) for row in own]) / np.diff(degC))
    assert np.max(list(slopes.values())) == slopes["BB2_matrix"][1] == pytest.approx(1.848, abs=1e-3)
    assert slopes["BB2_matrix"][0] == pytest.approx(1.57, abs=0.01)
    assert 1.5 * slopes["BB2_matrix"][1] * 0.19 * 2.0 == pytest.approx(1.05, abs=0.01)


@pytest.mark.slow
def test_the_parameter_files_say_what_stands_on_weak_feet(triad: SensorFit) -> None:
    """A confirmed bias has no remark; one that no form describes, and one that nothing confirms, have one each."""
    assert "confirm" not in autopilot_files(triad)["px4.params"]
    assert "no form describes" not in autopilot_files(triad)["ardupilot.parm"]
    jagged = {"BX": lambda t: 40.0 * (np.abs(t - 23.4) < 4.0)}
    four = np.isin(np.arange(96) // 12, (0, 3, 5, 7))
    rotating = triad_night(np.random.default_rng(21), {**jagged, "BY": lambda t: 200.0 * scaled(t)})
    text = autopilot_files(fit_thermal(rotating).sensors[1])["px4.params"]
    assert "# BX: differs between temperatures, and no form describes how; constant is held here" in text
    few = replace(rotating, sensors={1: rotating.sensors[1].rows(four)})
    assert (
        "# BY: temperatures that did not choose its form do not confirm it"
        in autopilot_files(fit_thermal(few).sensors[1])["ardupilot.parm"]
    )


@pytest.mark.slow
def test_a_run_that_no_curve_goes_through_is_none_to_see_to_before_it_is_used() -> None:
    """One that FAILed by what was recorded is in `runs_not_used`: thermal had said FAIL, and reconcile nothing."""
    night = rotor_night(np.random.default_rng(5), ROTOR)
    document = thermal_document(fit_thermal(replace(night, verdicts={3: Judgement(Verdict.FAIL, "the door was open")})))
    assert document["runs_not_used"] == {"2": [3]}
    assert document["runs_not_solved"] == {}


@pytest.mark.slow
@pytest.mark.parametrize(("share", "said"), [(-0.22, "(22 % more; 93 % more to 63 % less "), (0.4, "(40 % less; ")])
def test_curves_that_are_worse_than_constants_are_wrong_by_more(triad: SensorFit, share: float, said: str) -> None:
    """Minus 22 % less is 22 % more."""
    fit = copy(triad)
    fit.improvement = copy(triad.improvement)
    fit.improvement.share, fit.improvement.low, fit.improvement.high = share, -0.93, 0.63
    assert said in verdict_in_words(fit)


@pytest.mark.slow
def test_curves_that_take_next_to_nothing_away_hardly_improve_a_unit(triad: SensorFit) -> None:
    """Two hundredths less, however certain: it stands there as what it is."""
    fit = copy(triad)
    fit.improvement = copy(triad.improvement)
    assert "temperature improves this unit" in verdict_in_words(fit)
    fit.improvement.share = 0.02
    assert "temperature hardly improves this unit" in verdict_in_words(fit)
    assert "none was reached from both sides: it may be time" in verdict_in_words(fit)


def test_before_a_curve_is_used_the_runs_are_named_that_do_not_pass() -> None:
    """That modelling improves a unit stands beside no run that says nothing without saying so."""
    found = {"FAIL": {"1": [3], "2": [3]}, "INCONCLUSIVE": {"1": [], "2": [1, 2]}}
    words = first_in_words({"runs_not_solved_by_sensor": found}, "a curve")
    assert words == [
        (
            "before a curve is used, see to what hil solve does not pass (hil report says why): "
            "run 3 (FAIL), runs 1–2 of sensor 2 (INCONCLUSIVE)"
        )
    ]
    assert first_in_words({}, "a curve") == []


@pytest.mark.parametrize(("slope", "few"), [(15.0, True), (0.0, False)])
def test_what_only_too_few_repeats_leave_to_chance_is_said_to_be_so(slope: float, few: bool) -> None:
    """Four temperatures, one of them twice: hil reconcile names it, by forty standard errors."""
    made = rotor_night(
        np.random.default_rng(1),
        {"GSA": lambda t: slope * scaled(t)},
        temperatures_degC=(-30.0, 0.0, 30.0, 60.0),
        runs=2,
        run_to_run={},
    )
    rows = made.sensors[2].rows(~np.isin(made.sensors[2].conditions.run, (4, 6, 8)))
    found = fit_thermal(replace(made, sensors={2: rows})).sensors[2].parameters["GSA"]
    assert found.finding == "constant"
    assert ("but 1 repeat does not tell noise well enough" in parameter_in_words(found)) is few


@pytest.mark.slow
def test_one_run_at_each_temperature_is_no_surer_than_two() -> None:
    """What nobody repeated may differ from run to run by any amount: by standard errors alone it seemed to depend."""
    scatter = {"BA": 6.0, "BB": 6.0}
    once, twice = (rotor_night(np.random.default_rng(2), {}, runs=runs, run_to_run=scatter) for runs in (1, 2))
    alone, again = (fit_thermal(made).sensors[2] for made in (once, twice))
    for found in (alone, again):
        assert {name: each.finding for name, each in found.parameters.items() if name in scatter} == {
            "BA": "constant",
            "BB": "constant",
        }
    assert "sensor 2: no temperature was measured twice: what the curves leave is taken for noise" in alone.notes
    of_run = repeats(once, solve_campaign(once))[2].of_each[1]
    assert alone.parameters["BA"].repeatability == pytest.approx(of_run["BA"], rel=0.1)  # which has no more
    sloped = rotor_night(np.random.default_rng(2), {"BA": lambda t: 60.0 * scaled(t)}, runs=1, run_to_run=scatter)
    assert fit_thermal(sloped).sensors[2].parameters["BA"].finding == "modelled"
