"""What runs of one temperature differ by is no scatter where a jump, or a recorded column, explains it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.solve import repeats, solve_campaign
from hil.solve.between_runs import NO_NOISE, Jump, between_runs
from hil.solve.temperatures import runs_by_visit
from procedures.verdict import Verdict
from tests.hil.solve.runs_of_a_unit import campaign, repeated, up_and_down, with_column, with_rates


def visited(order: Sequence[int], seed: int = 0, scatter: float = 0.8) -> Campaign:
    """Return a run at each of some temperatures, 20 °C apart, in this order; MU scatters as the bias does."""
    one = campaign(len(order), 1, seed, scatter)
    rows, of = one.sensors[2], one.sensors[2].conditions
    here = 20.0 * np.array(order)[of.run - 1] - 20.0
    rates = rows.rates_deg_per_hr + np.outer(here - of.columns["setpoint_degC"], [0.5, 0.3])
    rates += of.f_g[:, [2]] * np.random.default_rng(seed + 100).normal(0.0, scatter, (len(order), 2))[of.run - 1]
    columns = {**of.columns, "setpoint_degC": here, "temperature_degC": here + 8.0, "chamber_degC": here + 0.1}
    return replace(one, sensors={2: replace(rows, conditions=replace(of, columns=columns), rates_deg_per_hr=rates)})


def visits_again(seed: int = 0, scatter: float = 0.8) -> Campaign:
    """Return three passes of four temperatures, coldest first."""
    return visited([0, 1, 2, 3] * 3, seed, scatter)


def after(run: int, size: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return what is `size` after a run, and nothing before."""
    return lambda runs: size * (runs > run)


def with_mua(one: Campaign, of_run: Callable[[np.ndarray], np.ndarray]) -> Campaign:
    """Return the campaign with an MUA that is larger by so much in each run, (n,)."""
    of, rates = one.sensors[2].conditions, one.sensors[2].rates_deg_per_hr.copy()
    rates[:, 1] -= of.f_g[:, 2] * of_run(of.run)
    return with_rates(one, rates)


@pytest.mark.parametrize(("size", "last"), [(10.0, 4), (15.0, 6), (-20.0, 8), (30.0, 6)])
def test_a_step_of_mu_in_the_night_is_no_scatter_from_run_to_run(size: float, last: int) -> None:
    """Three visits to each temperature: all runs had been PASS, beside an MUA known by half of the step."""
    made = with_mua(visits_again(), after(last, size))
    solutions = solve_campaign(made)
    (jump,) = solutions[0].between.jumps.values()
    assert jump == Jump(pytest.approx(size, abs=2.0), jump.sd, "deg/hr/g", last, last + 1)
    by = f"MUA jumps by {jump.size:+.3g} ± {jump.sd:.2g} deg/hr/g"
    said = f"{by} between run {last} and run {last + 1}: hil reconcile asks what it is"
    assert [(each.verdict, said in each.reason) for each in solutions] == [(Verdict.MARGINAL, True)] * 12
    shown = repeats(made, solutions)[2]
    assert shown.between.in_words == [said]
    assert said not in shown.sentences()  # verdicts say it


def test_only_runs_that_others_contradict_are_judged_by_a_jump() -> None:
    """At a temperature that was measured after it alone no run contradicts another."""
    found = {
        each.run: each.verdict for each in solve_campaign(with_mua(visited([0, 1, 2] * 4 + [5] * 3), after(9, 25.0)))
    }
    assert {run for run, verdict in found.items() if verdict is Verdict.MARGINAL} == {*range(1, 13)}


@pytest.mark.parametrize("scatter", [0.0, 3.0])
def test_runs_that_scatter_are_said_to_follow_nothing(scatter: float) -> None:
    """Of none of some nights: three visits to each temperature, up and down, and one visit to each."""
    for seed in range(6):
        for made in (visits_again(seed, scatter), up_and_down(seed, scatter), campaign(12, 4, seed, scatter)):
            (found,) = {id(each.between): each.between for each in solve_campaign(made)}.values()
            assert found.in_words == []


