"""What is chosen between: sets in a fold, laws of temperature or values at each, what is kept or taken back."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.model import load_model
from hil.model.effects.base import Effect
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, VARIANCE_EFFECTS, Unasked
from hil.reconcile import reconcile, workflow
from hil.reconcile.follows import Follows, what_it_follows
from hil.reconcile.naming import Reading, _surely_wrong, read
from hil.reconcile.proof.held_out import HeldOut, likeliest_without
from hil.reconcile.search.evidence import Inner
from hil.reconcile.search.layout import coarse, searches, values_follow
from hil.reconcile.search.posterior import Found, Posterior, _alone, served, weigh
from hil.reconcile.search.problem import Problem, pose
from hil.reconcile.search.set_in_block import CLOSE, Sets
from hil.reconcile.search.sets import SensorSearch
from hil.reconcile.search.tied import tied_gains
from hil.reconcile.workflow import _kept
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


def turning(seed: int = 3, runs_each: int = 2, temperatures: tuple[float, ...] = EIGHT) -> Campaign:
    """Every value of the unit differs from setpoint to setpoint as no law does, and runs repeat it to the noise."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, temperatures, runs_each)
    place = np.unique(rows.setpoint, return_inverse=True)[1]
    bias, gs, mu = (rng.normal(0.0, 12.0, (3, len(temperatures), 2))[k][place] for k in range(3))
    rates = bias + gs * rows.f[:, :1] + mu * rows.f[:, 2:] + rows.w[:, :2]
    return campaign_of(rows, rates + rng.normal(0.0, 0.9, rates.shape))


def weighed(campaign: Campaign, model: str) -> Posterior:
    """The posterior beside one set of values of the base."""
    return weigh(searches(pose(campaign, load_model(model), (*BASE_EFFECTS, *EFFECTS)), EFFECTS, VARIANCE_EFFECTS))


def reseating(seed: int) -> Campaign:
    """Eight runs of a unit whose values follow temperature, the model has none of it, and whose MU is another each."""
    made, rng = hidden_campaign(seed, runs_each=1), np.random.default_rng(seed + 100)
    rows = made.sensors[2]
    of = rows.conditions
    temperature = of.columns["temperature_degC"]
    more = {
        "case_degC": temperature - 0.3 + rng.normal(0.0, 0.02, len(of)),
        "chamber_degC": of.columns["setpoint_degC"] + rng.normal(0.0, 0.02, len(of)),
        "spin_period_us": 10000.0 + rng.normal(0.0, 1.0, len(of)),
    }
    u, mu = (temperature - 20.0) / 40.0, rng.normal(0.0, 4.0, (of.run.max() + 1, 2))[of.run]
    own = np.stack([8.0 * (u**2 + u) + mu[:, 1] * of.f_g[:, 2], 30.0 * u - 8.0 * u**2 - mu[:, 0] * of.f_g[:, 2]], 1)
    laid = replace(of, columns={**of.columns, **more})
    return replace(made, sensors={2: replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + own, conditions=laid)})


@pytest.fixture(scope="module")
def supplied() -> tuple[Posterior, Reading]:
    """A supply effect, read."""

    def hidden(rows: Rows) -> np.ndarray:
        return both(rows.supply - 28.0, 40.0, -36.0)

    posterior = weighed(hidden_campaign(7, hidden), "matrix-6-thermal")
    return posterior, read(posterior, 0.05)


def test_a_fold_chooses_by_the_rows_that_it_does_not_hold_out() -> None:
    """The first set is ahead only by what the held-out rows say for it: without them it is behind."""
    assert likeliest_without(np.array([0.0, -1.0]), np.array([-2.0, -9.0])) == 1
    assert likeliest_without(np.array([0.0, -1.0]), np.array([-9.0, -2.0])) == 0


@pytest.mark.slow
def test_no_size_is_left_that_another_noise_makes_likelier() -> None:
    """A climb that ends where one noise is likeliest would count what it missed twice, once for each channel."""
    campaign = turning(0, 1)
    search = searches(pose(campaign, load_model("matrix-6"), (*BASE_EFFECTS, *EFFECTS)), EFFECTS, VARIANCE_EFFECTS)[2]
    for chosen, b in itertools.product(itertools.combinations(sorted(search.leading()), 2), (0, 1)):
        weighed = search.in_block(chosen, b)
        climbed = weighed.terms_log - np.sum(weighed.slack, axis=0)
        near = [(e, weighed.best[e] + k) for e, own in enumerate(weighed.options) for k in (-2, -1, 1, 2)]
        inside = np.array([(e, o) for e, o in near if 0 <= o < len(weighed.options[e])])
        own, members = search.blocks[b], {j: search.member(j, b) for j in weighed.members}
        sets = Sets(own.beside, own.points, members, [weighed.members], Inner.of(own.beside, members))
        others = np.tile(weighed.best, (len(inside), 1))
        others[np.arange(len(inside)), inside[:, 0]] = inside[:, 1]
        heights = sets.hold(np.zeros(len(inside), dtype=np.int64), others) + own.points.log_prior
        assert heights.max() < (climbed + own.points.log_prior).max() + 2.0 * CLOSE


