"""Where: the collects in which a missing effect acts are the places that the result names, and no others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import false_discovery_control

from hil.campaign import Campaign
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.outcome.page import page, place_in_words
from hil.reconcile.proof.places import _sure, false_discovery
from hil.reconcile.result import Disagreement
from tests.hil.reconcile.hidden_effects import Rows, base_rates, both, campaign_of, lay_out, noise
from tests.hil.reconcile.test_choices import turning


def with_hidden(hidden: Callable[[Rows], np.ndarray], seed: int = 5) -> tuple[Campaign, Rows]:
    """A night of eight temperatures, two runs at each, four collects a run."""
    rows = lay_out(np.random.default_rng(seed))
    rates = base_rates(rows) + noise(rows, np.random.default_rng(seed + 1)) + hidden(rows)
    return campaign_of(rows, rates), rows


def covered(found: list[Disagreement], rows: Rows) -> np.ndarray:
    """The rows and channels of all places, (n, 2), read as a stranger would read the document."""
    out = np.zeros((len(rows), 2), dtype=bool)
    for place in found:
        where = place.where
        inside = np.ones(len(rows), dtype=bool)
        if "position" in where:
            inside &= rows.position == where["position"]
        if "temperature_degC" in where:
            inside &= (rows.temperature >= where["temperature_degC"][0]) & (
                rows.temperature <= where["temperature_degC"][1]
            )
        if "runs" in where:
            inside &= np.isin(rows.run, where["runs"])
        out[inside, ["RA", "RB"].index(where["channel"])] = True
    return out


def agreement(found: np.ndarray, truth: np.ndarray) -> float:
    """F1."""
    return float(2.0 * (found & truth).sum() / (found.sum() + truth.sum()))


def ripple(rows: Rows) -> np.ndarray:
    """The supply acts on the bias of both channels, up and down."""
    return both(rows.supply - 28.0, 14.0, -13.0)


def one_position_cold(rows: Rows) -> np.ndarray:
    """One channel, one position, below 10 °C."""
    return both((rows.position == "3") & (rows.temperature < 10.0), 9.0, 0.0)


@pytest.fixture(scope="module")
def supplied() -> tuple[Reconciliation, Rows]:
    """What is said of an effect that is everywhere."""
    campaign, rows = with_hidden(ripple)
    return reconcile(campaign, "matrix-6-thermal", prove=False), rows


@pytest.fixture(scope="module")
def cornered() -> tuple[Reconciliation, Rows]:
    """What is said of one that is in a corner."""
    campaign, rows = with_hidden(one_position_cold)
    return reconcile(campaign, "matrix-6-thermal", prove=False), rows


@pytest.mark.slow
@pytest.mark.parametrize(("said", "hidden"), [("supplied", ripple), ("cornered", one_position_cold)])
def test_places_are_the_collects_in_which_the_effect_acts(
    said: str, hidden: Callable[[Rows], np.ndarray], request: pytest.FixtureRequest
) -> None:
    """Everywhere or in a corner: the places are the collects where it is large."""
    result, rows = request.getfixturevalue(said)
    truth = np.abs(hidden(rows))
    found = covered(list(result.disagreements), rows)
    assert agreement(found, truth > 0.25 * truth.max()) > 0.8


@pytest.mark.slow
def test_a_corner_is_one_place_with_the_size_that_is_there(cornered: tuple[Reconciliation, Rows]) -> None:
    """One channel, one position, the cold half: one place, by its temperatures, and its size within the error.

    No effect of the catalogue does that: it is called empirical, by the position.
    """
    result, rows = cornered
    assert result.effects[0].kind == "empirical"
    assert "position=3" in result.effects[0].id
    assert [(d.where["channel"], d.where["position"]) for d in result.disagreements] == [("RA", "3")]
    place = result.disagreements[0]
    low, high = place.where["temperature_degC"]
    assert place_in_words(place.where).endswith(f" to {high:.0f} °C (the unit's own)")
    assert low < rows.temperature.min() + 0.11
    assert 5.0 < high < 10.0
    assert abs(place.size_deg_per_hr - 9.0) < 3.0 * place.se_deg_per_hr
    assert place.se_deg_per_hr < 2.0
    assert result.p_value <= place.q_value < 0.01


@pytest.mark.slow
def test_an_effect_of_both_signs_has_places_of_both_signs_largest_first(supplied: tuple[Reconciliation, Rows]) -> None:
    """The supply is above and below: runs with more on one side, runs with less on the other, for each channel."""
    result, rows = supplied
    places = list(result.disagreements)
    sizes = [abs(place.size_deg_per_hr) for place in places]
    assert sizes == sorted(sizes, reverse=True)
    for place in places:
        assert "position" not in place.where
        above = rows.supply[np.isin(rows.run, place.where["runs"])] > 28.0
        assert np.mean(above == (place.size_deg_per_hr * (1 if place.where["channel"] == "RA" else -1) > 0)) > 0.9


@pytest.mark.slow
def test_of_an_effect_that_the_base_imitates_in_part_the_places_are_what_is_left() -> None:
    """A bias by how much warmer the case is: 8 °C of that are in the base's bias, and nobody knows how much is there.

    160 deg/hr in every run would be called the place of what differs from run to run by ten.
    """
    rows = lay_out(np.random.default_rng(6), (-20.0, 5.0, 30.0, 50.0))
    warmer = np.random.default_rng(15).normal(0.0, 0.4, rows.run.max() + 1)[rows.run]
    rates = base_rates(rows) + noise(rows, np.random.default_rng(7)) + both(8.0 + warmer, 20.0, 0.0)
    made = campaign_of(rows, rates).sensors[2]
    columns = {**made.conditions.columns, "case_degC": rows.temperature + 8.0 + warmer}
    night = replace(made, conditions=replace(made.conditions, columns=columns))
    result = reconcile(replace(campaign_of(rows, rates), sensors={2: night}), "matrix-6-thermal", prove=False)
    assert [effect.id for effect in result.effects] == ["bias_grad"]
    seen = 20.0 * (warmer - warmer.mean())
    places = list(result.disagreements)
    assert {place.size_deg_per_hr > 0.0 for place in places} == {True, False}
    for place in places:
        here = seen[np.isin(rows.run, place.where["runs"])]
        assert place.where["channel"] == "RA"
        assert np.all(here * place.size_deg_per_hr > 0.0)
        assert abs(place.size_deg_per_hr) < np.abs(seen).max()


def test_where_a_position_is_moved_both_ways_the_places_are_collects_of_a_run() -> None:
    """A drift in a palindrome: the means of a position are nothing; each run's ends are moved, and one way."""
    rows = lay_out(np.random.default_rng(5), (10.0, 45.0), 3, ("1", "3", "2", "2", "3", "1"))
    hidden = both(rows.order - 2.5, 1.5, -1.0)
    rates = base_rates(rows, thermal=False) + noise(rows, np.random.default_rng(6)) + hidden
    places = list(reconcile(campaign_of(rows, rates), "matrix-6", prove=False).disagreements)
    assert {(d.where["channel"], d.where["collect_of_run"]) for d in places} == {
        (channel, collect) for channel in ("RA", "RB") for collect in (1, 2, 5, 6)
    }
    assert len(places) == 8
    for each in places:
        moved = hidden[rows.order == each.where["collect_of_run"] - 1, ["RA", "RB"].index(each.where["channel"])]
        assert abs(each.size_deg_per_hr - moved.mean()) < 4.0 * each.se_deg_per_hr
    assert ", collect 6 of each run" in place_in_words(places[0].where | {"collect_of_run": 6})


