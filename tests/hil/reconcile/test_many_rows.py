"""Where rows are many, what is odd is asked about, every step near the best is tried, and values follow as they do."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest

from hil.campaign import Collects, FloatArray, IntArray
from hil.model import load_model
from hil.model.effects.catalogue import EFFECTS, SERIES_EFFECTS, VARIANCE_EFFECTS, effect_by_id
from hil.model.effects.prior import MANY as SHAPES
from hil.reconcile.inside import named_within
from hil.reconcile.search import problem as search_problem
from hil.reconcile.search.block_search import BlockSearch
from hil.reconcile.search.candidates import MANY, catalogue_candidates
from hil.reconcile.search.filters import Filter
from hil.reconcile.search.layout import searches
from hil.reconcile.search.likely_noise import _Rows
from hil.reconcile.search.mistakes import AsSolved, exchanges, may_be_wrong
from hil.reconcile.search.noise import Noise
from hil.reconcile.search.points import FOLLOWS, Points, Profile, log_profile
from hil.reconcile.search.problem import Problem, pose
from tests.hil.reconcile.hidden_effects import Rows, base_rates, both, hidden_campaign


def season(hidden: object = None) -> Problem:
    """A hundred and twenty runs of four collects, sixty at each of two temperatures; a step is all that is asked."""
    layout = {"temperatures": (-20.0, 30.0), "runs_each": 60}
    campaign = hidden_campaign(3, hidden, thermal=False, **layout)  # type: ignore[arg-type]
    return pose(campaign, load_model("matrix-6"), (effect_by_id("jump"),))


def _nothing(filed: Collects) -> AsSolved:
    """Return what `hil solve` makes of collects of which it doubts none."""
    rates = filed.rates_deg_per_hr
    return AsSolved(filed, rates, None, ())


def test_of_many_rows_those_that_are_odd_are_asked_about() -> None:
    """Two hundred of 480, the spoiled one and its run among them; of few rows every one."""
    spoiled = 333

    def gross(rows: Rows) -> np.ndarray:
        return both((np.arange(len(rows)) == spoiled).astype(float), 40.0, 0.0)

    problem = season(gross)
    conditions = problem.sensors[2].collects.conditions
    found = list(may_be_wrong(2, problem.blocks, conditions, _nothing(problem.sensors[2].collects)))
    rows = {int(c.shape["row"]) for c in found if c.name == "row"}
    assert len(rows) == MANY
    assert spoiled in rows
    assert float(conditions.run[spoiled]) in {c.shape["number"] for c in found if c.name == "run"}
    few = pose(hidden_campaign(3, temperatures=(0.0, 20.0, 40.0)), load_model("matrix-6"), ())
    every = few.sensors[2].collects.conditions
    asked = {
        int(c.shape["row"])
        for c in may_be_wrong(2, few.blocks, every, _nothing(few.sensors[2].collects))
        if c.name == "row"
    }
    assert asked == set(range(len(every)))


def test_columns_of_very_many_rows_are_made_anew_and_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of every effect of the catalogue, in every shape and form: what is not kept is what would have been."""
    campaign = hidden_campaign(3, lambda rows: both(rows.f[:, 0], 400.0, 3.0), temperatures=(0.0, 20.0, 40.0, 60.0))
    kept = pose(campaign, load_model("matrix-6"), EFFECTS).candidates
    monkeypatch.setattr(search_problem, "LARGE", 0)
    made = pose(campaign, load_model("matrix-6"), EFFECTS).candidates
    assert all(callable(each.laid) for each in made)
    for one, other in zip(kept, made, strict=True):
        np.testing.assert_array_equal(one.columns, other.columns)


