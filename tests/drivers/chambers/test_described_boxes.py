"""Boxes that speak frames, silence or Modbus: their bytes, written down; servers by others; and bad descriptions.

The descriptions that ship are held to the conventions in tests/drivers/test_driver_conventions.py, which looks for
their names in the tests with transcripts.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import minimalmodbus
import pytest
import yaml
from pymodbus import FramerType

from drivers.chambers import ChamberLimits, SafeState
from drivers.chambers.controllers.described import SetpointBox
from drivers.chambers.controllers.description import BoxDescription, load_box, parse_box
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import SystemClock, VirtualClock
from drivers.errors import CommandRefused, InputError, ProtocolError, WrongDevice
from drivers.simulators.chambers.described import SimulatedRegisterBox, simulated_box
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport
from drivers.simulators.serve import DeviceServer
from drivers.transports import open_port
from tests.drivers.chambers.chamber_benches import EXAMPLE_BOX, ChamberBench
from tests.drivers.chambers.modbus_peer import modbus_server
from tests.drivers.chambers.shipped import shipped
from tests.drivers.simulators.running import running
from tests.drivers.transcript import TranscriptDevice

LIMITS = ChamberLimits(-35.0, 65.0)
HOLD, OFF = SafeState("hold", 25.0), SafeState("off")


def _box(name: str) -> BoxDescription:
    return load_box(EXAMPLE_BOX.with_name(f"{name}.yaml"))


def _chamber(box: BoxDescription, device: Any, safe: SafeState = HOLD) -> SupervisedChamber:
    clock = VirtualClock()
    controller = SetpointBox(MemoryTransport(device, clock, "sim://chamber"), clock, box)
    return SupervisedChamber(controller, clock, Supervision(limits=LIMITS, safe=safe, celsius_confirmed=True))


def _transcript(exchanges: Sequence[tuple[bytes | str, bytes | str]]) -> TranscriptDevice:
    both = [tuple(bytes.fromhex(each) if isinstance(each, str) else each for each in pair) for pair in exchanges]
    return TranscriptDevice([(request, reply) for request, reply in both])


# The published question; a reply with the places of a public client, its checks summed up by hand.
SB22_ASK = b"\x021?8E\x03"
SB22_AT_20 = b"\x021T023.0F45P        --T020.0F00R1100000000000000      2F\x03"
SB22_AT_MINUS_29 = b"\x021T023.0F45P        --T-29.7F00R1100000000000000      22\x03"


def test_weiss_sb22_sets_a_temperature_in_frames_with_a_check() -> None:
    """One question tells everything; the switch is written back as it was read."""
    device = _transcript(
        [
            (SB22_ASK, SB22_AT_20),
            (SB22_ASK, SB22_AT_20),
            (b"\x021T-29.7F00R110000000000000082\x03", b"\x021\x06C7\x03"),
            (SB22_ASK, SB22_AT_MINUS_29),
        ]
    )
    _chamber(_box("weiss-sb22"), device, OFF).set_temperature(-29.72)
    device.finish()


def test_weiss_sb22_with_a_wrong_check_is_not_believed_and_asked_again() -> None:
    """One bit of the temperature: 027.0 instead of 023.0."""
    device = _transcript([(SB22_ASK, SB22_AT_20.replace(b"023.0", b"027.0")), (SB22_ASK, SB22_AT_20)])
    reading = _chamber(_box("weiss-sb22"), device, OFF).read()
    assert (reading.temperature_degC, reading.setpoint_degC, reading.mode) == (23.0, 20.0, "CONSTANT")
    device.finish()


def test_eurotherm_answers_each_kind_of_text_in_its_own_frame() -> None:
    """Mnemonics of its handbook at address 1; checks worked out by hand, one of them nought and one that is ENQ."""
    low, high = (b"\x040011LS\x05", b"\x02LS-40.0\x03+"), (b"\x040011HS\x05", b"\x02HS70.0\x03\x01")
    temperature = (b"\x040011PV\x05", b"\x02PV22.0\x03\x1b")
    before, after = ((b"\x040011SL\x05", reply) for reply in (b"\x02SL20.0\x03\x00", b"\x02SL25.0\x03\x05"))
    told = (b"\x040011\x02SL25.0\x03\x05", b"\x06")
    device = _transcript([temperature, before, low, high] * 2 + [told, temperature, after, low, high])
    _chamber(_box("eurotherm"), device).set_temperature(25.0)
    device.finish()
    unknown = _transcript([(temperature[0], b"\x04")] * 3)
    with pytest.raises(CommandRefused, match="refused 'PV' with code EOT; it does not know this mnemonic"):
        _chamber(_box("eurotherm"), unknown).read()


def test_the_address_of_a_bench_file_is_used_or_refused() -> None:
    """In frames, in texts and in Modbus; a simulated one of another address does not answer."""
    path = EXAMPLE_BOX.with_name("eurotherm.yaml")
    device = simulated_box(ChamberPlant(), load_box(path, address=12))
    device.receive(b"\x040011PV\x05" + b"\x041122PV\x05" + b"\x041122\x02SL25.0\x03\x05" + b"\x041122SL\x05", 0.0)
    assert device.transmit(9.0) == b"\x02PV22.0\x03\x1b\x06\x02SL25.0\x03\x05"
    assert load_box(path.with_name("weiss-sb22.yaml"), address=2).temperature.ask == "2?"
    modbus = load_box(path.with_name("binder-mk53.yaml"), address=7).modbus
    assert modbus is not None
    assert modbus.address == 7
    with pytest.raises(InputError, match=r"cts\.yaml: there is no \{address\} in its texts; leave address out"):
        load_box(path.with_name("cts.yaml"), address=2)
    with pytest.raises(InputError, match="address: Unknown format code 'q'"):
        parse_box(yaml.safe_dump(TEXT | {"temperature": {"ask": "{address:q}"}}), "box.yaml")


def test_cts_needs_no_terminator() -> None:
    """Its replies have lengths; what a short one lacks is waited for, and the rest of a long one answers nothing."""
    device = _transcript(
        [(b"A0", b"A0 023.0 020.0")] * 2 + [(b"a0 -29.7", b"a"), (b"A0", b"A0 023.0 -29.7")],
    )
    _chamber(_box("cts"), device).set_temperature(-29.72)
    device.finish()


def test_binder_mk53_writes_its_setpoint_wherever_it_is_entered() -> None:
    """Manual and basic operation; read back where the controller follows it. The reference's frames, and its rule."""
    temperature = ("01 03 11 a9 00 02 11 17", "01 03 04 00 00 41 c8 cb f5")
    before, after = (
        ("01 03 10 77 00 02 70 d1", reply) for reply in ("01 03 04 00 00 41 a0 ca 1b", "01 03 04 00 00 c1 f0 ab e7")
    )
    writes = [
        ("01 10 15 81 00 02 04 00 00 c1 f0 99 47", "01 10 15 81 00 02 15 ec"),
        ("01 10 15 6f 00 02 04 00 00 c1 f0 16 83", "01 10 15 6f 00 02 75 d9"),
    ]
    device = _transcript([temperature, before, temperature, before, *writes, temperature, after])
    _chamber(_box("binder-mk53"), device).set_temperature(-30.0)
    device.finish()


