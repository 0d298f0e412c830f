"""Samples are placed on the bench's clock by counter and arrival."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.imu.stream import SampleClock


def test_late_arrivals_do_not_move_the_samples() -> None:
    """The operating system may be late by 100 ms; the samples stay evenly spaced on the clock, within the drift."""
    rng, clock = np.random.default_rng(5), SampleClock(100.0, 65536)
    for second in range(600):
        sequence = np.arange(100 * second, 100 * (second + 1))
        late_s = 0.0 if second == 0 else float(rng.uniform(0.0, 0.1))
        times_s, correction = clock.stamp(sequence, (100 * second + 99) / 100 + late_s)
        assert correction == 0
        assert np.diff(times_s) == pytest.approx(0.01)
        assert times_s == pytest.approx(sequence / 100, abs=0.015)


def test_a_first_block_that_arrived_late_is_corrected_and_time_never_goes_back() -> None:
    """The first arrival was 0.3 s late; the next ones show it, and half a period is made up in each."""
    clock = SampleClock(10.0, 256)
    blocks = [clock.stamp(np.arange(5), 0.4 + 0.3)[0]]
    blocks += [clock.stamp(np.arange(at, at + 5), (at + 4) / 10)[0] for at in range(5, 50, 5)]
    assert blocks[0] == pytest.approx(np.arange(5) / 10 + 0.3)
    assert blocks[-1] == pytest.approx(np.arange(45, 50) / 10)
    assert (np.diff(np.concatenate(blocks)) > 0.049).all()


def test_an_outage_of_whole_turns_is_found_by_the_clock() -> None:
    """A 7-bit counter at 1 kHz comes round every 128 ms; one second and a bit was lost."""
    clock = SampleClock(1000.0, 128)
    clock.stamp(np.arange(100), 0.099)
    sequence = np.arange(100, 200) + (1100 % 128)  # what the counter shows of 1100 lost frames
    times_s, correction = clock.stamp(sequence, 1.299)
    assert correction == 1100 - 1100 % 128
    assert times_s == pytest.approx(np.arange(1200, 1300) / 1000)


def test_frames_before_an_outage_within_one_read_stay_where_they_were() -> None:
    """Only those after the widest gap move."""
    clock = SampleClock(10.0, 256)
    clock.stamp(np.arange(10), 0.9)
    times_s, correction = clock.stamp(np.concatenate([np.arange(10, 20), np.arange(30, 40)]), 3.9 + 25.6)
    assert correction == 256
    assert times_s[:10] == pytest.approx(np.arange(10, 20) / 10, abs=0.01)
    assert times_s[10:] == pytest.approx(np.arange(30, 40) / 10 + 25.6, abs=0.01)


def test_a_counter_that_began_anew_is_not_a_leap_ahead() -> None:
    """What the counter seems to have skipped is taken back."""
    clock = SampleClock(20.0, 65536)
    clock.stamp(np.arange(1000), 999 / 20)
    times_s, correction = clock.stamp(np.arange(65536, 65556), 80.0)
    assert times_s[-1] == pytest.approx(80.0)
    lost = 65536 - 1000 + correction
    assert lost == pytest.approx((80.0 - 999 / 20) * 20 - 20, abs=1)


def test_without_a_counter_an_outage_shows_in_the_arrival() -> None:
    """The frames after it are placed by the clock; how many were lost is not claimed."""
    clock = SampleClock(10.0, None)
    clock.stamp(np.arange(10), 0.9)
    times_s, correction = clock.stamp(np.arange(10, 20), 31.9)
    assert correction == 0
    assert times_s == pytest.approx(np.arange(310, 320) / 10, abs=0.01)


@pytest.mark.parametrize(("sent_hz", "placed_hz"), [(100.0, 100.0), (103.0, 100.0), (50.0, 50.0), (200.0, 200.0)])
def test_a_unit_at_another_rate_is_followed_and_an_oscillator_that_is_off_is_not(
    sent_hz: float, placed_hz: float
) -> None:
    """After two looks of 20 s the samples are as far apart as they are sent; within 4 % the description is believed."""
    clock, number = SampleClock(100.0, 65536), 0
    for second in range(1, 90):
        many = int(sent_hz)
        times_s, _ = clock.stamp(np.arange(number, number + many), float(second))
        number += many
    assert np.diff(times_s) == pytest.approx(1.0 / placed_hz, rel=1e-3)
    assert times_s[-1] == pytest.approx(89.0, abs=2.5)
