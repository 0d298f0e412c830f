"""What is hidden is found and called by its name; what cannot be told apart is called ambiguous."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.model.effects.catalogue import effect_by_id
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.naming import as_usual, leading
from hil.reconcile.result import FoundEffect, stated
from hil.reconcile.scattering import what_scatters
from tests.hil.reconcile.hidden_effects import (
    EIGHT,
    Hidden,
    Rows,
    base_rates,
    both,
    campaign_of,
    hidden_campaign,
    lay_out,
    noise,
)
from tests.hil.solve.runs_of_a_unit import campaign as made_of_runs


def ids(result: Reconciliation) -> list[str]:
    """Ids in the order found."""
    return [effect.id for effect in result.effects]


def also(*case: object) -> object:
    """Try this one, too, where everything is tried."""
    return pytest.param(*case, marks=pytest.mark.slow)


def mass_unbalance(rows: Rows) -> np.ndarray:
    """RA += MUB fS, RB -= MUA fS with MUA = 14, MUB = -20 deg/hr/g."""
    return np.stack([-20.0 * rows.f[:, 2], -14.0 * rows.f[:, 2]], 1)


def on_the_mean(result: Reconciliation) -> list[FoundEffect]:
    """What moves averages: beside it a scatter may be found that the noise, correlated from run to run, really has."""
    return [effect for effect in result.effects if effect.acts_on == "mean"]


@pytest.mark.parametrize(
    ("probable", "lead"),
    [
        ({("ageing", ""): 0.74, ("", "rrw"): 0.25, ("", ""): 0.01}, "rrw"),  # a walk is a quarter as probable
        ({("jump", ""): 0.92, ("", "rrw"): 0.07, ("", ""): 0.01}, "jump"),
        ({("jump", ""): 0.90, ("", "rrw"): 0.02, ("", ""): 0.08}, ""),
        ({("jump", "MU_rr"): 0.85, ("", "MU_rr"): 0.04, ("jump", ""): 0.11}, "jump"),
        ({("jump", "MU_rr"): 0.92, ("", "MU_rr"): 0.04, ("jump", ""): 0.04}, "MU_rr jump"),
        ({("ageing", "MU_rr"): 0.60, ("", "MU_rr"): 0.15, ("", "base"): 0.24}, "base"),
        ({("ageing", "MU_rr"): 0.60, ("hyst", "MU_rr"): 0.38, ("", "base"): 0.01, ("", ""): 0.01}, "MU_rr ageing"),
        ({("k2", "rrw"): 0.4, ("k2", ""): 0.6}, "k2"),
        ({("hyst", "MU_rr"): 0.50, ("", "MU_rr rrw"): 0.48, ("", "MU_rr"): 0.02}, "MU_rr rrw"),
        ({("hyst", "MU_rr"): 0.50, ("", "MU_rr rrw"): 0.40, ("", "MU_rr"): 0.10}, "MU_rr"),
        ({("turnon", ""): 0.55, ("", "turnon"): 0.44, ("", ""): 0.01}, "turnon"),  # either moves or scatters
        # What is as good is likelier where more sets have it; what has no name takes no name's place.
        ({("hyst", "MU_rr"): 0.40, ("bias_T", "MU_rr"): 0.38, ("bias_T jump", "MU_rr"): 0.22}, "bias_T MU_rr"),
        ({("hyst", "rrw"): 0.40, ("bias_T", "rrw"): 0.38, ("bias_T", "markov"): 0.22}, "bias_T rrw"),
        ({("hyst", "rrw"): 0.40, ("bias_T", "markov"): 0.30, ("bias_T", "base"): 0.30}, "hyst rrw"),
        ({("hyst", ""): 0.40, ("empirical", ""): 0.39, ("empirical drift", ""): 0.21}, "hyst"),
        ({}, ""),
    ],
)
def test_what_moves_averages_leads_only_where_scatter_alone_is_improbable(
    probable: dict[tuple[str, str], float], lead: str
) -> None:
    """At 5 %: nothing in a name's place at most .05, and what only scatters at most .1."""
    every = {(frozenset(mean.split()), frozenset(kinds.split())): p for (mean, kinds), p in probable.items()}
    assert leading(every, 0.05) == set(lead.split())


def test_a_name_leads_by_what_is_its_own() -> None:
    """Of a hysteresis that nobody recorded enough for, three quarters are what could not be tried."""
    every = {("bias_T", ""): 0.40, ("hyst", ""): 0.52, ("", ""): 0.03}
    weights = {(frozenset(mean.split()), frozenset(kinds.split())): p for (mean, kinds), p in every.items()}
    assert leading(weights, 0.05) == {"hyst"}
    assert leading(weights, 0.05, {"hyst": 0.25, "bias_T": 0.8}) == {"bias_T"}
    weights[frozenset(), frozenset()] = 0.6  # but nothing is no name, and leads by all that it has
    assert leading(weights, 0.05, {"hyst": 0.25, "bias_T": 0.8}) == set()


