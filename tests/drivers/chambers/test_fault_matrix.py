"""Every fault on every chamber driver in every operation: the right answer, or a named error, before a deadline.

The rows come from the registry of drivers, the columns from the simulators' own list of faults and from the operations
of a `Chamber`: a new driver, fault or operation is in the matrix, or these tests fail. Each pair of driver, fault and
operation is quick, the rest of the matrix slow.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from itertools import product

import pytest

from drivers.chambers import CHAMBER_DRIVERS, Chamber
from drivers.errors import CommandRefused, DeviceError, DeviceTimeout, ProtocolError, SensorFault, WrongDevice
from drivers.simulators.chambers.controller import OF_A_REPLY
from drivers.simulators.chambers.controller import ChamberFaultKind as Fault
from tests.drivers.chambers.chamber_benches import KINDS, LIMITS, ChamberBench
from tests.drivers.pairs import every_pair

_HELD, _NEXT = 60.0, 45.0


def _identify(bench: ChamberBench) -> bool:
    return bench.chamber.identify().unit == "degC"


def _prepare(bench: ChamberBench) -> bool:
    bench.chamber.prepare()
    return bench.device.mode == "CONSTANT" and abs(bench.device.setpoint_degC - _HELD) < 0.15


def _read(bench: ChamberBench) -> bool:
    reading = bench.chamber.read()
    return (
        abs(reading.temperature_degC - bench.plant.advance(bench.clock.now())) < 0.3
        and abs(reading.setpoint_degC - bench.device.setpoint_degC) < 0.06
        and reading.mode == bench.device.mode
        and bool(reading.alarms) == bool(bench.device.alarms)
    )


def _set(bench: ChamberBench) -> bool:
    bench.chamber.set_temperature(_NEXT)
    return bench.device.mode == "CONSTANT" and abs(bench.device.setpoint_degC - _NEXT) < 0.06


def _safe(bench: ChamberBench) -> bool:
    bench.chamber.safe_state()
    return bench.is_safe()


# What is done, telling whether what it left or said is right; and its deadline, s.
OPERATIONS: dict[str, tuple[Callable[[ChamberBench], bool], float]] = {
    "identify": (_identify, 15.0),
    "prepare": (_prepare, 30.0),
    "read": (_read, 15.0),
    "set_temperature": (_set, 20.0),
    "safe_state": (_safe, 150.0),
}

# What may come of a fault that lasts, by operation, "*" for all others: the right answer (None) or one of these errors.
Outcomes = dict[str, set[type[DeviceError] | None]]
_UNREADABLE: Outcomes = {"*": {ProtocolError, DeviceTimeout}}
_NOT_TAKEN: set[type[DeviceError] | None] = {CommandRefused, ProtocolError}  # in its words, or by reading back
# An idle chamber at 60 may be one at 60 °F, where the controller cannot tell its unit.
_IDLE: Outcomes = {"*": {None}, "identify": {None, WrongDevice}, "set_temperature": {CommandRefused}}
LASTING: dict[Fault, Outcomes] = {
    Fault.DEAF: {"*": {DeviceTimeout}},
    Fault.SILENCE: {"*": {DeviceTimeout}},
    Fault.GARBAGE: _UNREADABLE,
    Fault.TRUNCATED: {"*": {DeviceTimeout}},
    Fault.CORRUPTED: _UNREADABLE | {"safe_state": {ProtocolError, DeviceTimeout, CommandRefused}},
    Fault.LATE: {"*": {None, DeviceTimeout}},  # ESPEC's replies show what they answer
    Fault.REFUSED: {"*": {CommandRefused, DeviceTimeout, ProtocolError}},
    Fault.ALARM: _IDLE | {"prepare": {CommandRefused}},
    Fault.PANEL_LOCK: {"*": {None}, "set_temperature": _NOT_TAKEN, "safe_state": _NOT_TAKEN},
    Fault.POWER_CYCLE: _IDLE,
    Fault.FAHRENHEIT: {"*": {WrongDevice}, "identify": {None, WrongDevice}},  # asked anew, where it cannot tell
    Fault.PROGRAM: {"*": {None}, "prepare": {CommandRefused}, "set_temperature": {CommandRefused}},
    Fault.SENSOR_FROZEN: {"*": {None}},  # shows over time: test_every_chamber
    Fault.SENSOR_BROKEN: {"*": {None}, "prepare": {SensorFault}, "read": {SensorFault}},
    Fault.PLANT_DEAD: {"*": {None}},
    Fault.NOT_CARRIED_OUT: {"*": {None}},  # the air tells: tests/hil/night/test_safe_by_its_air.py
    Fault.RUNAWAY: {"*": {None}},  # the reading tells, and an interlock acts
}


def _faults_of(name: str) -> list[Fault]:
    """Return the faults that the protocol can have: a program that the line does not show is none of them."""
    shows_programs = name not in KINDS or KINDS[name].sees_programs
    return [fault for fault in Fault if fault is not Fault.PROGRAM or shows_programs]


def _held(name: str) -> ChamberBench:
    """Return a chamber that has been held at 60 °C for an hour."""
    bench = ChamberBench(name)
    bench.chamber.prepare()
    bench.chamber.set_temperature(_HELD)
    bench.clock.sleep(3600.0)
    bench.chamber.read()
    return bench


def _outcome(bench: ChamberBench, operation: str) -> type[DeviceError] | None:
    """Do it; insist on its deadline, on a right answer or a message that names the port, and on the limits."""
    act, deadline_s = OPERATIONS[operation]
    began_s = bench.clock.now()
    message, outcome = "sim://chamber", None
    try:
        assert act(bench), f"{operation} said that it was done, and it was not"
    except DeviceError as error:
        message, outcome = str(error), type(error)
    assert "sim://chamber" in message
    assert bench.clock.now() - began_s <= deadline_s
    assert all(LIMITS.low_degC <= setpoint <= LIMITS.high_degC for setpoint in bench.setpoints)
    return outcome


def test_the_matrix_is_complete() -> None:
    """Every driver that a bench file can name, every fault that a simulator knows, everything that a chamber does."""
    assert set(KINDS) == set(CHAMBER_DRIVERS), "a chamber driver has no line in chamber_benches.KINDS"
    assert set(LASTING) == set(Fault)
    methods = {name for name, member in vars(Chamber).items() if callable(member) and not name.startswith("_")}
    assert set(OPERATIONS) == methods - {"close"}


LASTS = [(name, fault, each) for name in CHAMBER_DRIVERS for fault in _faults_of(name) for each in OPERATIONS]


@pytest.mark.parametrize(("name", "fault", "operation"), every_pair(LASTS))
def test_a_fault_that_lasts(name: str, fault: Fault, operation: str) -> None:
    """It ends as the table says; and whatever it was, a chamber that hears is then in its safe state or stopped."""
    bench = _held(name)
    bench.fault(fault, times=None)
    expected = LASTING[fault]
    assert _outcome(bench, operation) in expected.get(operation, expected["*"])
    if operation == "safe_state" and fault in (Fault.SILENCE, Fault.GARBAGE, Fault.TRUNCATED, Fault.LATE):
        assert bench.is_safe()
    if operation == "safe_state" and fault is Fault.FAHRENHEIT:
        assert bench.device.mode in ("STANDBY", "OFF")


@pytest.mark.parametrize(
    ("name", "fault", "operation"), every_pair(list(product(CHAMBER_DRIVERS, sorted(OF_A_REPLY), OPERATIONS)))
)
def test_a_fault_of_one_reply_changes_nothing(name: str, fault: Fault, operation: str) -> None:
    """It is asked again; also a model that a damaged name hides, where nobody knows that the name was damaged."""
    bench = _held(name)
    bench.chamber = bench.rebuilt(expected_model=bench.chamber.identify().model, celsius_confirmed=True)
    bench.fault(fault)
    assert _outcome(bench, operation) is None


@pytest.mark.parametrize(("name", "fault"), [(name, fault) for name in CHAMBER_DRIVERS for fault in _faults_of(name)])
def test_every_fault_is_one(name: str, fault: Fault) -> None:
    """A simulator that ignored a fault would make its column prove nothing."""
    assert _history(name, fault) != _history(name, None)


def _history(name: str, fault: Fault | None) -> list[object]:
    bench, history = _held(name), list[object]()
    if fault is not None:
        bench.fault(fault, times=None)
    for operation in ("read", "set_temperature", "read"):
        outcome: object = None
        try:
            OPERATIONS[operation][0](bench)
        except DeviceError as error:
            outcome = type(error)
        history += [outcome, bench.device.mode, round(bench.clock.now(), 3), bench.wire.sent]
        bench.clock.sleep(600.0)
    bench.device._suffer(bench.clock.now())
    return [*history, bench.device.alarms, bench.device._air(bench.clock.now())]


@pytest.mark.parametrize("operation", ["prepare", "set_temperature", "safe_state"])
@pytest.mark.parametrize("name", CHAMBER_DRIVERS)
def test_a_line_on_which_every_reply_is_late_ends_in_time(name: str, operation: str) -> None:
    """Each answer comes with the next asking, and looks take half a minute: there is an end all the same."""
    bench = _held(name)
    bench.fault(Fault.ALARM)
    bench.fault(Fault.LATE, times=None, delay_s=5.0)
    began_s = bench.clock.now()
    with suppress(DeviceError):
        OPERATIONS[operation][0](bench)
    assert bench.clock.now() - began_s < 180.0
