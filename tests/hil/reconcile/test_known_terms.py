"""What a model's terms make of the rates is as the model states it, and the base is what it is beside that."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.model import Model
from hil.model.effects.catalogue import effect_by_id
from hil.reconcile import reconcile
from hil.reconcile.outcome.improve import base_curves
from hil.reconcile.outcome.values import taken_out
from hil.reconcile.search.problem import pose
from tests.hil.reconcile.hidden_effects import hidden_campaign

BASE = {"BA": 21.0, "BB": -6.0, "GSA": 59.0, "GSB": -25.0, "MUA": 2.0, "MUB": -3.0}
UNIT = {"B": "deg/hr", "G": "deg/hr/g", "M": "deg/hr/g"}
STATED: dict[str, dict[str, Any]] = {
    "line": {"polynomial": [0.0, 0.2], "reference_degC": 20.0},
    "parabola about a level": {"polynomial": [5.0, 0.2, 0.004], "reference_degC": 20.0},
    "table": {"table": {"temperature_degC": [-40.0, 0.0, 80.0], "value": [3.0, 9.0, -4.0]}},
    "constant": {"value": 7.0},
}


def known(how: str) -> Model:
    """Return a model of sensor 2 with a term in GSA and one in the bias of B."""
    values = {name: {"unit": UNIT[name[0]], "value": value} for name, value in BASE.items()}
    terms = [
        {"effect": effect, "sensor": 2, "parameters": {name: {"unit": unit, **STATED[how]}}}
        for effect, name, unit in (("GS", "GSA", "deg/hr/g"), ("bias", "B_B", "deg/hr"))
    ]
    document = {"schema": "hil.model/1", "title": how, "form": "matrix-6", "sensors": {2: values}, "terms": terms}
    return Model.model_validate(document)


def made_by(model: Model, noise: float) -> Campaign:
    """Return a night of which a model makes the rates."""
    night = hidden_campaign(seed=4)
    rows = night.sensors[2]
    drawn = np.random.default_rng(1).normal(0.0, noise, rows.rates_deg_per_hr.shape)
    made = replace(rows, rates_deg_per_hr=model.rates(rows.conditions) + drawn)
    return replace(night, sensors={2: made})


@pytest.mark.parametrize("how", STATED)
def test_the_base_is_what_it_is_beside_the_terms_as_they_are_stated(how: str) -> None:
    """Terms that were fitted anew, each temperature for itself, took half of what the base has at all of them."""
    model = known(how)
    problem = pose(made_by(model, 0.0), model, ())
    curves = base_curves(problem.sensors[2], (), calibrated=False)
    assert {name: curve.at([20.0])[0] for name, curve in curves.items()} == pytest.approx(BASE, abs=1e-6)
    assert problem.sensors[2].values == pytest.approx([*BASE.values()], abs=1e-6)
    left = taken_out(problem, problem.sensors, (), ()).sensors[2]
    np.testing.assert_allclose(left.rates_deg_per_hr, model.base_for(left.conditions).rates, atol=1e-6)


@pytest.mark.parametrize("how", STATED)
def test_what_acts_on_the_base_acts_on_all_of_it(how: str) -> None:
    """Also beside an effect that shows beyond doubt, with which it is fitted anew."""
    model, phase = known(how), effect_by_id("phase")
    made = made_by(model, 0.3)
    rows = made.sensors[2]
    turned = phase.columns(rows.conditions, model.base_for(rows.conditions), {})[..., 1]  # by 1 mrad for each °C
    made = replace(made, sensors={2: replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + turned)})
    problem = pose(made, model, ()).sensors[2]
    beside = problem.base_beside(phase, {})
    assert beside is not problem.base
    right = model.base_for(rows.conditions)
    np.testing.assert_allclose(beside.k, right.k, atol=1.0)
    np.testing.assert_allclose(beside.bias, right.bias, atol=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("how", STATED)
def test_reconciled_again_with_what_stands_in_the_model_nothing_changes(how: str) -> None:
    """Of a law of temperature that the model has nothing is named once more."""
    model = known(how)
    result = reconcile(made_by(model, 0.5), model, prove=False)
    assert result.verdict == "none"
    after = {name: curve.at([20.0])[0] for name, curve in result.model_after.sensors[2].items()}
    assert after == pytest.approx(BASE, abs=0.5)
