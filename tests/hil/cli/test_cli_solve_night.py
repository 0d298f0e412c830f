"""`hil solve` of a night: what was not measured well is not called PASS because its equations can be solved."""

from __future__ import annotations

import json
from pathlib import Path

from tests.hil.cli.conftest import Run


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
