"""What every chamber driver must do, held to its simulator: a night's work, and each way in which it is disturbed."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import pytest

from drivers.chambers import CHAMBER_DRIVERS, ChamberLimits, SafeState
from drivers.errors import (
    CommandRefused,
    DeviceError,
    DeviceTimeout,
    ProtocolError,
    SensorFault,
    SetpointOutOfLimits,
    TransportError,
    WrongDevice,
)
from drivers.simulators.chambers.catalogue import CHAMBER_SIMULATORS
from drivers.simulators.chambers.controller import ChamberFaultKind
from tests.drivers.chambers.chamber_benches import HOLD, KINDS, LIMITS, ChamberBench
from tests.drivers.pairs import every_pair

every_chamber = pytest.mark.parametrize("name", KINDS)
SAFE_STATES = [HOLD, SafeState("standby"), SafeState("off")]
Fault = ChamberFaultKind


def test_no_driver_and_no_simulator_is_left_out() -> None:
    """Both registries and these tests name the same chambers."""
    assert set(KINDS) == set(CHAMBER_DRIVERS) == set(CHAMBER_SIMULATORS)


@every_chamber
def test_a_setpoint_is_reached_with_all_pauses_kept(name: str) -> None:
    """Identify, prepare, set, wait, read: nothing was sent too early, and native limits are in force."""
    bench = ChamberBench(name, setpoint_degC=85.0)
    assert bench.chamber.identify().unit == "degC"
    bench.chamber.prepare()
    bench.chamber.set_temperature(-29.7222)
    bench.clock.sleep(3600.0)
    reading = bench.chamber.read()
    assert reading.temperature_degC == pytest.approx(-29.7, abs=0.1)
    assert reading.setpoint_degC == pytest.approx(-29.7)
    assert (reading.mode, reading.alarms) == ("CONSTANT", ())
    if bench.kind.native_limits:
        assert (reading.low_limit_degC, reading.high_limit_degC) == (-40.0, 70.0)
    assert bench.device.ignored_requests == 0
    assert bench.chamber.limits == LIMITS


@every_chamber
def test_a_forgotten_setpoint_is_never_driven_to(name: str) -> None:
    """What somebody left at 85 °C starts at the present temperature."""
    bench = ChamberBench(name, setpoint_degC=85.0)
    bench.chamber.prepare()
    assert bench.device.setpoint_degC == pytest.approx(22.0)
    assert bench.plant.commanded_degC == pytest.approx(22.0)


@every_chamber
def test_a_chamber_that_holds_a_legal_setpoint_keeps_it(name: str) -> None:
    """After a crash of the program the soak may still be good."""
    bench = ChamberBench(name, mode="CONSTANT", setpoint_degC=45.0, celsius_confirmed=True)
    bench.chamber.prepare()
    assert bench.device.setpoint_degC == 45.0
    assert not bench.setpoints or set(bench.setpoints) == {45.0}


@every_chamber
@pytest.mark.parametrize("wanted", [-35.06, 65.04, 900.0, float("nan"), float("inf")])
def test_a_setpoint_outside_the_limits_sends_nothing(name: str, wanted: float) -> None:
    """Not even a question."""
    bench = ChamberBench(name)
    with pytest.raises(SetpointOutOfLimits):
        bench.chamber.set_temperature(wanted)
    assert bench.wire.sent == b""


@every_chamber
def test_a_safe_state_outside_the_limits_is_refused_at_once(name: str) -> None:
    """Not at three in the morning, when it is needed."""
    with pytest.raises(SetpointOutOfLimits):
        ChamberBench(name, safe=SafeState("hold", 90.0))


@every_chamber
def test_another_model_is_refused_before_anything_is_written(name: str) -> None:
    """Port, who answered, and whom the bench file expects."""
    bench = ChamberBench(name, expected_model="X-99")
    with pytest.raises(WrongDevice, match=r"sim://chamber says it is .*, the bench file expects 'X-99'"):
        bench.chamber.prepare()
    assert bench.setpoints == []


@every_chamber
@pytest.mark.parametrize("kind", [Fault.DEAF, Fault.SILENCE, Fault.GARBAGE, Fault.TRUNCATED])
def test_disturbed_answers_do_not_end_the_night(name: str, kind: ChamberFaultKind) -> None:
    """A read is asked again, whatever became of its first two answers."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.fault(kind, command=bench.kind.read, times=2)
    assert bench.chamber.read().mode == "CONSTANT"