@pytest.mark.slow
@pytest.mark.parametrize(("size", "kind"), [(11.0, "ambiguous"), (12.0, "named")])
def test_a_name_is_sure_only_where_nothing_is_ruled_out_as_well(size: float, kind: str) -> None:
    """One name at .95 and .98: noise may get a name on the averages in one of a hundred nights, not in one of ten."""
    campaign = hidden_campaign(7, lambda r: both(r.supply - 28.0, size, -size), thermal=False)
    result = reconcile(campaign, "matrix-6", prove=False)
    found = {e.id: e for e in result.effects}["supply"]
    assert found.kind == kind
    assert found.probability > 0.9


@pytest.mark.slow
def test_a_wrong_rate_gives_nothing_else_a_name() -> None:
    """Where a row and a missing term hide the noise together, it is chosen beside both: else steps stand in for it."""
    rng = np.random.default_rng(0)
    rows = lay_out(rng, EIGHT, 3)
    place, run = (np.unique(of, return_inverse=True)[1] for of in (rows.setpoint, rows.run))
    bias = rng.normal(0.0, 4.0, (8, 2))[place]
    mu = np.array([20.0, -15.0]) + rng.normal(0.0, 4.0, (24, 2))[run]
    rates = bias + mu * rows.f[:, 2:] + 40.0 * rows.f[:, :1] + rows.w[:, :2] + rng.normal(0.0, 0.9, mu.shape)
    rates[20, 0] += 100.0
    result = reconcile(campaign_of(rows, rates), "collins-4", prove=False)
    assert [e.id for e in result.effects] == ["MU_real", "MU_rr"]
    assert [round(row["size_deg_per_hr"], -1) for row in result.outliers] == [100.0]


