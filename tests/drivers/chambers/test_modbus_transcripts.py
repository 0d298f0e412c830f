"""The Modbus drivers' own bytes: one transcript per conversation, and nothing left over."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import pytest

from drivers.chambers import ChamberLimits, SafeState
from drivers.chambers.controller import Controller
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, DeviceTimeout, ProtocolError, WrongDevice
from drivers.simulators.chambers.controller import ChamberFault, ChamberFaultKind
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport
from drivers.transports.modbus import ModbusExchange, decoded, encoded
from tests.drivers.chambers.shipped import ezt570i, simulated_f4, watlow_f4
from tests.drivers.transcript import TranscriptDevice

LIMITS = ChamberLimits(-35.0, 65.0)

# Written down with their checksums: the reference's where it has them, computed from the rule for the rest.
F4_IDENTIFY = [
    ("01 03 00 00 00 01 84 0a", "01 03 02 14 96 37 2a"),
    ("01 03 02 60 00 01 85 ac", "01 03 02 00 00 b8 44"),
    ("01 03 02 5e 00 01 e4 60", "01 03 02 00 01 79 84"),
    ("01 03 03 85 00 01 95 a7", "01 03 02 00 01 79 84"),
]


def _f4_state(air: str, setpoint: str, limits: str = "fe 70 02 bc ca d1") -> list[tuple[str, str]]:
    return [
        ("01 03 00 64 00 07 45 d7", f"01 03 0e {air}"),
        ("01 03 01 2c 00 01 44 3f", f"01 03 02 {setpoint}"),
        ("01 03 02 5a 00 02 e5 a0", f"01 03 04 {limits}"),
        ("01 03 00 c8 00 01 05 f4", "01 03 02 00 01 79 84"),
        ("01 03 07 d0 00 01 84 87", "01 03 02 00 01 79 84"),
        ("01 03 03 85 00 01 95 a7", "01 03 02 00 01 79 84"),
    ]


AIR_23 = "00 e6 00 00 00 00 00 00 00 00 00 00 00 00 98 b2"
AIR_23_ALARM = "00 e6 00 00 00 00 00 00 00 00 00 00 00 01 59 72"


def _device(exchanges: list[tuple[str, str]]) -> TranscriptDevice:
    return TranscriptDevice([(bytes.fromhex(request), bytes.fromhex(reply)) for request, reply in exchanges])


def _chamber(
    controller: Callable[[MemoryTransport, VirtualClock], Controller], device: TranscriptDevice
) -> SupervisedChamber:
    clock = VirtualClock()
    built: Controller = controller(MemoryTransport(device, clock, "sim://chamber"), clock)
    return SupervisedChamber(built, clock, Supervision(limits=LIMITS, safe=SafeState("off"), celsius_confirmed=True))


def test_f4_sets_a_temperature() -> None:
    """-21.5 °F: model, input type, decimals, unit; look, write in tenths, look again."""
    device = _device(
        [
            *F4_IDENTIFY,
            *_f4_state(AIR_23, "00 e6 39 ce"),
            ("01 06 01 2c fe d7 49 c1", "01 06 01 2c fe d7 49 c1"),
            *_f4_state(AIR_23, "fe d7 b8 7a"),
        ]
    )
    _chamber(watlow_f4, device).set_temperature((-21.5 - 32.0) / 1.8)
    device.finish()


def test_f4_reads_its_alarms_and_writes_nothing() -> None:
    """Register 106 tells alarm 2; registers 311, 331 and 332, which clear and silence, are never written."""
    device = _device([F4_IDENTIFY[2], *_f4_state(AIR_23_ALARM, "00 e6 39 ce")])
    assert _chamber(watlow_f4, device).read().alarms == ("alarm 2 (1)",)
    device.finish()


def test_f4_in_fahrenheit_is_refused_before_anything_is_written() -> None:
    """Register 901 is 0."""
    device = _device([*F4_IDENTIFY[:3], (F4_IDENTIFY[3][0], "01 03 02 00 00 b8 44")])
    with pytest.raises(WrongDevice, match="set to °F; set it to °C at its panel"):
        _chamber(watlow_f4, device).set_temperature(25.0)
    device.finish()


@pytest.mark.parametrize(("reply", "error"), [("01 03 02 00 05 78 47", "shows 5 decimals")])
def test_f4_with_decimals_that_cannot_be_is_not_guessed_at(reply: str, error: str) -> None:
    """A wrong scale is a setpoint ten times off."""
    device = _device([*F4_IDENTIFY[:2], *[(F4_IDENTIFY[2][0], reply)] * 3])
    with pytest.raises(ProtocolError, match=error):
        _chamber(watlow_f4, device).identify()
    device.finish()


EZT_STATE = [
    ("01 03 00 00 00 01 84 0a", "01 03 02 00 01 79 84"),
    ("01 03 00 3c 00 06 05 c4", "01 03 0c 00 e6 00 e6 00 00 00 00 02 bc fe 70 b9 87"),
    ("01 03 00 16 00 03 e4 0f", "01 03 06 00 11 00 00 00 00 dd 76"),
    ("01 03 00 37 00 05 34 07", "01 03 0a 00 00 00 00 00 00 00 00 00 00 24 b6"),
]


def test_ezt570i_reads() -> None:
    """Online, loop 1, what is switched on, the alarm words."""
    device = _device(EZT_STATE)
    reading = _chamber(ezt570i, device).read()
    assert (reading.temperature_degC, reading.setpoint_degC, reading.mode) == (23.0, 23.0, "CONSTANT")
    assert (reading.low_limit_degC, reading.high_limit_degC, reading.alarms) == (-40.0, 70.0, ())
    device.finish()


def test_ezt570i_names_its_alarms() -> None:
    """Bit 0 of word 57 is the heater's high limit; nothing is written to register 54."""
    heater = "01 03 0a 00 00 00 00 00 01 00 00 00 00 19 76"
    device = _device([*EZT_STATE[:3], (EZT_STATE[3][0], heater)])
    assert _chamber(ezt570i, device).read().alarms == ("heater high limit",)
    device.finish()


