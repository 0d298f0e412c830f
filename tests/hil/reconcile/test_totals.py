"""What is printed is what a parameter is: an increment of the model's own value stands beside the value."""

from __future__ import annotations

import pytest

from hil.cli.model import _values
from hil.model import Model
from hil.model.curve import Constant
from hil.model.model_file import SCHEMA
from hil.reconcile.outcome.findings import with_totals
from hil.reconcile.result import FoundEffect, rival_in_words


def test_an_increment_says_what_the_parameter_then_is() -> None:
    """MUB is 206 in the model and -184 is added at one temperature: 22 stands first; the rest is as it was."""
    at = {"se": 2.0, "unit": "deg/hr/g", "sensor": 2}
    parameters = [
        {"name": "MUB", "value": -184.0, "at": "-29.6 degC", **at},
        {"name": "MUB", "value": 3.0, "at": "-29.6 to 60.0 degC", **at},
        {"name": "s_mu", "value": 4.0, "at": "", **at},
    ]
    found = FoundEffect("MU_T", "", "", parameters, 1.0, [], "named")
    curves = {2: {"MUB": Constant(unit="deg/hr/g", value=206.0)}}
    after = Model(schema=SCHEMA, title="t", form="matrix-6", source="s", sensors=curves)
    (told,) = with_totals([found], after)
    assert [each.get("total") for each in told.parameters] == [pytest.approx(22.0), None, None]
    lines = list(_values(told.parameters))
    assert "22.0 ± 2.0 (-184.0 by this effect) at -29.6 °C" in lines[0]


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


def test_what_the_data_say_of_a_rival_stands_apart_from_what_was_known_before() -> None:
    """1.00 and 0.00 beside "ambiguous" is no contradiction where physics alone ranks the two, and says so."""
    said = rival_in_words({"bayes_factor": 1.0, "prior_odds": 0.0004})
    assert said == "the data cannot tell it apart; before them it was 0.0004 times as probable"
    assert "the data make it 0.13 times as probable" in rival_in_words({"bayes_factor": 0.13, "prior_odds": 0.05})
    assert rival_in_words({"id": "k2", "probability": 0.1}) == ""