@pytest.mark.slow
def test_the_noise_is_what_repeats_show_and_not_what_a_model_cannot_follow() -> None:
    """MU of its own at each setpoint is called scatter of MU here; the floor is what runs at one setpoint differ by."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng, EIGHT, 2)
    place, run = (np.unique(of, return_inverse=True)[1] for of in (rows.setpoint, rows.run))
    mu = rng.normal(0.0, 8.0, (8, 2))[place] + rng.normal(0.0, 3.0, (16, 2))[run]
    rates = 10.0 + mu * rows.f[:, 2:] + 40.0 * rows.f[:, :1] + rows.w[:, :2] + rng.normal(0.0, 0.9, mu.shape)
    gap = reconcile(campaign_of(rows, rates), "matrix-6", prove=False).gap
    assert gap.noise_floor == pytest.approx(np.sqrt(0.9**2 + 3.0**2 / 3.0), rel=0.35)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["matrix-6", "matrix-6-thermal"])
def test_values_that_turn_from_setpoint_to_setpoint_are_a_calibration(model: str) -> None:
    """No name for what differs at each temperature, beside one set or beside quadratics, which are said to fail."""
    result = reconcile(turning(), model, prove=False)
    assert result.calibration == "per temperature"
    assert [effect.id for effect in result.effects if effect.acts_on == "mean"] == []
    assert any("no quadratics" in note for note in result.notes) == (model == "matrix-6-thermal")


@pytest.mark.slow
def test_a_jump_beside_a_line_over_temperature_is_no_calibration_that_follows_time_in_three_ways() -> None:
    """Where each temperature was measured once, values at each leave a jump to be ageing and a curve over time."""
    one = campaign(24, 3, seed=9, scatter=2.0)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[39:42] += [30.0, -21.0]
    result = reconcile(with_rates(one, rates), "matrix-6", prove=False)
    assert result.calibration == "one set"
    assert {effect.id for effect in result.effects} == {"bias_T", "jump"}


@pytest.mark.slow
def test_values_at_each_temperature_are_asked_for_where_they_explain_something() -> None:
    """Of values that turn from setpoint to setpoint, not of quadratics."""
    for one, expected in ((turning(), True), (hidden_campaign(7, noise_of_supply), False)):
        problem = pose(one, load_model("matrix-6-thermal"), ())
        nothing = Found({2: ()}, frozenset(), 0.0)
        assert values_follow(problem, weigh(searches(problem, (), ())), nothing) is expected


def noise_of_supply(rows: Rows) -> np.ndarray:
    """A supply effect: it follows no temperature."""
    return both(rows.supply - 28.0, 10.0, -9.0)


def test_what_the_base_has_is_no_law_for_having_a_value_at_each_setpoint() -> None:
    """A bias of its own at each setpoint is called nothing, where the model has a bias; a straight line is bias_T."""
    problem = pose(hidden_campaign(7, thermal=False), load_model("matrix-6"), (*BASE_EFFECTS, *EFFECTS))
    search = searches(problem, (), ())[2]
    forms = {(term.name, term.candidate.form) for term in search.terms}
    assert ("bias_T", "line") in forms
    assert not {(name, "table") for name in ("bias_T", "GS_T", "MU_real")} & forms


@pytest.mark.parametrize("seed", range(8))
def test_of_few_folds_no_improvement_is_surer_than_their_signs_tell(seed: int) -> None:
    """Of eight signs one pattern in 256 is that of the data, however its sum is rounded."""
    gains, flat = np.random.default_rng(seed).uniform(0.0, 3.0, 8), np.ones((2, 8))
    proof = HeldOut(flat, flat, np.full(8, 4), np.stack([np.zeros(8), gains]), [])
    assert proof.improvement_p_value() > 0.5 / 256


@pytest.mark.slow
@pytest.mark.parametrize(("better", "kept"), [(1.0, True), (-1.0, False)])
def test_what_predicts_held_out_rows_no_better_is_taken_back(
    supplied: tuple[Posterior, Reading], better: float, kept: bool
) -> None:
    """By the log density of the rows, whatever the squares of errors; what is told to be wrong is what is fitted."""
    posterior, reading = supplied
    wrong = next(j for j, term in enumerate(posterior.searches[2].terms) if term.is_mistake)
    reading = replace(reading, mended=Found({2: (wrong,)}, frozenset(), 0.0))
    assert [named.name for named in reading.names] == ["supply"]
    flat = np.ones((2, 4))
    proof = HeldOut(flat, flat, np.full(4, 8), np.stack([np.zeros(4), np.full(4, better)]), [])
    left, reverted = _kept(posterior, reading, proof)
    assert bool(left.names) is kept
    assert bool(reverted) is not kept
    assert left.found == (reading.found if kept else reading.mended)
    assert left.mistakes == posterior.mistakes(left.found)
    assert _kept(posterior, replace(reading, names=()), proof)[1] == ()


def test_of_drivers_as_sure_as_one_another_that_of_what_moves_averages_comes_first() -> None:
    """Whatever order a set of words has today; a name that is half another's is half what follows something else."""
    moves = SimpleNamespace(called="bias_T", follows="temperature", is_mistake=False)
    scatters = SimpleNamespace(follows="run")
    posterior = SimpleNamespace(
        sets=[SimpleNamespace(scatter=frozenset({"MU_rr"}), log_weight=-0.7)] * 2,
        members=lambda _: [moves],
        scatter={"MU_rr": scatters},
    )
    assert what_it_follows(cast(Posterior, posterior), {}) == Follows([("temperature", 1.0), ("run", 1.0)])
    could_be = Unasked(cast(Effect, SimpleNamespace(follows="temperature")), 1.0, "a second run")
    found = what_it_follows(cast(Posterior, posterior), {"MU_rr": [could_be]})
    assert found == Follows([("temperature", 1.0), ("run", 0.5)])


def test_where_no_driver_is_sure_it_is_said_of_which_few_one_is() -> None:
    """As few as it takes, none of them sure by itself; what is sure anyhow is none of them."""

    def of(follows: str) -> SimpleNamespace:
        return SimpleNamespace(called=follows, follows=follows, is_mistake=False)

    def found(shares: Mapping[str, float], scatter: frozenset[str] = frozenset()) -> Follows:
        sets = [SimpleNamespace(scatter=scatter, log_weight=np.log(share), of=name) for name, share in shares.items()]
        posterior = SimpleNamespace(
            sets=sets, members=lambda f: [of(f.of)], scatter={"MU_rr": SimpleNamespace(follows="run")}
        )
        return what_it_follows(cast(Posterior, posterior), {})

    shares = {"temperature_history": 0.47, "temperature": 0.34, "temperature_rate": 0.15, "time": 0.04}
    told = found(shares, frozenset({"MU_rr"}))
    assert dict(told.shares)["run"] == pytest.approx(1.0)
    assert told.one_of == {"drivers": ["temperature_history", "temperature"], "probability": pytest.approx(0.81)}
    assert found({"temperature": 0.85, "time": 0.15}).one_of is None
    assert found(dict.fromkeys(("time", "pose", "supply", "run", "heading"), 0.2)).one_of is None


