"""Four verdicts with their reasons, and how they combine.

    PASS          the evidence is complete and within limits
    MARGINAL      usable, but something deserves a look
    INCONCLUSIVE  the evidence is not enough to say
    FAIL          the evidence says that this is not a measurement of a stationary unit

A run that ends early has no verdict; it has an outcome (ERROR, TIMEOUT, ABORTED).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

from procedures.journal_protocol import StepResult
from procedures.plan import Step, StepKind
from procedures.words import hours_minutes

_APART = 2.0  # collects further apart than this many times the plan were interrupted
_APART_S = 300.0


class Verdict(StrEnum):
    """Whether a result is good, from best to worst."""

    PASS = "PASS"  # noqa: S105 - a verdict, not a secret
    MARGINAL = "MARGINAL"
    INCONCLUSIVE = "INCONCLUSIVE"
    FAIL = "FAIL"


NOT_GOOD = (Verdict.FAIL, Verdict.INCONCLUSIVE)
"""Of a measurement that tells nothing of the unit."""


@dataclass(frozen=True)
class Judgement:
    """A verdict and why, in words for a technician."""

    verdict: Verdict
    reason: str

    @property
    def severity(self) -> int:
        """0 for PASS, up to 3 for FAIL."""
        return list(Verdict).index(self.verdict)


def combine(judgements: Iterable[Judgement], passed: str = "all criteria met") -> Judgement:
    """Return the worst verdict, with the reasons of everything that did not pass (worst first)."""
    worrying = sorted(
        (each for each in judgements if each.verdict is not Verdict.PASS), key=lambda each: -each.severity
    )
    if not worrying:
        return Judgement(Verdict.PASS, passed)
    reasons = dict.fromkeys(each.reason for each in worrying)
    return Judgement(worrying[0].verdict, "; ".join(reasons))


def self_calibration_verdict(steps: Iterable[Step], results: Mapping[str, StepResult]) -> Judgement:
    """Return the verdict on one self-calibration from its steps and the journal's completed results, by step key.

    INCONCLUSIVE where a step is missing; otherwise the worst of restabilisation and collects. Collects that stand much
    further apart than planned (an interruption between them) make it MARGINAL at best: a slow drift between collects
    looks like an acceleration sensitivity (RD-GC-86-1's equations take the three as simultaneous).
    """
    steps = [step for step in steps if step.kind in (StepKind.RESTABILISE, StepKind.COLLECT)]
    alike: dict[Judgement, list[str]] = {}
    for step in steps:
        alike.setdefault(_of_step(results.get(step.key)), []).append(_name(step))
    judgements = [Judgement(each.verdict, f"{', '.join(names)}: {each.reason}") for each, names in alike.items()]
    collects = [step for step in steps if step.kind is StepKind.COLLECT]
    judgements += _apart(collects, results)
    return combine(judgements, passed="restabilised, and every collect was stationary and complete")


def _name(step: Step) -> str:
    return "restabilisation" if step.kind is StepKind.RESTABILISE else f"collect at position {step.position}"


def _of_step(result: StepResult | None) -> Judgement:
    if result is None:
        return Judgement(Verdict.INCONCLUSIVE, "missing")
    verdict = Verdict(result.data.get("verdict", Verdict.INCONCLUSIVE))
    return Judgement(verdict, result.data.get("reason") or "no verdict recorded")


def _apart(collects: list[Step], results: Mapping[str, StepResult]) -> Iterable[Judgement]:
    for before, after in pairwise(collects):
        if before.key not in results or after.key not in results:
            continue
        planned_s = after.starts_s - before.starts_s
        actual_s = float(results[after.key].data["start_s"]) - float(results[before.key].data["start_s"])
        if actual_s > _APART * planned_s + _APART_S:
            pair = f"collects at positions {before.position} and {after.position}"
            apart = f"{hours_minutes(actual_s)} apart, {hours_minutes(planned_s)} were planned"
            yield Judgement(Verdict.MARGINAL, f"{pair} are {apart}")