@pytest.mark.slow
def test_products_that_were_asked_for_are_not_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer of the columns, in another order, whiten nothing; where the grid grew only what is new in it does."""
    problem = season()
    block = problem.blocks[0]
    noise, fresh = (Noise(block, problem.sensors[2].collects.conditions, VARIANCE_EFFECTS) for _ in range(2))
    columns = np.column_stack([block.base, block.y])[noise.order]
    noise.products(columns)
    asked: list[int] = []
    filters = Noise.filters

    def counted(noise: Noise, points: Points) -> Iterator[tuple[IntArray, Filter]]:
        asked.append(len(points))
        return filters(noise, points)

    monkeypatch.setattr(Noise, "filters", counted)
    gram, half_log_det = noise.products(columns[:, [2, 0]])
    assert sum(asked) == 0
    before = len(noise.grid)
    for own in (noise, fresh):
        assert own.grow(own.grid.take(np.arange(before - 3, before)))
    np.testing.assert_array_equal(noise.products(columns)[0][:before, [2, 0]][:, :, [2, 0]], gram)
    assert sum(asked) == len(noise.grid) - before
    for known, made in zip(noise.products(columns), fresh.products(columns), strict=True):
        np.testing.assert_allclose(known, made, rtol=1e-12)
    assert np.array_equal(noise.products(columns)[1][:before], half_log_det)


def test_of_many_runs_those_that_are_odd_may_have_exchanged_labels() -> None:
    """And those that `hil solve` names: the run in which two collects changed places, and not most of the others."""

    def exchanged(rows: Rows) -> np.ndarray:
        rates = base_rates(rows, thermal=False)
        change = np.zeros_like(rates)
        first, second = np.flatnonzero(rows.run == 77)[[0, 2]]
        change[[first, second]] = rates[[second, first]] - rates[[first, second]]
        return change

    problem = season(exchanged)
    filed = problem.campaign.sensors[2]
    rates = filed.rates_deg_per_hr
    named = np.where((filed.conditions.run == 5)[:, None], np.nan, rates)
    for laid, runs in ((rates, {77.0}), (named, {5.0, 77.0})):
        found = list(exchanges(problem.sensors[2], problem.blocks, AsSolved(filed, laid, None, ())))
        asked = {c.shape["run"] for c in found}
        assert runs <= asked
        assert (5.0 in asked) == (5.0 in runs)
        assert len(asked) < 40
        assert len(found) <= MANY


@pytest.mark.slow
def test_a_step_is_found_where_it_is_though_not_every_place_was_tried_first() -> None:
    """Every few places one is tried, and then those beside the best."""
    at = 241

    def step(rows: Rows) -> np.ndarray:
        return both((np.arange(len(rows)) >= at).astype(float), 6.0, -5.0)

    problem = season(step)
    sensor = problem.sensors[2]
    conditions = sensor.collects.conditions
    effect = effect_by_id("jump")
    passed_over = len(effect.shape_grid(conditions)) // SHAPES
    assert passed_over > 0
    tried = list(catalogue_candidates(conditions, sensor.base_beside, [effect]))
    search = searches(problem, (), ())[2]
    jumps = [term for term in search.terms if term.name == "jump"]
    assert len(jumps) > len(tried) > len(effect.shape_grid(conditions)) // (passed_over + 2)
    scores = search.scan(())
    best = search.terms[max((j for j, t in enumerate(search.terms) if t.name == "jump"), key=lambda j: scores[j])]
    run, collect = best.candidate.shape["from_run"], best.candidate.shape["from_collect"]
    assert (run, collect) == (float(conditions.run[at]), float(at % 4))
    assert best.candidate.shape not in [c.shape for c in tried]
    finer = [t.candidate.shape for t in jumps if t.candidate.shape not in [c.shape for c in tried]]
    assert len(finer) == 2 * passed_over, "on either side of the best that was tried first"


@pytest.mark.slow
def test_each_value_of_the_base_follows_temperature_in_its_own_way() -> None:
    """A bias that is a straight line, an MU that turns from temperature to temperature: the likeliest noise says so."""
    turns = np.array([30.0, -25.0, 10.0, -30.0, 25.0, -10.0, 20.0, -20.0])

    def hidden(rows: Rows) -> np.ndarray:
        mu = turns[np.unique(rows.setpoint, return_inverse=True)[1]] * rows.f[:, 2]
        return both(0.4 * rows.temperature, 1.0, 1.0) + both(mu, 1.0, -1.0)

    campaign = hidden_campaign(5, hidden, thermal=False)
    problem = pose(campaign, load_model("matrix-6"), ())
    search = searches(problem, (), (), searches(problem, (), ()))[2]
    for own in search.blocks:
        weight = own.beside.log_null() + own.points.log_prior
        profile = [*own.noise.profiles][int(own.points.profile[np.argmax(weight)])]
        names = search.blocks[0].block.base.shape[1]
        assert len(profile) == names
        bias, mu = profile[0], profile[-1]
        assert bias != mu
        assert bias[1] in {0, 1}, "a straight line, or nearly"
        assert mu[1] == len(FOLLOWS[1:]) // 5 - 1, "each temperature for itself"


def test_values_that_follow_alike_are_likelier_before_the_data() -> None:
    """Half of them do as the unit's others; the prior adds up to one."""
    one, other = FOLLOWS[3], FOLLOWS[8]
    assert log_profile((one, one, one)) > log_profile((one, one, other)) > log_profile((one, other, FOLLOWS[0]))
    total = sum(np.exp(log_profile((a, b))) for a in FOLLOWS for b in FOLLOWS)
    assert total == pytest.approx(1.0)