@every_chamber
@pytest.mark.parametrize("kind", [Fault.SILENCE, Fault.GARBAGE, Fault.TRUNCATED])
def test_a_write_without_a_good_reply_is_sent_once(name: str, kind: ChamberFaultKind) -> None:
    """Reading back shows that it holds."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.fault(kind, command=bench.kind.write)
    bench.chamber.set_temperature(60.0)
    assert bench.device.setpoint_degC == 60.0
    assert bench.setpoints.count(60.0) == 1


@every_chamber
def test_a_write_that_never_arrived_is_an_error_and_is_not_repeated(name: str) -> None:
    """Reading back shows the old setpoint; whether to try again is the procedure's decision."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.fault(Fault.DEAF, command=bench.kind.write)
    with pytest.raises(ProtocolError, match="reads back setpoint 22 °C instead of 60 °C"):
        bench.chamber.set_temperature(60.0)
    assert bench.setpoints.count(60.0) == 1


@pytest.mark.parametrize(
    ("name", "which", "delay_s"),
    every_pair(list(product(KINDS, ["", "read", "write"], [0.5, 0.97, 1.9, 2.2, 3.0, 4.4]))),
)
def test_a_late_reply_never_answers_another_request(name: str, which: str, delay_s: float) -> None:
    """Wherever it lands, the setpoint is right, the reading is today's, and nothing was written twice."""
    bench = ChamberBench(name)
    command = {"": "", "read": bench.kind.read, "write": bench.kind.write}[which]
    bench.fault(Fault.LATE, command=command, delay_s=delay_s)
    bench.chamber.prepare()
    bench.fault(Fault.LATE, command=command, delay_s=delay_s)
    bench.chamber.set_temperature(60.0)
    bench.clock.sleep(3600.0)
    bench.fault(Fault.LATE, command=command, delay_s=delay_s)
    reading = bench.chamber.read()
    assert reading.setpoint_degC == 60.0
    assert reading.temperature_degC == pytest.approx(60.0, abs=0.1)
    assert bench.setpoints.count(60.0) == 1


@every_chamber
def test_a_dead_controller_is_named_within_its_deadline(name: str) -> None:
    """A few seconds for each of three attempts."""
    bench = ChamberBench(name)
    bench.fault(Fault.SILENCE, times=None)
    with pytest.raises(DeviceTimeout, match=r"(chamber|circulator|temptronic-ats) on sim://chamber did not answer"):
        bench.chamber.read()
    assert bench.clock.now() < 16.0


@every_chamber
def test_a_refused_setpoint_is_an_error(name: str) -> None:
    """Where a controller says no, in its words; where it keeps silent, by reading back. Sent once."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.fault(Fault.PANEL_LOCK)
    with pytest.raises(CommandRefused if bench.kind.refuses else ProtocolError, match="sim://chamber"):
        bench.chamber.set_temperature(60.0)
    assert bench.setpoints.count(60.0) == 1


@every_chamber
def test_an_alarm_is_reported_and_nothing_acknowledges_it(name: str) -> None:
    """It stands until somebody has been at the panel; and the chamber cannot be prepared with it."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.fault(Fault.ALARM)
    for _ in range(3):
        assert len(bench.chamber.read().alarms) == 1
    with pytest.raises(CommandRefused, match="acknowledge it at the panel"):
        bench.chamber.prepare()
    assert len(bench.device.alarms) == 1
    bench.device.alarms = ()
    bench.chamber.prepare()
    assert bench.chamber.read().alarms == ()


