"""What is said of runs that do not pass, once each, and to which of them somebody has to see."""

from __future__ import annotations

from dataclasses import replace

from hil.solve import RunSolution, solve_campaign
from hil.solve.document import not_passed, not_passed_of, of_sensors_in_words, reasons
from hil.solve.residuals import LACKS, MOVED, judge
from procedures.verdict import Judgement, Verdict
from tests.hil.solve.runs_of_a_unit import campaign


def _solved(verdict: Verdict, reason: str, run: int) -> RunSolution:
    (one, *_) = solve_campaign(campaign(runs=3, per_temperature=3))
    return replace(one, run=run, runs=(run,), judged=Judgement(verdict, reason), beside=())


def test_somebody_has_to_see_to_runs_that_do_not_pass() -> None:
    """By verdict, the worst first."""
    quiet = [_solved(Verdict.PASS, "agree", run) for run in range(1, 12)]
    moved = _solved(Verdict.MARGINAL, "the soak had not ended", 13)
    failed = _solved(Verdict.FAIL, "clipped", 14)
    assert not_passed_of(quiet) == {}
    assert not_passed(not_passed_of([*quiet, moved, failed])) == {"FAIL": [14], "MARGINAL": [13]}
    assert next(iter(not_passed_of([moved, failed]))) == "FAIL"


def test_a_reason_is_said_once_with_the_runs_that_it_holds_for() -> None:
    """The worst first; sentences of the same runs stand together."""
    dead = [_solved(Verdict.FAIL, "nothing was measured; BA is not seen", run) for run in (3, 4, 5)]
    late = [_solved(Verdict.MARGINAL, f"the soak had not ended; p = 0.0{run}", run) for run in (1, 2)]
    assert list(reasons([*late, *dead])) == [
        (Verdict.FAIL, "sensor 2, runs 3–5", "nothing was measured; BA is not seen"),
        (Verdict.MARGINAL, "sensor 2, runs 1–2", "the soak had not ended"),
        (Verdict.MARGINAL, "sensor 2, run 1", "p = 0.01"),
        (Verdict.MARGINAL, "sensor 2, run 2", "p = 0.02"),
    ]


def test_each_cause_stands_under_the_verdict_that_it_gives() -> None:
    """A soak that had not ended makes no run FAIL, not beside residuals that do; these come first."""
    moved = Judgement(Verdict.MARGINAL, "the soak had not ended")
    both = replace(_solved(Verdict.FAIL, "clipped", 3), beside=(moved,), form_reason="bias only")
    one = replace(_solved(Verdict.PASS, "agree", 4), beside=(moved,))
    assert (both.verdict, both.reason) == (Verdict.FAIL, "clipped; the soak had not ended; bias only")
    assert list(reasons([one, both])) == [
        (Verdict.FAIL, "sensor 2, run 3", "clipped"),
        (Verdict.MARGINAL, "sensor 2, runs 3–4", "the soak had not ended"),
    ]


def test_runs_whose_residuals_are_too_large_share_a_line() -> None:
    """Of several from how much to how much, and what it means; of one its own chi-square, as solve states it."""
    many = [
        _solved(Verdict.FAIL, judge(chi, 8, 14, True).reason, run) for run, chi in ((4, 40.0), (5, 300.0), (7, 80.0))
    ]
    alone = _solved(Verdict.MARGINAL, judge(18.0, 8, 14, True, where=", in RA 2.1 times").reason, 6)
    between = f"the residuals are 2.2 to 6.1 times what the standard errors allow: {LACKS}"
    assert list(reasons([*many, alone])) == [
        (Verdict.FAIL, "sensor 2, runs 4–5, 7", between),
        (Verdict.MARGINAL, "sensor 2, run 6", alone.reason),
    ]
    assert [each[2] for each in reasons(many[:1])] == [many[0].reason]
    unsettled = [_solved(Verdict.FAIL, judge(80.0, 8, 14, True, why=MOVED).reason, 1)]
    assert [where for _, where, _ in reasons([*many, *unsettled])] == ["sensor 2, runs 4–5, 7", "sensor 2, run 1"]


def test_a_range_of_which_both_ends_are_alike_is_one_number() -> None:
    """The residuals of two runs are 2.2 times what is allowed, not 2.2 to 2.2 times."""
    two = [_solved(Verdict.FAIL, judge(chi, 8, 14, True).reason, run) for run, chi in ((4, 40.0), (5, 40.1))]
    ((_, _, said),) = reasons(two)
    assert said.startswith("the residuals are 2.2 times what the standard errors allow")


def test_where_a_verdict_is_not_every_sensor_s_it_is_said_whose() -> None:
    """Of run 3 that FAILs in one sensor and is MARGINAL in the other both are said; nothing of what both have."""
    first = [_solved(Verdict.FAIL, "clipped", 3), _solved(Verdict.FAIL, "clipped", 4)]
    second = [replace(_solved(Verdict.MARGINAL, "late", 3), sensor=1), replace(first[1], sensor=1)]
    assert [*of_sensors_in_words(not_passed_of(first))] == [("FAIL", "runs 3–4 (FAIL)")]
    said = [each for _, each in of_sensors_in_words(not_passed_of([*first, *second]))]
    assert said == ["run 4 of sensor 1 (FAIL)", "runs 3–4 of sensor 2 (FAIL)", "run 3 of sensor 1 (MARGINAL)"]
    assert [*of_sensors_in_words(not_passed_of([*first, *second]), [3])] == [("FAIL", "run 4 (FAIL)")]


def test_no_run_passes_whose_f_is_none_of_gravity() -> None:
    """Values per g are as wrong as f is, unless it was a centrifuge; one collect is named, of a whole run none."""
    made = campaign(9, 3, seed=1)
    rows, f = made.sensors[2], made.sensors[2].conditions.f_g.copy()
    f[[4, 9, 10, 11]] *= 1.03
    heavy = replace(made, sensors={2: replace(rows, conditions=replace(rows.conditions, f_g=f))})
    said = {each.run: each.reason for each in solve_campaign(heavy) if each.verdict is Verdict.INCONCLUSIVE}
    why = "|f| is off 1 g by more than 2 % (the worst is 1.030 g): f is wrong, and every parameter per g with it"
    assert {run: reason.partition("; ")[0] for run, reason in said.items()} == {2: f"collect 5: {why}", 4: why}
    assert not any(why in each.reason for each in solve_campaign(replace(heavy, centrifuge=True)))
