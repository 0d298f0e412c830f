"""The page and the notes where a result has less to say than usual."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.blind.cases import make_case, write_case
from benchmarks.blind.jobs import EIGHT
from hil.campaign.reader import read_campaign
from hil.model import Model
from hil.model.curve import Constant
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.outcome.page import page, write_result


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Reconciliation:
    """A night in which nothing is missing, compared with a model whose values are somebody else's."""
    folder = write_case(make_case(3, model="matrix-6", design=EIGHT), tmp_path_factory.mktemp("case") / "campaign")
    units = {"BA": "deg/hr", "BB": "deg/hr", "GSA": "deg/hr/g", "GSB": "deg/hr/g", "MUA": "deg/hr/g", "MUB": "deg/hr/g"}
    values = {name: Constant(unit=unit, value=1.0) for name, unit in units.items()}
    model = Model(schema="hil.model/1", title="another unit", form="matrix-6", sensors={2: values})
    return reconcile(read_campaign(folder), model)


@pytest.mark.slow
def test_what_the_data_exclude_makes_nothing_ambiguous(tmp_path: Path) -> None:
    """Ageing of 25 noise sizes: its rivals overlap by 0.991, and are less probable by a thousand."""
    case = make_case(72, ("ageing",), d=25.0, model="matrix-6")
    found = reconcile(read_campaign(write_case(case, tmp_path / "campaign")), "matrix-6")
    assert [(each.id, each.kind) for each in found.effects] == [("ageing", "named")]
    assert all(rival.bayes_factor < 1e-3 for rival in found.effects[0].confusable_with)


def test_values_of_another_unit_are_said_to_be_off(plain: Reconciliation) -> None:
    """The form describes the data, the values do not: the verdict is none, and notes and page say what is off."""
    assert plain.verdict == "none"
    assert any("not this unit's" in note for note in plain.notes)
    assert "not this unit" in page(plain)


def test_what_is_left_is_called_noise_only_where_it_is(plain: Reconciliation) -> None:
    """Held-out residuals of 1.53 times the noise's mean square are not "nothing but noise" on the same page."""
    said = "leaves nothing but noise"
    assert said in page(replace(plain, gap=replace(plain.gap, standardised_after=1.05)))
    loud = page(replace(plain, gap=replace(plain.gap, standardised_after=1.53)))
    assert said not in loud
    assert "nothing that can be told from noise, of 1.5 times the variance" in loud


@pytest.mark.parametrize(
    "experiment",
    [
        {"why": "no stationary collect", "collects": [], "expected_difference_deg_per_hr": 0.1, "power": 0.02},
        {"why": "look inside", "collects": [], "expected_difference_deg_per_hr": None, "power": None},
    ],
)
def test_an_experiment_without_collects_has_a_page(
    plain: Reconciliation, experiment: dict[str, object], tmp_path: Path
) -> None:
    """What cannot be settled by a further collect, or is not known in numbers, is still written."""
    write_result(replace(plain, next_experiment=experiment), tmp_path)
    assert str(experiment["why"]) in (tmp_path / "reconciliation.html").read_text()


def test_the_page_says_whether_simulated_nights_are_like_the_measured_one(plain: Reconciliation) -> None:
    """Before and after, in words, where the gap is; nothing where nobody asked."""
    asked = {"draws": 20, "seed": 1, "before": {"p_value": 1e-6}, "after": {"p_value": 0.412}}
    told = (
        "The night beside 20 simulated ones, through bytes: from those with the model as it was it can be told "
        "(p below 0.0001), from those with the model as it is now it cannot be told (p = 0.41)."
    )
    text = page(replace(plain, twin=asked))
    assert text.index("How much smaller the gap is") < text.index(told) < text.index("What to measure next")
    assert "simulated ones" not in page(plain)
