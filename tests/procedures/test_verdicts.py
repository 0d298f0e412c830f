"""Verdicts combine to the worst, with every reason, and a missing step is never a pass."""

from __future__ import annotations

from dataclasses import replace

import pytest

from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import StepKind, make_plan
from procedures.settings import SweepProcedure
from procedures.verdict import Judgement, Verdict, combine, self_calibration_verdict

STEPS = make_plan(SweepProcedure("x", (20.0,), self_calibrations=1)).self_calibrations[1]


def _results(**changes):
    """Return results of a clean self-calibration; `changes` by position or 'soak' give a verdict, or None to miss."""
    results = {}
    for step in STEPS:
        name = "soak" if step.kind is StepKind.RESTABILISE else f"p{step.position}"
        verdict = changes.get(name, "PASS")
        if step.kind is StepKind.INDEX or verdict is None:
            continue
        data = {"verdict": verdict, "reason": f"{name} is {verdict}", "start_s": step.starts_s}
        results[step.key] = StepResult(Outcome.DONE, data=data)
    return results


def test_everything_passed_is_a_pass_with_a_reason():
    """A pass says why, too."""
    judgement = self_calibration_verdict(STEPS, _results())
    assert judgement.verdict is Verdict.PASS
    assert "restabilised" in judgement.reason


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"p2": "MARGINAL"}, Verdict.MARGINAL),
        ({"p2": "MARGINAL", "p3": "INCONCLUSIVE"}, Verdict.INCONCLUSIVE),
        ({"p1": "FAIL", "p3": "INCONCLUSIVE"}, Verdict.FAIL),
        ({"soak": "INCONCLUSIVE"}, Verdict.INCONCLUSIVE),
        ({"soak": None}, Verdict.INCONCLUSIVE),
        ({"p3": None}, Verdict.INCONCLUSIVE),
        ({"p3": None, "p1": "FAIL"}, Verdict.FAIL),
    ],
)
def test_the_worst_decides_and_every_worry_is_named(changes, expected):
    """FAIL over INCONCLUSIVE over MARGINAL over PASS."""
    judgement = self_calibration_verdict(STEPS, _results(**changes))
    assert judgement.verdict is expected
    for name, verdict in changes.items():
        assert (f"{name} is {verdict}" in judgement.reason) if verdict else ("missing" in judgement.reason)


def test_a_result_without_a_verdict_is_inconclusive():
    """A record that does not say is not a pass."""
    results = _results()
    key = next(iter(results))
    results[key] = StepResult(Outcome.DONE, data={"start_s": 0.0})
    assert self_calibration_verdict(STEPS, results).verdict is Verdict.INCONCLUSIVE


def test_collects_that_were_torn_apart_are_marginal():
    """Ten minutes more than planned between two collects."""
    results = _results()
    late = next(step for step in STEPS if step.kind is StepKind.COLLECT and step.position == "3")
    results[late.key].data["start_s"] += 600.0
    judgement = self_calibration_verdict(STEPS, results)
    assert judgement.verdict is Verdict.MARGINAL
    assert "positions 2 and 3 are 12 min apart" in judgement.reason
    close = [replace(step, starts_s=8.0 * k) for k, step in enumerate(STEPS)]
    assert "apart, 16 s were planned" in self_calibration_verdict(close, results).reason


def test_reasons_come_worst_first_and_once():
    """The first words are what matters most."""
    marginal, fail = Judgement(Verdict.MARGINAL, "b"), Judgement(Verdict.FAIL, "a")
    assert combine([marginal, fail, marginal]) == Judgement(Verdict.FAIL, "a; b")
    assert combine([]) == Judgement(Verdict.PASS, "all criteria met")