@every_chamber
def test_an_alarm_that_went_away_by_itself_is_still_in_the_reading(name: str) -> None:
    """Latched by the host: a night must not go on over an alarm between two polls of the report."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.fault(Fault.ALARM)
    seen = bench.chamber.read().alarms
    bench.device.alarms = ()
    assert bench.chamber.read().alarms == seen


@every_chamber
def test_after_a_power_cycle_the_chamber_must_be_prepared_anew(name: str) -> None:
    """The setpoint alone would be taken and nothing would happen."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.chamber.set_temperature(45.0)
    bench.clock.sleep(1800.0)
    bench.fault(Fault.POWER_CYCLE)
    assert bench.chamber.read().mode == "OFF"
    with pytest.raises(CommandRefused, match="mode OFF"):
        bench.chamber.set_temperature(45.0)
    bench.chamber.prepare()
    bench.chamber.set_temperature(45.0)
    assert bench.chamber.read().mode == "CONSTANT"


@every_chamber
@pytest.mark.parametrize("reading", [-199.9, 999.9, 3276.7])
def test_a_broken_sensor_is_a_sensor_fault_and_no_temperature(name: str, reading: float) -> None:
    """It never becomes a reading, and never a setpoint to start from."""
    bench = ChamberBench(name, celsius_confirmed=True)
    bench.fault(Fault.SENSOR_BROKEN, reading=reading)
    with pytest.raises(SensorFault, match="check its temperature sensor"):
        bench.chamber.read()
    with pytest.raises(DeviceError):
        bench.chamber.prepare()
    assert bench.setpoints == []


@every_chamber
def test_a_sensor_that_freezes_on_the_way_is_a_fault(name: str) -> None:
    """The very same reading for a quarter of an hour, far from where it should be going."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.fault(Fault.SENSOR_FROZEN)
    bench.chamber.set_temperature(60.0)
    bench.chamber.read()
    bench.clock.sleep(600.0)
    bench.chamber.read()
    bench.clock.sleep(400.0)
    with pytest.raises(SensorFault, match="without any change"):
        bench.chamber.read()


@every_chamber
def test_somebody_switching_the_panel_to_fahrenheit_is_noticed(name: str) -> None:
    """By its unit where it tells it, by its setpoint where it does not; and no setpoint is sent in the wrong unit."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.chamber.set_temperature(60.0)
    bench.clock.sleep(3600.0)
    bench.chamber.read()
    before = len(bench.setpoints)
    bench.fault(Fault.FAHRENHEIT)
    with pytest.raises(WrongDevice, match="set to °F"):
        bench.chamber.read()
    with pytest.raises(WrongDevice, match="set to °F"):
        bench.chamber.set_temperature(45.0)
    with pytest.raises(WrongDevice, match="go to the chamber"):
        bench.chamber.safe_state()
    assert bench.device.mode in ("OFF", "STANDBY")
    assert set(bench.setpoints[before:]) <= {65.0}  # ASCII-2 cannot stop without sending one: 140 within the limits
    with pytest.raises(WrongDevice, match="set to °F"):
        bench.chamber.prepare()


@every_chamber
def test_a_setpoint_that_is_the_number_of_the_last_one_in_fahrenheit_is_no_switch(name: str) -> None:
    """50 after 10 is a step; and 10 that reads as 50 is a panel in °F."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    for setpoint in (10.0, 50.0, 10.0):
        bench.chamber.set_temperature(setpoint)
    assert bench.chamber.read().setpoint_degC == 10.0
    bench.fault(Fault.FAHRENHEIT)
    with pytest.raises(WrongDevice, match="set to °F"):
        bench.chamber.set_temperature(20.0)


@pytest.mark.parametrize("name", [name for name in KINDS if KINDS[name].sees_programs])
def test_a_program_started_at_the_panel_is_not_overridden(name: str) -> None:
    """A setpoint would be ignored while it runs; only the safe state ends it."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.fault(Fault.PROGRAM)
    with pytest.raises(CommandRefused, match="mode RUN"):
        bench.chamber.set_temperature(45.0)
    with pytest.raises(CommandRefused, match=r"running a program|in mode RUN"):
        bench.chamber.prepare()
    bench.chamber.safe_state()
    assert bench.is_safe()


