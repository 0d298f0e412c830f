"""What is printed is what a parameter is: before what was found and with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign.stand_ins import OWN
from hil.cli.model import _values
from hil.model import load_model
from hil.model.effects.catalogue import effect_by_id
from hil.reconcile.outcome.improve import improved
from hil.reconcile.outcome.values import before_and_after
from hil.reconcile.result import before_and_after_in_words
from hil.reconcile.rivals import Rival
from hil.reconcile.search.problem import pose
from tests.hil.analysis.thermal.nights import PUBLISHED_DEGC, rotor_night, scaled


def test_what_is_printed_is_what_a_parameter_is_before_and_after() -> None:
    """BA rises by 20 deg/hr over the night: at each temperature it is what the unit's is, and was one value for all."""
    curves = {"BA": lambda t: 30.0 + 10.0 * scaled(t), "GSA": lambda t: 55.0 + 0.0 * t, "MUB": lambda t: 7.0 + 0.0 * t}
    campaign = rotor_night(np.random.default_rng(0), curves, run_to_run={}, white=1e-6)
    problem = pose(campaign, load_model("matrix-6"), [effect_by_id("bias_T")])
    line = next(each for each in problem.candidates if each.name == "bias_T")
    own, rates = problem.sensors[2], campaign.sensors[2].rates_deg_per_hr
    columns = np.concatenate([line.columns, own.form.columns(campaign.sensors[2].conditions)], axis=2)
    slopes = np.linalg.lstsq(columns.reshape(-1, columns.shape[2]), rates.reshape(-1), rcond=None)[0][
        : len(line.parameters)
    ]
    terms = [(line, {k: (v, 0.1) for k, v in enumerate(slopes)})]
    model = improved(problem.model, problem.sensors, terms, [], {"bias_T": {}}, frozenset())
    found = before_and_after(problem.model, model, problem.sensors, terms, frozenset(), {})
    assert {each["name"] for each in found} == {"BA"}
    for each, degC in zip(found, (-29.7, 23.4, 60.0), strict=True):
        assert each["temperature_degC"] == pytest.approx(degC, abs=0.1)
        assert each["after"] == pytest.approx(curves["BA"](np.array(degC)), abs=0.05)
        assert each["before"] == pytest.approx(np.mean([curves["BA"](np.array(t)) for t in PUBLISHED_DEGC]), abs=0.05)
    (told,) = before_and_after_in_words(found)
    assert told.startswith(
        "BA of sensor 2, deg/hr: 20.0 at -29.7 °C (the unit's own), without it 30.1; 31.8 at 23.4 °C (the"
    )
    problem = pose(campaign, load_model("collins-4"), [effect_by_id("MU_real")])
    constant = next(each for each in problem.candidates if each.name == "MU_real" and each.form == "constant")
    terms = [(constant, {0: (0.0, 0.1), 1: (7.0, 0.1)})]
    model = improved(problem.model, problem.sensors, terms, [], {"MU_real": {}}, frozenset())
    found = before_and_after(problem.model, model, problem.sensors, terms, frozenset(), {})
    assert {(each["name"], each["temperature_degC"]) for each in found} == {("BA", None), ("MUB", None)}


def test_no_value_is_told_at_a_temperature_between_runs_that_settled_and_one_that_had_not() -> None:
    """A run at the warmest setpoint in which the unit was still at 20 °C is part of no temperature there."""
    campaign = rotor_night(np.random.default_rng(0), {"BA": lambda t: 30.0 + 10.0 * scaled(t)}, run_to_run={})
    rows = campaign.sensors[2].conditions
    setpoint = np.asarray(PUBLISHED_DEGC)[np.argmin(abs(rows.columns[OWN][:, None] - PUBLISHED_DEGC), axis=1)]
    own = np.where(rows.run == rows.run[np.argmax(setpoint)], 20.0, rows.columns[OWN])
    late = replace(rows, columns={**rows.columns, OWN: own, "setpoint_degC": setpoint})
    campaign = replace(campaign, sensors={2: replace(campaign.sensors[2], conditions=late)})
    problem = pose(campaign, load_model("matrix-6"), [effect_by_id("bias_T")])
    line = next(each for each in problem.candidates if each.name == "bias_T")
    terms = [(line, dict.fromkeys(range(len(line.parameters)), (1.0, 0.1)))]
    model = improved(problem.model, problem.sensors, terms, [], {"bias_T": {}}, frozenset())
    found = before_and_after(problem.model, model, problem.sensors, terms, frozenset(), {})
    assert max(each["temperature_degC"] for each in found) == pytest.approx(60.0, abs=0.1)


