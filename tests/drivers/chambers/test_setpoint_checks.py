"""What every chamber driver does once: limits, rounding, the order of writes, read-back, plausibility."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.chambers import ChamberLimits, SafeState
from drivers.chambers.setpoints import (
    NativeLimits,
    Settings,
    check_plausible,
    clamped,
    confirm_settings,
    refuse_fahrenheit,
    representable_setpoint,
    writes_in_order,
)
from drivers.clock import VirtualClock
from drivers.errors import ProtocolError, SensorFault, SetpointOutOfLimits, WrongDevice
from drivers.transports.transport import own_port
from tests.drivers.chambers.shipped import espec

LIMITS = ChamberLimits(-35.0, 65.0)


@pytest.mark.parametrize(
    ("wanted", "sent"), [(-29.7222, -29.7), (60.0, 60.0), (0.04, 0.0), (-0.04, 0.0), (-35.0, -35.0), (65.0, 65.0)]
)
def test_a_setpoint_is_rounded_to_what_the_controller_holds(wanted: float, sent: float) -> None:
    """-21.5 °F is -29.72 °C; the controller holds tenths. There is no minus zero on the wire."""
    value = representable_setpoint(wanted, LIMITS, 0.1)
    assert value == sent
    assert f"{value:.1f}" == f"{sent:.1f}"


@pytest.mark.parametrize("wanted", [65.001, -35.001, 9999.0, math.nan, math.inf, -math.inf])
def test_a_setpoint_outside_the_limits_is_refused(wanted: float) -> None:
    """Also where rounding would bring it inside, and where it is no number."""
    with pytest.raises(SetpointOutOfLimits, match="nothing was sent"):
        representable_setpoint(wanted, LIMITS, 0.1)


@pytest.mark.parametrize(("wanted", "sent"), [(59.97, 59.9), (-29.96, -29.9)])
def test_rounding_never_steps_over_a_limit(wanted: float, sent: float) -> None:
    """The nearest tenth would lie outside: the last tenth inside is taken."""
    assert representable_setpoint(wanted, ChamberLimits(-29.96, 59.97), 0.1) == sent


def test_limits_between_two_steps_hold_no_setpoint() -> None:
    """Where no representable value lies within the limits, that is said."""
    with pytest.raises(SetpointOutOfLimits, match="no setpoint in steps"):
        representable_setpoint(20.05, ChamberLimits(20.04, 20.06), 0.1)


@given(
    limits=st.tuples(st.floats(-100, 100), st.floats(0.2, 200)).map(lambda p: ChamberLimits(p[0], p[0] + p[1])),
    share=st.floats(0, 1),
)
def test_whatever_is_sent_lies_within_the_limits_and_near_what_was_wanted(limits: ChamberLimits, share: float) -> None:
    """For any limits and any setpoint within them."""
    wanted = clamped(limits.low_degC + share * (limits.high_degC - limits.low_degC), limits)
    sent = float(f"{representable_setpoint(wanted, limits, 0.1):.1f}")
    assert limits.low_degC - 1e-6 <= sent <= limits.high_degC + 1e-6
    assert abs(sent - wanted) <= 0.1 + 1e-6


def test_limits_are_widened_before_and_tightened_after_the_setpoint() -> None:
    """From a hot test with wide limits to a cold one: high limit last, low limit first."""
    writes = writes_in_order(Settings(0.0, 85.0, 105.0), Settings(-40.0, -29.7, 70.0), 0.1)
    assert writes == [("low", -40.0), ("setpoint", -29.7), ("high", 70.0)]


def test_what_already_agrees_is_not_written() -> None:
    """Controllers keep settings in memory that wears."""
    present = Settings(-40.0, 25.0, 70.0)
    assert writes_in_order(present, present, 0.1) == []
    assert writes_in_order(present, Settings(-40.0, 25.04, 70.0), 0.1) == []


def test_a_setpoint_beyond_the_native_limits_is_refused() -> None:
    """A wanted state that contradicts itself is never begun."""
    with pytest.raises(SetpointOutOfLimits):
        writes_in_order(Settings(-40.0, 25.0, 70.0), Settings(-40.0, 75.0, 70.0), 0.1)


def _settings() -> st.SearchStrategy[Settings]:
    tenths = st.integers(-800, 1800).map(lambda n: n / 10)
    return st.tuples(tenths, tenths, tenths).map(lambda t: Settings(*sorted(t)))


@given(present=_settings(), wanted=_settings())
def test_at_no_moment_does_the_setpoint_lie_outside_the_native_limits(present: Settings, wanted: Settings) -> None:
    """Whatever the two states, every intermediate one is legal, and the last is the wanted one."""
    state = present._asdict()
    for which, value in writes_in_order(present, wanted, 0.1):
        state[which] = value
        assert state["low"] <= state["setpoint"] <= state["high"]
    assert state == wanted._asdict()


def test_read_back_must_agree_within_half_a_step() -> None:
    """0.05 °C off is the controller's rounding; 0.1 °C off is another setpoint."""
    wanted = Settings(-40.0, 25.0, 70.0)
    confirm_settings(Settings(-40.0, 25.05, 70.0), wanted, 0.1, "chamber")
    with pytest.raises(ProtocolError, match=r"chamber reads back setpoint 25\.1 °C instead of 25 °C"):
        confirm_settings(Settings(-40.0, 25.1, 70.0), wanted, 0.1, "chamber")
    with pytest.raises(ProtocolError, match=r"low limit -41 °C .* high limit 105 °C"):
        confirm_settings(Settings(-41.0, 25.0, 105.0), wanted, 0.1, "chamber")


