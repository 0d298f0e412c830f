"""`hil solve` of a night: what was not measured well is not called PASS because its equations can be solved."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml

from hil.campaign.header import parse_header
from hil.campaign.reader import read_campaign
from hil.errors import InputError
from hil.report.content import gather
from procedures.verdict import Verdict
from tests.hil.cli.conftest import Run


@pytest.mark.slow
def test_a_self_calibration_that_never_settled_is_not_called_pass(hil: Run, tmp_path: Path) -> None:
    """Six equations for six unknowns always solve; the soak of the quick sweep is far too short."""
    night = tmp_path / "night"
    assert hil("run", "quick", "--bench", "simulated", "--out", night, "--yes", "--quiet").returncode == 0
    solutions = json.loads(hil("solve", night, "--json").stdout)["solutions"]
    assert [each["verdict"] for each in solutions] == ["INCONCLUSIVE", "INCONCLUSIVE"]
    assert all("not restabilised" in each["reason"] for each in solutions)
    printed = hil("solve", night).stdout
    assert "INCONCLUSIVE" in printed
    assert "PASS" not in printed
    campaign = tmp_path / "campaign"
    assert hil("export", night, campaign).returncode == 0
    assert json.loads(hil("solve", campaign, "--json").stdout)["solutions"] == solutions
    assert read_campaign(campaign).warnings == ()
    assert gather(read_campaign(campaign)).verdict_counts() == {Verdict.INCONCLUSIVE: 2}
    next((night / "blocks").glob("*.parquet")).unlink()
    solved = hil("solve", night, "--json")
    assert (solved.returncode, solved.stdout) == (4, "")
    assert "hil: ERROR: " in solved.stderr
    assert "the block is missing" in solved.stderr


@pytest.mark.parametrize(
    ("verdicts", "words"),
    [
        ({1: {"verdict": "GOOD"}}, "verdicts.1.verdict: 'GOOD' is not allowed; allowed: 'PASS', "),
        ({1: {"verdict": ["PASS"]}}, "verdicts.1.verdict"),
        ({1: "PASS"}, "verdicts.1: must be a mapping with the keys verdict, reason, not 'PASS'"),
        ({"one": {"verdict": "PASS"}}, "verdicts.one: must be a whole number, not 'one'"),
        (["PASS"], "verdicts: must be a mapping of keys to values, not a list"),
    ],
)
def test_a_verdict_that_cannot_be_understood_is_refused(tmp_path: Path, verdicts: object, words: str) -> None:
    """The key may be written by hand; it is read as strictly as the rest."""
    header = {"schema": "hil.campaign/1", "sensors": {2: {"axes": ["A", "B", "S"], "channels": {"RA": "A"}}}}
    (tmp_path / "campaign.yaml").write_text(yaml.safe_dump({**header, "verdicts": verdicts}))
    with pytest.raises(InputError, match=re.escape(words)):
        parse_header((tmp_path / "campaign.yaml").read_text(), tmp_path / "campaign.yaml")