def test_ezt570i_offline_is_not_believed() -> None:
    """Register 0 is 0: its values are frozen."""
    device = _device([(EZT_STATE[0][0], "01 03 02 00 00 b8 44")] * 3)
    with pytest.raises(ProtocolError, match="offline or under maintenance"):
        _chamber(ezt570i, device).read()
    device.finish()


def test_ezt570i_is_switched_with_its_other_events_as_they_were() -> None:
    """Event bit 4 is somebody's dry air."""
    clock = VirtualClock()
    device = _device(
        [
            *EZT_STATE,
            ("01 06 00 16 00 10 69 c2", "01 06 00 16 00 10 69 c2"),
        ]
    )
    controller = ezt570i(MemoryTransport(device, clock, "sim://chamber"), clock)
    controller.state()
    controller.stop(off=True)
    device.finish()


def _exchange(exchanges: list[tuple[str, str]]) -> tuple[ModbusExchange, TranscriptDevice, VirtualClock]:
    device, clock = _device(exchanges), VirtualClock()
    return ModbusExchange(MemoryTransport(device, clock, "sim://chamber"), clock, device="chamber"), device, clock


READ = "01 03 00 64 00 01 c5 d5"
REPLY = "01 03 02 00 fd 79 c5"


@pytest.mark.parametrize(
    "bad",
    [
        "",
        "01 03 02 00 fd 79 c4",  # checksum
        "01 03 02 00",
        "02 03 02 00 fd 3d c5",  # another unit
        "01 03 04 00 fd 00 fd aa 42",  # another length
        "01 83 02 c0 f1",  # refused
        "ff fe 00",
    ],
)
def test_a_read_is_asked_again(bad: str) -> None:
    """After silence, damage, another's reply and a refusal."""
    exchange, device, _ = _exchange([(READ, bad), (READ, REPLY)])
    assert exchange.query(100, 1, list) == [253]
    device.finish()


def test_a_two_wire_adapter_hears_itself() -> None:
    """The request stands before the reply."""
    exchange, device, _ = _exchange([(READ, READ + REPLY)])
    assert exchange.query(100, 1, list) == [253]
    device.finish()


