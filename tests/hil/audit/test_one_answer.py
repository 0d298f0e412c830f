"""One question, one answer: every command's document over small folders of every kind, laid side by side.

The questions, and where each command keeps its answer, stand in `questions`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.analysis.allan.sources import read_recording
from hil.campaign import Series
from hil.campaign.reader import read_campaign
from hil.campaign.stand_ins import OWN
from hil.campaign.writer import write_campaign
from hil.cli.app import run
from hil.model.forms import named_form
from hil.reconcile import reconcile
from hil.reconcile.outcome.sentences import what_to_do
from hil.reconcile.scattering import what_scatters
from hil.report.content import gather, headline, to_do
from hil.solve.both_sensors import common_and_differential
from hil.solve.wrong_rows import USED, wrong_rows
from tests.hil.audit.folders import FOLDERS, night_that_ended_early, written
from tests.hil.audit.questions import ANSWERS, BESIDE, COMMANDS, FIRST, IN_COMMON, MODEL, READ, Ask
from tests.hil.solve.runs_of_a_unit import campaign, with_rates


@pytest.fixture
def ask(request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Ask:
    """Return a function that gives a command's document of the folder, None where it says that it has no answer."""
    folder = written(request.param, tmp_path / "campaign")
    known: dict[str, dict[str, Any] | None] = {}

    def asked(command: str) -> dict[str, Any] | None:
        if command not in known:
            assert command not in FIRST or run(FIRST[command](folder)) == 0
            capsys.readouterr()
            status = run({**COMMANDS, **BESIDE}[command](folder, MODEL.get(request.param, "matrix-6")))
            assert status in (0, 2, 4), f"{command}: {capsys.readouterr().err}"
            known[command] = READ.get(command, json.loads)(capsys.readouterr().out) if status != 2 else None
        return known[command]

    return asked


MAY_HAVE_NONE = ("history", "reconcile", "scatter", "solve, where nobody stated it")


def disagreements(ask: Ask, commands: tuple[str, ...]) -> Iterator[str]:
    """Yield every question that two commands answer differently."""
    for question, places in ANSWERS.items():
        asked = {key: key.partition(",")[0] for key in places}
        told = {
            key: places[key](document)
            for key, command in asked.items()
            if command in commands and (document := ask(command)) is not None
        }
        first = next(iter(told), "")
        for command, answer in told.items():
            # Thermal leaves out temperatures at which not every parameter can be told: of means what both have.
            # A budget is of one run.
            some = question in IN_COMMON
            keys = set(answer) & set(told[first]) if some else set(answer) | set(told[first])
            # An archive keeps nothing of what must not be relied upon; a search may have no value to tell.
            nothing = command in MAY_HAVE_NONE and not (answer and told[first])
            assert keys or nothing or not some, f"{question}: {first} and {command} have nothing in common"
            for key in keys:
                one, other = told[first].get(key), answer.get(key)
                if one != (pytest.approx(other, rel=1e-6, abs=1e-9) if isinstance(other, float) else other):
                    yield f"{question}: {key}: {first} {one}, {command} {other}"


IN_ANOTHER = {
    *("good", "one standard error huge", "one run without its thermometer", "no thermometer of its own"),
    *("labels exchanged", "two sensors", "one channel noisy", "after a pause"),
}
"""Folders of which another one has all: what is whole and measured, each gap, one exchange, two equal plans."""


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once", "only_answers")
@pytest.mark.parametrize("ask", [name for name in FOLDERS if name not in IN_ANOTHER], indirect=True)
def test_all_commands_agree(ask: Ask) -> None:
    """And those that search: what is wrong with rows, and that what is printed is simulated."""
    assert list(disagreements(ask, (*COMMANDS, *BESIDE))) == []


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_what_is_suspicious_is_said_to_people_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Beside the result, or instead of one, by every command that reads the folder."""
    for name, refuses in (("labels exchanged", ()), ("poses, one wrong", ("thermal",))):
        folder = written(name, tmp_path / name)
        (suspicious,) = read_campaign(folder).warnings
        for command in ("solve", "thermal", "budget", "visibility", "scatter", "report"):
            words = {**COMMANDS, **BESIDE}[command](folder, "matrix-6")
            assert run([word for word in words if word != "--json"]) == (2 if command in refuses else 0)
            assert capsys.readouterr().err.count(f"warning: {suspicious}\n") == 1, command


@pytest.mark.slow
def test_a_screen_says_which_runs_fail(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is not green where a run FAILs, whether or not the model lacks anything."""
    folder, page = written("labels exchanged", tmp_path / "campaign"), tmp_path / "fleet.html"
    assert run(["fleet", str(folder), "--model", "matrix-6", "--out", str(page)]) == 0
    assert (
        f"FAIL by what was recorded, and screened all the same: {folder} (run 5); hil solve" in capsys.readouterr().out
    )
    assert '<section class="verdict FAIL"' in page.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("ask", ["two plans"], indirect=True)
