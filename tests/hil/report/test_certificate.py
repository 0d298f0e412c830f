"""A certificate states every number's whole uncertainty, or says why there is none; a draft says so on every page."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest
import yaml

from hil.cli.app import run as hil
from hil.config import Bench, load_bench, parse_bench
from hil.records.export import campaign_of_night
from hil.report.certificate import Certificate, certificate, refusals
from hil.solve import repeats, solve_campaign
from hil.solve.omissions import without
from procedures.verdict import Judgement, Verdict
from tests.hil.audit.folders import FOLDERS
from tests.hil.cli.test_cli_in_spec import WIDE

TODAY = date(2026, 11, 30)
LABORATORY = """
laboratory: {name: Laboratory of Gyros, method: WI-17, edition: "3"}
equipment:
  - {name: thermometer, number: KA-0012, certificate: D-K 2025-11, traceable_to: PTB, due: 2026-11-30}
  - {name: level, number: KA-0013, due: 2027-02-28}
"""
GOOD = {"simulated": False, "state": "complete", "reason": "", "identity": {}, "missing": []}
WELL = Judgement(Verdict.PASS, "all is well")


@pytest.fixture(scope="module")
def bench() -> Bench:
    """The simulated bench with a laboratory around it."""
    return parse_bench(load_bench("simulated").text + LABORATORY, "bench.yaml")


@pytest.fixture(scope="module")
def draft(night: Path) -> Certificate:
    """Of a simulated night."""
    return certificate(night, TODAY, "SIM-0001")


def test_every_reason_against_it_is_told_and_without_one_there_is_none(bench: Bench) -> None:
    """Simulated, not whole, not good, damaged, of nobody, by nobody, with nothing or with what is past its date.

    What is only missing is no record that is not what was written.
    """
    proven = {"problems": []}
    assert not list(refusals(GOOD, WELL, proven, bench, "0042", TODAY))
    for wrong, word in (
        ({**GOOD, "simulated": True}, "simulated"),
        ({**GOOD, "state": "aborted"}, "aborted"),
        ({**GOOD, "identity": {"despite": "the bench is not level"}}, "not level"),
    ):
        (said,) = refusals(wrong, WELL, proven, bench, "0042", TODAY)
        assert word in said
    assert [*refusals(GOOD, Judgement(Verdict.FAIL, "run 3"), proven, bench, "0042", TODAY)] == [
        "the measurement is FAIL: run 3"
    ]
    assert len(list(refusals(GOOD, WELL, {"problems": ["a block is lost"]}, bench, "", TODAY))) == 2
    runs = [f"self-calibration {run} at 23.0 °C: all of it" for run in (2, 3)]
    lacking = {"problems": [*(f"missing: {each}" for each in runs), "a block is lost"]}
    assert [*refusals({**GOOD, "missing": runs}, WELL, lacking, bench, "0042", TODAY)] == [
        "missing: self-calibrations 2–3 at 23.0 °C: all of them",  # in the words of hil status and hil verify
        "the records are not what was written: a block is lost",
    ]
    (late,) = refusals(GOOD, WELL, proven, bench, "0042", date(2026, 12, 1))
    assert late == "thermometer KA-0012 was due for calibration on 2026-11-30, and measured until 2026-12-01"
    bare = bench.model_copy(update={"laboratory": None, "equipment": ()})
    assert len(list(refusals(GOOD, WELL, proven, bare, "0042", TODAY))) == 2


def test_no_uncertainty_is_smaller_than_repeats_or_sources_show(draft: Certificate, night: Path) -> None:
    """The standard uncertainty is made of sources and what they leave unexplained, to the digit; k is 2 at least."""
    budgets = {(each["sensor"], each["temperature_degC"]): each for each in draft.document["budgets"]}
    results = draft.document["results"]
    assert len(results) == 24
    for each in results:
        of = budgets[each["sensor"], each["temperature_degC"]]
        name, u = each["parameter"], each["standard_uncertainty"]
        parts = [source["parameters"][name] for source in of["sources"]]
        assert np.hypot(np.linalg.norm(parts), each["unexplained"]) == pytest.approx(u)
        assert of["unexplained"][name] == each["unexplained"]
        assert each["expanded_uncertainty"] == pytest.approx(each["k"] * u)
        assert each["k"] >= 2.0 - 1e-12
    assert any(each["unexplained"] > 0.5 * each["standard_uncertainty"] for each in results)  # MU, from run to run
    campaign = campaign_of_night(night)
    for number, shown in repeats(campaign, solve_campaign(campaign)).items():
        for mean in shown.means:
            for name, value in mean.values.items():
                found = next(
                    each
                    for each in results
                    if (each["sensor"], each["parameter"]) == (number, name)
                    and each["temperature_degC"] == mean.temperature_degC
                )
                assert found["value"] == value.value
                assert {key: found[key] for key in shown.where(mean)} == shown.where(mean)
                assert found["expanded_uncertainty"] >= value.expanded(2.0) * (1.0 - 1e-12)


def test_a_draft_says_so_on_every_page_and_a_certificate_nowhere(draft: Certificate) -> None:
    """The mark is fixed, which paper repeats; the running title has it, too."""
    page = draft.page()
    assert draft.refused[0] == "the night is simulated: no device was measured"
    assert re.search(r"\.draft-mark \{ position: fixed;", page)
    assert page.count('class="draft-mark"') == 1
    assert "DRAFT\\20 Calibration" in page
    assert "size: A4" in page
    assert set(re.findall(r'id="budget-\d+" class="(\w+)', page)) == {"short"}  # none is cut in two between pages
    document = {**draft.document, "draft": False, "simulated": False, "refused_because": []}
    good = replace(draft, document=document, refused=[]).page()
    assert not re.search("draft-mark. role|DRAFT", good)
    assert "Calibration certificate SIM-0001-" in good


def test_it_names_what_it_rests_upon(draft: Certificate, bench: Bench) -> None:
    """Laboratory, method, instruments with numbers and dates, hash, signatures, what was assumed."""
    facts = {
        "laboratory": bench.laboratory.model_dump() if bench.laboratory else None,
        "traceability": [each.model_dump(mode="json") for each in bench.equipment],
    }
    page = replace(draft, document={**draft.document, **facts}).page()
    for word in ("Laboratory of Gyros", "WI-17, edition 3", "KA-0012", "PTB", "2026-11-30", "signature", "usual sizes"):
        assert word in page
    assert draft.document["records"]["journal_head_sha256"] in page
    assert len(draft.document["records"]["journal_head_sha256"]) == 64
    assert "No statement of conformity" in page


def test_a_soak_that_had_not_ended_is_said(night: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the words of every other command."""
    measured = campaign_of_night(night)
    for rows in measured.sensors.values():
        rows.conditions.columns["temperature_degC"][:1] += 9.0
        rows.conditions.duration_s[:1] *= 1.0 - 1e-12
    told = [each["why"] for each in without(measured)["runs_not_settled"]]
    monkeypatch.setattr("hil.report.certificate.campaign_of_night", lambda _: measured)
    said = certificate(night, TODAY).document["conditions"]
    assert told
    assert all(any(why in line for line in said) for why in told)
    assert [line for line in said if "after restabilisation" in line or "s and" in line] == []  # of one duration


