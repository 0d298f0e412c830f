"""A thermometer that shows another temperature in one run: it is off, or the soak had not ended. The rates tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.reconcile import reconcile
from tests.hil.reconcile.hidden_effects import base_rates, campaign_of, lay_out, noise

LEVELS, ODD, JUMPED = (-15.0, 10.0, 35.0, 60.0), 5, 8


def night(
    *, thermometer: bool = True, jump: float = 12.0, odd: tuple[int, ...] = (ODD,), degC: tuple[float, ...] = LEVELS
) -> Campaign:
    """Three runs at each temperature; in some 7 °C less are shown, and in one the bias is another."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng, degC, 3)
    rows.temperature = rows.setpoint + rng.normal(0.0, 0.03, len(rows))
    shown = rows.temperature - 7.0 * np.isin(rows.run, odd)
    if not thermometer:
        rows.temperature = shown
    rates = base_rates(rows) + noise(rows, rng, run_bias=0.0)
    rates[rows.run == JUMPED, 1] += jump
    campaign = campaign_of(rows, rates, conditions=False)
    (number,) = campaign.sensors
    collects = campaign.sensors[number]
    conditions = replace(collects.conditions, columns={"temperature_degC": shown, "setpoint_degC": rows.setpoint})
    return replace(campaign, sensors={number: replace(collects, conditions=conditions)})


@pytest.mark.slow
@pytest.mark.parametrize("thermometer", [True, False], ids=["it is off", "the soak had not ended"])
def test_it_takes_no_law_of_temperature_away(thermometer: bool) -> None:
    """Believed where it is off, no law holds, and beside values of each temperature little else is certain."""
    result = reconcile(night(thermometer=thermometer), "matrix-6", prove=False)
    assert {each.id for each in result.effects} == {"GS_T", "MU_real", "bias_T", "jump"}
    jumps = [of for each in result.effects if each.id == "jump" for of in each.parameters if of["name"] == "J_B"]
    assert [of["value"] for of in jumps] == [pytest.approx(12.0, abs=1.0)]
    (said,) = (note for note in result.notes if "likelier" in note)
    assert f"run {ODD}: " in said
    assert said.endswith("is off by -7.0 °C" if thermometer else "is right: the soak had not ended")


@pytest.mark.slow
def test_what_may_be_missing_is_said_whole_whatever_was_not_recorded() -> None:
    """A jump at .91, of which half is a turn-on's where nobody recorded when power came on, is more than half of it."""
    (said,) = (each for each in reconcile(night(jump=8.5), "matrix-6", prove=False).notes if "not called" in each)
    assert said.startswith("Bearing or retainer jump (jump) or turnon: 9")


@pytest.mark.slow
def test_it_may_be_off_in_runs_of_two_temperatures() -> None:
    """With values of each temperature, whichever tells which is one: of three that repeat, all are at the setpoint."""
    result = reconcile(night(jump=0.0, odd=(2, 8), degC=(-20.0, 10.0, 40.0)), "matrix-6", prove=False)
    assert [note.split(":")[0] for note in result.notes if "is off by" in note] == [
        "sensor 2, run 2",
        "sensor 2, run 8",
    ]
