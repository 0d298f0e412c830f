"""The acceptance suite: unit, stream, positions and chamber answer as the bench file says, and stay within its limits.

    pytest --pyargs hil.acceptance --hil-bench my-bench.yaml

It commands the chamber by a degree or two about its present temperature, and the unit through every position.
"""

from __future__ import annotations

import pytest

from drivers.chambers.setpoints import clamped
from drivers.errors import SetpointOutOfLimits
from drivers.frames.counts import StreamCounts
from hil.bench import LiveBench

pytestmark = pytest.mark.hardware

_LISTEN_S = 2.0
_MOVE_TIMEOUT_S = 600.0


def _listen(live: LiveBench, seconds: float = _LISTEN_S) -> tuple[float, StreamCounts]:
    """Return samples per second and the counts of a stretch of the stream."""
    imu, clock = live.devices.imu, live.devices.clock
    imu.discard()
    begins_s, samples, counts = clock.now(), 0, StreamCounts()
    while clock.now() - begins_s < seconds:
        clock.sleep(0.1)
        block = imu.read_block()
        samples += len(block)
        counts += block.counts
    return samples / (clock.now() - begins_s), counts


def test_the_unit_is_the_one_of_the_bench_file(live_bench: LiveBench) -> None:
    """Model and serial number, where the unit says them."""
    found = live_bench.devices.imu.identify()
    assert found.serial in ("", live_bench.bench.unit.serial)


def test_frames_arrive_at_the_expected_rate_with_none_bad(live_bench: LiveBench) -> None:
    """Two seconds: no wrong checksum, nothing lost."""
    rate_hz, counts = _listen(live_bench)
    assert rate_hz == pytest.approx(live_bench.devices.imu.sample_rate_hz, rel=0.05, abs=1.0)
    assert (counts.bad_checksum, counts.bad_delimiter, counts.lost) == (0, 0, 0)


def test_every_position_is_reached_and_confirmed(live_bench: LiveBench) -> None:
    """In the order of the bench file, and back to the first."""
    positions = [*live_bench.bench.positions, live_bench.bench.positions[0]]
    for position in positions:
        live_bench.devices.positioner.move_to(position, timeout_s=_MOVE_TIMEOUT_S)
        assert live_bench.devices.positioner.position() == position


def test_the_chamber_is_the_one_of_the_bench_file_and_speaks_celsius(live_bench: LiveBench) -> None:
    """Nothing is written before this has passed."""
    assert live_bench.devices.chamber.identify().unit == "degC"


def test_the_chamber_reads_a_temperature_and_no_alarm(live_bench: LiveBench) -> None:
    """A plausible one, without an alarm."""
    assert live_bench.devices.chamber.read().alarms == ()


def test_a_setpoint_outside_the_limits_is_refused(live_bench: LiveBench) -> None:
    """Above and below, before anything is sent."""
    chamber = live_bench.devices.chamber
    for outside in (chamber.limits.low_degC - 1.0, chamber.limits.high_degC + 1.0):
        with pytest.raises(SetpointOutOfLimits):
            chamber.set_temperature(outside)


def test_a_setpoint_is_taken_and_read_back(live_bench: LiveBench) -> None:
    """A degree beside the present temperature, and back."""
    chamber = live_bench.devices.chamber
    chamber.prepare()
    present = chamber.read().temperature_degC
    for wanted in (clamped(present + 1.0, chamber.limits), clamped(present, chamber.limits)):
        chamber.set_temperature(wanted)
        assert chamber.read().setpoint_degC == pytest.approx(wanted, abs=0.06)
    assert chamber.read().mode == "CONSTANT"


def test_the_safe_state_is_reached_and_confirmed(live_bench: LiveBench) -> None:
    """As the bench file defines it; twice is allowed."""
    chamber, safe = live_bench.devices.chamber, live_bench.bench.chamber.safe_state
    chamber.safe_state()
    chamber.safe_state()
    reading = chamber.read()
    if safe.temperature_degC is not None:
        assert reading.setpoint_degC == pytest.approx(safe.temperature_degC, abs=0.06)
    else:
        assert reading.mode in ("STANDBY", "OFF")