@pytest.mark.slow
def test_what_moves_both_sensors_is_said(night: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Among the conditions; nothing of sensors that scatter each alone."""
    for name, together in (("both sensors disturbed", True), ("two sensors", False)):
        measured = FOLDERS[name]()
        monkeypatch.setattr("hil.report.certificate.campaign_of_night", lambda _, of=measured: of)
        said = certificate(night, TODAY).document["conditions"]
        assert any("sensors 1 and 2 move together" in line for line in said) is together


@pytest.mark.slow
def test_the_command_refuses_or_drafts(night: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Status 2 and nothing written without --draft; another unit, a campaign, a slip of the name are refused."""
    out = tmp_path / "certificate.html"
    assert hil(["certificate", str(night), "--out", str(out)]) == 2
    assert "simulated" in (said := capsys.readouterr().err)
    assert "no laboratory" in said
    assert hil(["certificate", str(night), "--draft", "--unit", "0042", "--out", str(out)]) == 2
    assert "--unit 0042: the unit of this night is SIM-0001" in capsys.readouterr().err
    assert hil(["certificate", str(night), "--draft", "--out", str(tmp_path / "journal.sqlite")]) == 2
    assert hil(["certificate", str(tmp_path), "--draft", "--out", str(out)]) == 2
    assert not list(tmp_path.iterdir())
    limits = tmp_path / "limits.yaml"
    limits.write_text(yaml.safe_dump(WIDE))
    asked = ["--draft", "--limits", str(limits), "--customer", "Ship & Sons <Ltd>", "--number", "C-1", "--strict"]
    assert hil(["certificate", str(night), "--out", str(out), *asked]) == 0
    assert re.search(
        r"value +U +k +unit", capsys.readouterr().out
    )  # of each value its own: where few repeats tell, larger
    assert "Ship &amp; Sons &lt;Ltd&gt;" in out.read_text()
    assert "IN SPEC" in out.read_text()
