"""The simulated ESPEC controller says what its manual says, and misbehaves as told; see also the golden vectors."""

from __future__ import annotations

import re
from typing import Any

import pytest

from drivers.chambers import ChamberLimits
from drivers.simulators.chambers.controller import ChamberFault
from drivers.simulators.chambers.controller import ChamberFaultKind as Fault
from drivers.simulators.chambers.described import SimulatedSetpointBox
from drivers.simulators.chambers.plant import ChamberPlant
from tests.drivers.chambers.shipped import simulated_espec


def _device(ambient: float = 22.0, **settings: Any) -> SimulatedSetpointBox:
    return simulated_espec(ChamberPlant(ambient_degC=ambient), **settings)


def _ask(device: SimulatedSetpointBox, request: bytes, now_s: float) -> bytes:
    device.receive(request, now_s)
    return device.transmit(now_s + 0.1)


@pytest.mark.parametrize(
    ("request_", "reply"),
    [
        (b"ROM?", b"P300 SIMULATED 1.00"),
        (b"MON?", b"22.0,,OFF,0"),
        (b"MODE?", b"OFF"),
        (b"ALARM?", b"0"),
        (b"HUMI?", b"NA:INVALID REQ"),
        (b"TEMP?,X", b"NA:PARA ERR"),
        (b"TEMP,X25", b"NA:PARA ERR"),
        (b"TEMP,S25x", b"NA:PARA ERR"),
        (b"TEMP,S110.0", b"NA:DATA OUT OF RANGE"),
        (b"TEMP,H20.0", b"NA:DATA OUT OF RANGE"),
        (b"TEMP,L25.0", b"NA:DATA OUT OF RANGE"),
        (b"MODE,SLEEP", b"NA:PARA ERR"),
        (b"POWER,MAYBE", b"NA:PARA ERR"),
        (b"TIMER LIST?,0", b"STANDBY,0:0"),
        (b"TIMER ON?", b"0"),
        (b"TIMER WRITE,NO0,3:60,STANDBY", b"NA:PARA ERR"),
        (b"TIMER WRITE,NO1,3:00,STANDBY", b"NA:PARA ERR"),
        (b"TIMER,ON,1", b"NA:PARA ERR"),
        (b"PRGM,DANCE", b"NA:PARA ERR"),
        (b"PRGM,END,STANDBY", b"NA:CONT NOT READY-2"),
        (b"HELLO", b"NA:CMD ERR"),
        (b"MODE ,OFF", b"NA:CMD ERR"),
        (b"\xff\xfe", b"NA:CMD ERR"),
    ],
)
def test_other_requests(request_: bytes, reply: bytes) -> None:
    """Monitor and setting commands, and how they are refused."""
    assert _ask(_device(), request_ + b"\r\n", 0.0) == reply + b"\r\n"


def test_another_spelling_and_another_terminator() -> None:
    """A GL's acknowledgement, and a controller set to CR alone."""
    device = _device(spoken={"terminator": "CR"}, gl=True)
    assert _ask(device, b"TEMP,S25\r", 0.0) == b"OK:1,temp,s25.0\r"


def test_a_controller_answers_to_its_own_address_only() -> None:
    """On RS-485 others stay silent, also where there is no address at all."""
    device = _device(spoken={"address": 2})
    assert _ask(device, b"1,TEMP?\r\n", 0.0) == b""
    assert _ask(device, b"TEMP?\r\n", 1.0) == b""
    assert _ask(device, b"2,TEMP?\r\n", 2.0) == b"22.0,23.0,105.0,-75.0\r\n"


def test_requests_before_the_pause_is_over_are_ignored_by_a_strict_one_alone() -> None:
    """0.3 s after a monitor's reply, 0.5 s after a setting's; another answers whoever does not pause."""
    patient = _device()
    patient.receive(b"TEMP?\r\nTEMP,S25\r\nTEMP?\r\n", 0.0)
    assert patient.transmit(0.1).count(b"\r\n") == 3
    device = _device()
    device.strict = True
    device.receive(b"TEMP?\r\nTEMP?\r\n", 0.0)
    assert device.transmit(0.1).count(b"\r\n") == 1
    assert _ask(device, b"TEMP?\r\n", 0.30) == b""
    assert _ask(device, b"TEMP,S25\r\n", 0.36) != b""
    assert _ask(device, b"TEMP?\r\n", 0.86) == b""
    assert _ask(device, b"TEMP?\r\n", 0.92) != b""
    assert device.ignored_requests == 3


def test_a_request_may_arrive_in_pieces_and_is_answered_after_a_while() -> None:
    """Nothing is answered before the terminator, nor before the latency has passed."""
    device = _device(latency_s=0.05)
    device.receive(b"TE", 0.0)
    assert device.next_transmission(0.0) is None
    device.receive(b"MP?\r\n", 0.01)
    assert device.next_transmission(0.01) == pytest.approx(0.06)
    assert device.transmit(0.05) == b""
    assert device.transmit(0.06) == b"22.0,23.0,105.0,-75.0\r\n"
    assert device.next_transmission(0.06) is None