def test_runs_are_said_in_stretches() -> None:
    """A reader is told runs 1–3, 7."""
    said = place_in_words({"sensor": 2, "channel": "RA", "runs": [1, 2, 3, 7]})
    assert said == "sensor 2, channel RA, runs 1–3, 7"
    scatters = place_in_words({"sensor": 2, "channel": "RA", "of": "scatter", "effect": "MU_rr"})
    assert scatters == "sensor 2, channel RA, what its averages scatter by, rms over all of them (MU_rr)"


@pytest.mark.slow
def test_the_page_lists_the_largest_places_and_says_how_many_more_there_are(
    cornered: tuple[Reconciliation, Rows],
) -> None:
    """A page stays readable where an effect has thirty places; the file has them all."""
    result, _ = cornered
    place = result.disagreements[0]
    many = page(replace(result, disagreements=[place] * 30))
    assert many.count("sensor 2, channel RA, position 3") == 12
    assert "and 18 smaller ones, in reconciliation.json" in many
    assert "smaller ones" not in page(result)


def test_false_discovery_rates_are_scipys() -> None:
    """Ours spares every reconciliation the import."""
    chances = np.random.default_rng(2).random(200) ** 3
    np.testing.assert_allclose(false_discovery(chances), false_discovery_control(chances), rtol=1e-14)


def test_of_what_is_everywhere_a_little_the_surest_place_stands() -> None:
    """No place holds by itself where a name does: the surest has its chance beside it; else only what holds is told."""
    vague, surer, sure = (Disagreement({"runs": [n]}, size, 1.0, 1.0) for n, size in enumerate((0.3, 1.2, 9.0)))
    assert [each.where for each in _sure([vague, surer], 1e-3, 0.05)] == [surer.where]
    assert _sure([vague, surer], 1e-3, 0.05)[0].q_value > 0.05
    assert [each.where for each in _sure([vague, surer, sure], 1e-3, 0.05)] == [sure.where]
    assert _sure([], 1e-3, 0.05) == []


@pytest.mark.slow
def test_at_a_temperature_that_was_only_seen_with_an_effect_nothing_disagrees() -> None:
    """A jump between the runs of one temperature: those of warmer ones agree with each other, as calibrated there."""
    campaign = turning(3, 3)
    own = campaign.sensors[2]
    run = own.conditions.run
    more = np.where(run[:, None] > 10, [25.0, -18.0], 0.0)
    moved = replace(campaign, sensors={2: replace(own, rates_deg_per_hr=own.rates_deg_per_hr + more)})
    result = reconcile(moved, "matrix-6", prove=False)
    assert result.calibration == "per temperature"
    assert {"jump"} == {effect.id for effect in result.effects if effect.parameters}
    places = [runs for each in result.disagreements for runs in each.where.get("runs", run)]
    assert set(places) <= {10, 11, 12}
