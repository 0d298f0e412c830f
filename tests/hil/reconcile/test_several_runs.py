"""What happened in one run happened in others: more probably than it happened at all, and each hides the other."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.model import load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS
from hil.reconcile import reconcile
from hil.reconcile.outcome.sentences import what_to_do
from hil.reconcile.scattering import what_scatters
from hil.reconcile.search.layout import coarse
from hil.reconcile.search.problem import pose
from hil.solve import repeats, solve_campaign
from hil.solve.wrong_rows import USED, wrong_rows
from tests.hil.reconcile.hidden_effects import EIGHT, base_rates, campaign_of, lay_out
from tests.hil.solve.test_neighbours import night

FOUR = (0.0, 20.0, 40.0, 60.0)
OF = {"jump": ("BA", "J_A", 60.0, (2, 7, 12)), "MU_jump": ("MUA", "JMUA", 17.0, (2, 6, 9))}


@pytest.mark.parametrize("name", sorted(OF))
def test_what_several_runs_have_of_their_own_has_its_name_in_each_and_solve_says_the_same(name: str) -> None:
    """Three of twelve runs were an offset from run to run, in every ± and every mean, and stated of all nights."""
    parameter, value, size, runs = OF[name]
    rng = np.random.default_rng(1)
    rows = lay_out(rng, FOUR, 3)
    off = size * np.isin(rows.run, runs)
    rates = base_rates(rows, thermal=False) + rng.normal(0.0, 0.9, (len(rows), 2))
    rates += np.stack([off, 0.0 * off] if name == "jump" else [0.0 * off, -off * rows.f[:, 2]], 1)
    made = campaign_of(rows, rates)
    result = reconcile(made, "matrix-6", prove=False)
    (effect,) = result.effects
    told = [of for of in effect.parameters if of["name"] == value]
    assert (effect.id, [of["when"].split()[2] for of in told]) == (name, [str(run) for run in runs])
    assert all(abs(of["value"] - size) < 4.0 * of["se"] < 8.0 for of in told)
    assert not any(each["run_offset_se_deg_per_hr"] for each in result.noise)
    assert not any("hil solve doubts" in note for note in result.notes)
    assert wrong_rows(made)[2].another == {parameter: frozenset(runs)}


def test_runs_that_are_others_make_no_channel_noisier() -> None:
    """Where no errors are stated the whole of RA was taken for noisier, and nothing for wrong: ± 5 on twelve runs."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        rows = lay_out(rng, FOUR[:3], 4)
        rates = base_rates(rows) + rng.normal(0.0, 0.3, (len(rows), 2))
        rates[:, 0] += 6.0 * np.isin(rows.run, (2, 7, 11))
        assert wrong_rows(campaign_of(rows, rates, stated=None))[2].another == {"BA": frozenset({2, 7, 11})}


@pytest.mark.parametrize("seed", [1, 2])
def test_what_differs_from_run_to_run_is_no_row_of_events(seed: int) -> None:
    """A bias of its own in every run, as large as it is usual: no event, however often one is asked about."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, FOUR, 3)
    rates = base_rates(rows, thermal=False) + rng.normal(0.0, 0.9, (len(rows), 2))
    rates += rng.normal(0.0, 4.0, (13, 2))[rows.run]
    made = campaign_of(rows, rates)
    assert not [effect.id for effect in reconcile(made, "matrix-6", prove=False).effects]
    assert not wrong_rows(made)[2].another


@pytest.mark.parametrize(
    "levels",
    [
        (-10.0, 40.0) * 3,
        pytest.param((-40.0, -20.0, 0.0, 20.0, 40.0, 60.0) * 2, marks=pytest.mark.slow),
    ],
    ids=["3", "2"],
)
def test_runs_of_one_visit_that_are_alike_are_no_runs_that_were_others(levels: tuple[float, ...]) -> None:
    """A bias that is another at each visit is scatter of visits, in every ±: two runs of one are one event, if any."""
    for seed, size in itertools.product(range(6), (4.0, 6.0)):
        of_visit = np.random.default_rng(seed).normal(0.0, size, (len(levels), 2))
        off = {run: tuple(of_visit[(run - 1) // 2]) for run in range(1, 2 * len(levels) + 1)}
        found = wrong_rows(made_of(off, 2, levels))[2]
        assert not found.another
        assert not found.rows or len(levels) > 6  # of two visits a few are doubted


@pytest.mark.parametrize(("run", "other"), [(1, 5), (4, 8), (7, 0)])
def test_a_run_at_an_end_of_its_temperature_is_in_no_mean_either(run: int, other: int) -> None:
    """A step beside it would do as well: it is said, and what is in no mean is the same; it had widened every ±."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng, FOUR[:3], 3)
    rates = base_rates(rows, thermal=False) + rng.normal(0.0, 0.5, (len(rows), 2))
    rates[:, 0] += 20.0 * (rows.run == run) + 15.0 * (rows.run == other)
    made = campaign_of(rows, rates, stated=0.5)
    own = made.sensors[2].conditions  # a clock that is rounded otherwise in that run is nothing to follow
    clock = {**own.columns, "time_since_index_s": 60.4 + 1e-11 * (own.run == run)}
    made = replace(made, sensors={2: replace(made.sensors[2], conditions=replace(own, columns=clock))})
    solved = solve_campaign(made)
    assert solved[0].between.alone["BA"] == {run, other} - {0}
    assert repeats(made, solved)[2].spread.beyond[0] < 1.0
    result = reconcile(made, "matrix-6")
    (effect,) = result.effects
    told = {of.get("when", effect.shape_in_words) for of in effect.parameters}
    assert (effect.id, told) == ("jump", {f"in run {each} alone" for each in (run, other) if each})
    assert result.gap.after < 1.5 * result.gap.noise_floor


