"""The acceptance suite: unit, stream, positions and chamber answer as the bench file says, and stay within its limits.

    pytest --pyargs hil.acceptance --hil-bench my-bench.yaml

It commands the chamber by a degree or two about its present temperature, and the unit through every position.
"""

import pytest

from drivers.chambers.setpoints import clamped
from drivers.errors import SetpointOutOfLimits
from hil.bench import LiveBench
from hil.bench.preflight import look_at_devices

pytestmark = pytest.mark.hardware

_MOVE_TIMEOUT_S = 600.0


def test_hil_check_calls_nothing_of_unit_stream_and_chamber_not(live_bench: LiveBench) -> None:
    """Who they are, frames whole and in time, rates and pose at rest, air, alarms. Nothing has been written yet."""
    assert [each for each in look_at_devices(live_bench) if not each.good] == []


def test_every_position_is_reached_and_confirmed(live_bench: LiveBench) -> None:
    """In the order of the bench file, and back to the first."""
    positions = [*live_bench.bench.positions, live_bench.bench.positions[0]]
    for position in positions:
        live_bench.devices.positioner.move_to(position, timeout_s=_MOVE_TIMEOUT_S)
        assert live_bench.devices.positioner.position() == position


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
