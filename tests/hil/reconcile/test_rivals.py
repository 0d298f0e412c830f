"""What stands in the place of a name: each by itself, so that shares add up, and nothing that no unit can do."""

from __future__ import annotations

import re
from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hil.campaign import FloatArray
from hil.reconcile import reconcile, workflow
from hil.reconcile.naming import in_its_place
from hil.reconcile.outcome.sentences import summary, what_to_do
from hil.reconcile.result import Reconciliation
from hil.reconcile.search.posterior import Found
from procedures.words import percent
from tests.hil.reconcile.hidden_effects import (
    EIGHT,
    Rows,
    base_rates,
    both,
    campaign_of,
    hidden_campaign,
    lay_out,
    noise,
)
from tests.hil.solve.runs_of_a_unit import campaign, with_rates


@pytest.mark.slow
def test_what_stands_in_the_place_of_a_name_is_said_once() -> None:
    """GS and MU follow temperature, or one term without a name does: both together are no two ways more."""

    def slopes(rows: Rows) -> FloatArray:
        warm = rows.temperature - 25.0
        return both(0.15 * warm * rows.f[:, 0], 1.0, -0.4) + both(0.08 * warm * rows.f[:, 2], 1.0, -1.0)

    result = reconcile(
        hidden_campaign(3, slopes, temperatures=(0.0, 20.0, 40.0), runs_each=2, thermal=False), "matrix-6", prove=False
    )
    together = [rival for effect in result.effects for rival in effect.confusable_with if rival.beside]
    assert together
    for effect in result.effects:
        rivals = effect.confusable_with
        assert effect.probability + sum(rival.share for rival in rivals) < 1.001
        for rival in rivals:
            assert rival.beside == ("mostly beside another" in rival.in_words)
    said = next(line for line in summary(result) if line.startswith(result.effects[0].title))
    assert not any(f"({rival.id})" in said for rival in together)


def warm_unit(temperatures: tuple[float, ...]) -> Reconciliation:
    """GSA and MUB follow temperature nearly in the ratio of the earth rate's parts: one column would describe both."""
    rng = np.random.default_rng(0)
    rows = lay_out(rng, temperatures, 3, ("1", "2", "3"))
    warm, (fa, fb, fs) = rows.temperature - 25.0, rows.f.T
    slopes = [(0.2 + 0.15 * fa + 0.1 * fs) * warm, (0.15 * fb + 0.004 * warm) * warm]
    rates = base_rates(rows, thermal=False) + np.stack(slopes, 1) + noise(rows, rng, run_bias=1.0, rho=0.0)
    return reconcile(campaign_of(rows, rates), "matrix-6", prove=False)