def test_of_two_causes_outside_the_sensor_that_look_the_same_neither_is_named() -> None:
    """Input axes that lean are as usual as a magnetic field; as a mass unbalance they are not, and it has its name."""
    here = [hidden_campaign(7).sensors[2].conditions]
    assert as_usual(effect_by_id("misalign"), effect_by_id("mag"), here)
    assert not as_usual(effect_by_id("mag"), effect_by_id("misalign"), here)  # by the one heading of collects
    assert not as_usual(effect_by_id("misalign"), effect_by_id("MU_real"), here)
    assert as_usual(effect_by_id("k2"), effect_by_id("MU_real"), here)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "hidden", "model", "thermal"),
    [
        ("supply", lambda r: both(r.supply - 28.0, 14.0, -13.0), "matrix-6-thermal", True),
        also("jump", lambda r: both(r.run > 7, 12.0, -11.0), "matrix-6-thermal", True),
        also("warmup", lambda r: both(np.exp(-r.start_s / 2400.0), 90.0, -100.0), "matrix-6-thermal", True),
        also("bias_T", lambda r: both(r.temperature - 20.0, 0.2, 0.5), "matrix-6", False),
        also("GS_T", lambda r: both(r.f[:, 0] * (r.temperature - 20.0), 0.1, 0.06), "matrix-6", False),
    ],
)
def test_a_hidden_effect_gets_its_name(name: str, hidden: Hidden, model: str, thermal: bool) -> None:
    """One effect, clearly there: its own name at .8 or more, and the gap shrinks on runs that were not seen.

    The bias of runs is correlated from run to run. What wanders so may be called an ageing beside the effect, but then
    as one of several that it may be, or as the scatter that it is.
    """
    result = reconcile(hidden_campaign(7, hidden, thermal=thermal), model)
    first, *others = on_the_mean(result)
    assert first.id == name
    assert first.probability >= 0.8
    assert all(other.kind == "ambiguous" for other in others)
    assert result.gap.standardised_after < result.gap.standardised_before


@pytest.mark.parametrize(
    ("truth", "hidden", "model"),
    [
        also("bias_Tdot", lambda r: both(r.slope, 60.0, -45.0), "matrix-6-thermal"),
        also("drift", lambda r: both(r.order * 1.0, 3.0, -2.0), "matrix-6"),
        also("k2", lambda r: both(r.f[:, 2] ** 2 - r.f[:, 0] ** 2, 3.0, -2.0), "matrix-6"),
    ],
)
def test_columns_that_are_the_same_in_this_design_are_ambiguous(truth: str, hidden: Hidden, model: str) -> None:
    """The truth is in the stated class, the verdict is ambiguous, and an experiment is proposed."""
    night = hidden_campaign(7, hidden, thermal=model != "matrix-6", temperatures=EIGHT[::2])
    result = reconcile(night, model, prove=False)
    assert result.verdict == "ambiguous"
    assert all(other.kind == "ambiguous" for other in result.effects[1:])  # the bias of runs wanders
    same = {result.effects[0].id} | {r.id for r in result.effects[0].confusable_with if r.overlap > 0.95}
    assert truth in same
    assert result.next_experiment is not None


@pytest.mark.slow
def test_what_collects_tell_of_parameters_only_together_is_said() -> None:
    """At 1 g kAA + kSS is a bias: both had stood there with a ± each that did not hold, and not a word of it."""
    night = {"temperatures": (-25.0, 25.0), "runs_each": 2, "positions": tuple("123413")}
    hidden = hidden_campaign(7, lambda r: both(6.0 * r.f[:, 2] ** 2, 4.0, -3.0), thermal=False, **night)
    result = reconcile(hidden, "matrix-6", prove=False)
    assert "k2" in ids(result)
    (said,) = [note for note in result.notes if note.startswith("k2, sensor 2: kAA_A - kSS_A")]
    assert "kAA_A + kSS_A are not (kAA_A - kSS_A" in said
    told = re.search(r" kAS_A = (-?[0-9.]+) ± ([0-9.]+) deg/hr/g²\): by itself each is only as", said)
    assert told is not None, said
    assert abs(float(told[1]) + 24.0) < 4.0 * float(told[2])
    assert float(told[2]) < 2.0


