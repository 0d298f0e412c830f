"""A thermometer that is off the case in one run, and in no other: every command that reads the folder says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.campaign.reader import read_campaign
from hil.campaign.stand_ins import off_its_case, own_degC, with_stand_ins
from hil.campaign.writer import write_campaign
from hil.cli.app import run
from hil.reconcile import reconcile
from hil.solve.temperatures import unsettled
from tests.hil.reconcile.hidden_effects import base_rates, campaign_of, lay_out, noise
from tests.hil.solve.runs_of_a_unit import campaign, with_column

OFF = "sensor 2: in run 5 its thermometer shows 13.0 °C more than its case, in all other runs 8.0 to 8.0 °C"


def beside_its_case(off_degC: float, runs: int = 9, moving: float = 0.0) -> Campaign:
    """Return a campaign whose case has the setpoint, in run 5 with a thermometer of its own that is off."""
    one = campaign(runs, 3, seed=1)
    columns = one.sensors[2].conditions.columns
    here = one.sensors[2].conditions.run == 5
    slope = np.where(here, moving, 0.0)
    own = columns["temperature_degC"] + off_degC * here
    return with_column(one, case_degC=columns["setpoint_degC"], temperature_degC=own, dTdt_degC_per_min=slope)


@pytest.mark.slow
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


def test_the_case_stands_in_for_a_thermometer_that_is_off() -> None:
    """By the setpoint it is the thermometer: what it shows in that run is nobody's temperature, and no soak's."""
    off, right = (beside_its_case(by).sensors[2].conditions for by in (5.0, 0.0))
    assert np.allclose(own_degC(off), right.columns["temperature_degC"])
    assert unsettled(off) == {}
    (said,) = [each for each in with_stand_ins(beside_its_case(5.0)).warnings if "stands in" in each]
    assert said.startswith("sensor 2: temperature_degC is off in run 5; the case's")


@pytest.mark.parametrize("what", ["case_degC", "dTdt_degC_per_min"])
def test_a_thermometer_that_may_be_right_is_believed(what: str) -> None:
    """It is the case that is off the air, or the unit may still be warming: no slope was recorded."""
    one = beside_its_case(5.0)
    columns = dict(one.sensors[2].conditions.columns)
    if what == "case_degC":
        by = np.where(one.sensors[2].conditions.run == 5, 5.0, 0.0)
        columns |= {"temperature_degC": columns["temperature_degC"] - by, "case_degC": columns["case_degC"] - by}
    else:
        del columns[what]
    rows = replace(one.sensors[2].conditions, columns=columns)
    assert np.array_equal(own_degC(rows), columns["temperature_degC"])
    assert len(list(off_its_case(rows))) == 1


@pytest.mark.slow
def test_a_thermometer_that_is_off_has_no_name_of_an_effect() -> None:
    """Run 11 of a quiet unit whose values follow temperature: it was a scale error, or a state of that run."""
    rng = np.random.default_rng(1)
    rows = lay_out(rng)
    one = campaign_of(rows, base_rates(rows) + 0.3 * noise(rows, rng, run_bias=0.3), stated=0.27)
    shown = rows.temperature + 5.0 * (rows.run == 11)
    night = with_column(one, temperature_degC=shown, case_degC=rows.temperature - 3.0)
    assert reconcile(night, "matrix-6-thermal", prove=False).verdict == "none"


@pytest.mark.parametrize(("short_degC", "said"), [(9.0, 1), (1.0, 0)])
def test_a_setpoint_that_the_chamber_did_not_reach_is_said_once(short_degC: float, said: int, tmp_path: Path) -> None:
    """All runs of -40 °C were made at -31, all PASS, and stood under -40."""
    one = campaign(9, 3, seed=1)
    setpoint = one.sensors[2].conditions.columns["setpoint_degC"]
    short = with_column(one, chamber_degC=setpoint + short_degC * (setpoint == setpoint.min()))
    told = [each for each in read_campaign(write_campaign(short, tmp_path / "night")).warnings if "not reached" in each]
    assert len(told) == said
    assert all(f"the air was at {setpoint.min() + short_degC:z.1f} °C where" in each for each in told)


def test_the_errors_of_one_sensor_stand_for_none_of_the_other(tmp_path: Path) -> None:
    """A sensor without any was said to have the largest of the other's: it is solved by its residuals."""
    one = campaign(9, 3, seed=1)
    rows = one.sensors[2]
    other = replace(
        rows.conditions, sensor=replace(rows.conditions.sensor, number=1), collect=rows.conditions.collect + 99
    )
    silent = replace(rows, conditions=other, rates_se_deg_per_hr=np.full(rows.rates_se_deg_per_hr.shape, np.nan))
    read = read_campaign(write_campaign(replace(one, sensors={1: silent, 2: rows}), tmp_path / "night"))
    assert not any("standard error" in each for each in read.warnings)
