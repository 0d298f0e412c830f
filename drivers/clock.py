"""The one clock. Nothing else in the project asks the operating system for the time or sleeps.

A bench has a `SystemClock`. A simulated night has a `VirtualClock`, which jumps: sleeping costs nothing, so twenty
hours of soaking pass in seconds through the same code.

    >>> clock = VirtualClock()
    >>> clock.sleep(45 * 60.0)
    >>> clock.now()  # at once
    2700.0
"""

import time
from datetime import UTC, datetime, timedelta
from typing import Protocol

SIMULATED_EPOCH = datetime(1985, 10, 1, 17, 0, tzinfo=UTC)
"""When a simulated night begins: a fixed instant, so that it is reproducible to the byte."""

_WORTH_WAITING_S, _MADE_UP_FOR_S = 0.005, 0.1  # of real time


class Clock(Protocol):
    """Monotonic seconds, wall time and sleep; injected everywhere that time matters."""

    def now(self) -> float:
        """Return monotonic seconds since this clock was made."""

    def utc(self) -> datetime:
        """Return the wall time, timezone-aware, in UTC."""

    def sleep(self, seconds: float) -> None:
        """Let `seconds` pass (none where negative)."""


_STEADY = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # which goes on while the computer is suspended


class SystemClock:
    """The bench's `Clock`: the operating system's monotonic and wall clocks; a computer that sleeps is no exception."""

    def __init__(self) -> None:
        self._origin = time.clock_gettime(_STEADY)

    def now(self) -> float:
        return time.clock_gettime(_STEADY) - self._origin

    def utc(self) -> datetime:
        return datetime.now(UTC)

    def sleep(self, seconds: float) -> None:
        if seconds > 0:
            time.sleep(seconds)


class VirtualClock:
    """A `Clock` that jumps: sleeping advances it at once. `start` is the wall time at which it begins."""

    def __init__(self, start: datetime = SIMULATED_EPOCH, now_s: float = 0.0) -> None:
        self._start = start
        self._now = now_s
        self.wall_jumps: list[tuple[float, float]] = []
        """When somebody sets the wall clock, and by how much, s; `now` goes on as ever."""

    def now(self) -> float:
        return self._now

    def utc(self) -> datetime:
        jumped_s = sum(by_s for at_s, by_s in self.wall_jumps if at_s <= self._now)
        return self._start + timedelta(seconds=self._now + jumped_s)

    def sleep(self, seconds: float) -> None:
        if seconds > 0:
            self._now += seconds


class PacedClock(VirtualClock):
    """A virtual clock that jumps no faster than `speed` times real time, so that a simulated night can be watched.

    Only sleeping takes real time; what the program computes in between costs none of the simulated, as under every
    virtual clock, so that the night is the same to the byte at any speed. Where the computing itself is slower than
    `speed` allows, nothing is waited for. `real` is what is slept on. Raises `ValueError` for a `speed` of 0 or less.
    """

    def __init__(self, speed: float, start: datetime = SIMULATED_EPOCH, real: Clock | None = None) -> None:
        if not speed > 0.0:
            raise ValueError(f"speed must be positive, not {speed:g}")
        super().__init__(start)
        self.speed = speed
        self._real = real or SystemClock()
        self._due_s = self._real.now()

    def sleep(self, seconds: float) -> None:
        """Jump forward by `seconds`, `seconds / speed` of real time after the last jump was due."""
        super().sleep(seconds)
        now_s = self._real.now()
        # What is later than this stays late, so that what was computed slowly is not made up for by a race.
        self._due_s = max(self._due_s, now_s - _MADE_UP_FOR_S) + max(seconds, 0.0) / self.speed
        if self._due_s - now_s > _WORTH_WAITING_S:
            self._real.sleep(self._due_s - now_s)
