"""A night whose sweep names limits: its verdict and whether the unit is in spec, beside each other, everywhere."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml

from hil.dashboard.facts import NightFacts
from hil.night.notify import in_words_at_the_end
from hil.records import open_readonly
from tests.hil.cli.conftest import SHORT_SWEEP, Run

WIDE = {"title": "wide", "origin": "a test", "sensors": {2: {"BA": {"low": "-90 deg/hr", "high": "90 deg/hr"}}}}


@pytest.fixture(scope="module")
def judged(hil: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short night with the limits that are out of reach of its GSA."""
    folder = tmp_path_factory.mktemp("judged")
    narrow = {**WIDE, "title": "narrow", "sensors": {2: {"GSA": {"high": "10 deg/hr/g"}}}}
    for name, what in (("narrow", narrow), ("wide", WIDE), ("sweep", {**SHORT_SWEEP, "limits": "narrow"})):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(what))
    ended = hil("run", folder / "sweep.yaml", "--bench", "simulated", "--out", folder / "night", "--quiet")
    assert ended.returncode == 0, ended.stderr
    assert re.search(r"\nPASS: .*\nOUT OF SPEC: 2 of 2 limits broken, by guard band of 2 standard unc", ended.stderr)
    return folder


def test_every_place_says_both(hil: Run, judged: Path) -> None:
    """Status, its JSON, the live page, the last message; the measurement stays PASS, and the exit status 0."""
    status = hil("status", judged / "night", "--json")
    document = json.loads(status.stdout)
    assert (status.returncode, document["judgement"]["verdict"]) == (0, "PASS")
    assert (document["in_spec"]["verdict"], document["in_spec"]["title"]) == ("out of spec", "narrow")
    said = hil("status", judged / "night").stdout
    assert "OUT OF SPEC: 2 of 2" in said
    assert "to do: with the measurement nothing, but the unit is out of spec" in said
    facts = NightFacts(judged / "night", "night")
    head = facts.look()["head"]
    assert (head["verdict"]["verdict"], head["in_spec"]) == ("PASS", document["in_spec"])
    with open_readonly(judged / "night") as journal:
        assert "; PASS; OUT OF SPEC: 2 of 2" in in_words_at_the_end(journal, "complete")  # type: ignore[arg-type]


@pytest.mark.slow
def test_solve_and_report_judge_by_the_nights_limits_or_by_others(hil: Run, judged: Path) -> None:
    """Without --limits those that the night began with; a campaign folder has none."""
    own, other = (
        json.loads(hil("solve", judged / "night", *of, "--json").stdout)["in_spec"] for of in ((), wide(judged))
    )
    assert (own["verdict"], len(own["characteristics"])) == ("out of spec", 2)
    assert other["verdict"] == "in spec"
    assert "\nOUT OF SPEC: 2 of 2" in hil("solve", judged / "night").stdout
    page = judged / "page.html"
    ended = hil("report", judged / "night", "--out", page)
    assert ended.returncode == 0
    assert re.search(r"page.html: PASS: Measured well.*\nOUT OF SPEC: 2 of 2", ended.stdout)
    assert ">OUT OF SPEC</span> – 2 of 2" in page.read_text()
    assert "PASS</span> – Measured well: " in page.read_text()
    assert "The measurement needs nothing; the unit does" in page.read_text()
    assert "Nothing has to be done" not in page.read_text()
    assert "Nor whether the unit keeps its specification" not in page.read_text()
    assert hil("export", judged / "night", judged / "campaign").returncode == 0
    assert json.loads(hil("solve", judged / "campaign", "--json").stdout)["in_spec"] is None


@pytest.mark.slow
def test_the_export_of_a_night_that_was_not_finished_is_not_in_spec_either(hil: Run, judged: Path) -> None:
    """What was planned and is not there goes with the campaign: cannot tell, exit 8, and no PASS in the report."""
    assert hil("export", judged / "night", judged / "half").returncode == 0
    of = (judged / "half", *wide(judged))
    assert json.loads(hil("solve", *of, "--json").stdout)["in_spec"]["verdict"] == "in spec"
    header = judged / "half" / "campaign.yaml"
    header.write_text(header.read_text() + "missing: ['self-calibrations 3–9 at 20.0 °C: all of them']\n")
    assert json.loads(hil("solve", *of, "--json").stdout)["in_spec"]["verdict"] == "cannot tell"
    assert hil("solve", *of, "--strict").returncode == 8
    assert hil("report", *of, "--out", judged / "half.html").returncode == 0
    page = (judged / "half.html").read_text()
    assert "INCONCLUSIVE</span> – Incomplete: missing are self-calibrations 3–9" in page
    assert ">IN SPEC<" not in page


def wide(folder: Path) -> tuple[object, ...]:
    """The option that names the other limits."""
    return ("--limits", folder / "wide.yaml")


@pytest.mark.slow
def test_a_script_sees_it_where_it_asks(hil: Run, judged: Path) -> None:
    """7 out of spec, 8 where nobody can tell, 0 in spec: only with --strict."""
    night, nothing = judged / "night", {**WIDE, "sensors": {2: {"BA": {"change": "1 deg/hr"}}}}
    (judged / "change.yaml").write_text(yaml.safe_dump(nothing))
    for command in (["status", night], ["solve", night], ["report", night, "--out", judged / "strict.html"]):
        assert hil(*command).returncode == 0
        assert hil(*command, "--strict").returncode == 7
    assert hil("solve", night, *wide(judged), "--strict").returncode == 0
    assert hil("solve", night, "--limits", judged / "change.yaml", "--strict").returncode == 8
    assert hil("solve", judged / "night", "--limits", "nosuch", "--strict").returncode == 2


@pytest.mark.slow
def test_a_night_without_samples_is_not_in_spec_either(hil: Run, judged: Path, tmp_path: Path) -> None:
    """Over damaged records nothing is stated: status has no word on the unit."""
    import shutil

    night = tmp_path / "night"
    shutil.copytree(judged / "night", night)
    next((night / "blocks").glob("*.parquet")).unlink()
    status = hil("status", night, "--strict", "--json")
    assert (status.returncode, json.loads(status.stdout)["in_spec"]) == (4, None)


def test_no_limits_no_word(hil: Run, night: Path) -> None:
    """A night that asks for nothing is not judged, and says nothing of it."""
    assert json.loads(hil("status", night, "--json").stdout)["in_spec"] is None
    strict = hil("status", night, "--strict")
    assert (strict.returncode, "--strict: nobody said what the unit must be" in strict.stderr) == (8, True)
    assert "SPEC" not in hil("status", night).stdout.upper().replace("SPECIF", "")
    with open_readonly(night) as journal:
        assert "SPEC" not in in_words_at_the_end(journal, "complete")  # type: ignore[arg-type]