def test_a_native_limit_is_never_drawn_through_the_air() -> None:
    """It would raise an alarm at once; a sensor that cannot be believed moves no limit."""
    controller = espec(own_port("own://chamber", VirtualClock()), VirtualClock())
    native = NativeLimits(controller, ChamberLimits(30.0, 65.0), 5.0)
    assert native.around(45.0, 45.0) == (25.0, 45.0, 70.0)
    assert native.around(45.0, 22.04) == (17.0, 45.0, 70.0)
    assert native.around(45.0, 80.0) == (25.0, 45.0, 85.0)
    for broken in (math.nan, 9999.0, -3276.8):
        assert native.around(45.0, broken) == (25.0, 45.0, 70.0)


@pytest.mark.parametrize("reading", [math.nan, math.inf, -3276.8, 850.0, 9999.0, -199.9])
def test_a_reading_of_a_broken_sensor_is_a_sensor_fault(reading: float) -> None:
    """Values that broken sensors and open inputs give."""
    with pytest.raises(SensorFault, match="sensor"):
        check_plausible(reading, "chamber")


def test_readings_that_a_chamber_can_reach_are_plausible() -> None:
    """Nothing within a chamber's range is called a fault."""
    for reading in (-75.0, 0.0, 185.0):
        check_plausible(reading, "chamber")


def test_an_idle_chamber_that_reads_a_room_in_fahrenheit_is_refused() -> None:
    """72 on an idle chamber is a room at 22 °C if the controller speaks °F."""
    with pytest.raises(WrongDevice, match="22 °C"):
        refuse_fahrenheit(72.0, idle=True, chamber_maximum=None, device="chamber")
    refuse_fahrenheit(72.0, idle=False, chamber_maximum=180.0, device="chamber")
    refuse_fahrenheit(22.0, idle=True, chamber_maximum=180.0, device="chamber")
    refuse_fahrenheit(-20.0, idle=True, chamber_maximum=None, device="chamber")


def test_a_chamber_that_says_it_reaches_356_speaks_fahrenheit() -> None:
    """180 °C is 356 °F, which no climatic chamber reaches in °C."""
    with pytest.raises(WrongDevice, match="reaches 356"):
        refuse_fahrenheit(22.0, idle=False, chamber_maximum=356.0, device="chamber")


def test_a_safe_state_says_what_it_needs() -> None:
    """A held temperature belongs to hold, and to nothing else."""
    assert SafeState("hold", 25.0).temperature_degC == 25.0
    for action, temperature in (("hold", None), ("off", 25.0), ("standby", 25.0), ("sleep", None)):
        with pytest.raises(ValueError, match="safe state"):
            SafeState(action, temperature)  # type: ignore[arg-type]