@every_chamber
@pytest.mark.parametrize("safe", SAFE_STATES)
@pytest.mark.parametrize("mode", ["OFF", "STANDBY", "CONSTANT", "RUN"])
def test_the_safe_state_is_reached_from_every_mode(name: str, safe: SafeState, mode: str) -> None:
    """Without having identified anything, as a watchdog does; and a second call writes no setpoint."""
    if mode == "STANDBY" and not KINDS[name].knows_standby:
        mode = "OFF"
    if mode == "RUN" and not KINDS[name].has_programs:
        mode = "CONSTANT"
    bench = ChamberBench(name, safe=safe, mode=mode, setpoint_degC=60.0)
    bench.chamber.safe_state()
    assert bench.is_safe()
    before = len(bench.setpoints)
    bench.chamber.safe_state()
    assert len(bench.setpoints) == before
    assert bench.is_safe()


DISTURBANCES = [
    Fault.DEAF,
    Fault.SILENCE,
    Fault.GARBAGE,
    Fault.TRUNCATED,
    Fault.CORRUPTED,
    Fault.LATE,
    Fault.REFUSED,
    Fault.ALARM,
    Fault.POWER_CYCLE,
    Fault.SENSOR_BROKEN,
    Fault.PLANT_DEAD,
]


@pytest.mark.parametrize(
    ("name", "safe", "kind", "times"), every_pair(list(product(KINDS, SAFE_STATES, DISTURBANCES, [1, 4, 8])))
)
def test_the_safe_state_is_reached_through_disturbances(
    name: str, safe: SafeState, kind: ChamberFaultKind, times: int
) -> None:
    """Eight disturbed exchanges in a row, an alarm that has stopped the chamber, a power cut a moment ago."""
    bench = ChamberBench(name, safe=safe)
    bench.chamber.prepare()
    bench.chamber.set_temperature(60.0)
    bench.clock.sleep(600.0)
    bench.fault(kind, times=times)
    bench.chamber.safe_state()
    assert bench.is_safe()


@every_chamber
@pytest.mark.parametrize("safe", SAFE_STATES)
def test_a_chamber_that_hears_but_does_not_answer_is_made_safe_and_still_reported(name: str, safe: SafeState) -> None:
    """A broken receive line: what was sent was carried out, but nobody could confirm it."""
    bench = ChamberBench(name, safe=safe)
    bench.chamber.prepare()
    bench.chamber.set_temperature(60.0)
    bench.fault(Fault.SILENCE, times=None)
    began_s = bench.clock.now()
    with pytest.raises(DeviceTimeout, match=r"could not be confirmed in \d attempts?; go to the chamber"):
        bench.chamber.safe_state()
    assert bench.is_safe()
    assert bench.clock.now() - began_s < 150.0


@every_chamber
def test_a_port_that_is_gone_is_a_transport_error(name: str) -> None:
    """For reads, for settings and for the safe state."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.transport.pulled_between.append((0.0, float("inf")))
    attempts: list[Callable[[], object]] = [
        bench.chamber.read,
        lambda: bench.chamber.set_temperature(30.0),
        bench.chamber.safe_state,
    ]
    for attempt in attempts:
        with pytest.raises(TransportError, match="sim://chamber"):
            attempt()


@every_chamber
def test_closing_changes_nothing(name: str) -> None:
    """The chamber holds what it held."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    before = bench.wire.sent
    bench.chamber.close()
    assert bench.wire.sent == before
    assert bench.device.mode == "CONSTANT"


@every_chamber
def test_starting_outside_the_limits_raises_no_alarm(name: str) -> None:
    """A bench for 30 to 65 °C begins in a room of 22 °C."""
    bench = ChamberBench(name, limits=ChamberLimits(30.0, 65.0), safe=SafeState("off"))
    bench.chamber.prepare()
    bench.chamber.set_temperature(45.0)
    bench.clock.sleep(3600.0)
    bench.chamber.set_temperature(50.0)
    reading = bench.chamber.read()
    assert (reading.mode, reading.alarms) == ("CONSTANT", ())