def test_watlow_ez_zone_is_switched_by_its_control_mode() -> None:
    """62 is off; what is read is the active mode, 1882. Computed from the rule."""
    auto = [
        ("01 03 01 6a 00 01 a5 ea", "01 03 02 00 3d 79 95"),
        ("01 03 01 68 00 02 44 2b", "01 03 04 00 00 41 c8 cb f5"),
        ("01 03 08 70 00 02 c7 b0", "01 03 04 00 00 41 a0 ca 1b"),
        ("01 03 07 5a 00 01 a5 6d", "01 03 02 00 0a 38 43"),
    ]
    off = [*auto[:3], (auto[3][0], "01 03 02 00 3e 39 94")]
    device = _transcript([*auto, *auto, ("01 06 07 58 00 3e 88 bd", "01 06 07 58 00 3e 88 bd"), *off])
    _chamber(_box("watlow-ez-zone"), device, OFF).safe_state()
    device.finish()


def test_a_setpoint_only_box_must_hold() -> None:
    """It cannot be stopped over the line, and a safe state that would is refused at once."""
    with pytest.raises(ValueError, match="cannot be stopped over the line"):
        _chamber(_box("cts"), simulated_box(ChamberPlant(), _box("cts")), OFF)


# A plant controller with everything that Modbus has: input registers, coils, discrete inputs, 32 bits, high word first.
PLC: dict[str, Any] = {
    "name": "plc",
    "verified": "nothing",
    "modbus": {"type": "int32", "scale": 0.01, "words": "high first", "writes": "several"},
    "identify": {"register": 9, "expect": 77, "model": "PLC {value}"},
    "unit": {"register": 3, "table": "discrete", "celsius": 0, "fahrenheit": 1},
    "temperature": {"register": 0, "table": "input"},
    "setpoint": {"register": 0},
    "low_limit": {"register": 2, "type": "int16", "scale": 0.1},
    "high_limit": {"register": 3, "type": "int16", "scale": 0.1},
    "state": {"register": 5, "table": "coil", "modes": {0: "OFF", 1: "CONSTANT"}},
    "start": {"register": 5, "table": "coil", "value": 1},
    "stop": {"register": 5, "table": "coil", "value": 0},
    "alarms": [
        {"register": 8, "table": "input", "bits": {0: "door", 3: "fan"}, "name": "alarm {value}"},
        {"register": 6, "table": "discrete", "name": "emergency stop"},
    ],
    "ramp_degC_per_min": {"register": 10, "type": "uint16", "scale": 0.1},
}


