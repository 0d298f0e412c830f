"""The page and the notes where a result has less to say than usual."""

from __future__ import annotations

import re
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
from hil.reconcile.outcome.sentences import summary, what_to_do
from hil.reconcile.result import FoundEffect, Solved, without_collects
from hil.reconcile.rivals import Rival


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
    assert said in page(replace(plain, noise=[], gap=replace(plain.gap, standardised_after=1.05)))
    loud = page(replace(plain, gap=replace(plain.gap, standardised_after=1.53)))
    assert said not in loud
    assert "though what was held out is 1.2 times what noise should leave" in loud


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


def test_nothing_runs_over_the_only_run(plain: Reconciliation) -> None:
    """A log of one run at one temperature is shown over its positions, upright where they are many."""
    rows = [
        {**row, "run": 1, "temperature_degC": 23.0, "position": f"pose-{n % 9}"}
        for n, row in enumerate(plain.picture["rows"])
    ]
    assert "Measured less simulated over run" not in page(plain)
    one = page(replace(plain, picture={"rows": rows}))
    assert "Measured less simulated over position" in one
    assert "rotate(-90)" in one


def test_where_nothing_is_missing_the_band_is_all_of_the_noise(plain: Reconciliation) -> None:
    """Offsets from run to run included, of which standard errors say nothing: two of three points lie within."""
    stated = [{**channel, "explained_deg_per_hr": 0.01} for channel in plain.noise]
    assert "noise 0.0" not in page(replace(plain, noise=stated))


@pytest.mark.slow
def test_who_has_what_averages_scatter_by_is_said_where_it_is_so(plain: Reconciliation) -> None:
    """By model.yaml, and the ± of hil solve where repeats or residuals tell it; what may be chance is not said."""
    channel = {**plain.noise[0], "stated_deg_per_hr": 1.0, "explained_deg_per_hr": 1.0, "observed_deg_per_hr": 5.0}
    chance = dict.fromkeys(("run_offset_se_deg_per_hr", "collect_to_collect_se_deg_per_hr"))
    sure = {**chance, "run_offset_se_deg_per_hr": 0.5}
    said = {
        (widens, known["run_offset_se_deg_per_hr"]): what_to_do(
            replace(plain, noise=[{**channel, **known}], solved=replace(plain.solved, widens=widens))
        )[1]
        for widens in (True, False)
        for known in (chance, sure)
    }
    assert "say; the ± of hil solve and the noise of model.yaml have it." in said[True, 0.5]
    assert "say; the noise of model.yaml has it." in said[False, 0.5]
    assert {said[widens, None] for widens in (True, False)} == {"Nobody has to act."}


def test_the_first_line_says_whether_anybody_has_to_act(plain: Reconciliation) -> None:
    """And says it once; what scatters too much is no green verdict."""
    said = r'<h2 id="verdict"><span class="tag {}">none</span> – {}</h2>'
    assert re.search(said.format("none", r"Nobody has to act\."), page(plain))
    loud = page(replace(plain, left=Solved({}, [2])))
    assert re.search(said.format("MARGINAL", r"Repeat these collects[^.]*\."), loud)
    assert loud.count("scatter more than their standard errors") == 1


@pytest.mark.slow
def test_the_page_says_whether_simulated_nights_are_like_the_measured_one(plain: Reconciliation) -> None:
    """Before and after, in words, where the gap is; nothing where nobody asked."""
    channel = {key: plain.picture["rows"][0][key] for key in ("sensor", "channel")}
    worst = [{**channel, "channel": name} for name in ("RA", "RB")]
    places = [
        {
            "where": {**at, "temperature_degC": degC, "position": "1"},
            "p_value": 0.5,
            "measured_deg_per_hr": 2.0,
            "simulated_deg_per_hr": [1.0, 3.0],
        }
        for at in worst
        for degC in (-30, 60)
    ]
    asked = {
        "draws": 20,
        "seed": 1,
        "before": {"p_value": 1e-6},
        "after": {"p_value": 0.412, "places": [*places, {"where": channel, "p_value": 0.1}]},
    }
    told = (
        "The night beside 20 simulated ones, through bytes: from those with the model as it was it can be told "
        "(p below 0.0001), from those with the model as it is now it cannot be told (p = 0.41)."
    )
    text = page(replace(plain, twin=asked))
    assert text.index("the gap is</h2>") < text.index(told) < text.index("What to measure next")
    assert text.count("2 of 2 measured sizes lie among the simulated ones") == 1
    assert "simulated ones" not in page(plain)
    for each in places:
        each["where"].pop("temperature_degC")
    text = page(replace(plain, twin=asked))  # of which nobody knows a temperature
    assert ">every position<" in text
    assert text.count("2 of 2 measured sizes lie among the simulated ones") == 1
    off = {"sensor": 2, "run": 5, "collects": [13], "channels": ["RA"], "done": "left out", "why": "it is off"}
    unlike = [page(replace(plain, twin=asked, rows=[{**off, "done": done}])) for done in ("left out", "used")]
    assert ["are compared with nothing" in each for each in unlike] == [True, False]


def test_of_two_names_the_more_probable_is_said_though_the_other_is_written(plain: Reconciliation) -> None:
    """What may be noise is written as noise; that a step is the more probable stands in the same sentence."""
    jump = Rival("jump", 0.71, 0.1, title="A jump")
    ice = FoundEffect("frost", "Ice", 0.27, "ambiguous", confusable_with=[jump], acts_on="scatter")
    said = " ".join(summary(replace(plain, effects=[ice])))
    assert "Ice (frost) may be missing from" in said
    assert "(27 %), or – 71 % – A jump (jump): what may be no more than scatter is written as scatter." in said
    snow = Rival("snow", 0.02, 1.0, title="Snow", bayes_factor=1.0, prior_odds=0.1)  # and no collect tells it apart
    said = " ".join(summary(replace(plain, effects=[replace(ice, confusable_with=[jump, snow])])))
    assert "Snow (snow): these collects cannot tell frost and snow apart; physics expects frost: by" in said
    assert "10 times as probable; what may be no more than scatter is written as scatter." in said
    alone, likely = (replace(ice, confusable_with=[], probability=probability) for probability in (0.27, 0.7))
    assert "Ice (frost) may be missing from another unit (27 %)." in " ".join(summary(replace(plain, effects=[alone])))
    assert "is missing from another unit – probably (70 %), not" in " ".join(summary(replace(plain, effects=[likely])))


def test_an_advice_has_one_full_stop() -> None:
    """The page ends the sentence; a remedy of the catalogue has ended it already."""
    assert without_collects("cycle the power between runs.")["why"] == "cycle the power between runs"