def made_of(off: dict[int, tuple[float, float]], runs_each: int, levels: tuple[float, ...] = FOUR[:3]) -> Campaign:
    """Return runs of which some have another bias, deg/hr, in the two channels."""
    rng = np.random.default_rng(5)
    rows = lay_out(rng, levels, runs_each)
    rates = base_rates(rows, thermal=False) + rng.normal(0.0, 0.5, (len(rows), 2))
    return campaign_of(rows, rates + np.array([off.get(run, (0.0, 0.0)) for run in rows.run.tolist()]), stated=0.5)


@pytest.mark.parametrize("size", [12.0, 20.0])
def test_one_run_of_three_at_every_temperature_is_another(size: float) -> None:
    """More than a fifth of all collects, of which none is wrong: they have another bias, and that is in no mean."""
    found = wrong_rows(made_of(dict.fromkeys((2, 5, 9), (size, 0.0)), 3))[2]
    assert found.another == {"BA": {2, 5, 9}}
    assert {row.done for row in found.rows} == {USED}


def test_each_of_two_channels_is_another_in_a_run_of_its_own() -> None:
    """What is known of one run prices the other: asked alone, noise that is larger than stated had been as probable."""
    assert wrong_rows(made_of({2: (7.5, 0.0), 7: (0.0, -9.0)}, 3))[2].another == {"BA": {2}, "BB": {7}}


def test_of_two_and_two_runs_that_differ_neither_is_accused_whatever_is_beside_them() -> None:
    """The likeliest pair alone had been asked for the third, and the other pair was sound by chance."""
    found = wrong_rows(made_of({3: (25.0, 0.0), 4: (25.0, 0.0), 9: (12.0, 0.0)}, 4))[2]
    assert found.another == {"BA": {9}}
    assert {row.run for row in found.rows if row.run != 9} == {1, 2, 3, 4}


@pytest.mark.slow
def test_of_few_events_among_many_runs_none_is_more_than_there_are() -> None:
    """Grown in the noise that the others make, runs came with them that were no others, and stayed."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        rows = lay_out(rng, EIGHT, 3)
        own = rng.normal(0.0, 2.0, (25, 2))[rows.run] + np.outer(60.0 * np.isin(rows.run, (5, 14, 20)), (1.0, 0.0))
        made = campaign_of(rows, base_rates(rows, thermal=False) + own + rng.normal(0.0, 0.9, own.shape))
        (effect,) = reconcile(made, "matrix-6", prove=False).effects
        told = {of["when"] for of in effect.parameters}
        assert {f"in run {run} alone" for run in (5, 14, 20)} <= told
        assert len(told) <= 3 + (seed == 1)  # of which one is as far off by chance


def test_a_known_step_is_why_nothing_is_missing_and_nothing_is_doubted() -> None:
    """It had been "by the noise that the model states", beside runs that hil solve without the model doubts."""
    rng = np.random.default_rng(1)
    rows = lay_out(rng, FOUR, 3)
    rates = base_rates(rows, thermal=False) + rng.normal(0.0, 0.5, (len(rows), 2))
    rates[:, 0] += 20.0 * (rows.run == 5)
    made = campaign_of(rows, rates, stated=0.5)
    after = reconcile(made, "matrix-6", prove=False).model_after
    assert after is not None
    again = reconcile(made, after.model_copy(update={"noise": {}}), prove=False)
    known = "That is by the terms that the model states; hil solve without --model does not pass run 5"
    assert again.verdict == "none"
    assert known in what_to_do(again)[1]
    assert not any("doubts" in note for note in again.notes)


def test_an_offset_of_each_run_that_model_yaml_states_certainly_scatters() -> None:
    """Of rates without errors nothing exceeds any, and scatter had said that nothing certainly scatters."""
    rng = np.random.default_rng(2)
    rows = lay_out(rng, FOUR, 3)
    rates = base_rates(rows, thermal=False) + rng.normal(0.0, 0.5, (len(rows), 2))
    rates += rng.normal(0.0, 3.0, (13, 2))[rows.run]
    scatters = what_scatters(campaign_of(rows, rates, stated=None))
    assert any(each["run_offset_se_deg_per_hr"] for each in scatters.answer.noise)
    assert not any("nothing certainly scatters" in words for words in scatters.sentences())


def test_two_of_three_runs_that_are_others_alike_are_told_and_not_the_third() -> None:
    """Of any two each hides the other: a jump that stays, at the third, had explained more than either alone."""
    made = night(5, 3, {10: 60.0, 11: 60.0})
    (jump, *_) = reconcile(made, "matrix-6", prove=False).effects
    assert (jump.id, {of["when"].split()[2] for of in jump.parameters}) == ("jump", {"10", "11"})


def test_the_search_starts_from_what_solve_says_that_runs_had_of_their_own() -> None:
    """Grown term by term it had never met two of three that hide each other: another set was likelier so far."""
    problem = pose(night(5, 3, {10: 60.0, 11: 60.0}), load_model("matrix-6"), (*BASE_EFFECTS, *EFFECTS))
    search = coarse(problem, EFFECTS, ())[2]
    starts = [[(search.terms[j].name, dict(search.terms[j].candidate.shape)) for j in each] for each in search.starts]
    alone = [("jump", {"from_run": run, "runs_held": 1.0, "from_collect": 0.0}) for run in (10.0, 11.0)]
    assert alone in starts