def _plc(**changes: Any) -> BoxDescription:
    return parse_box(yaml.safe_dump(PLC | changes), "plc.yaml")


def _words(value: int) -> list[int]:
    high, low = struct.unpack(">HH", struct.pack(">i", value))
    return [high, low]


def test_all_four_tables_are_read_and_written_on_pymodbus_server() -> None:
    """Input and holding registers of the same number are two; a coil switches; what is written is high word first."""
    clock = SystemClock()
    high, low = _words(2000)
    holding = {0: high, 1: low, 2: -400, 3: 700, 9: 77, 10: 0}
    inputs = {0: 0xFFFF, 1: (-3000) & 0xFFFF, 8: 0b1010}
    with modbus_server(holding, FramerType.RTU, inputs=inputs, coils=[0] * 8, discretes=[0] * 8) as url:
        port = open_port(url, clock=clock)
        controller = SetpointBox(port, clock, _plc(timeout_s=2.0, pause_after_question_s=0.001))
        try:
            assert controller.identify().model == "PLC 77"
            state = controller.state()
            assert (state.temperature, state.setpoint, state.low, state.high) == (-30.0, 20.0, -40.0, 70.0)
            assert (state.mode, state.alarms, state.unit) == ("OFF", ("alarm bit 1", "fan"), "degC")
            controller.start()
            controller.write("setpoint", -29.7)
            assert (controller.state().mode, controller.state().setpoint) == ("CONSTANT", -29.7)
            assert controller.set_ramp_rate(2.5) is True
        finally:
            port.close()


def test_a_simulated_plc_keeps_its_tables_apart() -> None:
    """A night's work, and an alarm by the number of its register and bit."""
    device = simulated_box(ChamberPlant(), _plc(), limits=ChamberLimits(-75.0, 185.0))
    clock = VirtualClock()
    controller = SetpointBox(MemoryTransport(device, clock, "sim://plc"), clock, _plc())
    chamber = SupervisedChamber(controller, clock, Supervision(limits=LIMITS, safe=OFF))
    chamber.prepare()
    chamber.set_temperature(-29.7)
    clock.sleep(3600.0)
    assert chamber.read().temperature_degC == pytest.approx(-29.7, abs=0.1)
    device.alarms = ("8.3", "6")
    assert chamber.read().alarms == ("fan", "emergency stop")
    chamber.safe_state()
    assert device.mode == "OFF"