def test_what_a_recorded_column_explains_is_said_to_be_no_scatter() -> None:
    """The supply moves MUA; one that steps with it is followed, and no jump of the unit."""
    one = visits_again()
    run = one.sensors[2].conditions.run
    for shown in (28.0 + np.sin(1.7 * run), 28.0 + (run > 6)):
        made = with_mua(with_column(one, supply_V=shown), lambda _, shown=shown: 12.0 * (shown - 28.0))
        solutions = solve_campaign(made)
        said = f"MUA follows supply_V from run to run: {NO_NOISE}"
        assert said in repeats(made, solutions)[2].sentences()
        assert {each.verdict for each in solutions} == {Verdict.PASS}


def test_a_drift_and_the_way_to_a_temperature_are_no_jump() -> None:
    """What rises through the night follows time; what the way explains as well as a jump does is history."""
    one = visits_again()
    one = with_column(one, time_since_power_on_s=one.sensors[2].conditions.start_s + 3600.0)
    drifts = solve_campaign(with_mua(one, lambda run: 2.0 * run))
    assert drifts[0].between.follow == {"MUA": ("time",)}
    up = np.repeat(np.arange(6), 2).tolist()
    made = with_mua(visited([*up, *up[::-1]]), after(12, 15.0))
    solutions = solve_campaign(made)
    assert {each.verdict for each in solutions} == {Verdict.PASS}
    assert solutions[0].between.in_words == []
    assert any(said.startswith("MUA differs between visits") for said in repeats(made, solutions)[2].sentences())
    assert repeats(made, solutions, runs_by_visit)[2].of_visits == (), "visits are not taken together there"


def test_of_one_run_alone_that_is_another_both_are_said() -> None:
    """The last run differs: from then on the unit may be another, or the run may be. Two that do are a jump."""
    conditions, noise = visits_again().sensors[2].conditions, np.random.default_rng(0).normal(0.0, 1.0, (12, 1))
    runs = np.arange(1, 13)
    for last, alone in ((11, True), (10, False)):
        values = noise + 50.0 * (runs > last)[:, None]
        found = between_runs({"MUA": "deg/hr/g"}, runs.tolist(), values, np.ones((12, 1)), conditions)
        sd = pytest.approx(1.0, abs=0.5)
        assert found.jumps == {"MUA": Jump(pytest.approx(50.0, abs=5.0), sd, "deg/hr/g", last, last + 1, alone)}
        assert ("or in one run alone" in found.in_words[0]) is alone


def test_a_jump_inside_the_only_visit_to_a_temperature_is_told_by_how_little_the_others_differ() -> None:
    """Two runs of three, or one, are another; those at other temperatures agree."""
    for last in (4, 5):
        made = with_mua(repeated(9, 3, (0, 1, 2, 2)), after(last, 15.0))
        solutions = solve_campaign(made)
        assert {each.run for each in solutions if each.verdict is Verdict.MARGINAL} == {4, 5, 6}
        assert solutions[0].between.jumps["MUA"].before == last


def test_where_no_temperature_was_recorded_a_jump_gives_no_verdict() -> None:
    """It may be the temperature that jumps: said, beside what to record."""
    one = with_mua(visits_again(), after(6, 25.0))
    rows = one.sensors[2]
    conditions = replace(rows.conditions, columns={})
    rates = rows.rates_deg_per_hr - np.outer(rows.conditions.columns["setpoint_degC"], [0.5, 0.3])
    made = replace(one, sensors={2: replace(rows, conditions=conditions, rates_deg_per_hr=rates)})
    solutions = solve_campaign(made)
    assert {each.verdict for each in solutions} == {Verdict.PASS}
    assert any(said.startswith("MUA jumps by +2") for said in repeats(made, solutions)[2].sentences())


