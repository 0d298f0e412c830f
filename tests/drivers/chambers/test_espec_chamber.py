"""What is particular to an ESPEC chamber; what it shares with all others is in test_every_chamber and the matrix."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from drivers.chambers import ChamberLimits, SafeState
from drivers.errors import CommandRefused, DeviceTimeout, SensorFault
from drivers.simulators.chambers.controller import ChamberFaultKind as Fault
from tests.drivers.chambers.chamber_benches import ChamberBench


def test_the_alarm_limits_follow_the_air_inside() -> None:
    """A bench for 30 to 65 °C begins in a room of 22 °C; once the air is inside, the next setpoint tightens."""
    bench = ChamberBench("espec", limits=ChamberLimits(30.0, 65.0), safe=SafeState("off"))
    bench.chamber.prepare()
    bench.chamber.set_temperature(45.0)
    assert bench.chamber.read().low_limit_degC == 17.0
    bench.clock.sleep(3600.0)
    bench.chamber.set_temperature(50.0)
    reading = bench.chamber.read()
    assert (reading.low_limit_degC, reading.mode, reading.alarms) == (25.0, "CONSTANT", ())


@pytest.mark.parametrize("kind", [Fault.DEAF, Fault.SILENCE, Fault.GARBAGE, Fault.TRUNCATED])
@pytest.mark.parametrize("command", ["TEMP?", "MON?", "ALARM?", "ROM?", "TYPE?"])
def test_each_question_is_asked_again(kind: Fault, command: str) -> None:
    """Whatever became of its first two answers."""
    bench = ChamberBench("espec")
    bench.fault(kind, command=command, times=2)
    bench.chamber.prepare()
    assert bench.chamber.read().mode == "CONSTANT"


@pytest.mark.parametrize("delay_s", [0.5, 2.2, 2.5, 5.0, 8.0])
@pytest.mark.parametrize("command", ["TEMP?", "MON?", "MODE"])
def test_a_late_reply_to_any_command_answers_no_other(delay_s: float, command: str) -> None:
    """Its replies show what they answer: even one that is eight seconds late is told apart."""
    bench = ChamberBench("espec")
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


def test_a_dead_controller_is_named_within_its_deadline() -> None:
    """Three times two seconds and the pauses."""
    bench = ChamberBench("espec")
    bench.fault(Fault.SILENCE, times=None)
    with pytest.raises(DeviceTimeout, match=r"chamber on sim://chamber did not answer 'TEMP\?'"):
        bench.chamber.read()
    assert bench.clock.now() < 8.0


@pytest.mark.parametrize("text", ["PROTECT ON", "DATA OUT OF RANGE", "CHB NOT READY", "CONT NOT READY-3"])
def test_a_refused_setpoint_is_reported_in_the_controllers_own_words(text: str) -> None:
    """And sent once."""
    bench = ChamberBench("espec")
    bench.chamber.prepare()
    bench.fault(Fault.REFUSED, command="TEMP,S", text=text)
    with pytest.raises(CommandRefused, match=text):
        bench.chamber.set_temperature(60.0)
    assert bench.setpoints.count(60.0) == 1


@pytest.mark.parametrize("text", ["nan", "9999.0", "-3276.8", "---.-"])
def test_what_a_panel_shows_for_a_broken_sensor_is_no_temperature(text: str) -> None:
    """Dashes too."""
    bench = ChamberBench("espec")
    bench.fault(Fault.SENSOR_BROKEN, text=text)
    with pytest.raises(SensorFault, match="check its temperature sensor"):
        bench.chamber.read()


def test_the_dead_man_stops_a_chamber_whose_program_died() -> None:
    """As long as somebody reads it is renewed; left alone, the chamber stands by when the time is over."""
    bench = ChamberBench("espec", dead_man_s=3600.0)
    bench.chamber.prepare()
    bench.chamber.set_temperature(60.0)
    for _ in range(24):
        bench.clock.sleep(600.0)
        assert bench.chamber.read().mode == "CONSTANT"
    bench.clock.sleep(3600.0)
    bench.wire.receive(b"MON?\r\n", bench.clock.now())
    assert bench.device.mode == "STANDBY"


def test_the_dead_man_is_not_renewed_once_the_safe_state_was_asked_for() -> None:
    """Nor by somebody who only looks."""
    bench = ChamberBench("espec", dead_man_s=3600.0, mode="CONSTANT")
    bench.chamber.read()
    assert bench.device.timer_ends_s is None
    bench.chamber.prepare()
    bench.chamber.safe_state()
    ends_s = bench.device.timer_ends_s
    bench.clock.sleep(1800.0)
    bench.chamber.read()
    assert bench.device.timer_ends_s == ends_s


@pytest.mark.parametrize("asked", [False, True])
def test_a_timer_that_nobody_asked_for_is_done_without_where_there_is_none(asked: bool) -> None:
    """A night goes on; a bench file that insists on it is refused, and one that has it gets it either way."""
    bench = ChamberBench("espec", dead_man_s=3600.0, dead_man_asked=asked)
    bench.fault(Fault.REFUSED, command="TIMER ON?", times=None)
    with pytest.raises(CommandRefused, match="take dead_man out") if asked else nullcontext():
        bench.chamber.prepare()
    assert (bench.device.mode == "CONSTANT") != asked
    other = ChamberBench("espec", dead_man_s=3600.0, dead_man_asked=asked)
    other.chamber.prepare()
    assert other.device.timer_ends_s is not None


def test_a_renewal_that_is_lost_is_made_good_in_time() -> None:
    """The first says so; the next one is in time."""
    bench = ChamberBench("espec", dead_man_s=3600.0)
    bench.chamber.prepare()
    bench.clock.sleep(1000.0)
    bench.fault(Fault.SILENCE, command="TIMER LIST?", times=3)
    with pytest.raises(DeviceTimeout, match="TIMER LIST"):
        bench.chamber.read()
    assert bench.chamber.read().mode == "CONSTANT"
    assert bench.device.timer_ends_s == pytest.approx(bench.clock.now() + 3600.0, abs=5.0)
