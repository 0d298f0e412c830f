"""The one clock. Nothing else in the project asks the operating system for the time or sleeps.

A bench has a `SystemClock`. A simulated night has a `VirtualClock`, which jumps: sleeping costs nothing, so twenty
hours of soaking pass in seconds through the same code.

    clock = VirtualClock()
    clock.sleep(45 * 60.0)
    clock.now()  # 2700.0, at once
"""

from __future__ import annotations

import time
from datetime import UTC, datetime, timedelta
from typing import Protocol

_SIMULATED_EPOCH = datetime(1985, 10, 1, 17, 0, tzinfo=UTC)


class Clock(Protocol):
    """Monotonic seconds, wall time and sleep; injected everywhere that time matters."""

    def now(self) -> float:
        """Return monotonic seconds since this clock was made."""

    def utc(self) -> datetime:
        """Return the wall time, timezone-aware, in UTC."""

    def sleep(self, seconds: float) -> None:
        """Let `seconds` pass (none where negative)."""


class SystemClock:
    """The bench's clock: the operating system's monotonic and wall clocks."""

    def __init__(self) -> None:
        self._origin = time.monotonic()

    def now(self) -> float:
        """Return monotonic seconds since this clock was made."""
        return time.monotonic() - self._origin

    def utc(self) -> datetime:
        """Return the wall time, timezone-aware, in UTC."""
        return datetime.now(UTC)

    def sleep(self, seconds: float) -> None:
        """Let `seconds` pass."""
        if seconds > 0:
            time.sleep(seconds)


class VirtualClock:
    """A clock that jumps: sleeping advances it at once.

    `start` is the wall time at which it begins; the default is a fixed instant so that a simulated night is
    reproducible to the byte.
    """

    def __init__(self, start: datetime = _SIMULATED_EPOCH, now_s: float = 0.0) -> None:
        self._start = start
        self._now = now_s

    def now(self) -> float:
        """Return seconds since this clock was made."""
        return self._now

    def utc(self) -> datetime:
        """Return the simulated wall time."""
        return self._start + timedelta(seconds=self._now)

    def sleep(self, seconds: float) -> None:
        """Jump forward by `seconds`."""
        if seconds > 0:
            self._now += seconds