@pytest.mark.slow
def test_a_tied_parameter_brings_its_gain_into_the_evidence(supplied: tuple[Posterior, Reading]) -> None:
    """Both channels' evidence together is that of each, and what it is worth that one number serves both."""
    search = supplied[0].searches[2]
    place = next(j for j, term in enumerate(search.terms) if term.ties)
    apart = [search.in_block((place,), b).by_sort(len(search.blocks[b].noise.sorts)) for b in (0, 1)]
    weighed, without = ([search.in_block(own, b) for b in (0, 1)] for own in ((place,), ()))
    (gain,) = tied_gains([(weighed, without, [place])])
    assert abs(gain) > 1e-3
    together = search.evidence([(place,)])[0]
    assert together[0][0] + together[1][0] == pytest.approx(apart[0][0] + apart[1][0] + gain)


@pytest.mark.slow
def test_what_one_block_alone_has_gains_nothing_by_being_one_number(supplied: tuple[Posterior, Reading]) -> None:
    """Of an axis in which nothing is missing there are no amplitudes, and no fewer than none."""
    search = supplied[0].searches[2]
    place = next(j for j, term in enumerate(search.terms) if term.ties)
    weighed, without = ([search.in_block(own, b) for b, own in enumerate(each)] for each in (((place,), ()), ((), ())))
    assert tied_gains([(weighed, without, [place])]) == pytest.approx([0.0], abs=1e-9)


@pytest.mark.slow
def test_sets_that_are_weighed_side_by_side_gain_what_each_gains_by_itself(
    supplied: tuple[Posterior, Reading],
) -> None:
    """However many amplitudes another has, and however soon its bound is reached."""
    search = supplied[0].searches[2]
    tied = [j for j in search.leading() if search.terms[j].ties][:3]
    sets = [(tied[0],), tuple(sorted(tied[:2])), tuple(sorted(tied))]
    together = SensorSearch(search.blocks, search.terms).evidence(sets)
    for chosen, by_block in zip(sets, together, strict=True):
        (alone,) = SensorSearch(search.blocks, search.terms).evidence([chosen])
        for b, own in enumerate(by_block):
            np.testing.assert_allclose(own, alone[b], rtol=1e-9)


@pytest.mark.parametrize(("sure", "left_out"), [(0.5, [1, 0]), (0.8, [0])])
def test_a_row_is_left_out_where_it_is_as_sure_as_is_asked(sure: float, left_out: list[int]) -> None:
    """Two thirds say that it is wrong: enough where nothing else may be missing, too little where something is."""
    row = SimpleNamespace(is_mistake=True, candidate=SimpleNamespace(effect=None))
    posterior = cast(Posterior, SimpleNamespace(members=lambda found: [row for _ in found.terms[2]]))
    wrong, nothing = (Found({2: of}, frozenset(), float(np.log(p))) for of, p in (((0,), 0.66), ((), 0.34)))
    kept = _surely_wrong(posterior, [wrong, nothing], [wrong, nothing], sure)
    assert [len(each.terms[2]) for each in kept] == left_out


