"""How a run of a sweep ends: its states, the outcome, and the reason in words."""

import errno
from dataclasses import dataclass, field
from enum import StrEnum

from drivers.errors import DeviceError
from procedures.interlocks import InterlockTripped
from procedures.safe_air import Left
from procedures.stop import StopRequested


class SweepState(StrEnum):
    """How a run of a sweep ended."""

    COMPLETE = "complete"  # every step of the plan is DONE in the journal
    INCOMPLETE = "incomplete"  # it ran to its end, but steps are missing
    ABORTED = "aborted"  # somebody asked for it
    FAILED = "failed"  # an interlock, or a device that stayed lost
    ERROR = "error"  # the software, the disk


@dataclass(frozen=True)
class SweepOutcome:
    """What became of a run: state, reason, what is missing, and how the chamber was left."""

    state: SweepState
    reason: str
    missing: tuple[str, ...] = ()  # keys of the steps that are not DONE
    partly: bool = False  # nothing is missing but of units that were set aside
    left: Left = field(default_factory=Left)  # the chamber
    error: BaseException | None = None  # for the log, where the state is failed or error


def state_after(cause: BaseException) -> SweepState:
    """Return the state in which a run ends for this cause."""
    if isinstance(cause, StopRequested):
        return SweepState.ABORTED
    if isinstance(cause, InterlockTripped | DeviceError):
        return SweepState.FAILED
    return SweepState.ERROR


def why(cause: BaseException | None) -> str:
    """Say in words what ended a run."""
    if cause is None:
        return ""
    if isinstance(cause, StopRequested | InterlockTripped | DeviceError):
        return str(cause)
    if "disk is full" in str(cause) or getattr(cause, "errno", None) == errno.ENOSPC:
        return f"the disk is full ({getattr(cause, 'strerror', None) or cause}): free some space, then carry on"
    if isinstance(cause, MemoryError):
        return "the computer is out of memory: end other programs, then carry on"
    return f"{type(cause).__name__}: {cause}"