@pytest.mark.slow
def test_a_slope_has_the_name_that_the_catalogue_gives_it() -> None:
    """A bias of 0.5 deg/hr/°C is b1_A of the equation, not B_A, which is a rate; GS and MU have theirs."""
    campaign = hidden_campaign(3, lambda rows: both(rows.temperature, 0.5, 0.5), thermal=False, mu=False)
    (effect,) = on_the_mean(reconcile(campaign, "matrix-6", prove=False))
    assert (effect.id, "b1 (T - 25 degC)" in effect.equation) == ("bias_T", True)
    named = {each["unit"]: each["name"] for each in effect.parameters if each["name"].endswith("_A")}
    assert named.pop("deg/hr", "B_A") == "B_A"
    assert named.pop("deg/hr/degC") == "b1_A"
    assert named.pop("deg/hr/degC^2", "b2_A") == "b2_A"


@pytest.mark.slow
def test_values_that_the_model_has_are_not_what_is_missing_where_they_follow_temperature() -> None:
    """MU of matrix-6 that has a slope: its dependence is missing, by title, equation and names, not MU."""
    campaign = hidden_campaign(
        3, lambda rows: mass_unbalance(rows) * rows.temperature[:, None] / 40.0, thermal=False, mu=False
    )
    (effect,) = on_the_mean(reconcile(campaign, "matrix-6", prove=False))
    assert (effect.id, effect.title) == ("MU_real", "MUA, MUB temperature dependence")
    assert "MU1 (T - 25 degC)" in effect.equation
    assert {each["name"] for each in effect.parameters} >= {"MUA1", "MUB1"}
    assert not {"MUA", "MUB"} & {each["name"] for each in effect.parameters}


@pytest.mark.slow
def test_three_collects_cannot_tell_mass_unbalance_from_g_squared_and_ask_for_the_fourth() -> None:
    """The contractor's model, collects 1-2-3: ambiguous, led by MU_real, k2 among the rivals, Collect 4 next."""
    night = {"temperatures": (-25.0, 0.0, 25.0, 50.0), "positions": ("1", "2", "3")}
    result = reconcile(hidden_campaign(7, mass_unbalance, thermal=False, mu=False, **night), "collins-4")
    assert result.verdict == "ambiguous"
    assert ids(result)[0] == "MU_real"
    assert "k2" in {rival.id for rival in result.effects[0].confusable_with}
    values = {p["name"]: p["value"] for p in result.effects[0].parameters}
    assert values["MUA"] == pytest.approx(14.0, abs=1.5)
    assert values["MUB"] == pytest.approx(-20.0, abs=1.5)
    assert result.next_experiment is not None
    assert [c["position"] for c in result.next_experiment["collects"]] == ["4"]
    assert result.next_experiment["collects"][0]["f"][2] == pytest.approx(-1.0, abs=0.01)
    assert result.next_experiment["power"] > 0.95
    places = {(d.where["channel"], d.where.get("position")) for d in result.disagreements[:2]}
    assert places == {("RA", "3"), ("RB", "3")}


@pytest.mark.slow
def test_the_fourth_collect_settles_it() -> None:
    """With Collect 4 in the data it is MU_real, with the right signs."""
    campaign = hidden_campaign(7, mass_unbalance, thermal=False, mu=False, temperatures=EIGHT[::2])
    result = reconcile(campaign, "collins-4")
    assert [(effect.id, effect.kind) for effect in on_the_mean(result)] == [("MU_real", "named")]
    values = {p["name"]: p["value"] for p in result.effects[0].parameters}
    assert values["MUA"] == pytest.approx(14.0, abs=0.8)
    assert values["MUB"] == pytest.approx(-20.0, abs=0.8)
    assert result.gap.after < 0.2 * result.gap.before


@pytest.mark.slow
def test_two_effects_at_once_are_both_found() -> None:
    """Supply and a step, together."""
    campaign = hidden_campaign(7, lambda r: both(r.supply - 28.0, 14.0, -13.0) + both(r.run > 8, 12.0, -11.0))
    result = reconcile(campaign, "matrix-6-thermal", prove=False)
    assert sorted(ids(result)) == ["jump", "supply"]


@pytest.mark.parametrize(
    ("words", "hidden"),
    [
        also("MU × supply_V", lambda r: both(r.f[:, 2] * (r.supply - 28.0), 14.0, -13.0)),
        also("MU × temperature_degC[", lambda r: both(r.f[:, 2] * (np.abs(r.temperature - 6.0) < 6.0), 5.0, -5.0)),
    ],
)
def test_what_the_catalogue_does_not_know_is_empirical(words: str, hidden: Hidden) -> None:
    """A term outside the catalogue, and one at a single temperature: no false name, the term itself is stated."""
    result = reconcile(hidden_campaign(7, hidden), "matrix-6-thermal")
    assert result.verdict == "empirical"
    assert ids(result)[0].startswith(f"empirical: {words}")
    assert result.gap.after < result.gap.before


