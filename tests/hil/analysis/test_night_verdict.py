"""The verdict on a whole night: the worst of its solutions, and whether it is whole."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from hil.analysis.night_verdict import night_verdict, of_units
from procedures.verdict import Judgement, Verdict

OUT = {"verdict": "out of spec", "reason": "one limit broken"}


def solutions(*verdicts: Verdict) -> Any:
    """Solutions of one sensor, run by run."""
    return [SimpleNamespace(verdict=each, sensor=2, run=run, reason="why") for run, each in enumerate(verdicts, 1)]


@pytest.mark.parametrize(
    ("state", "verdicts", "verdict", "reason"),
    [
        ("complete", (Verdict.PASS, Verdict.PASS), Verdict.PASS, "everything that was asked for is there"),
        (
            "complete",
            (Verdict.PASS, Verdict.FAIL, Verdict.MARGINAL),
            Verdict.FAIL,
            "1 of 3 solutions; the first is sensor 2, run 2: why",
        ),
        ("failed", (Verdict.PASS,), Verdict.INCONCLUSIVE, "something is missing"),
        ("aborted", (Verdict.PASS, Verdict.FAIL), Verdict.FAIL, "run 2: why; it is aborted: something is missing"),
        ("complete", (), Verdict.INCONCLUSIVE, "nothing was solved"),
    ],
)
def test_a_night_is_as_good_as_its_worst_part(
    state: str, verdicts: tuple[Verdict, ...], verdict: Verdict, reason: str
) -> None:
    """One bad solution is enough, and a night that is not whole is never PASS."""
    found = night_verdict(state, solutions(*verdicts))
    assert found.verdict is verdict
    assert reason in found.reason
    assert night_verdict(state, solutions(*verdicts)[::-1]) == found  # whoever lists them


def test_of_several_units_it_is_said_how_many_are_as_bad_as_the_worst() -> None:
    """Of the measurement and of the limits alike."""
    judged = {"A": Judgement(Verdict.PASS, "x"), "B": Judgement(Verdict.FAIL, "y"), "C": Judgement(Verdict.FAIL, "z")}
    whole, unit = of_units(judged, {"A": {"verdict": "in spec", "reason": "x"}} | dict.fromkeys("BC", OUT))
    assert whole.reason == "2 units of 3; B: y"
    assert unit == {**OUT, "reason": "2 units of 3; B: one limit broken"}
