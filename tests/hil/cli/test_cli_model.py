"""Reconcile, visibility and effects from the command line: documents in the contract's keys, files written whole."""

from __future__ import annotations

import json
import re
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import pytest

from benchmarks.blind.cases import make_case, write_case
from benchmarks.blind.night import Design
from hil.campaign.reader import read_campaign
from hil.cli.model import _bar
from hil.cli.output import check_result_folder
from hil.errors import InputError
from hil.likeness import draws
from hil.model import load_model

FOUR = Design(temperatures_degC=(23.0,), runs_per_temperature=8, positions=("1", "2", "3", "4"))


@pytest.fixture
def contractors(tmp_path: Path) -> Path:
    """A unit with a spin-axis drift, at one temperature, four collects in each of eight runs."""
    case = make_case(1, ("MU_real",), 30.0, model="collins-4", design=FOUR)
    return write_case(case, tmp_path / "campaign")


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_reconcile_writes_its_three_files_and_prints_the_document(hil: Any, contractors: Path, tmp_path: Path) -> None:
    """What the contractor took for zero is named; the document printed is the file; the model gains a term.

    For people it is a screenful: verdict, name, values with units, gap. Applied twice it finds nothing more.
    """
    out = tmp_path / "out"
    ended = hil("reconcile", contractors, "--model", "collins-4", "--out", out, "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told == json.loads((out / "reconciliation.json").read_text())
    check_result_folder(out, "reconciliation.json", of=read_campaign(contractors))  # its own may be made anew
    assert told["schema"] == "hil.reconciliation/1"
    assert told["verdict"] == "named"
    assert [effect["id"] for effect in told["effects"]] == ["MU_real"]
    assert told["gap"]["after"] < told["gap"]["before"]
    assert told["simulated"] is True
    assert [term.effect for term in load_model(out / "model.yaml").terms] == ["MU_real"]
    assert "SIMULATED" in (out / "reconciliation.html").read_text()
    people = hil("reconcile", contractors, "--model", "collins-4", "--out", out).stdout
    assert "verdict: named" in people
    assert "MU_real" in people
    assert "deg/hr/g" in people
    assert len(people.splitlines()) < 40
    again = hil("reconcile", contractors, "--model", out / "model.yaml", "--out", tmp_path / "2", "--json")
    assert json.loads(again.stdout)["verdict"] == "none"


@pytest.mark.slow
def test_a_slipped_decimal_point_is_left_out_and_the_terminal_says_so(
    hil: Any, contractors: Path, tmp_path: Path
) -> None:
    """By collect, sensor and channel, and beside the improved model again: it finds nothing more."""
    table = contractors / "collects.csv"
    head, *rows = [line.split(",") for line in table.read_text().splitlines()]
    place = head.index("RA_deg_per_hr")
    rows[4][place] = str(float(rows[4][place]) * 1e3)
    table.write_text("\n".join(",".join(cells) for cells in [head, *rows]) + "\n")
    ended = hil("reconcile", contractors, "--model", "collins-4", "--out", tmp_path / "first")
    assert ended.returncode == 0, ended.stderr
    assert "left out: sensor 2, run 2: collect 5: RA is " in ended.stdout
    again = hil(
        "reconcile", contractors, "--model", tmp_path / "first" / "model.yaml", "--out", tmp_path / "2", "--json"
    )
    told = json.loads(again.stdout)
    assert told["verdict"] == "none"
    assert [(each["collect"], each["channel"]) for each in told["outliers"]] == [(5, "RA")]


def test_a_result_folder_below_a_file_is_refused(hil: Any, contractors: Path, tmp_path: Path) -> None:
    """The file that is in the way is named and stays as it is; the status is that of bad input."""
    (tmp_path / "afile").write_text("kept")
    ended = hil("reconcile", contractors, "--model", "collins-4", "--out", tmp_path / "afile" / "below")
    assert ended.returncode == 2
    assert "afile: is a file" in ended.stderr.replace("\n", "")
    assert (tmp_path / "afile").read_text() == "kept"


def test_a_folder_that_holds_something_else_is_no_place_for_a_result(tmp_path: Path) -> None:
    """Only a new folder, an empty one, or one with an earlier result of the same command."""
    check_result_folder(tmp_path, "reconciliation.json")
    (tmp_path / "notes.txt").write_text("kept")
    with pytest.raises(InputError, match=r"holds something, and no reconciliation\.json; name a new folder"):
        check_result_folder(tmp_path, "reconciliation.json")
    (tmp_path / "reconciliation.json").write_text("{}")
    check_result_folder(tmp_path, "reconciliation.json")


def test_the_result_of_another_campaign_is_not_lost(hil: Any, contractors: Path, tmp_path: Path) -> None:
    """It is another's by its title or by where it comes from; either command names it before it begins."""
    for command, own in (("reconcile --model collins-4", "reconciliation.json"), ("thermal", "thermal.json")):
        for key in ("campaign", "source"):
            campaign = read_campaign(contractors)
            there = {"campaign": campaign.title, "source": campaign.source, key: "another"}
            (tmp_path / "out" / own).parent.mkdir(exist_ok=True)
            (tmp_path / "out" / own).write_text(json.dumps(there))
            ended = hil(*command.split(), contractors, "--out", tmp_path / "out")
            assert ended.returncode == 2
            assert f"{own}: is of another campaign, {there['campaign']} ({there['source']})" in ended.stderr


def test_that_a_result_cannot_be_written_is_said_before_the_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a sentence that says what to do, of a folder in which nobody may write."""
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(InputError, match=r"out: cannot be written: .* name another folder"):
        check_result_folder(tmp_path / "out", "reconciliation.json")


def test_a_result_goes_into_no_nights_folder(hil: Any, night: Path) -> None:
    """Neither a reconciliation nor curves nor a list among its blocks; nothing that was recorded is changed."""
    before = sorted(path.name for path in night.iterdir())
    listed = ("fleet", night, "--model", "matrix-6", "--csv", night / "blocks" / "units.csv")
    reconciled = ("reconcile", night, "--model", "matrix-6")
    for command, below in ((reconciled, "blocks/new"), (("thermal", night), ""), (listed, "blocks/units.html")):
        ended = hil(*command, "--out", night / below)
        assert ended.returncode == 2
        assert "is a night's folder" in ended.stderr.replace("\n", " ")
    assert sorted(path.name for path in night.iterdir()) == before
    assert not {"new", "units.csv", "units.html"} & {path.name for path in (night / "blocks").iterdir()}


def test_a_model_that_nobody_knows_is_refused(hil: Any, contractors: Path, tmp_path: Path) -> None:
    """One sentence, and no folder."""
    ended = hil("reconcile", contractors, "--model", "matrx-6", "--out", tmp_path / "out")
    assert ended.returncode == 2
    assert "did you mean 'matrix-6'?" in ended.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_visibility_of_a_sweep_and_of_a_campaign(hil: Any, contractors: Path) -> None:
    """Both give a map in the contract's keys."""
    for arguments in (("quick", "--bench", "simulated"), (contractors,)):
        told = json.loads(hil("visibility", *arguments, "--json").stdout)
        assert told["schema"] == "hil.visibility/1"
        for effect in told["effects"]:
            assert 0.0 <= effect["kept"] <= 1.0
            assert effect["id"] in effect["class"]


def test_the_catalogue_lists_every_effect(hil: Any) -> None:
    """Each with its equation; the words for people name the same ids."""
    told = json.loads(hil("effects", "--json").stdout)
    ids = {effect["id"] for effect in told["effects"]}
    assert {"MU_real", "k2", "hyst", "settle", "arw"} <= ids
    words = hil("effects").stdout
    assert all(identifier in words for identifier in ids)


def test_too_few_nights_to_tell_by_are_refused_in_a_sentence(hil: Any, contractors: Path, tmp_path: Path) -> None:
    """Nothing is begun, and nothing is left behind."""
    ended = hil("twin", contractors, "--model", "collins-4", "--draws", 1, "--out", tmp_path / "kept")
    assert ended.returncode == 2
    assert "3 at least" in ended.stderr
    assert not (tmp_path / "kept").exists()


def test_draws_may_be_kept_beside_a_model_that_they_do_not_touch(hil: Any, contractors: Path, tmp_path: Path) -> None:
    """The folder of a result is no reason to refuse: what is asked next is how many nights there are to be."""
    (tmp_path / "model.yaml").write_text("somebody's")
    ended = hil("twin", contractors, "--model", "collins-4", "--draws", 1, "--out", tmp_path)
    assert "3 at least" in ended.stderr
    assert (tmp_path / "model.yaml").read_text() == "somebody's"


def test_how_long_the_other_simulated_nights_take_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    """From the first on, however slow a machine is, and of all that a command simulates."""
    with _bar(24) as done:
        done(1)
        done(1)
    assert re.fullmatch(r"(simulated night \d of 24, \d+ s to go\n){2}", capsys.readouterr().err)


@pytest.mark.slow(seconds=12)
@pytest.mark.usefixtures("searched_once")
def test_the_twin_tells_the_model_that_lacks_something_and_not_the_one_that_reconcile_wrote(
    hil: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before and after, in the result; asked by itself it says the same of what is kept, also for people.

    Two processes simulate the nights before, this one those after.
    """
    most = chain([2], repeat(1))
    monkeypatch.setattr(draws, "processes", lambda count, of=draws.processes: of(min(count, next(most))))
    design = Design((23.0,), 4, ("1", "2", "3", "4"), restabilisation_s=300.0)
    campaign = write_case(make_case(1, ("MU_real",), 30.0, model="collins-4", design=design), tmp_path / "campaign")
    out, few = tmp_path / "out", ("--draws", 6)
    ended = hil("reconcile", campaign, "--model", "collins-4", "--out", out, "--twin", *few, "--json")
    assert ended.returncode == 0, ended.stderr
    assert re.search(r"simulated night 7 of 12, \d+ (s|min) to go\n", ended.stderr)
    told = json.loads(ended.stdout)["twin"]
    assert (told["draws"], told["seed"]) == (6, 1)
    assert told["before"]["p_value"] < 1e-3
    assert told["after"]["p_value"] > 0.05
    kept = ("twin", campaign, "--model", "collins-4", "--out", out / "twin-before", *few)
    document = json.loads(hil(*kept, "--json").stdout)
    assert document["schema"] == "hil.twin/1"
    assert document["p_value"] == told["before"]["p_value"]
    people = hil(*kept).stdout
    assert "the night can be told from them" in people
    assert "ask for 20 or more)\n  averages, beside the fitted model: " in people
    again = hil("reconcile", campaign, "--model", "collins-4", "--out", out, "--twin", *few).stdout
    assert "(6 draws) (beyond the most unlike of so few draws it is an estimate that others may not repeat" in again
    assert "may not repeat: ask for 20 or more)." in (out / "reconciliation.html").read_text()
    assert "SIMULATED" in people
    assert "degC" not in people
