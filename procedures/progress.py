"""What an onlooker may see of a running sweep; one that raises is dropped, and the sweep goes on."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime

from drivers.frames.counts import StreamCounts
from procedures.journal_protocol import StepResult
from procedures.plan import Plan, Step


@dataclass(frozen=True)
class Snapshot:
    """The state of a sweep at one poll. Times are campaign seconds; temperatures °C; rates deg/hr.

    Rates are keyed by sensor and channel, "2.RA". `rates_deg_per_hr` and `rates_se_deg_per_hr` belong to a collect that
    is being taken, and are empty otherwise.
    """

    step: Step
    attempt: int
    elapsed_s: float
    step_elapsed_s: float
    step_remaining_s: float  # planned, never below zero
    finishing_utc: datetime  # expected end of the sweep
    chamber_degC: float | None
    setpoint_degC: float | None
    unit_degC: Mapping[int, float] = field(default_factory=dict)
    rates_deg_per_hr: Mapping[str, float] = field(default_factory=dict)  # running means
    rates_se_deg_per_hr: Mapping[str, float] = field(default_factory=dict)  # of the running means, from the third poll
    rates_now_deg_per_hr: Mapping[str, float] = field(default_factory=dict)  # means of what arrived with this poll
    stream: StreamCounts = field(default_factory=StreamCounts)  # since this run began
    stream_hz: float | None = None  # good samples per second, since the last snapshot
    stream_nominal_hz: float | None = None
    chamber_age_s: float | None = None  # since the chamber answered
    note: str = ""  # what the step waits for
    steps_done: int = 0
    steps_total: int = 0
    unit: str = ""  # of several in one chamber each has its own


class Progress:
    """An onlooker; what it does not see it ignores. As it stands, nobody looks."""

    def sweep_began(self, plan: Plan, done: frozenset[str]) -> None:
        """See the plan, and the keys of the steps that were completed before."""

    def step_began(self, step: Step, attempt: int) -> None:
        """See a step begin."""

    def update(self, snapshot: Snapshot) -> None:
        """See the state at a poll."""

    def step_ended(self, step: Step, result: StepResult) -> None:
        """See how a step ended."""

    def event(self, kind: str, message: str, at_s: float) -> None:
        """See what goes into the journal as an event, at campaign seconds: a retry, an interlock, the safe state."""
