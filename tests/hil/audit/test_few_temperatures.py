"""How values follow temperature, asked of collects that were made at too few: every command says so in the same words.

The unit's thermometer scatters by half a degree at a temperature, and a law through that is a law of its scatter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hil.analysis.thermal.document import thermal_document
from hil.analysis.thermal.fit import fit_thermal
from hil.campaign import Campaign
from hil.campaign.stand_ins import OWN
from hil.design.visibility.document import campaign_document
from hil.errors import InputError
from hil.model import Model, built_in_model
from hil.model.curve import Constant, Curve, Polynomial
from hil.reconcile import reconcile
from hil.reconcile.fleet import Screen
from hil.reconcile.outcome.sentences import what_to_do
from hil.reconcile.search.problem import pose
from hil.solve import solve_campaign
from tests.hil.reconcile.hidden_effects import hidden_campaign
from tests.hil.solve.runs_of_a_unit import campaign as made_of_runs

ASKED: dict[str, Callable[[Campaign], Any]] = {
    "solve": lambda campaign: solve_campaign(campaign, "matrix-6-thermal"),
    "reconcile": lambda campaign: reconcile(campaign, "matrix-6-thermal", prove=False),
    "fleet": lambda campaign: Screen.of(campaign, "matrix-6-thermal"),
    "thermal": fit_thermal,
    "visibility": lambda campaign: campaign_document(campaign, built_in_model("matrix-6-thermal")),
}


def at(*temperatures_degC: float) -> Campaign:
    """Return a campaign at these temperatures, with a thermometer that scatters by half a degree."""
    campaign = hidden_campaign(3, temperatures=temperatures_degC, runs_each=2)
    rows = campaign.sensors[2]
    columns, rng = rows.conditions.columns, np.random.default_rng(4)
    shown = columns["setpoint_degC"] + 0.5 * rng.standard_normal(len(rows.conditions))
    conditions = replace(rows.conditions, columns={**columns, OWN: shown})
    return replace(campaign, sensors={2: replace(rows, conditions=conditions)})


@pytest.mark.parametrize("command", ASKED)
@pytest.mark.parametrize(("temperatures_degC", "said"), [((25.0,), "1 temperature"), ((0.0, 30.0), "2 temperatures")])
def test_how_values_follow_too_few_temperatures_no_command_says(
    command: str, temperatures_degC: tuple[float, ...], said: str
) -> None:
    """Not as a fit through the scatter of a thermometer, nor as a model to use from now on."""
    with pytest.raises(InputError, match=f"sensor 2.*: {said}.*; at least three are needed"):
        ASKED[command](at(*temperatures_degC))


def test_values_that_a_model_has_stand_where_too_few_temperatures_were_measured() -> None:
    """A law that is known is asked of one temperature, too: what is fitted to that is one set beside it."""
    law = Polynomial(unit="deg/hr", polynomial=(10.0, 0.5, 0.01), reference_degC=20.0)
    flat = Constant(unit="deg/hr/g", value=1.0)
    values: dict[str, Curve] = {**dict.fromkeys(("BA", "BB"), law), **dict.fromkeys(("GSA", "GSB", "MUA", "MUB"), flat)}
    model = Model(schema="hil.model/1", title="known", form="matrix-6-thermal", sensors={2: values})
    sensor = pose(at(25.0), model, ()).sensors[2]
    assert sensor.form.name == "matrix-6"
    assert sensor.given is model


@pytest.mark.parametrize(("temperatures_degC", "answers"), [((0.0, 30.0), False), ((0.0, 20.0, 40.0), True)])
@pytest.mark.slow
def test_nobody_is_sent_to_a_command_that_refuses(temperatures_degC: tuple[float, ...], *, answers: bool) -> None:
    """How far off a model may be at other temperatures is asked of hil thermal where that answers."""
    result = reconcile(at(*temperatures_degC), "matrix-6", prove=False)
    _, act = what_to_do(replace(result, calibration="per temperature"))
    assert "The model holds at temperatures that were measured" in act
    assert ("hil thermal says" in act) == answers
    assert ("at least three are needed" in act) != answers


@pytest.mark.slow
@pytest.mark.parametrize(("temperatures", "answers"), [(3, True), (2, False)])
def test_why_thermal_may_call_constant_what_reconcile_names_is_said(temperatures: int, *, answers: bool) -> None:
    """By both: they ask two things of the same collects; of two temperatures hil thermal says nothing."""
    one = made_of_runs(3 * temperatures, 3, seed=1, scatter=0.5)
    notes = " ".join(reconcile(one, "matrix-6", prove=False).notes)
    assert ("bias_T: asked of all collects together" in notes) == answers
    if answers:
        (sensor,) = thermal_document(fit_thermal(one))["sensors"]
        assert sensor["parameters"]["MUA"]["finding"] == "constant"
        assert "hil reconcile may show more" in sensor["verdict"]["words"]