def test_a_sensor_that_cannot_be_fitted_hides_no_other(ask: Ask) -> None:
    """Thermal answers of sensor 2 and says why not of sensor 1; a headline counts each sensor's own."""
    document = ask("thermal")
    assert document is not None
    assert [each["sensor"] for each in document["sensors"]] == [2]
    assert [(each["sensor"], "2 temperatures" in each["why"]) for each in document["not_fitted"]] == [(1, True)]
    said = headline(gather(FOLDERS["two plans"]()))
    assert said.startswith("sensor 1: 6 self-calibrations at 2 temperatures; sensor 2: 12 self-calibrations at 4 temp")
    assert headline(gather(FOLDERS["clipped"]())).startswith("12 self-calibrations at 4 temperatures, 1 sensor: 7 PASS")


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
@pytest.mark.parametrize(("name", "together"), [("both sensors disturbed", True), ("two sensors", False)])
def test_what_moves_both_sensors_is_said_wherever_somebody_asks_what_scatters(
    tmp_path: Path, name: str, together: bool
) -> None:
    """With what is to be done: by the report's first screen and reconcile's verdict, too; not where each is alone."""
    one = FOLDERS[name]()
    both = common_and_differential(one)
    assert both is not None
    assert bool(both.look_for) is together
    said = [" ".join(to_do(gather(one))), what_to_do(reconcile(one, "matrix-6"))[1]]
    assert ["what moves sensors 1 and 2 together" in each for each in said] == [together, together]
    assert set(both.sentences()) <= set(what_scatters(one).sentences())
    noise = np.random.default_rng(1).normal(0.0, 1.0, (64, 2))
    rates = one.sensors[2].rates_deg_per_hr[3] + noise - noise.mean(axis=0)
    write_campaign(replace(one, recorded={40: lambda: Series(np.arange(64.0), rates)}), folder := tmp_path / name)
    notes = read_recording(folder, channel="RA", sensor=2).notes
    assert [any(said in note for note in notes) for said in both.sentences()] == [together]


@pytest.mark.slow
def test_nobody_is_sent_to_look_for_what_has_just_been_named() -> None:
    """Both sensors follow the supply, another in each run: that is the finding, and what is left moves neither."""
    one, moved = FOLDERS["two sensors"](), np.repeat(np.random.default_rng(3).normal(0.0, 0.02, 12), 3)
    for number, rows in one.sensors.items():
        columns = {**rows.conditions.columns, "supply_V": 28.0 * (1.0 + moved)}
        one = with_rates(one, rows.rates_deg_per_hr + 100.0 * moved[:, None] * [4.0, -3.0], number)
        conditions = replace(rows.conditions, columns=columns)
        one = replace(one, sensors={**one.sensors, number: replace(one.sensors[number], conditions=conditions)})
    found = reconcile(one, "matrix-6", prove=False)
    assert "supply" in {effect.id for effect in found.effects}
    assert any("move together from run to run" in note for note in found.notes)
    assert "together" not in what_to_do(found)[1]


@pytest.mark.slow
def test_what_parts_a_bias_at_each_temperature_from_its_rival_is_what_parts_the_effect_of_that_name() -> None:
    """Any collects tell a bias; whether it follows temperature or remembers it, no further collect of a climb does."""
    one = campaign(9, 3, seed=211, scatter=0.3)
    rows = one.sensors[2]
    columns = rows.conditions.columns | {"case_degC": rows.conditions.columns["temperature_degC"] + 2.0}
    recorded = replace(rows, conditions=replace(rows.conditions, columns=columns))
    asked = reconcile(replace(one, sensors={2: recorded}), "matrix-6", prove=False).next_experiment
    assert asked is not None
    assert asked["why"].startswith("no stationary collect that was tried separates bias_T from ")
    assert asked["why"].endswith("Revisit every temperature from both directions and on another day")


@pytest.mark.slow
@pytest.mark.parametrize("ask", ["poses, dead channel"], indirect=True)
def test_a_dead_channel_has_no_value_and_no_pass(ask: Ask) -> None:
    """What is exactly 0 in every pose was not measured; the other channels have their values, and scatter answers."""
    document = ask("solve")
    assert document is not None
    (solved,) = document["solutions"]
    assert solved["verdict"] == "FAIL"
    assert "GY: every rate is exactly 0: nothing was measured" in solved["reason"]
    assert {name for name, of in solved["parameters"].items() if of["value"] is None} == {"BY", "GYX", "GYY", "GYZ"}
    assert ask("scatter") is not None
    screened = ask("fleet")
    assert screened is not None
    assert {(*of["channels"], of["done"]) for of in screened["units"][0]["rows"]} == {("GY", "left out")}