def test_what_shows_inside_pays_the_odds_that_anything_pays() -> None:
    """One step in hundreds of series at a chance of 1 in 330 is nothing to be named; one at 1 in a million is."""
    finding = {"id": "jump", "sensor": 1, "channel": "RB", "collect": 7, "collects": 1, "asked": 96, "q_value": 0.003}
    finding |= {"estimates": {"J_deg_per_hr": -29.8, "t_s": 34.0}, "sentence": "Collect 7, channel RB: steps"}
    assert named_within([finding], SERIES_EFFECTS, 0.05) == []
    (found,) = named_within([{**finding, "q_value": 1e-6}], SERIES_EFFECTS, 0.05)
    assert found.id == "jump"
    assert found.probability > 0.95


def test_rates_beyond_all_measure_are_weighed_as_others_are() -> None:
    """Of 10^10 deg/hr values at each temperature explain all but rounding, which may come out as less than nothing."""
    campaign = hidden_campaign(5, lambda rows: both(np.full(len(rows.run), 1e10), 1.0, -1.0), thermal=False)
    problem = pose(campaign, load_model("matrix-6"), ())
    noise = Noise(problem.blocks[0], problem.sensors[2].collects.conditions, ()).at_each_temperature()
    points = BlockSearch.of(problem.blocks[0], noise).points
    assert np.all(np.isfinite(points.log_prior))


def test_every_set_climbs_by_its_own_heights(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the rows are beside a profile is said once for all sets, and yet of each with its own columns."""
    problem, climb, checked = season(), _Rows.climb, []

    def compared(rows: _Rows) -> list[tuple[list[Profile], FloatArray]]:
        profile = (FOLLOWS[3],) * len(next(iter(rows.noise.profiles)))
        every = rows.heights(np.arange(len(rows.grid)), [profile])[:, :, 0]
        for v, heights in enumerate(every):
            np.testing.assert_allclose(rows.everywhere(v, profile), heights)
        checked.append(float(np.ptp(every, axis=0).max()))
        return climb(rows)

    monkeypatch.setattr(_Rows, "climb", compared)
    noise = Noise(problem.blocks[0], problem.sensors[2].collects.conditions, ()).at_each_temperature()
    search = BlockSearch.of(problem.blocks[0], noise)
    search.choose([np.zeros((len(search.y), 0)), (np.arange(len(search.y)) % 7 > 3)[:, None].astype(np.float64)])
    assert checked[1] > 0.1


def test_a_way_of_following_stands_for_all_that_are_nearly_as_likely(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else values that stand, of which no way is left out, would be weighed against one way of hundreds."""
    campaign = hidden_campaign(5, lambda rows: both(0.3 * rows.temperature, 1.0, -1.0), thermal=False)
    problem, climb, checked = pose(campaign, load_model("collins-4"), ()), _Rows.climb, []

    def compared(rows: _Rows) -> list[tuple[Profile, FloatArray]]:
        found = climb(rows)
        best, beside = found[0]
        at, every = int(np.argmax(beside)), [*product(FOLLOWS, repeat=len(best))]
        heights = rows.heights(np.array([at]), every).ravel()
        exact = np.logaddexp.reduce(heights) - heights[every.index(best)]
        checked.append((rows.log_width(0, at, best, ()), exact, rows.log_width(0, at, best, every)))
        return found

    monkeypatch.setattr(_Rows, "climb", compared)
    noise = Noise(problem.blocks[0], problem.sensors[2].collects.conditions, ()).at_each_temperature()
    points = BlockSearch.of(problem.blocks[0], noise).points
    for width, exact, none_left in checked:
        assert exact > 0.5
        assert width == pytest.approx(exact, abs=0.35)
        assert none_left == 0.0
    monkeypatch.setattr(_Rows, "log_width", lambda *_: 0.0)
    alone = BlockSearch.of(problem.blocks[0], noise).points
    np.testing.assert_allclose(points.log_prior - alone.log_prior, checked[0][0])
