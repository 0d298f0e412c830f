"""Held-back units: what is hidden is of the upper half of what is typical, and who is told apart stands first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.coverage import SWEEPS
from benchmarks.held_back import case, table, term
from hil.model.effects.catalogue import effect_by_id, variance_effect_by_id
from tests.hil.reconcile.hidden_effects import hidden_campaign
from tests.hil.short_sweeps import published


@pytest.mark.parametrize("entry", [effect_by_id("supply"), effect_by_id("frame"), variance_effect_by_id("MU_rr")])
def test_a_size_is_in_the_upper_half_of_what_is_typical(entry: object) -> None:
    """Of either sign where it moves averages, but for what is there or not."""
    campaign, rng = hidden_campaign(7), np.random.default_rng(1)
    signs = set()
    for _ in range(20):
        own = term(entry, campaign, 2, rng)  # type: ignore[arg-type]
        for each in entry.parameters_for(campaign.sensors[2].conditions):  # type: ignore[attr-defined]
            value = own["parameters"][each.name]["value"]
            assert np.mean(each.typical) <= abs(value) <= each.typical[1]
            signs.add(float(np.sign(value)))
    assert signs == ({-1.0, 1.0} if own["effect"] == "supply" else {1.0})


def test_units_that_are_told_apart_afterwards_stand_first() -> None:
    """They are what has to be looked into."""
    same = {"sweep": "published", "rivals": [], "before": {"p_value": 1e-6}}
    rows = [
        {**same, "number": 1, "hidden": ["k2"], "found": {"k2": 0.9}, "after": {"p_value": 0.6}},
        {**same, "number": 2, "hidden": ["rrw"], "found": {}, "after": {"p_value": 0.001}},
    ]
    assert [line.split("|")[1].strip() for line in list(table(rows))[2:]] == ["2", "1"]


@pytest.mark.slow(seconds=7)
def test_a_unit_that_is_held_back_is_found_and_its_twin_not_told_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One effect in a night of three temperatures, by its averages: the command as it is run."""
    monkeypatch.setitem(SWEEPS, "published", published(tmp_path / "sweep.yaml", "-20 degC, 20 degC, 60 degC"))
    made = case(0, seed=77, keep=tmp_path, averages=True)
    assert made["hidden"] == list(made["found"])
    assert made["before"]["p_value"] < 0.001
    assert made["after"]["p_value"] > 0.05
