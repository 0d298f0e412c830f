"""The mission on its own night: what the contractor's model lacks, what the full one lacks, and nothing beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest


@pytest.mark.slow(seconds=45)
def test_the_published_night_lacks_what_the_report_found(hil: Any, demo: Path, tmp_path: Path) -> None:
    """MU beside collins-4, with values that follow temperature; that it differs from run to run; then no more.

    Values of the base may each go their own way with temperature: where all had to go one, a law of g squared stood in.
    """

    def lacks(model: object, out: Path) -> dict[str, Any]:
        assert hil("reconcile", demo, "--model", model, "--out", out).returncode == 0
        return dict(json.loads((out / "reconciliation.json").read_text()))

    for model, names in (("collins-4", ["MU_real", "MU_rr"]), ("matrix-6", ["MU_rr"])):
        found = lacks(model, tmp_path / model)
        assert [effect["id"] for effect in found["effects"]] == names
        assert all(effect["probability"] > 0.99 for effect in found["effects"])
        assert found["gap"]["after"] < found["gap"]["before"]
        assert model == "matrix-6" or found["calibration"] == "per temperature"
    again = lacks(tmp_path / "collins-4/model.yaml", tmp_path / "again")
    assert (again["verdict"], again["effects"]) == ("none", [])
