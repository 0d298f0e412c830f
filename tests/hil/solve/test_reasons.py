"""What is said of runs that do not pass, once each, and to which of them somebody has to see."""

from __future__ import annotations

from dataclasses import replace

from hil.solve import RunSolution, solve_campaign
from hil.solve.runs import not_passed, reasons
from procedures.verdict import Verdict
from tests.hil.solve.test_neighbours import campaign


def _solved(verdict: Verdict, reason: str, run: int, chi_square: float, beside: Verdict = Verdict.PASS) -> RunSolution:
    (one, *_) = solve_campaign(campaign(runs=3, per_temperature=3))
    said = {"verdict": verdict, "reason": reason, "chi_square": chi_square, "beside": beside, "degrees_of_freedom": 2}
    return replace(one, run=run, runs=(run,), **said)  # type: ignore[arg-type]


def test_somebody_has_to_see_to_runs_that_chance_does_not_explain() -> None:
    """One of twelve runs whose residuals are large, where all others' are small, is chance; where all are it is not."""
    quiet = [_solved(Verdict.PASS, "agree", run, 2.0) for run in range(1, 12)]
    strained = _solved(Verdict.MARGINAL, "large", 12, 6.5)
    assert not_passed([*quiet, strained]) == {}
    assert not_passed([strained]) == {Verdict.MARGINAL: [12]}
    assert not_passed([replace(each, chi_square=5.0) for each in quiet] + [strained]) == {Verdict.MARGINAL: [12]}
    moved = _solved(Verdict.MARGINAL, "the soak had not ended", 13, 2.0, Verdict.MARGINAL)
    failed = _solved(Verdict.FAIL, "clipped", 14, 2.0, Verdict.FAIL)
    assert not_passed([*quiet, moved, failed]) == {Verdict.FAIL: [14], Verdict.MARGINAL: [13]}
    assert next(iter(not_passed([moved, failed]))) is Verdict.FAIL


def test_a_reason_is_said_once_with_the_runs_that_it_holds_for() -> None:
    """The worst first; sentences of the same runs stand together."""
    dead = [_solved(Verdict.FAIL, "nothing was measured; BA is not seen", run, 1.0) for run in (3, 4, 5)]
    late = [_solved(Verdict.MARGINAL, f"the soak had not ended; p = 0.0{run}", run, 1.0) for run in (1, 2)]
    assert list(reasons([*late, *dead])) == [
        (Verdict.FAIL, "sensor 2, runs 3–5", "nothing was measured; BA is not seen"),
        (Verdict.MARGINAL, "sensor 2, runs 1–2", "the soak had not ended"),
        (Verdict.MARGINAL, "sensor 2, run 1", "p = 0.01"),
        (Verdict.MARGINAL, "sensor 2, run 2", "p = 0.02"),
    ]