@pytest.mark.slow
def test_of_several_steps_each_has_its_run() -> None:
    """Two jumps: the first had been said, and J_A twice without a word of which it is."""
    rng = np.random.default_rng(1)
    rows = lay_out(rng, runs_each=3)
    hidden = both(rows.run > 8, 9.0, -8.0) + both(rows.run > 17, -7.0, 9.0)
    one = campaign_of(rows, base_rates(rows, thermal=False) + noise(rows, rng, run_bias=0.0) + hidden)
    (found,) = reconcile(one, "matrix-6", prove=False).effects
    assert found.shape_in_words == "from run 9 on and from run 18 on"
    told = [name.partition(" (")[0] for name, *_ in stated(found.parameters)]
    assert told == [f"{name}, from run {run} on" for run in (9, 18) for name in ("J_A", "J_B")]


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_of_several_terms_without_a_name_each_is_said() -> None:
    """The bias follows one number and MU another: the first had been said, beside the values of both."""
    rng = np.random.default_rng(1)
    rows = lay_out(rng, runs_each=3)
    fan, oil = rng.normal(size=(2, rows.run.max() + 1))[:, rows.run]
    hidden = both(fan, 6.0, 5.0) + both(oil * rows.f[:, 2], 5.0, 4.0)
    one = campaign_of(rows, base_rates(rows, thermal=False) + noise(rows, rng, run_bias=0.0) + hidden)
    own = one.sensors[2]
    columns = {**own.conditions.columns, "fan_rpm": 1000.0 + 50.0 * fan, "oil_bar": 1.0 + 0.1 * oil}
    one = replace(one, sensors={2: replace(own, conditions=replace(own.conditions, columns=columns))})
    (found,) = reconcile(one, "matrix-6", prove=False).effects
    assert found.id == "empirical: B × fan_rpm, MU × oil_bar"
    assert found.title == "B follows fan_rpm and MU follows oil_bar"
    assert {str(each["name"]) for each in found.parameters} == {f"{n} × fan_rpm" for n in ("BA", "BB")} | {
        f"{n} × oil_bar" for n in ("MUA", "MUB")
    }
    assert what_scatters(one).moves == (found.id,)


@pytest.mark.slow
def test_a_wrong_heading_is_found_where_several_headings_were_measured() -> None:
    """The horizontal earth rate turned by 8 degrees, three headings: earth, not misalignment."""

    def wrong(rows: Rows) -> np.ndarray:
        h, off, level = np.deg2rad(rows.heading), np.deg2rad(8.0), 15.041067 * np.cos(np.deg2rad(34.6))
        d2, d3 = level * (np.cos(h + off) - np.cos(h)), level * (np.sin(h + off) - np.sin(h))
        theta = np.deg2rad([{"1": -90.0, "2": 90.0, "3": 0.0, "4": 180.0}[p] for p in rows.position])
        return np.stack([d3 * np.cos(theta), d2], 1)

    result = reconcile(hidden_campaign(7, wrong, headings=(30.0, 120.0, 210.0)), "matrix-6-thermal", prove=False)
    assert result.verdict == "named"
    assert ids(result) == ["earth"]


@pytest.mark.slow
@pytest.mark.parametrize(("sizes", "differ"), [((12.0, 12.0), False), ((12.0, 2.0), True)])
def test_how_sure_a_jump_is_is_said_of_each_sensor_where_that_differs(
    sizes: tuple[float, float], *, differ: bool
) -> None:
    """An event of one sensor or of both: one probability of both hid that the other's was seen less surely."""
    rows = {}
    for number, size in enumerate(sizes, 1):
        own = made_of_runs(12, 12, seed=20 + number, scatter=1.0).sensors[2]
        conditions = replace(own.conditions, sensor=replace(own.conditions.sensor, number=number))
        rates = own.rates_deg_per_hr + size * (conditions.run >= 7)[:, None]
        rows[number] = replace(own, conditions=conditions, rates_deg_per_hr=rates)
    made = Campaign("two", "", rows, site={"latitude_deg": 34.6})
    (jump,) = reconcile(made, "matrix-6", prove=False).effects
    assert (jump.id, jump.sensors) == ("jump", [1, 2])
    assert max(jump.of_sensor.values()) <= jump.probability
    assert ("sensor 1: 100.0 %, sensor 2: 9" in jump.sure) == differ
    assert set(jump.document()["probability_of_sensor"]) == {"1", "2"}