def test_the_air_follows_the_setpoint_in_constant_mode_only() -> None:
    """A setpoint given while it is off does nothing until it is started."""
    plant = ChamberPlant()
    device = simulated_espec(plant)
    _ask(device, b"TEMP,S60.0\r\n", 0.0)
    assert plant.advance(3600.0) == 22.0
    _ask(device, b"MODE,CONSTANT\r\n", 3600.0)
    assert plant.advance(7200.0) == pytest.approx(60.0, abs=0.1)
    _ask(device, b"MODE,OFF\r\n", 7200.0)
    assert _ask(device, b"MON?\r\n", 7300.0).endswith(b",,OFF,0\r\n")
    assert plant.advance(9000.0) < 50.0


def test_power_on_leads_to_standby() -> None:
    """And leaves a chamber that runs as it is."""
    device = _device()
    _ask(device, b"POWER,ON\r\n", 0.0)
    assert device.mode == "STANDBY"
    _ask(device, b"MODE,CONSTANT\r\n", 1.0)
    _ask(device, b"POWER,ON\r\n", 2.0)
    assert device.mode == "CONSTANT"


def test_a_program_ends_in_standby() -> None:
    """Where one runs; another end than the one that is asked for it does not know."""
    device = _device(mode="RUN")
    assert _ask(device, b"PRGM,END,SOON\r\n", 0.0) == b"NA:PARA ERR\r\n"
    assert _ask(device, b"PRGM,END,STANDBY\r\n", 1.0) == b"OK:PRGM,END,STANDBY\r\n"
    assert device.mode == "STANDBY"


def test_the_quick_timer_stops_it_and_is_forgotten_with_the_power() -> None:
    """Counted from the moment it is switched on; it does nothing before, nor once it is switched off."""
    device = _device(mode="CONSTANT")
    assert _ask(device, b"TIMER WRITE,NO0,1:30,STANDBY\r\n", 0.0) == b"OK:TIMER WRITE,NO0,1:30,STANDBY\r\n"
    assert _ask(device, b"TIMER LIST?,0\r\n", 1.0) == b"STANDBY,1:30\r\n"
    _ask(device, b"TIMER,ON,0\r\n", 100.0)
    assert _ask(device, b"TIMER ON?\r\n", 101.0) == b"1,0\r\n"
    _ask(device, b"TIMER,OFF,0\r\n", 5000.0)
    _ask(device, b"TIMER,ON,0\r\n", 5001.0)
    assert _ask(device, b"MON?\r\n", 10400.0).endswith(b",,CONSTANT,0\r\n")
    assert _ask(device, b"MON?\r\n", 10402.0).endswith(b",,STANDBY,0\r\n")
    _ask(device, b"TIMER,ON,0\r\n", 10403.0)
    device.inject(ChamberFault(Fault.POWER_CYCLE, 10404.0))
    assert _ask(device, b"TIMER ON?\r\n", 10405.0) == b"0\r\n"


@pytest.mark.parametrize(
    ("fault", "reply", "setpoint"),
    [
        (ChamberFault(Fault.DEAF), b"", 23.0),
        (ChamberFault(Fault.SILENCE), b"", 25.0),
        (ChamberFault(Fault.GARBAGE), b"\x00\x7f\xfe#~\r\n", 25.0),
        (ChamberFault(Fault.TRUNCATED), b"OK:TEM", 25.0),
        (ChamberFault(Fault.REFUSED, text="CHB NOT READY"), b"NA:CHB NOT READY\r\n", 23.0),
    ],
)
def test_faults_of_a_reply(fault: ChamberFault, reply: bytes, setpoint: float) -> None:
    """What is answered, and whether it was carried out: a host cannot tell the one from the other."""
    device = _device(faults=[fault])
    assert _ask(device, b"TEMP,S25\r\n", 0.0) == reply
    assert device.setpoint_degC == setpoint
    assert _ask(device, b"TEMP,S26\r\n", 5.0) == b"OK:TEMP,S26\r\n"


def test_a_late_reply_comes_after_the_next_one() -> None:
    """The controller is on time; the line is late."""
    device = _device(faults=[ChamberFault(Fault.LATE, command="TEMP", delay_s=3.0)])
    assert _ask(device, b"TEMP?\r\n", 0.0) == b""
    assert _ask(device, b"MON?\r\n", 1.0) == b"22.0,,OFF,0\r\n"
    assert device.transmit(4.0) == b"22.0,23.0,105.0,-75.0\r\n"


def test_faults_strike_the_command_the_number_of_times_and_from_the_moment_given() -> None:
    """Two TEMP? from 10 s on; and one that never ends."""
    device = _device(faults=[ChamberFault(Fault.SILENCE, begins_s=10.0, command="TEMP", times=2)])
    answered = [_ask(device, b"TEMP?\r\n", now_s) != b"" for now_s in (0.0, 10.0, 11.0, 12.0)]
    assert answered == [True, False, False, True]
    device.inject(ChamberFault(Fault.SILENCE, times=None))
    assert not any(_ask(device, b"MON?\r\n", now_s) for now_s in (20.0, 21.0, 22.0, 23.0))


