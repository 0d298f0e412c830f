"""A sweep is a list of steps: pure data, made once from the sweep file.

The same list is the dry run, the estimated finishing time, the run, the resume and the proof of completeness. Nothing
else decides what happens next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum


class StepKind(StrEnum):
    """What a step does."""

    IDENTIFY = "identify"  # ask the devices who they are, refuse the wrong ones
    SETPOINT = "setpoint"  # command the chamber
    RESTABILISE = "restabilise"  # wait for evidence that the unit is in thermal equilibrium
    INDEX = "index"  # bring the unit to a collect position
    COLLECT = "collect"  # settle, sample, average
    SAFE_STATE = "safe_state"  # leave the chamber as it may be left


@dataclass(frozen=True)
class Step:
    """One step. `key` is unique in a plan and never changes for the same sweep: it is the journal's key."""

    index: int
    key: str  # "T1/S2/restabilise", "T1/S2/C3/collect"
    kind: StepKind
    starts_s: float  # planned, from the beginning of the sweep
    duration_s: float  # planned
    temperature_degC: float | None = None
    self_calibration: int | None = None  # the campaign's `run`: 1, 2, … over the whole sweep
    position: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)  # seconds, °C and °C/min, named


@dataclass(frozen=True)
class Plan:
    """The steps of one sweep, in order."""

    title: str
    steps: Sequence[Step]

    @property
    def total_s(self) -> float:
        """Planned duration of the whole sweep."""
        last = self.steps[-1]
        return last.starts_s + last.duration_s
