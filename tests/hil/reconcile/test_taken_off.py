"""Which runs `hil solve` would not pass even if what is known were taken off their rates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.model import Model
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.outcome.page import page
from hil.reconcile.outcome.sentences import what_to_do
from hil.reconcile.outcome.values import taken_out
from hil.reconcile.result import Solved
from hil.reconcile.rivals import Rival
from hil.reconcile.search.problem import pose
from tests.hil.reconcile.hidden_effects import Rows, hidden_campaign


def drift(rows: Rows) -> np.ndarray:
    """A bias of which each run has another value at each of its collects."""
    return (rows.order - 1.0)[:, None] * np.array([6.0, -3.0])


@pytest.fixture(scope="module")
def night() -> Campaign:
    """A night that drifts inside its runs, and nothing else."""
    return hidden_campaign(3, drift, thermal=False, mu=False)


@pytest.fixture(scope="module")
def found(night: Campaign) -> Reconciliation:
    """It and what is found in it."""
    return reconcile(night, "matrix-6", prove=False)


@pytest.mark.slow
def test_a_run_that_fails_by_what_was_found_is_not_held_against_the_model(found: Reconciliation) -> None:
    """Every run FAILs against the form that lacks the drift; with it taken off none does."""
    assert [effect.id for effect in found.effects] == ["drift"]
    assert len(found.solved.not_passed["FAIL"]) == 16
    assert "FAIL" not in found.left.not_passed
    assert not found.left.beyond_errors
    document = found.document()
    assert document["runs_not_solved_after"] == found.left.not_passed != document["runs_not_solved"]


@pytest.mark.slow
def test_a_run_that_fails_even_so_is_named_whatever_the_verdict(found: Reconciliation) -> None:
    """In the first sentence of terminal and page, before the improved model is recommended."""
    for verdict in ("named", "ambiguous"):
        odd = replace(found, verdict=verdict, left=Solved({"FAIL": {"2": [6]}}))
        told = "First see to what hil solve does not pass, even with what is known taken off (notes say why): run 6"
        assert what_to_do(odd)[1].startswith(told)
        assert told in page(odd)
    assert "First see" not in what_to_do(replace(found, left=Solved()))[1]


@pytest.mark.slow
def test_whoever_is_sent_to_the_notes_finds_the_reason_there(night: Campaign) -> None:
    """Also of a run that does not pass for the same reason with what is known taken off and without."""
    rows = night.sensors[2]
    kept = (rows.conditions.run != 6) | np.isin(rows.conditions.position, ["1", "4"])
    result = reconcile(replace(night, sensors={2: rows.rows(kept)}), "matrix-6", prove=False)
    assert "(notes say why): run 6 (INCONCLUSIVE)" in what_to_do(result)[1]
    assert any(
        "INCONCLUSIVE, sensor 2, run 6: positions 2 and 3, which other runs have" in note for note in result.notes
    )


@pytest.mark.slow
def test_what_the_model_knows_already_is_taken_off_too(found: Reconciliation, night: Campaign) -> None:
    """Asked again with the improved model, no run is left that somebody has to see to; its scatter is in the errors."""
    again = reconcile(night, found.model_after, prove=False)
    assert again.verdict == "none"
    assert what_to_do(again)[0] == "none"
    assert again.left == found.left


def test_errors_have_what_scatters_inside_a_run_and_not_what_its_own_values_take(night: Campaign) -> None:
    """A bias that is another in each run leaves nothing in it; one that is another in each collect does."""
    sizes = {name: {"unit": "deg/hr", "value": 6.0} for name in ("BA", "BB")}
    stated = night.sensors[2].rates_se_deg_per_hr
    grown = {}
    for key in ("run_to_run", "collect_to_collect"):
        model = {"schema": "hil.model/1", "title": key, "form": "matrix-6", "noise": {2: {key: sizes}}}
        problem = pose(night, Model.model_validate(model), ())
        grown[key] = taken_out(problem, problem.sensors, (), ()).sensors[2].rates_se_deg_per_hr ** 2 - stated**2
    np.testing.assert_allclose(grown["run_to_run"], 0.0, atol=1e-9)
    np.testing.assert_allclose(grown["collect_to_collect"], 36.0)  # as white noise, of which values take as much


@pytest.mark.slow
def test_whoever_reads_that_a_model_holds_reads_at_which_temperatures(found: Reconciliation) -> None:
    """What is held out stands at a temperature that other runs have: of others hil thermal speaks."""
    held = "The model holds at temperatures that were measured: how far off it may be at others, hil thermal says."
    assert held not in what_to_do(found)[1]
    warm = {"effects": [replace(each, follows={"temperature"}) for each in found.effects]}
    for changed in ({"follows": [("temperature", 0.9)], **warm}, {"calibration": "per temperature"}):
        assert what_to_do(replace(found, **changed))[1].endswith(held)  # type: ignore[arg-type]
        assert held in page(replace(found, **changed))  # type: ignore[arg-type]
    assert held not in what_to_do(replace(found, follows=[("temperature", 0.3)]))[1]
    only = replace(found, follows=[("temperature", 0.9)], effects=[replace(found.effects[0], follows=frozenset())])
    unsaid = "what probably follows temperature, and is not in the model (notes)"
    assert f"{unsaid}. " in what_to_do(only)[1]
    assert held not in what_to_do(only)[1]
    or_else = replace(only.effects[0], confusable_with=[Rival("bias_T", 0.5, 1.0)])
    assert unsaid not in what_to_do(replace(only, effects=[or_else]))[1], "that it may be is told as a rival"
    shown = found.left.shown[2]
    once = replace(shown, means=[*shown.means[:-1], replace(shown.means[-1], runs=shown.means[-1].runs[:1])])
    told = what_to_do(replace(only, left=replace(found.left, shown={2: once})))[1]
    assert f"{unsaid}: a second run at a temperature that has one tells it from what changes by the run" in told
    nowhere = replace(
        found, follows=[("temperature", 0.9)], effects=warm["effects"], solved=replace(found.solved, temperatures=0)
    )
    assert "The model holds" not in what_to_do(nowhere)[1]


@pytest.mark.slow
def test_nobody_is_told_to_measure_what_is_not_said(found: Reconciliation) -> None:
    """Of a name that no further collect settles there is nothing below that could be measured."""
    unsure = replace(found, verdict="ambiguous", next_experiment=None)
    assert "Take more runs before the name is relied upon." in what_to_do(unsure)[1]
    assert "below" in what_to_do(replace(unsure, next_experiment={"why": "it tells them apart"}))[1]
