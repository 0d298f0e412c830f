"""A controller's own timer is renewed in time, however often or seldom it is looked at, and not at every look."""

from __future__ import annotations

import pytest

from drivers.chambers.guards import DeadMan
from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, DeviceTimeout

SECONDS = 3600.0


class Timer:
    """A controller with nothing but a timer; it keeps when it was armed."""

    device = "timer"
    exists = True
    deaf = False

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.armed_s: list[float] = []

    def arm_dead_man(self, seconds: float) -> bool:
        """Begin the time anew."""
        assert seconds == SECONDS
        if self.deaf:
            raise DeviceTimeout("timer: no answer")
        if self.exists:
            self.armed_s.append(self.clock.now())
        return self.exists


@pytest.fixture
def timer() -> Timer:
    """A timer on a clock that jumps."""
    return Timer(VirtualClock())


def dead_man(timer: Timer, seconds: float | None = SECONDS) -> DeadMan:
    """What keeps it from running out."""
    return DeadMan(timer, timer.clock, seconds)  # type: ignore[arg-type]


@pytest.mark.parametrize("every_s", [5.0, 60.0, 899.0, 900.0, 901.0, 1700.0, 3000.0])
def test_it_never_runs_out_while_somebody_looks(timer: Timer, every_s: float) -> None:
    """Whatever the interval between two looks, as long as it is shorter than the time itself."""
    looked_after = dead_man(timer)
    looked_after.arm()
    while timer.clock.now() < 12 * SECONDS:
        timer.clock.sleep(every_s)
        looked_after.renew()
        assert timer.clock.now() - timer.armed_s[-1] < SECONDS
    gaps_s = [after - before for before, after in zip(timer.armed_s, timer.armed_s[1:], strict=False)]
    assert max(gaps_s) < max(SECONDS / 4.0, every_s) + every_s


def test_it_is_not_renewed_at_every_look(timer: Timer) -> None:
    """A controller's memory wears out: once in a quarter of the time, and exactly then."""
    looked_after = dead_man(timer)
    looked_after.arm()
    for _ in range(int(SECONDS)):
        timer.clock.sleep(1.0)
        looked_after.renew()
    assert timer.armed_s == pytest.approx([0.0, 900.0, 1800.0, 2700.0, 3600.0])


def test_a_renewal_that_failed_is_tried_again_at_the_next_look(timer: Timer) -> None:
    """Three quarters of the time are left for it."""
    looked_after = dead_man(timer)
    looked_after.arm()
    timer.clock.sleep(1000.0)
    timer.deaf = True
    with pytest.raises(DeviceTimeout):
        looked_after.renew()
    timer.deaf = False
    timer.clock.sleep(5.0)
    looked_after.renew()
    assert timer.armed_s == pytest.approx([0.0, 1005.0])


def test_what_was_not_armed_or_rests_is_not_renewed(timer: Timer) -> None:
    """Somebody who only looks must not bring a timer to life, and the safe state lets it run out."""
    looked_after = dead_man(timer)
    timer.clock.sleep(SECONDS)
    looked_after.renew()
    assert timer.armed_s == []
    looked_after.arm()
    looked_after.rest()
    timer.clock.sleep(SECONDS)
    looked_after.renew()
    assert len(timer.armed_s) == 1


def test_a_bench_without_one_arms_nothing_and_a_controller_without_one_is_refused(timer: Timer) -> None:
    """Nobody is told that a timer runs which does not exist."""
    without = dead_man(timer, None)
    without.arm()
    without.renew()
    assert timer.armed_s == []
    timer.exists = False
    with pytest.raises(CommandRefused, match="has no timer of its own"):
        dead_man(timer).arm()
