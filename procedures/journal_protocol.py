"""What the sequencer needs of a journal. The durable one is in `hil/records/journal.py`; a list will do in a test."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Protocol

from procedures.plan import Step

if TYPE_CHECKING:  # who only looks on loads no arithmetic
    from drivers.imu import SampleBlock


class Outcome(StrEnum):
    """How a step ended. Only DONE counts as completed."""

    DONE = "DONE"
    FAILED = "FAILED"  # the criterion was not met, and waiting longer would not help
    ERROR = "ERROR"  # a device or the software failed
    TIMEOUT = "TIMEOUT"
    ABORTED = "ABORTED"  # somebody asked for it


@dataclass(frozen=True)
class StepResult:
    """What a step leaves behind: the outcome, its reason in words, and data that JSON can hold."""

    outcome: Outcome
    reason: str = ""
    data: Mapping[str, Any] = field(default_factory=dict)
    samples: "SampleBlock | None" = None  # a collect's samples and raw bytes


Ended = tuple[Step, int, StepResult]
"""How an attempt at a step ended: the step, the attempt's number, its result."""


def of_unit(data: Mapping[str, Any], unit: str) -> Mapping[str, Any]:
    """Return the data of a chamber's step as they are for one unit: what is told of it (`units`) laid over the rest."""
    own = data.get("units", {}).get(unit)
    return data if own is None else {**data, **own}


class Journal(Protocol):
    """The truth about a night. Every call is durable when it returns."""

    def completed(self) -> Mapping[str, StepResult]:
        """Return the results of the steps that are DONE, by step key (without samples)."""

    def begin(self, *steps: Step) -> Sequence[int]:
        """Record that steps begin, at once; return the number of each one's attempt, 1 for the first."""

    def end(self, *ended: Ended) -> None:
        """Commit results, with their samples, all of them or none, before anything else begins."""

    def event(self, kind: str, message: str, **evidence: Any) -> None:
        """Record something that happened: a retry, an alarm, a hold, a signal, a resumption."""

    def heartbeat(self, step: Step, readings: Mapping[str, float]) -> None:
        """Record that the controller is alive, what it is doing and the latest readings (at most once a minute)."""