@pytest.mark.parametrize(
    "ask",
    [
        "labels exchanged",
        "labels exchanged, two runs",
        "one rate far off",
        "poses, one wrong",
        "one run, one rate far off, beside another sensor",
    ],
    indirect=True,
)
def test_no_run_that_rests_on_a_wrong_row_passes(ask: Ask) -> None:
    """Whatever was done about it; and the row is named in the verdict's cause."""
    document = ask("solve")
    assert document is not None
    assert document["rows"]
    for each in document["rows"]:
        (solved,) = (s for s in document["solutions"] if (s["run"], s["sensor"]) == (each["run"], each["sensor"]))
        assert solved["verdict"] != "PASS"
        assert str(each["collects"][0]) in solved["reason"] or each["done"] == "used"


def test_what_fits_another_sensor_as_well_as_any_is_not_this_ones() -> None:
    """Its rates leave nothing over here, as those of any sensor; what is said to be the other's has to agree there."""
    found = wrong_rows(FOLDERS["one run, one rate far off, beside another sensor"]())
    assert [(row.run, row.done) for row in found[2].rows] == [(1, USED)]
    assert "contradicts itself: collect 2: RA is +300.8 deg/hr, or collect 3" in found[2].rows[0].why
    assert not found[1].rows


@pytest.mark.slow
def test_the_only_run_at_a_temperature_is_not_wrong_for_being_there() -> None:
    """Nor any of its collects, nor its labels: nothing is there to compare it with."""
    result = reconcile(night_that_ended_early(7), "matrix-6", prove=False)
    assert result.rows == []
    assert not [effect for effect in result.effects if effect.mends_labels or "run 4" in effect.id]


def test_of_two_collects_that_contradict_each_other_people_are_told_both() -> None:
    """Of two runs nobody knows which is wrong: the search's note says so, as its document does."""
    one = campaign(2, 2, seed=1, scatter=0.5)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[4, 0] += 60.0
    result = reconcile(with_rates(one, rates), "matrix-6", prove=False)
    (row,) = result.rows
    assert "collect 2 may be, in its place" in row["why"] or "collect 5 may be, in its place" in row["why"]
    assert [note for note in result.notes if row["why"] in note]


@pytest.mark.parametrize("ask", ["short soaks"], indirect=True)
def test_a_temperature_says_whose_it_is_and_a_soak_that_did_not_end_is_no_pass(ask: Ask) -> None:
    """The unit's own thermometer moved by more than one temperature through the runs of each setpoint."""
    document = ask("solve")
    assert document is not None
    assert {mean["temperature_of"] for mean in document["repeats"]["2"]["means"]} <= {
        "setpoint_degC",
        "temperature_degC",
    }
    early = [each for each in document["solutions"] if each["run"] % 3 == 1]
    assert {each["verdict"] for each in early} == {"MARGINAL"}
    assert all("the soak had not ended" in each["reason"] for each in early)
    for mean in document["repeats"]["2"]["means"]:
        assert mean["unit_degC"][1] - mean["unit_degC"][0] > 2.5
        assert all(run % 3 != 1 for run in mean["runs"])  # which repeat nothing that had settled
    ask("thermal")  # says that it cannot, or answers with finite numbers; no internal error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ask", "lacks", "other", "of"),
    [
        ("no thermometer of its own", "", "chamber_degC", "chamber_degC"),
        ("one run without its thermometer", " in run 5", "the unit's mean through the same setpoint", OWN),
    ],
    indirect=["ask"],
)
def test_what_stands_in_for_a_thermometer_does_so_whoever_asks(ask: Ask, lacks: str, other: str, of: str) -> None:
    """A fit against temperature, a map of what can be seen, a form: none says beside it that temperature is lacking."""
    solved, fitted, seen = ask("solve"), ask("thermal"), ask("visibility")
    assert solved is not None
    said = f"sensor 2: temperature_degC is not recorded{lacks}; {other} stands in for it"
    assert solved["warnings"] == [said]
    assert fitted is not None
    (sensor,) = fitted["sensors"]
    assert (sensor["temperature_of"], "without temperature" in str(sensor["notes"])) == (of, False)
    assert seen is not None
    assert seen["forms"] == {"2": "matrix-6-thermal"}
    without = FOLDERS["no thermometer of its own"]().sensors[2].conditions
    assert named_form("matrix-6-thermal", without).reason == "quadratics in chamber_degC about 10 degC"
