"""What a simulated unit can be told to do wrong, and when."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray


class ImuFault(StrEnum):
    """The ways in which a unit's stream and its index misbehave."""

    DROPPED_FRAMES = "dropped_frames"  # whole frames never arrive; the counter goes on
    FLIPPED_BITS = "flipped_bits"  # one bit of a frame is wrong
    GARBAGE = "garbage"  # a burst of random bytes stands before a frame
    DROPPED_BYTES = "dropped_bytes"  # one byte of a frame never arrives
    WRONG_COUNTER = "wrong_counter"  # the unit's counter is ahead of its frames by five
    REPEATED_FRAMES = "repeated_frames"  # a frame is sent twice
    STALL = "stall"  # the stream stops
    FROZEN = "frozen"  # every value stays as it is; counter and checksum go on
    SPIN_FAULT = "spin_fault"  # a rotor is not at speed, and the status says so
    EXCHANGED = "exchanged"  # another unit is there, with a serial number and a counter of its own
    SILENT_IDENTITY = "silent_identity"  # the identity is asked for in vain
    INDEX_REFUSED = "index_refused"  # an index command only sets the fault bit
    INDEX_NEVER_FINISHES = "index_never_finishes"  # an index move begins and does not end
    INDEX_WRONG_POSITION = "index_wrong_position"  # it arrives, but elsewhere
    INDEX_SLIPS = "index_slips"  # it says that it has arrived; the unit has not turned


@dataclass(frozen=True)
class FaultWindow:
    """One fault from `begins_s` up to `ends_s`; `probability` is per frame, of those that concern single frames."""

    fault: ImuFault
    begins_s: float = 0.0
    ends_s: float = math.inf
    probability: float = 1.0


class FaultPlan(list[FaultWindow]):
    """The faults of one device."""

    def active(self, fault: ImuFault, now_s: float) -> bool:
        """Tell whether `fault` is on at `now_s`."""
        return bool(self.during(fault, np.array([now_s]))[0])

    def during(
        self, fault: ImuFault, times_s: NDArray[np.float64], rng: np.random.Generator | None = None
    ) -> NDArray[np.bool_]:
        """Tell for each time whether `fault` is on, shape (n,); with `rng`, whether it strikes the frame sent then."""
        struck = np.zeros(len(times_s), np.bool_)
        for window in self:
            if window.fault == fault:
                on = (times_s >= window.begins_s) & (times_s < window.ends_s)
                struck |= on if rng is None else on & (rng.random(len(times_s)) < window.probability)
        return struck