def test_what_follows_no_temperature_is_in_no_parameter() -> None:
    """A drift through each run stands beside the base in the improved model, and BA is printed as it is there."""
    curves = {"BA": lambda t: 30.0 + 10.0 * scaled(t)}
    campaign = rotor_night(np.random.default_rng(0), curves, run_to_run={}, white=1e-6)
    problem = pose(campaign, load_model("matrix-6"), [effect_by_id("drift")])
    drift, rows = next(each for each in problem.candidates if each.name == "drift"), campaign.sensors[2]
    drifting = replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + 20.0 * drift.columns[:, :, 0])
    sensors = {2: replace(problem.sensors[2], collects=drifting)}
    terms = [(drift, {0: (20.0, 0.1)})]
    model = improved(problem.model, sensors, terms, [], {"drift": {}}, frozenset({2}))
    found = before_and_after(problem.model, model, sensors, terms, frozenset({2}), {})
    assert "BA" in {each["name"] for each in found}
    for each in found:
        degC = each["temperature_degC"]
        assert each["after"] == pytest.approx(model.sensors[2][each["name"]].at(degC), abs=0.05)
        assert each["after"] == pytest.approx(curves.get(each["name"], np.zeros_like)(np.array(degC)), abs=0.05)
        assert abs(each["before"] - each["after"]) > 1.0


def test_a_term_without_a_name_says_how_far_it_moves_the_rate() -> None:
    """5.606e-15 per second to the third is nothing to anybody; what has no unit is a ratio; powers are told once."""
    cubic = {"name": "BB × start_s^3", "unit": "deg/hr", "sensor": 2, "at": "", "moves_deg_per_hr": 12.5}
    curve = {"unit": "deg/hr", "sensor": 2, "at": "", "moves_deg_per_hr": 3.0, "moves_se_deg_per_hr": None}
    parameters = [
        {**cubic, "value": 5.606e-15, "se": 5.9e-16, "moves_se_deg_per_hr": 1.3},
        {"name": "scale", "value": 0.0439, "se": 0.001, "unit": "1", "sensor": 2, "at": ""},
        *({"name": "BA × t", "value": v, "se": 1e-9, **curve} for v in (1e-5, 1e-10)),
    ]
    assert list(_values(parameters)) == [
        "  BB × start_s^3 (sensor 2), deg/hr from one end of these collects to the other: 12.5 ± 1.3",
        "  scale (sensor 2), ratio: 0.0439 ± 0.0010",
        "  BA × t (sensor 2), deg/hr from one end of these collects to the other: 3",
    ]


@pytest.mark.parametrize(
    ("overlap", "told", "likely", "probability", "withholds"),
    [
        (0.995, 1.0, True, 0.01, True),  # the same in these collects
        (0.995, 0.1, True, 0.01, False),  # which the data tell apart all the same
        (0.98, 1.0, True, 0.01, False),  # nearly the same, and no more probable by the data
        (0.98, 50.0, True, 0.01, True),  # but for physics the data would have it
        (0.995, 1.0, False, 0.01, False),  # an accident of the order, and hardly probable
        (0.995, 1.0, False, 0.3, True),
        (0.5, 50.0, True, 0.3, False),  # looks otherwise
    ],
)
def test_what_the_data_refute_withholds_no_name(
    overlap: float, told: float, likely: bool, probability: float, withholds: bool
) -> None:
    """GS_T at 99.7 % was ambiguous beside a scale factor that the data made a hundredth as probable."""
    rival = Rival("scale", probability, overlap, bayes_factor=told, prior_odds=1.0, likely=likely)
    assert rival.withholds is withholds


def test_what_the_data_say_of_a_rival_stands_apart_from_what_was_known_before() -> None:
    """1.00 and 0.00 beside "ambiguous" is no contradiction where physics alone ranks the two, and says so."""
    said = Rival("k2", 0.1, 0.0, bayes_factor=1.0, prior_odds=0.0004).in_words
    assert said == "the data cannot tell it apart; by how usual it is at this size, 0.0004 times as probable"
    said = Rival("k2", 0.1, 0.0, bayes_factor=0.13, prior_odds=0.05).in_words
    assert said.startswith(
        "the data make it 0.13 times as probable as the first name; by how usual it is at its size and"
    )
    assert Rival("k2", 0.1, 0.0).in_words == ""


def test_what_stands_only_beside_a_likelier_rival_is_no_further_name() -> None:
    """However improbable: its share in the first sentence was 0.0 %, beside 0.4 % further down."""
    spin = Rival("spin", 0.004, 0.98, alone=0.0, bayes_factor=0.05, prior_odds=0.07)
    assert spin.beside
    assert spin.in_words.startswith("mostly beside another of these")
    assert not Rival("demod", 0.004, 0.98, alone=0.004).beside
    assert not Rival("k2", 1e-20, 1.0, alone=0.0, bayes_factor=1.0).beside, "it looks the same"