def test_a_status_word_may_tell_state_and_alarms_and_off_needs_no_quotes() -> None:
    """Each alarm by its own bit, as in an Omron E5CC; YAML reads an unquoted OFF as false."""
    box = _plc(
        state={"register": 20, "bit": 8, "modes": {0: "CONSTANT", 1: False}},
        start={"register": 21, "value": 256},
        stop={"register": 21, "value": 257},
        alarms={"register": 20, "bit": 6, "name": "sensor error"},
    )
    device = simulated_box(ChamberPlant(), box, limits=ChamberLimits(-75.0, 185.0))
    chamber = _chamber(box, device, OFF)
    chamber.prepare()
    assert (chamber.read().mode, chamber.read().alarms) == ("CONSTANT", ())
    chamber.safe_state()
    assert chamber.read().mode == "OFF"
    device.alarms = ("20",)
    assert (chamber.read().mode, chamber.read().alarms) == ("OFF", ("sensor error",))


def test_another_number_is_another_box() -> None:
    """In the description's own words where it has some."""
    device = simulated_box(ChamberPlant(), _plc(identify=PLC["identify"] | {"expect": 78}))
    with pytest.raises(WrongDevice, match=r"chamber on sim://chamber says it is '78', its description expects '77'"):
        _chamber(_plc(), device, OFF).identify()


def test_limits_the_wrong_way_round_are_another_controllers() -> None:
    """A map that does not fit shows in what it reads."""
    device = SimulatedRegisterBox(ChamberPlant(), shipped("ezt-570i"), limits=ChamberLimits(70.0, -40.0))
    with pytest.raises(ProtocolError, match="a lower setpoint limit above its upper one; check that the bench file"):
        _chamber(shipped("ezt-570i"), device, OFF).identify()


@pytest.mark.parametrize(
    ("name", "registers"),
    [
        ("watlow-f4t", [*range(31), 2784, 2785, 2810, 2811, 14664, 16594, 33718]),
        ("watlow-f4", [0, 103, 107, *range(1916, 1922), 1925, 2010, 2070]),
    ],
)
def test_what_public_clients_read_is_answered(name: str, registers: list[int]) -> None:
    """By minimalmodbus: identity, clock, power and event outputs, which our drivers do not ask."""
    device = SimulatedRegisterBox(ChamberPlant(), shipped(name, "rtu"), latency_s=0.0)
    with running(DeviceServer({"chamber": device}, SystemClock())) as server:
        client = minimalmodbus.Instrument(server.urls["chamber"], 1)
        client.serial.timeout = 5.0
        try:
            for register in registers:
                assert client.read_register(register) >= 0
        finally:
            client.serial.close()


@pytest.mark.parametrize(("name", "guards"), [("watlow-f4", True), ("watlow-f4t", True), ("ezt-570i", False)])
def test_a_simulated_controller_guards_its_limits_where_the_real_one_does(name: str, guards: bool) -> None:
    """Exception 3 beyond them; the EZT-570i takes what it is told over the line."""
    device = SimulatedRegisterBox(ChamberPlant(), shipped(name), limits=ChamberLimits(-40.0, 70.0))
    clock = VirtualClock()
    controller = SetpointBox(MemoryTransport(device, clock, "sim://chamber"), clock, shipped(name))
    if guards:
        with pytest.raises(CommandRefused, match="exception 3"):
            controller.write("setpoint", 80.0)
    else:
        controller.write("setpoint", 80.0)
    assert device.setpoint_degC == (23.0 if guards else 80.0)


def test_an_f4_that_measures_no_temperature_is_refused() -> None:
    """Register 608 is 1: relative humidity."""
    device = SimulatedRegisterBox(ChamberPlant(), shipped("watlow-f4"))
    device._box = shipped("watlow-f4").model_copy(
        update={"identify": shipped("watlow-f4").identify.model_copy(update={"requires": ()})}
    )
    device.registers[608] = 1
    with pytest.raises(WrongDevice, match="measures no temperature on channel 1; set its input up at its panel"):
        _chamber(shipped("watlow-f4"), device, OFF).identify()


TEXT: dict[str, Any] = {
    "name": "oven",
    "verified": "nothing",
    "identify": {"model": "oven"},
    "temperature": {"ask": "T?"},
    "setpoint": {"ask": "S?", "send": "S={value:.1f}"},
}