@pytest.mark.slow
def test_nothing_makes_the_earth_turn_faster(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of values that stand: what GSA and MUB follow is theirs, and no term without a name of a rate that is known."""
    monkeypatch.setattr(workflow, "FOLLOW", 1e-9)
    assert {"GS_T", "MU_real"} <= {effect.id for effect in warm_unit(EIGHT).effects}


@pytest.mark.slow
def test_a_rival_is_as_probable_as_what_the_data_say_of_it_and_what_was_known_make_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of the name's own part, where more of its history could not be asked about."""
    monkeypatch.setattr(workflow, "FOLLOW", 1e-9)
    effects = [*with_bias(0, lambda rows: 0.0 * rows.start_s).effects, *warm_unit(EIGHT).effects]
    rivals = [(effect, rival) for effect in effects for rival in effect.confusable_with]
    assert {"demod", "k2"} <= {rival.id for _, rival in rivals}  # nobody recorded the case, and three poses tell no k2
    for effect, rival in rivals:
        assert rival.bayes_factor is not None
        assert rival.prior_odds is not None
        both = effect.probability * rival.bayes_factor * rival.prior_odds
        assert rival.probability == pytest.approx(both, rel=1e-6, abs=1e-12)


@pytest.mark.slow
def test_values_that_follow_temperature_are_said_to() -> None:
    """Where they are all that there is nothing is missing: nobody may take that for values that stand."""
    result = warm_unit((-20.0, 0.0, 23.0, 50.0))
    assert result.verdict == "none"
    assert result.calibrated
    assert "its values follow temperature" in summary(result)[0]
    assert "values follow temperature, or time: each temperature was met once." in what_to_do(result)[1]


def with_bias(seed: int, hidden: Callable[[Rows], FloatArray]) -> Reconciliation:
    """A quiet unit, BA of which follows temperature, with more in BA."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, (-20.0, 0.0, 23.0, 50.0), 3)
    more = both(0.2 * (rows.temperature - 25.0) + hidden(rows), 1.0, 0.0)
    rates = base_rates(rows, thermal=False) + more + noise(rows, rng, run_bias=0.0)
    return reconcile(campaign_of(rows, rates), "matrix-6", prove=False)


@pytest.mark.slow
def test_what_is_probable_and_not_called_missing_is_said() -> None:
    """Nine of ten that a bias ages beside bias_T are too few for a rate of 5 %; but it is why time is spoken of."""
    result = with_bias(1, lambda rows: rows.start_s / 3600.0)
    assert [effect.id for effect in result.effects] == ["bias_T"]
    assert dict(result.follows)["time"] > 0.8
    too_few = re.compile(r"\(ageing\): 8\d %, and so not called missing at a rate of false alarms of 0.05")
    assert any(too_few.search(note) for note in result.notes)
    sure = with_bias(1, lambda rows: 3.0 * rows.start_s / 3600.0)
    assert not any("not called missing" in note for note in sure.notes)


@pytest.mark.slow
def test_a_term_without_a_name_has_its_rivals_beside_it_and_what_would_tell_them_apart() -> None:
    """A step in time at a change of temperature: which of both it follows these collects cannot tell."""
    result = with_bias(0, lambda rows: 15.0 * (rows.run > 6))
    effect = next(effect for effect in result.effects if effect.kind == "empirical")
    assert "jump" in {rival.id for rival in effect.confusable_with}
    said = next(line for line in summary(result) if effect.id in line)
    assert f"({percent(effect.probability)}), or – " in said
    assert "(jump)" in said
    assert result.next_experiment is not None
    assert result.next_experiment["why"].endswith("jump: let time go in another order than temperature")


def test_what_moves_and_what_scatters_stand_for_each_other_where_nothing_else_of_a_sort_is_there() -> None:
    """Beside a lead of MU_rr and a walk, ageing with MU_rr is the walk's rival, and what scatters where it is there."""
    scatters = frozenset({"MU_rr", "rrw", "markov"})
    every = [{"MU_rr", "ageing"}, {"MU_rr", "markov"}, {"markov", "ageing"}]
    sets = [(frozenset(own), 0.1, cast(Found, SimpleNamespace(scatter=scatters & own))) for own in every]
    lead = frozenset({"MU_rr", "rrw"})
    found = in_its_place(sets, lead, moves=False)
    assert {name: len(of) for name, of in found.items()} == {"ageing": 1, "markov": 2}
    found = in_its_place(sets, lead, moves=True)
    assert {name: len(of) for name, of in found.items()} == {"ageing": 2, "markov": 1}


def of_a_unit_that_ages(seed: int) -> Reconciliation:
    """What is said of twelve runs at one temperature, half an hour each, whose bias rises by 2.2 deg/hr in an hour."""
    made = campaign(12, 12, seed, scatter=2.0)
    rows = made.sensors[2]
    ages = np.outer(2.2 * rows.conditions.start_s / 3600.0, [1.0, 0.0])
    return reconcile(with_rates(made, rows.rates_deg_per_hr + ages), "matrix-6", prove=False)


@pytest.mark.slow
def test_nothing_is_measured_against_a_rival_that_is_hardly_probable() -> None:
    """Nor against what a night at one temperature cannot have: the same again shows whether it was chance."""
    result = of_a_unit_that_ages(5)
    (ages,) = result.effects
    assert (ages.id, ages.kind) == ("ageing", "ambiguous")
    assert 0.0 < max(rival.share for rival in ages.confusable_with) < 0.05
    assert result.next_experiment is not None
    assert result.next_experiment["why"] == "shows ageing again, or that it was chance"


@pytest.mark.slow
def test_ageing_that_is_likelier_than_a_walk_is_its_first_rival_and_measured_against() -> None:
    """It stood in a note alone; of two sorts no factor of the data is told, and how to part them is."""
    result = of_a_unit_that_ages(7)
    (walk,) = (effect for effect in result.effects if effect.acts_on == "scatter")
    first = walk.confusable_with[0]
    assert first.id == "ageing"
    assert first.probability > walk.probability
    assert first.bayes_factor is first.prior_odds is None
    assert result.next_experiment is not None
    assert result.next_experiment["why"].startswith(f"separates {walk.id} from ageing: A second night")
    assert f"or – {percent(first.share)} – Ageing of the bias" in " ".join(summary(result))