def test_an_alarm_stops_the_chamber_and_stays_until_it_is_acknowledged_at_the_panel() -> None:
    """Monitor commands report it; the number of alarms is the fourth field of MON?."""
    device = _device(mode="CONSTANT", faults=[ChamberFault(Fault.ALARM, begins_s=5.0, text="19")])
    assert _ask(device, b"MON?\r\n", 0.0) == b"22.0,,CONSTANT,0\r\n"
    assert _ask(device, b"MON?\r\n", 5.0).endswith(b",,STANDBY,1\r\n")
    assert _ask(device, b"ALARM?\r\n", 6.0) == b"1,19\r\n"
    device.alarms = ()
    assert _ask(device, b"ALARM?\r\n", 7.0) == b"0\r\n"


def test_air_beyond_an_alarm_limit_raises_an_alarm() -> None:
    """The second safety layer works by itself, once the chamber runs."""
    device = _device(ambient=40.0, limits=ChamberLimits(-45.0, 35.0), mode="CONSTANT")
    assert _ask(device, b"MON?\r\n", 1.0).endswith(b",,STANDBY,1\r\n")


def test_a_locked_panel_refuses_settings_and_answers_questions() -> None:
    """PROTECT ON is for an operator to release."""
    device = _device(faults=[ChamberFault(Fault.PANEL_LOCK, begins_s=1.0)])
    assert _ask(device, b"TEMP,S25\r\n", 0.0) == b"OK:TEMP,S25\r\n"
    assert _ask(device, b"TEMP,S26\r\n", 1.0) == b"NA:PROTECT ON\r\n"
    assert _ask(device, b"TEMP?\r\n", 2.0) == b"22.0,25.0,105.0,-75.0\r\n"


@pytest.mark.parametrize(("begins_s", "mode"), [(4000.0, "OFF"), (7200.0, "RUN")])
def test_nobody_starts_a_program_at_a_panel_that_is_dark(begins_s: float, mode: str) -> None:
    """As long as its power is gone; afterwards it does what the panel says, also where nobody looked meanwhile."""
    gone = ChamberFault(Fault.POWER_CYCLE, 3600.0, ends_s=7200.0)
    device = _device(mode="CONSTANT", faults=[ChamberFault(Fault.PROGRAM, begins_s), gone])
    device.receive(b"", 9000.0)
    assert device.mode == mode


def test_a_power_cycle_switches_it_off_and_loses_setpoint_and_replies() -> None:
    """The air then leaks to ambient."""
    device = _device(mode="CONSTANT", setpoint_degC=60.0, faults=[ChamberFault(Fault.POWER_CYCLE, begins_s=3600.0)])
    assert device.transmit(3599.0) == b""
    device.receive(b"TEMP?\r\n", 3599.99)
    assert device.transmit(3600.1) == b""
    assert _ask(device, b"MON?\r\n", 3605.0).endswith(b",,OFF,0\r\n")
    assert _ask(device, b"TEMP?\r\n", 3606.0).split(b",")[1] == b"23.0"


def test_sensors_freeze_and_break_and_the_plant_dies() -> None:
    """Each of them says nothing on the line: only the numbers tell."""
    frozen = _device(mode="CONSTANT", setpoint_degC=60.0, faults=[ChamberFault(Fault.SENSOR_FROZEN, begins_s=60.0)])
    early = _ask(frozen, b"TEMP?\r\n", 60.0)
    assert early != _ask(_device(), b"TEMP?\r\n", 0.0)
    assert _ask(frozen, b"TEMP?\r\n", 3600.0) == early
    broken = _device(faults=[ChamberFault(Fault.SENSOR_BROKEN)])
    assert _ask(broken, b"TEMP?\r\n", 0.0) == b"-199.9,23.0,105.0,-75.0\r\n"
    dead = _device(mode="CONSTANT", setpoint_degC=60.0, faults=[ChamberFault(Fault.PLANT_DEAD)])
    _ask(dead, b"TEMP?\r\n", 0.0)
    assert _ask(dead, b"TEMP?\r\n", 3600.0) == b"22.0,60.0,105.0,-75.0\r\n"


def test_what_public_clients_ask_has_the_form_that_they_parse() -> None:
    """ChamberConnectLibrary (MIT), p300.py: numbered lists, percentages, a date of YY.MM/DD, ON or OFF."""
    device = _device()
    form = {
        b"SET?": rb"REF\d", b"RELAY?": rb"\d+(,\d+)*", b"%?": rb"1,\d+\.\d", b"DATE?": rb"\d\d\.\d\d/\d\d",
        b"TIME?": rb"\d\d:\d\d:\d\d", b"TIMER USE?": rb"0", b"KEYPROTECT?": rb"OFF", b"SRQ?": rb"[01]{8}",
    }  # fmt: skip
    for request, reply in form.items():
        assert re.fullmatch(reply + rb"\r\n", _ask(device, request + b"\r\n", 1.0)), request
