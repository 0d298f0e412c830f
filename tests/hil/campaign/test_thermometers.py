"""A thermometer that is off the case in one run, and in no other: every command that reads the folder says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.campaign.writer import write_campaign
from hil.cli.app import run
from tests.hil.solve.test_other_runs import campaign, with_column

OFF = "sensor 2: in run 5 its thermometer shows 13.0 °C more than its case, in all other runs 8.0 to 8.0 °C"


def beside_its_case(off_degC: float, runs: int = 9, moving: float = 0.0) -> Campaign:
    """Return a campaign whose case has the setpoint, in run 5 with a thermometer of its own that is off."""
    one = campaign(runs, 3, seed=1)
    columns = one.sensors[2].conditions.columns
    here = one.sensors[2].conditions.run == 5
    slope = np.where(here, moving, 0.0)
    own = columns["temperature_degC"] + off_degC * here
    return with_column(one, case_degC=columns["setpoint_degC"], temperature_degC=own, dTdt_degC_per_min=slope)


@pytest.mark.parametrize("command", ["solve", "thermal", "budget", "visibility", "report"])
def test_every_command_says_that_a_thermometer_is_off(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Once, and in the same words, whichever states a temperature of that run."""
    write_campaign(beside_its_case(5.0), tmp_path / "night")
    assert run([command, str(tmp_path / "night")]) == 0
    assert capsys.readouterr().err.count(f"warning: {OFF}") == 1


@pytest.mark.parametrize(("off_degC", "runs", "moving"), [(3.0, 9, 0.0), (5.0, 9, 0.5), (5.0, 5, 0.0)])
def test_what_is_off_by_less_or_still_follows_is_not(off_degC: float, runs: int, moving: float) -> None:
    """Five runs tell as well as nine; a unit whose temperature still moves is off its case by right."""
    said = [each for each in beside_its_case(off_degC, runs, moving).warnings if "its case" in each]
    assert len(said) == (off_degC == 5.0 and not moving)
