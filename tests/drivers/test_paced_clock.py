"""A clock that jumps, but no faster than it can be watched."""

from __future__ import annotations

import pytest

from drivers.clock import PacedClock, VirtualClock


def test_simulated_time_takes_its_share_of_real_time_however_it_is_cut_into_sleeps() -> None:
    """Ten hours at 3600 times real time take ten seconds, in hours or in tenths of a second."""
    for piece_s in (3600.0, 0.1):
        real = VirtualClock()
        clock = PacedClock(3600.0, real=real)
        for _ in range(round(36000.0 / piece_s)):
            clock.sleep(piece_s)
        assert clock.now() == pytest.approx(36000.0)
        assert real.now() == pytest.approx(10.0, abs=0.01)


def test_computing_costs_no_simulated_time_and_is_made_up_for_by_waiting_less() -> None:
    """Whatever the computer is busy with, the night is the same; it only may not be raced through afterwards."""
    real = VirtualClock()
    clock = PacedClock(100.0, real=real)
    for _ in range(20):
        clock.sleep(10.0)
        real.sleep(0.05)  # the program computes
    assert clock.now() == 200.0
    assert real.now() == pytest.approx(2.0, abs=0.06)
    real.sleep(60.0)
    clock.sleep(100.0)
    assert real.now() == pytest.approx(2.0 + 60.0 + 0.9, abs=0.2)


def test_a_speed_that_would_never_arrive_is_refused() -> None:
    """Nothing runs backwards or stands still."""
    for speed in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="speed must be positive"):
            PacedClock(speed)