@pytest.mark.parametrize(
    ("base", "changes", "message"),
    [
        (PLC, {"modbus": {"words": "big"}}, "box.yaml: modbus.words: 'big' is not allowed; allowed: 'low first' or"),
        (PLC, {"modbus": {"reads": ["5-2"]}}, "box.yaml: modbus.reads.0: '5-2' must be a register, such as 300, or"),
        (PLC, {"modbus": None}, "box.yaml: identify: a box with registers needs a section modbus"),
        (PLC, {"temperature": {"register": 70000}}, "box.yaml: temperature.register: must be at most 65535, not 70000"),
        (PLC, {"temperature": {"register": 1, "type": "int8"}}, "box.yaml: temperature.type: 'int8' is not allowed"),
        (PLC, {"temperature": {"ask": "T?"}}, "box.yaml: temperature: a box with a section modbus has registers"),
        (
            PLC,
            {"unit": {"register": 3, "celsius": 1, "fahrenheit": 1}},
            "box.yaml: unit.fahrenheit: 1 means °C too; one",
        ),
        (PLC, {"low_limit": {"register": 1}}, "box.yaml: low_limit: register 1 belongs to setpoint; two numbers"),
        (PLC, {"temperature": {"register": 1, "table": "coil"}}, "box.yaml: temperature: a coil holds a bit and no"),
        (PLC, {"start": PLC["stop"]}, "box.yaml: start: it tells what stop tells"),
        (PLC, {"start": {"send": "GO"}}, "box.yaml: start: a box with a section modbus has registers and no texts"),
        (
            PLC,
            {"state": PLC["state"] | {"register": 8, "table": "input", "bit": 5}},
            "box.yaml: alarms: register 8 tells the state too; give each alarm its own bit",
        ),
        (PLC, {"address": 2}, "box.yaml: address: a box with a section modbus has it there"),
        (PLC, {"stop": {"value": 1}}, "box.yaml: stop: say how it is told: send, or register and value"),
        (
            PLC,
            {"temperature": {"scale": 0.1}},
            "box.yaml: temperature: say how it is asked: ask and reply, or register",
        ),
        (PLC, {"alarms": {"register": 8, "bits": {16: "x"}}}, "box.yaml: alarms.bits.16"),
        (TEXT, {"start": {"send": "GO"}}, "box.yaml: give state, start and stop; or none of them"),
        (TEXT, {"frame": {"parts": ["STX", "text", "EXT"]}}, "box.yaml: frame: 'EXT' is no part of a frame; there are"),
        (TEXT, {"frame": {"parts": ["STX", "text"]}}, "box.yaml: frame: a frame begins with a control character"),
        (
            TEXT,
            {"frame": {"parts": ["STX", "text", "check", "ETX"]}},
            "box.yaml: frame: a frame has the part text once",
        ),
        (
            TEXT,
            {"frame": {"parts": ["STX", "text", "check", "ETX"], "check": {"by": "xor", "over": ["text"]}}},
            "box.yaml: frame: a check that is a byte comes last",
        ),
        (
            TEXT,
            {"frame": {"parts": ["STX", "text", "ETX", "check"], "check": {"by": "crc", "over": ["text"]}}},
            "box.yaml: frame.check.by: 'crc' is not allowed; allowed: 'xor' or 'sum'",
        ),
        (
            TEXT,
            {"identify": {}},
            "box.yaml: identify: say how it is asked: ask and reply, or register; or give its model",
        ),
    ],
)
def test_a_wrong_description_is_one_sentence_that_names_file_and_key(
    base: dict[str, Any], changes: dict[str, Any], message: str
) -> None:
    """So that somebody who has a manual and no driver can write one."""
    with pytest.raises(InputError) as refusal:
        parse_box(yaml.safe_dump(base | changes), "box.yaml")
    assert str(refusal.value).startswith(message)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "question"),
    [
        ("espec", b"MON?\r\n"),
        ("simserv", b"11004\xb61\xb61\r"),
        ("thermotron", b"PVAR1?\r"),
        ("box", b"TEMP?\n"),
    ],
)
def test_impatience_would_be_noticed(name: str, question: bytes) -> None:
    """The simulators ignore what comes too early, so the pauses of a description are proven, not assumed."""
    bench = ChamberBench(name)
    bench.chamber.identify()
    assert bench.device.ignored_requests == 0
    bench.transport.write(question)
    assert bench.device.ignored_requests == 1
