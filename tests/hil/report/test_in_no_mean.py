"""A run of which nothing holds: no ± allows for it, and nobody is told that one does."""

from __future__ import annotations

import numpy as np

from hil.campaign import Campaign
from hil.design.visibility.document import campaign_document
from hil.model import Model
from hil.report.content import gather, to_do
from hil.solve import solve_campaign
from hil.solve.beside_terms import beside, solve_beside
from hil.solve.omissions import what_is_wrong
from procedures.verdict import Verdict
from tests.hil.solve.runs_of_a_unit import repeated, with_rates

JUMP = {
    "effect": "jump",
    "sensor": 2,
    "parameters": {"J_A": {"unit": "deg/hr", "value": 40.0}},
    "shape": {"from_run": 5, "runs_held": 0, "from_collect": 2},
}


def jumped() -> Campaign:
    """Return nine runs of five collects; from the third collect of run 5 on channel A is 40 deg/hr off."""
    one = repeated(9, 3, (0, 1, 2, 1, 0), seed=8)
    after = (np.arange(45) >= 4 * 5 + 2)[:, None] * [[40.0, 0.0]]
    return with_rates(one, one.sensors[2].rates_deg_per_hr + after)


def test_of_a_run_in_no_mean_no_uncertainty_is_said_to_allow_for_it() -> None:
    """Its ± is that of any other run, and its bias was another by 40 deg/hr within it."""
    content = gather(jumped())
    (run,) = (each for each in content.solutions if each.run == 5)
    assert run.verdict is Verdict.FAIL
    assert "it is in no mean, and no ± allows for that" in run.reason
    assert "as every ± allows" not in run.reason
    assert not any("which allow for it" in each for each in to_do(content))


def test_what_a_model_explains_is_held_against_no_row_by_any_command_that_has_it() -> None:
    """`hil visibility` left out runs of which `hil solve` and `hil budget` with the same model had said PASS."""
    one = jumped()
    values = {"BA": 0.0, "BB": 0.0, "GSA": 58.0, "GSB": -20.0, "MUA": -9.0, "MUB": 5.0}
    units = {name: "deg/hr" + "/g" * (name[0] != "B") for name in values}
    sensor = {name: {"unit": units[name], "value": value} for name, value in values.items()}
    document = {"schema": "hil.model/1", "title": "t", "form": "matrix-6", "sensors": {2: sensor}, "terms": [JUMP]}
    known = Model.model_validate(document)
    assert what_is_wrong(one)["rows"]
    assert {each.verdict for each in solve_beside(beside(one, known), known)} == {Verdict.PASS}
    assert campaign_document(one, known, changes=())["rows"] == []
    assert 5 in {each.run for each in solve_campaign(one) if each.verdict is Verdict.FAIL}
