"""The model that reconcile improved drives the twin: its bytes show the effect, and beside it nothing is missing."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
import yaml

from hil.campaign import Campaign
from hil.campaign.reader import read_campaign
from hil.config import Bench, load_sweep
from hil.model import load_model
from hil.model.effects.series import Ramp
from hil.night import start_night
from hil.reconcile import Reconciliation, reconcile, write_result
from hil.records.export import campaign_of_night, export_campaign
from hil.solve import solve_campaign
from tests.hil.twin.quiet import changed_bench

SWEEP: dict[str, Any] = {
    "title": "Four self-calibrations with Collect 4",
    "temperatures": ["23 degC"],
    "self_calibrations_per_temperature": 4,
    "positions": ["1", "2", "3", "4"],
    "restabilisation": {"at_least": "2 min", "window": "2 min", "slope": "1 degC/min", "unit_slope": "1 degC/min"},
    "collect": {"settle": "20 s", "duration": "8 s"},
}


def measured(folder: Path, bench: Bench, seed: int, other: Mapping[str, Any] = MappingProxyType({})) -> Campaign:
    """Run a simulated night through the bytes and return its campaign."""
    sweep = folder / "sweep.yaml"
    sweep.write_text(yaml.safe_dump({**SWEEP, **other}))
    night = folder / f"night-{seed}"
    assert start_night(night, load_sweep(sweep), bench, seed=seed).exit_status == 0
    return campaign_of_night(night)


def mass_unbalance(campaign: Campaign) -> dict[tuple[int, str], float]:
    """Mean MUA and MUB of each sensor, as solved from the bytes, deg/hr/g."""
    found: dict[tuple[int, str], list[float]] = {}
    for solution in solve_campaign(campaign):
        for name in ("MUA", "MUB"):
            value = solution.parameters[name].value
            assert value is not None
            found.setdefault((solution.sensor, name), []).append(value)
    return {key: float(np.mean(values)) for key, values in found.items()}


def names(result: Reconciliation) -> list[str]:
    """Ids in the order found."""
    return [effect.id for effect in result.effects]


@pytest.mark.slow
@pytest.mark.timeout(180)  # two nights through the bytes: ten seconds of work, more where a machine is shared
def test_a_twin_driven_by_the_improved_model_shows_the_effect_and_lacks_nothing_more(tmp_path: Path) -> None:
    """MU_real is found in bytes; the improved model makes other bytes: MU as found, and none that it lacks."""
    still = {"noise": {"run_to_run": False}, "start": {"powered_for": "8 h"}}
    first = measured(tmp_path, changed_bench(tmp_path, **still), 1)
    result = reconcile(first, "collins-4", prove=False)
    assert names(result)[0] == "MU_real"
    write_result(result, tmp_path)
    improved = tmp_path / "model.yaml"
    again = measured(tmp_path, changed_bench(tmp_path, model=str(improved), **still), 2)
    before, after = mass_unbalance(first), mass_unbalance(again)
    key = max(before, key=lambda one: abs(before[one]))
    assert abs(before[key]) > 3.0
    assert after[key] == pytest.approx(before[key], abs=2.0)
    assert names(reconcile(again, "collins-4", prove=False))[0] == "MU_real"
    assert reconcile(again, load_model(improved)).verdict == "none"


@pytest.mark.slow
def test_a_night_answers_as_its_export_does(tmp_path: Path) -> None:
    """What shows inside its collects is asked of its samples, in the means over a second that an export keeps."""
    longer = {"self_calibrations_per_temperature": 2, "collect": {"settle": "5 s", "duration": "40 s"}}
    bench = changed_bench(tmp_path, settling={"size": "300 deg/hr", "time_constant": "20 s"})
    night = measured(tmp_path, bench, 1, longer)
    export_campaign(tmp_path / "night-1", tmp_path / "campaign")
    told = [
        reconcile(each, "matrix-6", prove=False).document() for each in (night, read_campaign(tmp_path / "campaign"))
    ]
    assert {each["id"] for each in told[0]["within_collects"]} == {Ramp.id}
    assert told[0] == told[1]