def test_a_write_is_sent_once_whatever_comes_back() -> None:
    """Silence, damage: nobody knows, so the caller reads back."""
    for bad in ("", "01 06 01 2c fe d4 09 c1", "01 06 01"):
        exchange, device, _ = _exchange([("01 06 01 2c fe d4 09 c0", bad)])
        assert exchange.write(300, -300) is False
        device.finish()


def test_silence_is_bounded_and_names_what_to_check() -> None:
    """Three times a second, and the wait for late replies in between."""
    exchange, device, clock = _exchange([(READ, "")] * 3)
    with pytest.raises(DeviceTimeout, match=r"did not answer registers 100 to 100 in 1 s; check .* \(asked 3 times\)"):
        exchange.query(100, 1, list)
    device.finish()
    assert clock.now() < 12.0


def test_a_refusal_is_in_words() -> None:
    """Exception 2 three times."""
    exchange, _, _ = _exchange([(READ, "01 83 02 c0 f1")] * 3)
    with pytest.raises(CommandRefused, match="exception 2: it has no such register"):
        exchange.query(100, 1, list)


@pytest.mark.parametrize("value", [-32769, 65536, 70000])
def test_what_does_not_fit_is_never_wrapped_around(value: int) -> None:
    """70000 would be 4464 on the wire."""
    exchange, device, _ = _exchange([])
    with pytest.raises(ValueError, match="nothing was sent"):
        exchange.write(300, value)
    device.finish()


@pytest.mark.parametrize(
    ("value", "decimals", "register"),
    [
        (100.1, 1, 1001),
        (0.3, 1, 3),
        (-29.7, 1, -297),
        (12.34, 2, 1234),
        (0.29, 2, 29),
        (4.35, 2, 435),
        (-29.72, 1, -297),
        (24.96, 1, 250),
        (25.0, 0, 25),
    ],
)
def test_temperatures_are_rounded_and_not_cut(value: float, decimals: int, register: int) -> None:
    """int(100.1 / 0.1) is 1000, and int(0.29 * 100) is 28."""
    assert encoded(value, "int16", scale=10.0**-decimals) == (register & 0xFFFF,)
    assert decoded([register & 0xFFFF], "int16") == register


def test_a_temperature_that_no_register_holds_is_refused() -> None:
    """3276.8 in tenths."""
    with pytest.raises(ValueError, match="nothing was sent"):
        encoded(3276.8, "int16", scale=0.1)


def test_frames_with_wrong_checksums_are_called_that() -> None:
    """And not silence: somebody will look at the cable's shield and not at its plug."""
    exchange, device, clock = _exchange([(READ, "01 03 02 00 fd 79 c4")] * 3)
    with pytest.raises(ProtocolError, match="a frame with a wrong checksum"):
        exchange.query(100, 1, list)
    device.finish()
    assert clock.now() < 1.0


@pytest.mark.parametrize("delay_s", [1.02, 2.05, 3.03, 3.05, 3.07, 3.5, 4.5])
def test_the_late_reply_to_a_question_that_was_given_up_does_not_answer_another(delay_s: float) -> None:
    """Three late replies of -30.0 °C, and then the mode is asked for: it is 1 and not 65236."""
    faults = [ChamberFault(ChamberFaultKind.LATE, command="read 300", times=3, delay_s=delay_s)]
    device = simulated_f4(ChamberPlant(), setpoint_degC=-30.0, faults=faults)
    clock = VirtualClock()
    exchange = ModbusExchange(MemoryTransport(device, clock, "sim://chamber"), clock, device="chamber")
    with suppress(DeviceTimeout):
        assert exchange.query(300, 1, list) == [65236]
    assert exchange.query(200, 1, list) == [1]
    assert exchange.query(300, 1, list) == [65236]


def test_modbus_tcp_needs_no_wait_for_late_replies() -> None:
    """Its transactions have numbers: a late reply is passed over."""
    faults = [ChamberFault(ChamberFaultKind.LATE, command="read 300", delay_s=1.2)]
    device = simulated_f4(ChamberPlant(), setpoint_degC=-30.0, faults=faults, framing="tcp")
    clock = VirtualClock()
    exchange = ModbusExchange(MemoryTransport(device, clock, "sim://c"), clock, device="chamber", framing="tcp")
    assert exchange.query(300, 1, list) == [65236]
    assert exchange.query(200, 1, list) == [1]
    assert clock.now() < 2.0