def test_visits_that_differ_are_compared_as_visits() -> None:
    """A bias that is another in each visit jumps nowhere, though runs of a visit agree."""
    for seed in range(8):
        one = visited(np.repeat([0, 1, 2, 3] * 2, 4).tolist(), seed, 0.5)
        of_visit = np.random.default_rng(seed + 50).normal(0.0, 6.0, (8, 2))
        rates = one.sensors[2].rates_deg_per_hr + of_visit[(one.sensors[2].conditions.run - 1) // 4]
        assert solve_campaign(with_rates(one, rates))[0].between.jumps == {}


@pytest.mark.parametrize(("runs", "run", "size"), [(15, 5, 15.0), (15, 8, 15.0), (9, 5, 8.0)])
def test_one_run_that_is_another_than_all_that_repeat_it_is_accused_alone(runs: int, run: int, size: float) -> None:
    """Three runs at each temperature: PASS with a ± of 4 deg/hr/g for all before, where reconcile leaves it out."""
    sound = repeated(runs, 3, (0, 1, 2, 2))
    made = with_mua(sound, lambda each: size * (each == run))
    solutions = solve_campaign(made)
    jump = solutions[0].between.jumps["MUA"]
    assert (jump.before, jump.after, jump.alone, jump.size) == (run, run, True, pytest.approx(size, abs=2.5))
    by = f"MUA is another by {jump.size:+.3g} ± {jump.sd:.2g} deg/hr/g"
    (why,) = (each.reason for each in solutions if each.verdict is Verdict.MARGINAL)
    assert f"{by} in run {run} alone, and in no mean: hil reconcile asks what it is" in why
    shown, before = (repeats(of, solve_campaign(of))[2] for of in (made, sound))
    (mean,) = (each for each in shown.means if run in each.runs)
    assert {name for name in shown.names if run not in shown.runs_of(mean, name)} == {"MUA"}
    assert mean.values["MUA"].runs == len(mean.runs) - 1
    place = shown.names.index("MUA")
    assert shown.spread.degrees[place] == before.spread.degrees[place] - 1
    assert shown.spread.observed[place] < 1.5 * before.spread.observed[place]  # 5 and more with it


def test_a_run_at_an_end_of_its_visit_may_be_another_or_the_unit_from_there_on() -> None:
    """What a jump goes by is what is after it less what was before it."""
    solutions = solve_campaign(with_mua(repeated(15, 3, (0, 1, 2, 2)), lambda runs: 15.0 * (runs == 7)))
    jump = solutions[0].between.jumps["MUA"]
    assert (jump.before, jump.after, jump.alone, jump.size) == (7, 8, True, pytest.approx(-15.0, abs=2.5))
    assert {each.run for each in solutions if each.verdict is Verdict.MARGINAL} == {7, 8, 9}


def test_of_two_runs_at_a_temperature_that_differ_either_may_be_another() -> None:
    """All others agree, so that it is no scatter; which of the two it is nobody can tell."""
    conditions, runs = visited([*range(8), *range(8)]).sensors[2].conditions, np.arange(1, 17)
    values = np.random.default_rng(1).normal(0.0, 1.0, (16, 1)) + 25.0 * (runs == 12)[:, None]
    found = between_runs({"MUA": "deg/hr/g"}, runs.tolist(), values, np.ones((16, 1)), conditions)
    jump = found.jumps["MUA"]
    assert (jump.before, jump.after, jump.alone, jump.size) == (4, 12, True, pytest.approx(25.0, abs=3.0))
    assert found.apart == {"MUA": (4, 12)}


def test_where_each_temperature_was_gone_to_once_no_uncertainty_has_what_visits_differ_by() -> None:
    """The bias jumps between two temperatures: all runs of one agree, and a ± must not read as if it knew more."""
    said = "each temperature was gone to once: what changes from visit to visit, as a jump between two does,"
    up, again = campaign(12, 3), visits_again()
    for made, so in ((up, True), (again, False), (campaign(6, 6), False), (campaign(6, 1), False)):
        rates = made.sensors[2].rates_deg_per_hr + 15.0 * (made.sensors[2].conditions.run > 6)[:, None]
        jumps = with_rates(made, rates)
        told = repeats(jumps, solve_campaign(jumps))[2].sentences()
        assert any(each.startswith(said) for each in told) is so


@pytest.mark.parametrize(("each", "scatter"), [(1, 0.5), (3, 0.5), (3, 4.0)])
@pytest.mark.parametrize("at", [2, 4, 5])
def test_a_jump_between_temperatures_gone_to_once_is_told_beside_what_the_unit_may_do(
    each: int, scatter: float, at: int
) -> None:
    """All runs of a temperature agree, and nobody said a word of a bias that is another from there on.

    What they scatter by, which they tell better than a curve of few values does, is how near visits lie to it.
    """
    conditions = campaign(8 * each, each).sensors[2].conditions
    runs = np.arange(1, 8 * each + 1)
    station = (runs - 1) // each
    rng = np.random.default_rng(at)
    values = np.stack([0.3 * station**2 + 60.0 * (station >= at), 5.0 * station - 0.3 * station**2], 1)
    values += rng.normal(0.0, scatter, values.shape)
    found = between_runs(
        {"BA": "deg/hr", "BB": "deg/hr"}, runs.tolist(), values, np.full(values.shape, 0.5), conditions
    )
    (jump,) = found.jumps.values()
    assert (jump.before, jump.after, jump.once) == (at * each, at * each + 1, True)
    assert jump.size == pytest.approx(60.0, abs=5.0 * jump.sd)
    assert (found.apart, found.judged, found.lasting, found.alone) == ({}, {}, [], {})  # it may be what the unit does
    (said,) = found.not_judged
    assert said.startswith("BA jumps by ")
    assert said.endswith("go back to one of before to tell")
    assert found.off_a_curve == [said]


def test_what_arithmetic_leaves_of_values_on_a_curve_jumps_nowhere() -> None:
    """A planned sweep has no noise: what was left of its values was a jump by 1e-15."""
    conditions = campaign(24, 3).sensors[2].conditions
    station = (np.arange(24) // 3)[:, None]
    values = np.hstack([0.1 * station + 1.0 / 3.0, 0.7 * station**2, np.full((24, 1), 2.0 / 3.0)])
    units = {"BA": "deg/hr", "BB": "deg/hr", "MUA": "deg/hr/g"}
    found = between_runs(units, list(range(1, 25)), values, np.full(values.shape, 0.5), conditions)
    assert found.in_words == []


def test_a_run_alone_at_its_temperature_that_others_do_not_lead_to_is_no_pass() -> None:
    """Its own bias or the unit's there: it stays in the means, for nobody knows."""
    conditions = campaign(24, 3).sensors[2].conditions
    runs = np.setdiff1d(np.arange(1, 25), (10, 11))
    station = (runs - 1) // 3
    rng = np.random.default_rng(3)
    for off in (60.0, 0.0):
        values = (0.3 * station**2 + off * (runs == 12) + rng.normal(0.0, 0.5, len(runs)))[:, None]
        found = between_runs({"BA": "deg/hr"}, runs.tolist(), values, np.full(values.shape, 0.5), conditions)
        assert {run: of.verdict for run, of in found.judged.items()} == ({12: Verdict.MARGINAL} if off else {})
        assert not found.alone
        assert all("at which no other run was made: make one to tell" in of.reason for of in found.judged.values())


@pytest.mark.parametrize("kind", ["bend", "knee", "resonance", "scatter"])
def test_what_a_unit_does_over_temperature_is_hardly_ever_called_a_jump(kind: str) -> None:
    """Forty parameters of each kind."""
    conditions = campaign(24, 3).sensors[2].conditions
    runs = np.arange(1, 25)
    t, rng = ((runs - 1) // 3)[:, None] / 7.0, np.random.default_rng(1)
    of_each = {
        "bend": 60.0 * np.sin(rng.uniform(1.0, 4.0, 40) * t + rng.uniform(0.0, 6.0, 40)),
        "knee": 100.0 * np.maximum(t - rng.uniform(0.2, 0.8, 40), 0.0),
        "resonance": 60.0 * np.exp(-0.5 * ((t - rng.uniform(0.1, 0.9, 40)) / 0.07) ** 2),
        "scatter": 10.0 * rng.normal(size=(8, 40))[(runs - 1) // 3],
    }
    values = of_each[kind] + rng.normal(0.0, 0.5, (24, 40))
    units = {f"P{k}": "deg/hr" for k in range(40)}
    assert len(between_runs(units, runs.tolist(), values, np.full(values.shape, 0.5), conditions).jumps) < 3


def test_how_far_a_run_is_off_is_as_uncertain_as_any_run_is() -> None:
    """MU scatters by 3: its own scatter is in the ±, however well the others together are known."""
    conditions, runs = campaign(12, 12).sensors[2].conditions, np.arange(1, 13)
    off = []
    for seed in range(200):
        values = np.random.default_rng(seed).normal(0.0, 3.0, (12, 1)) + 40.0 * (runs == 5)[:, None]
        found = between_runs({"MUA": "deg/hr/g"}, runs.tolist(), values, np.full((12, 1), 0.6), conditions)
        off.append((found.jumps["MUA"].size - 40.0) / found.jumps["MUA"].sd)
    assert np.std(off) == pytest.approx(1.1, abs=0.12)  # Student's t of ten degrees of freedom


@pytest.mark.parametrize("follows", [False, True])
def test_values_tell_whether_the_thermometer_or_the_setpoint_is_wrong(follows: bool) -> None:
    """In the second of two passes the thermometer shows 20 °C more; the bias and GS follow it, or do not."""
    one = visited([*range(5), *range(5)], 1, 0.5)
    rows = one.sensors[2].conditions
    own = rows.columns["temperature_degC"] + 20.0 * (rows.run > 5)
    made = with_column(one, temperature_degC=own)
    rates = made.sensors[2].rates_deg_per_hr + np.outer(20.0 * follows * (rows.run > 5), [0.5, 0.3])
    solutions = solve_campaign(with_rates(made, rates))
    told = repeats(made, solutions)[2].sentences()
    wrong = "the thermometer is off in some runs", "in some runs the unit was elsewhere than it was set to"
    assert [any(said.endswith(words) for said in told) for words in wrong] == [not follows, follows]
    assert {each.verdict for each in solutions} == {Verdict.MARGINAL}
    assert repeats(one, solve_campaign(one))[2].between.agrees == []


def test_where_one_value_jumps_another_is_seen_to_by_less_than_elsewhere() -> None:
    """BB by four in the run in which BA does by twelve: BA alone was named, and BB had been called scatter."""
    conditions = visited([0, 0, 0, 1, 1, 1, 2, 2, 2]).sensors[2].conditions
    runs, units = list(range(1, 10)), {"BA": "deg/hr", "BB": "deg/hr"}
    told = []
    for seed in range(20):
        values = np.random.default_rng(seed).normal(0.0, 0.6, (9, 2)) + np.repeat([[5.0], [9.0], [14.0]], 3, axis=0)
        for size in (12.0, 0.0):
            moved = values + np.outer(np.arange(1, 10) == 5, [size, -4.0])
            told.append(between_runs(units, runs, moved, np.full((9, 2), 0.6), conditions).jumps)
    beside, alone = told[::2], told[1::2]
    assert sum("BA" in each for each in beside) >= 14
    assert sum("BB" in each for each in beside) >= 2 * sum("BB" in each for each in alone) > 4
    assert not any("BA" in each for each in alone)
    assert {(jump.before, jump.after) for each in beside for jump in each.values()} == {(5, 5)}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 4, 5, 6])
def test_runs_of_a_temperature_at_which_values_scatter_more_are_no_pass_and_none_is_accused_alone(seed: int) -> None:
    """MUA is another in each of six runs of one temperature, and in no other run: no jump, and no odd run."""
    of_run = np.append(np.random.default_rng(seed).normal(0.0, 8.0, 6), np.zeros(18))
    solutions = solve_campaign(with_mua(repeated(24, 6, (0, 1, 2, 2), seed), lambda runs: of_run[runs - 1]))
    assert solutions[0].between.jumps == {}
    assert solutions[0].between.uneven == {"MUA": (1, 2, 3, 4, 5, 6)}
    assert {each.run for each in solutions if each.verdict is Verdict.MARGINAL} == {1, 2, 3, 4, 5, 6}
    assert "MUA differs in runs 1–6, of one temperature, by more than at others" in solutions[0].reason


@pytest.mark.slow
@pytest.mark.parametrize(("what", "lasting"), [("step", ["MUA"]), ("ageing", ["MUA"]), ("none", [])])
def test_what_visits_differ_by_does_not_average_within_a_visit(what: str, lasting: list[str]) -> None:
    """Two runs in each of two visits to a temperature, MUA another in each: its ± had been that of four."""
    one = visited(np.repeat([0, 1, 2, 3, 2, 1, 0], 2).tolist(), scatter=0.0)
    moved = {"step": lambda runs: 12.0 * (runs > 8), "ageing": lambda runs: 2.0 * runs, "none": lambda runs: 0.0 * runs}
    made = with_mua(one, moved[what])
    shown = repeats(made, solve_campaign(made))[2]
    assert shown.between.lasting == lasting
    for name in ("MUA", "BA"):
        place = shown.names.index(name)
        beyond, own = shown.spread.beyond[place], np.mean([of[name] for of in shown.of_each.values()])
        assert (beyond > 5.0) == (name in lasting)
        for mean in shown.means:
            alike = len(mean.runs) / 2 if name in lasting else len(mean.runs)
            assert mean.values[name].sd == pytest.approx(own / np.sqrt(alike), rel=0.05)
