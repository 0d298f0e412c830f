"""The evidence is a marginal likelihood: closed forms beside what scipy's densities and a plain refit say."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.sparse import csc_array
from scipy.special import logsumexp
from scipy.stats import multivariate_t

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model import load_model
from hil.model.effects.base import Base, Effect, Parameter
from hil.model.effects.catalogue import effect_by_id, variance_effect_by_id
from hil.model.effects.columns import per_channel
from hil.model.effects.prior import OFFSETS, SCATTER, SECOND_TIER, log_sum, scatter_log_odds
from hil.reconcile.search import set_in_block
from hil.reconcile.search.block_search import BlockSearch
from hil.reconcile.search.evidence import Amplitude, Inner, bordered, eliminated
from hil.reconcile.search.layout import searches
from hil.reconcile.search.noise import Noise
from hil.reconcile.search.problem import pose
from hil.reconcile.search.scan import Group, log_factors
from hil.reconcile.search.set_in_block import Sets
from hil.reconcile.search.sets import SensorSearch
from hil.reconcile.search.terms import Part, terms
from tests.hil.reconcile.hidden_effects import both, hidden_campaign

SMALL = {"temperatures": (-20.0, 20.0, 60.0), "runs_each": 2}


class Usual(Effect):
    """Any bias that follows the supply, three times as usual as another."""

    id = "usual"
    family = "test"
    title = "Usual"
    equation = "B += u (V - 28)"
    per_channel = True
    parameters = (Parameter("u", "deg/hr/V", (1.0, 10.0)),)
    needs = frozenset({"supply_V"})
    follows = "supply"
    odds = 3.0

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        """Return volts above 28."""
        return per_channel(conditions.columns["supply_V"] - 28.0, conditions.sensor)


class Unusual(Usual):
    """Another one, which follows the cube."""

    id = "unusual"
    odds = 1.0

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        """Return the cube of the volts above 28."""
        return per_channel((conditions.columns["supply_V"] - 28.0) ** 3, conditions.sensor)


def laid(model: str, *, calibrated: bool, **night: Any) -> SensorSearch:
    """One sensor, a supply effect hidden, and little else to choose from."""
    campaign = hidden_campaign(7, lambda r: both(r.supply - 28.0, 40.0, -36.0), **night)
    problem = pose(campaign, load_model(model), (Usual(), Unusual(), effect_by_id("k2")))
    scatter = (variance_effect_by_id("MU_rr"), variance_effect_by_id("rrw"))
    stand = searches(problem, (), scatter)
    return (searches(problem, (), scatter, stand) if calibrated else stand)[2]


@pytest.fixture(scope="module")
def search() -> SensorSearch:
    """Six runs, and a model that says how its values follow temperature."""
    return laid("matrix-6-thermal", calibrated=False, **SMALL)


@pytest.fixture(scope="module")
def calibrated() -> SensorSearch:
    """Six runs at three temperatures, and a base that may have values of its own at each."""
    return laid("matrix-6", calibrated=True, **SMALL)


def term(search: SensorSearch, name: str) -> int:
    """The place of the first term of a name."""
    return next(j for j, one in enumerate(search.terms) if one.name == name)


def covariance_of(own: BlockSearch, t: int) -> FloatArray:
    """The covariance of a block's rows at one point, in the block's own order."""
    back = np.argsort(own.noise.order)
    return own.noise.covariance(own.points.take(np.array([t])))[np.ix_(back, back)]


def brute_force(search: SensorSearch, chosen: tuple[int, ...], b: int, *, near: bool = True) -> FloatArray:
    """Log evidence by kind of scatter of a set in a block, from which each of its terms may be absent."""
    out = np.full(len(search.blocks[b].noise.sorts), -np.inf)
    for there in itertools.product((True, False), repeat=len(chosen)):
        absent = [search.terms[j].absent for j in chosen]
        share = float(np.prod([1.0 - own if here else own for here, own in zip(there, absent, strict=True)]))
        if share:
            out = np.logaddexp(
                out, np.log(share) + with_all_of(search, tuple(itertools.compress(chosen, there)), b, near)
            )
    return out


def with_all_of(search: SensorSearch, chosen: tuple[int, ...], b: int, near: bool) -> FloatArray:
    """The same with all of them: Student t densities of the rows beside the base, summed over all that is open.

    `near`: over the sizes about the best of each term alone, as the search does it.
    """
    own: BlockSearch = search.blocks[b]
    points, base = own.points, own.block.base
    beside = null_space(base.T)
    y, freedom = beside.T @ own.y, beside.shape[1]
    # Densities with a flat prior of the base are those of the rows beside it, up to the volume of its columns.
    volume = 0.5 * freedom * np.log(2.0 * np.pi) - 0.5 * np.linalg.slogdet(base.T @ base)[1]
    columns, options, best = [], [], search.in_block(chosen, b).best
    for e, j in enumerate(chosen):
        part = search.terms[j].parts[b]
        assert part is not None
        columns.append(part.columns / own.unit)
        tried = [
            (float(w), a.mean, a.deviation * s)
            for a in search.terms[j].amplitudes[b]
            for s, w in zip(a.sizes, a.log_weights, strict=True)
        ]
        options.append(tried[max(0, best[e] - 2) : best[e] + 3] if near else tried)
    stacked = beside.T @ np.hstack([np.zeros((len(own.y), 0)), *columns])
    out = np.full(len(own.noise.sorts), -np.inf)
    for t in range(len(points)):
        noise = beside.T @ covariance_of(own, t) @ beside
        white = np.linalg.inv(np.linalg.cholesky(noise))
        left = white @ y
        if stacked.shape[1]:
            left = left - white @ stacked @ np.linalg.lstsq(white @ stacked, left, rcond=None)[0]
        for (a, strength, weight), picked in itertools.product(own.scales, itertools.product(*options)):
            scale = (strength + 0.5 * float(left @ left)) / (a + 0.5 * freedom)
            deviation = np.concatenate([np.zeros(0), *(p[2] for p in picked)])
            mean = np.concatenate([np.zeros(0), *(p[1] for p in picked)])
            covariance = noise + (stacked * deviation**2 / scale) @ stacked.T
            density = multivariate_t.logpdf(y, stacked @ mean, strength / a * covariance, df=2.0 * a)
            known = np.log(weight) + points.log_prior[t] + sum(p[0] for p in picked)
            at = int(points.sort[t])
            out[at] = np.logaddexp(out[at], density + known + volume)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("names", [(), ("usual",), ("k2",)])
def test_the_evidence_is_the_marginal_likelihood(
    search: SensorSearch, names: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of every kind of scatter, with sums over noise, sizes and scales; sizes far off the best add next to nothing.

    Nor does what other sizes add at points that are next to impossible, where it is what they add at the likeliest.
    """
    chosen = tuple(term(search, name) for name in names)
    quick = search.evidence([chosen])[0]
    monkeypatch.setattr(set_in_block, "DEPTH", np.inf)
    for b, evidence in enumerate(SensorSearch(search.blocks, search.terms).evidence([chosen])[0]):
        expected = brute_force(search, chosen, b)
        np.testing.assert_allclose(quick[b], evidence, atol=0.01)
        np.testing.assert_array_equal(np.isfinite(evidence), np.isfinite(expected))
        seen = np.isfinite(expected)
        assert np.any(seen)
        np.testing.assert_allclose(evidence[seen], expected[seen], atol=1e-6)
        np.testing.assert_allclose(evidence[seen], brute_force(search, chosen, b, near=False)[seen], atol=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("names", [(), ("usual",)])
def test_values_that_follow_temperature_are_in_the_evidence(
    calibrated: SensorSearch, names: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever way they follow it: the covariance of all rows says the same, and some points have such values."""
    monkeypatch.setattr(set_in_block, "DEPTH", np.inf)
    chosen = tuple(term(calibrated, name) for name in names)
    for b, evidence in enumerate(SensorSearch(calibrated.blocks, calibrated.terms).evidence([chosen])[0]):
        own = calibrated.blocks[b]
        assert any(far for p in np.unique(own.points.profile) for far, _ in [*own.noise.profiles][p])
        expected = brute_force(calibrated, chosen, b)
        seen = np.isfinite(expected)
        np.testing.assert_allclose(evidence[seen], expected[seen], atol=1e-5)


@pytest.mark.slow
def test_two_terms_together_have_the_evidence_of_both(search: SensorSearch) -> None:
    """Sizes of one and of the other are nearly independent given the data: a tenth of a log at most."""
    chosen = tuple(sorted(term(search, name) for name in ("usual", "k2")))
    total = logsumexp(search.evidence([chosen])[0][0])
    assert total == pytest.approx(logsumexp(brute_force(search, chosen, 0)), abs=0.1)


@pytest.mark.parametrize("steps", [[0], [-2, -1, 0, 1, 2]])
def test_the_sizes_of_a_set_are_found_from_wherever_the_climb_begins(
    search: SensorSearch, monkeypatch: pytest.MonkeyPatch, steps: list[int]
) -> None:
    """From the smallest size of every term, many steps away, where none nearer is better, too: nearly the same sizes.

    And the same evidence, as far as it has those about the best.
    """
    chosen = tuple(sorted(term(search, name) for name in ("usual", "k2")))
    usual = search.in_block(chosen, 0)
    monkeypatch.setattr(Sets, "best_sizes", lambda self, _: np.zeros(self.known.shape[:2], dtype=np.int64))
    monkeypatch.setattr(set_in_block, "ABOUT", np.array(steps))
    again = SensorSearch(search.blocks, search.terms).in_block(chosen, 0)
    assert max(usual.best) > 2
    assert np.abs(np.subtract(again.best, usual.best)).max() <= 1
    assert logsumexp(again.by_sort(9)) == pytest.approx(logsumexp(usual.by_sort(9)), abs=0.2 if len(steps) > 1 else 3.0)


def test_terms_that_come_later_are_scanned_as_if_they_had_been_there(search: SensorSearch) -> None:
    """What was laid out stays; what is new stands in its own place."""
    several = SensorSearch(search.blocks, list(search.terms))
    scores = several.scan(())
    several.terms += [search.terms[3], search.terms[0]]
    assert several.scan(()) == pytest.approx(np.append(scores, scores[[3, 0]]), abs=1e-9)


def test_points_that_were_known_are_scanned_as_if_they_were_new() -> None:
    """The noise was chosen anew beside leading terms: what was known of its points stays, and the others are asked."""
    size, asked = {"a": 1.0, "b": 2.0, "c": 3.0}, list[str]()

    def at(points: list[str], group: Group) -> Group:
        def project(columns: FloatArray, some: IntArray) -> FloatArray:
            asked.extend(points[k] for k in some)
            return np.array([size[points[k]] for k in some])[:, None, None] * columns

        return group.at(points, project, 100)

    values = np.random.default_rng(0).normal(size=(6, 2))
    amplitude = Amplitude(np.ones(2), np.ones(1), np.zeros(1), np.zeros(2))
    (group,) = Group.several([Part(np.arange(2), np.arange(6), values, 6)], [[amplitude]], 0)
    moved = at(["c", "b"], at(["a", "b"], group))
    assert asked == ["a", "b", "c"]
    np.testing.assert_allclose(moved.gram, np.array([9.0, 4.0])[:, None, None, None] * (values.T @ values))


def test_a_direction_of_which_nothing_is_left_proposes_nothing(search: SensorSearch) -> None:
    """A curve along what a set has already, however large it may be: its scores there are rounding."""
    beside = search.blocks[0].beside.at(np.array([0]))
    beside, many = replace(beside, rss=beside.rss[:, None]), beside.residual.shape[1]
    one, of_two, known = np.zeros(1, dtype=np.int64), np.array([[1e4, 1.0]]), np.array([[[10.0, 0.0]]])
    gram = 100.0 * np.eye(2)[None, None]
    group = Group(one, csc_array((many, 2)), (), gram, one, 0.0 * of_two, of_two, np.ones((1, 1)), np.zeros((1, 1)))
    none, noise = (log_factors(beside, [group], [(np.array([[[of, 20.0]]]), known)], 1) for of in (0.0, 1e-3))
    np.testing.assert_array_equal(noise, none)


def test_in_which_unit_a_column_is_given_changes_nothing(search: SensorSearch) -> None:
    """Seconds squared or days squared: the same evidence, the same scale of the noise, the same best sizes."""
    candidates = [search.terms[term(search, name)].candidate for name in ("usual", "k2")]
    sizes = [replace(p, typical=(1e-9 * p.typical[0], 1e-9 * p.typical[1])) for p in candidates[1].parameters]
    other = replace(candidates[1], laid=1e9 * candidates[1].columns, parameters=tuple(sizes))
    blocks = [own.block for own in search.blocks]
    conditions = search.blocks[0].noise.conditions
    laid = (terms([candidates[0], one], blocks, conditions, 1.0, {}) for one in (candidates[1], other))
    both_ways = [SensorSearch(search.blocks, own) for own in laid]
    same, scaled = (one.in_block((0, 1), 0) for one in both_ways)
    np.testing.assert_allclose(scaled.terms_log, same.terms_log, atol=1e-6)
    assert scaled.best == same.best
    np.testing.assert_allclose(scaled.left, same.left, rtol=1e-6)
    np.testing.assert_allclose(scaled.scales_left, same.scales_left, rtol=1e-6)


def test_a_scan_says_what_the_evidence_says(search: SensorSearch) -> None:
    """The quick look at all terms, at fewer points of the noise, puts the hidden one where the evidence does."""
    usual, noise = term(search, "usual"), term(search, "k2")
    gain = [sum(logsumexp(e) for e in search.evidence([s])[0]) for s in ((), (usual,), (noise,))]
    scanned = search.scan(())
    assert scanned[usual] == pytest.approx(gain[1] - gain[0], abs=1.0)
    assert scanned[noise] == pytest.approx(gain[2] - gain[0], abs=1.0)
    assert scanned[usual] > scanned[noise] + 1.0


def test_the_odds_before_the_data_are_the_classes(search: SensorSearch) -> None:
    """Three to one to one, over all shapes and forms of a name, and what nobody has described shares a fifth."""
    odds = {
        name: sum(np.exp(t.log_odds) for t in search.terms if t.name == name) for name in ("usual", "unusual", "k2")
    }
    k2 = effect_by_id("k2").odds
    assert odds["usual"] == pytest.approx(3.0 * odds["unusual"])
    assert odds["k2"] == pytest.approx(k2 * odds["unusual"])
    assert sum(odds.values()) == pytest.approx(1.0 - SECOND_TIER)
    effects = [kind.effect for kind in search.blocks[0].noise.kinds]
    scatter = {name: np.exp(own) for name, own in scatter_log_odds(effects).items()}
    assert scatter == pytest.approx({e.id: e.odds * scatter["rrw"] / effects[-1].odds for e in effects})
    assert sum(scatter.values()) == pytest.approx(SCATTER / (1.0 - SCATTER))


@pytest.mark.parametrize("quieter", [1.0, 8.0])
def test_what_scatters_is_tried_as_large_as_is_typical(search: SensorSearch, quieter: float) -> None:
    """Where the rows are as quiet as they are, and as far as the base leaves anything: larger, a walk comes back."""
    block, conditions = search.blocks[0].block, search.blocks[0].noise.conditions
    effects = [variance_effect_by_id(name) for name in ("MU_rr", "rrw")]
    noise = Noise(replace(block, sigma=block.sigma / quieter), conditions, effects)
    for k, kind in enumerate(noise.kinds):
        largest = noise.grid.amount[:, k].max() * np.sqrt(noise.unit) / kind.unit_deg_per_hr
        assert np.sqrt(2.0) * largest > kind.parameter.typical[1]
    still = Noise(replace(block, y=block.base[:, 0], sigma=block.sigma / quieter), conditions, effects)
    assert still.grid.amount.max() == OFFSETS[-1]


def test_the_log_of_no_summands_is_that_of_nothing() -> None:
    """A layout in which no name can be asked about leaves each unit as probable as it was."""
    assert log_sum(np.zeros((0, 2))).tolist() == [-np.inf, -np.inf]
    assert log_sum(np.log([[1.0, 2.0], [3.0, 4.0]])) == pytest.approx(np.log([4.0, 6.0]))
    assert log_sum(np.full((2, 1), -2000.0)) == pytest.approx([np.log(2.0) - 2000.0])  # of which exp is nothing


@pytest.mark.parametrize("place", [0, -1])
def test_what_other_sizes_are_worth_is_what_they_are_when_they_are_chosen(search: SensorSearch, place: int) -> None:
    """From the smallest of sizes and from the largest, of a hundred million times: else a climb might never end."""
    pair, own = (term(search, "usual"), term(search, "k2")), search.blocks[0]
    members = {j: search.member(j, 0) for j in pair}
    sets, t = Sets(own.beside, own.points, members, [pair], Inner.of(own.beside, members)), np.arange(len(own.points))
    best, one = np.array([[np.flatnonzero(known)[place] for known in sets.known[0]]]), np.zeros(1, dtype=np.int64)
    for e, known in enumerate(sets.known[0]):
        sets.hold(one, best)
        sizes = np.repeat(np.flatnonzero(known)[:, None], len(t), axis=1)
        told = sets.instead(np.zeros_like(t), np.full_like(t, e), best, sizes, t)
        for size, log in zip(sizes[:, 0], told, strict=True):
            chosen = np.where(np.arange(2) == e, size, best)
            np.testing.assert_allclose(log, sets.hold(one, chosen)[0], rtol=1e-9, atol=1e-6)


def test_squares_that_rounding_took_below_nothing_are_none() -> None:
    """A channel with as many rates as the base has values leaves 0, and by rounding less: that ends no search."""
    left, half_log_det = eliminated(bordered(np.zeros((1, 1, 1)), np.zeros((1, 1)), np.array([-3.6e-12])))
    assert 0.0 < left[0] < 1e-11
    assert half_log_det[0] == 0.0
