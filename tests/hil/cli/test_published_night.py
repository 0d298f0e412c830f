"""The mission on its own night: what the contractor's model lacks, what the full one lacks, and nothing beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest


@pytest.mark.slow
def test_the_published_night_lacks_what_the_report_found(hil: Any, tmp_path: Path) -> None:
    """MU beside collins-4, with values that follow temperature; that it differs from run to run; then no more."""
    assert hil("demo", "--out", tmp_path / "night", "--quiet").returncode == 0
    for model, names in (("collins-4", ["MU_real", "MU_rr"]), ("matrix-6", ["MU_rr"])):
        out = tmp_path / model
        assert hil("reconcile", tmp_path / "night", "--model", model, "--out", out).returncode == 0
        found = json.loads((out / "reconciliation.json").read_text())
        assert [effect["id"] for effect in found["effects"]] == names
        assert all(effect["probability"] > 0.99 for effect in found["effects"])
        assert found["gap"]["after"] < found["gap"]["before"]
        assert (
            hil("reconcile", tmp_path / "night", "--model", out / "model.yaml", "--out", out / "again").returncode == 0
        )
        again = json.loads((out / "again/reconciliation.json").read_text())
        assert (again["verdict"], again["effects"]) == ("none", [])
    contractors = json.loads((tmp_path / "collins-4/reconciliation.json").read_text())
    assert contractors["calibration"] == "per temperature"