def test_quiet_noise_and_every_scatter_are_asked_about_however_loud_a_night_is() -> None:
    """What is loud may be an effect that nobody has named yet; what this block speaks against another may ask for."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng, EIGHT, 3)
    loud = campaign_of(rows, base_rates(rows) + noise(rows, rng, run_bias=30.0))
    problem = pose(loud, load_model("matrix-6-thermal"), ())
    for block in searches(problem, (), VARIANCE_EFFECTS)[2].blocks:
        quiet = (block.points.sort == 0) & (block.points.offset < 1.0)
        assert quiet.any()
        single = {k for k, sort in enumerate(block.noise.sorts) if len(sort) < 2}
        assert set(block.points.sort.tolist()) >= single
        assert not quiet[int(np.argmax(block.beside.log_null() + block.points.log_prior))]


@pytest.mark.parametrize(("likelier", "follows"), [(-np.log(5.1), False), (-np.log(4.9), True)])
def test_values_that_follow_temperature_are_five_times_as_probable_before_the_data(
    monkeypatch: pytest.MonkeyPatch, likelier: float, follows: bool
) -> None:
    """Values that stand are read where the data make them so much likelier, and no sooner."""
    posterior, asked = weighed_in_turn(monkeypatch, 0.0, likelier, 0.0, 0.0)
    assert (posterior.log_evidence < 0.0) == follows
    assert asked == [False, True, False, True]


@pytest.mark.parametrize(
    ("at_first", "then", "asked"),
    [(-34.5, 0.0, [False, True]), (-34.3, -19.5, [False, True, False]), (-34.3, -19.3, [False, True, False, True])],
)
def test_the_noise_is_not_looked_at_anew_beside_sets_that_cannot_lead(
    monkeypatch: pytest.MonkeyPatch, at_first: float, then: float, asked: list[bool]
) -> None:
    """A sweep's biases on a curve took half a minute of search beside values that stand, for nothing."""
    posterior, served = weighed_in_turn(monkeypatch, at_first, 0.0, then, 10.0)
    assert served == asked
    assert posterior.log_evidence == (10.0 if len(asked) == 4 else 0.0)


@pytest.mark.slow
def test_sets_so_far_leave_the_noise_as_it_was() -> None:
    """Looking at the noise anew is what takes long, and what may be left."""
    few = turning(runs_each=3, temperatures=EIGHT[::3])
    problem = pose(few, load_model("matrix-6"), [effect for effect in EFFECTS if effect.id in ("bias_T", "drift")])
    (search,) = (found := searches(problem, (), ())).values()
    before = [len(block.points) for block in search.blocks]
    so_far = weigh(found, serve=False)
    assert [len(block.points) for block in search.blocks] == before
    assert weigh(found).log_evidence > so_far.log_evidence
    assert all(len(block.points) > own for block, own in zip(search.blocks, before, strict=True))


def test_what_leads_is_judged_in_the_noise_that_is_probable_beside_it() -> None:
    """By the noise of the base alone laws of temperature were hopeless where MU scatters, and none was named."""
    rng = np.random.default_rng(1)
    rows = lay_out(rng, (-30.0, -7.0, 22.0, 45.0), 3)
    rates = base_rates(rows) + rng.normal(0.0, 0.5, (len(rows), 2))
    rates -= rng.normal(0.0, 6.0, (13, 2))[rows.run] * rows.f[:, 2:]
    effects = [effect for effect in EFFECTS if effect.id in ("bias_T", "GS_T")]
    problem = pose(campaign_of(rows, rates, stated=0.5), load_model("matrix-6"), effects)
    so_far = weigh(coarse(problem, (), VARIANCE_EFFECTS), serve=False)
    assert served(so_far) > so_far.log_evidence + 20.0


def weighed_in_turn(monkeypatch: pytest.MonkeyPatch, *log_evidence: float) -> tuple[Posterior, list[bool]]:
    """Return which is read of values that stand at first, that follow, stand refined, and at last; and what is asked.

    Each has so much log evidence.
    """
    weighed, served = iter([SimpleNamespace(log_evidence=own, sets=[None]) for own in log_evidence]), list[bool]()

    def weigh(_: object, *, serve: bool = True) -> SimpleNamespace:
        served.append(serve)
        return next(weighed)

    monkeypatch.setattr(workflow, "weigh", weigh)
    monkeypatch.setattr(workflow, "served", lambda so_far: so_far.log_evidence)
    for laid in ("coarse", "refined", "searches"):
        monkeypatch.setattr(workflow, laid, lambda *_, **__: {})
    for question in ("may_be_calibrated", "values_follow"):
        monkeypatch.setattr(workflow, question, lambda *_: True)
    return workflow._likelier(cast(Problem, None), ()), served


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_what_was_found_first_goes_where_what_was_found_later_does_it_too(seed: int) -> None:
    """Of the likeliest set nothing can be taken out by which the data become more probable."""
    posterior = weighed(reseating(seed), "matrix-6")
    search, lead = posterior.searches[2], posterior.sets[0].terms[2]
    fewer = [lead[:k] + lead[k + 1 :] for k in range(len(lead))]
    search.weigh(fewer)
    alone = _alone(search, [lead, *fewer])
    assert len(lead) > 2
    assert max(alone, key=lambda chosen: alone[chosen]) == lead
