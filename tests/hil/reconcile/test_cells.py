"""Cells and labels as people type them: a slipped decimal point, coarse rounding, any label of a position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, Collects, FloatArray
from hil.model import load_model
from hil.model.effects.followed import driver_values, expressible, position_is
from hil.reconcile import reconcile
from hil.reconcile.bad_data.rows import BEYOND_SCORES, find_outliers
from hil.reconcile.explanations import posed
from hil.reconcile.outcome.page import page
from tests.hil.reconcile.hidden_effects import Rows, hidden_campaign
from tests.hil.reconcile.test_unrecorded import with_columns

DRAWS = 100
TWO_RUNS_A_SETPOINT = (-20.0, 0.0, 20.0, 40.0)


def with_rates(campaign: Campaign, rates: FloatArray) -> Campaign:
    """The campaign with other rates."""
    collects = campaign.sensors[2]
    return replace(campaign, sensors={2: Collects(collects.conditions, rates, collects.rates_se_deg_per_hr)})


def mistyped(cell: float, row: int = 4) -> Campaign:
    """A night of which channel RA has one cell `cell` times too large."""
    campaign = hidden_campaign(7, temperatures=TWO_RUNS_A_SETPOINT, positions=("1", "2", "3"), thermal=False)
    rates = campaign.sensors[2].rates_deg_per_hr.copy()
    rates[row, 0] *= cell
    return with_rates(campaign, rates)


@pytest.mark.parametrize("model", ["collins-4", "matrix-6"])
@pytest.mark.parametrize("cell", [1e3, 1e10])
def test_the_mistyped_cell_is_left_out_and_no_other_beside_any_model(model: str, cell: float) -> None:
    """At each setpoint the flexible model has hardly fewer values than rows: which row it is, the base says."""
    problem, tables, rich = posed(mistyped(cell), load_model(model), [])
    found = [(o["row"], o["channel"]) for o in find_outliers(problem.blocks, tables, rich) if o["channel"] == 0]
    assert found[0] == (4, 0)


def test_averages_that_are_mostly_one_value_are_no_reason_to_leave_the_others_out() -> None:
    """Rounded to whole degrees per hour, most rates are one: a step of one unit in a row is no gross error."""
    campaign = hidden_campaign(7, thermal=False)
    rates = campaign.sensors[2].conditions.w_channels_deg_per_hr + 20.0
    rates[[5, 21, 40], 0] += 1.0
    problem, tables, rich = posed(with_rates(campaign, rates), load_model("matrix-6"), [])
    found = find_outliers(problem.blocks, tables, rich)
    assert not [o for o in found if o["score"] == BEYOND_SCORES]


def mass_unbalance(rows: Rows) -> np.ndarray:
    """RA += MUB fS, RB -= MUA fS with MUA = 14, MUB = -20 deg/hr/g."""
    return np.stack([-20.0 * rows.f[:, 2], -14.0 * rows.f[:, 2]], 1)


def relabelled(campaign: Campaign, names: dict[str, str]) -> Campaign:
    """The campaign with other labels for its positions."""
    collects = campaign.sensors[2]
    position = np.array([names.get(label, label) for label in collects.conditions.position.tolist()])
    conditions = replace(collects.conditions, position=position)
    return replace(campaign, sensors={2: replace(collects, conditions=conditions)})


def test_a_position_may_be_called_anything() -> None:
    """An ampersand or a percent sign in a label is neither a product nor an escape."""
    names = {"1": "a & b", "2": "100 % & 5 %26", "3": "run>2", "4": "x^2"}
    plain = hidden_campaign(7, mass_unbalance, thermal=False, mu=False)
    campaign = relabelled(plain, names)
    conditions = campaign.sensors[2].conditions
    for label in names.values():
        np.testing.assert_array_equal(driver_values(position_is(label), conditions), conditions.position == label)
    result = reconcile(campaign, "collins-4", draws=DRAWS, prove=False)
    assert [effect.id for effect in result.effects] == ["MU_real"]


def test_a_column_whose_name_reads_as_an_operator_is_not_asked_about() -> None:
    """It could not be written into a model; a bracket or a space is no operator."""
    assert not [name for name in ("a & b", "oil^2", "load>5", "load[1..2]", "position=3") if expressible(name)]
    assert expressible("oil [bar]")
    assert expressible("supply_V")
    odd = {"a & b": np.linspace(0.0, 1.0, 64) ** 3, "load>5": np.sin(np.arange(64.0))}
    result = reconcile(with_columns(hidden_campaign(7), **odd), "matrix-6-thermal", draws=DRAWS, prove=False)
    assert result.verdict == "none"


@pytest.mark.slow
def test_runs_of_unknown_temperature_are_labelled_by_their_number() -> None:
    """No "nan °C" on the page; and what it holds is all it needs."""
    campaign = hidden_campaign(7)
    conditions = campaign.sensors[2].conditions
    temperature = np.where(conditions.run == 2, np.nan, conditions.columns["temperature_degC"])
    gaps = with_columns(campaign, temperature_degC=temperature, setpoint_degC=None)  # no setpoint to stand in for it
    text = page(reconcile(gaps, "matrix-6", draws=DRAWS, prove=False))
    assert "<!-- 2 -->" in text
    assert "nan °C" not in text
    assert "purl.org" not in text
