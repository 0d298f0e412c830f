"""The F4T driver: against pymodbus' own server, and its ramp over SCPI."""

from __future__ import annotations

import struct

import pytest
from pymodbus import FramerType

from drivers.chambers import ChamberLimits, SafeState
from drivers.chambers.controllers.watlow_f4t import WatlowF4t
from drivers.chambers.ramp import RampedChamber
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import SystemClock, VirtualClock
from drivers.errors import ProtocolError, WrongDevice
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.chambers.watlow_f4t import SimulatedF4tScpi, SimulatedWatlowF4t
from drivers.simulators.memory import MemoryTransport
from drivers.transports import open_port
from tests.drivers.chambers.modbus_peer import modbus_server
from tests.drivers.chambers.shipped import shipped, simulated_f4t, watlow_f4t
from tests.drivers.transcript import TranscriptDevice

LIMITS = ChamberLimits(-35.0, 65.0)


def _floats(**values: float) -> dict[int, int]:
    registers = {}
    for name, value in values.items():
        high, low = struct.unpack(">HH", struct.pack(">f", value))
        registers |= {int(name[1:]): low, int(name[1:]) + 1: high}
    return registers


def test_our_driver_works_against_pymodbus_server() -> None:
    """Modbus TCP: identify, set, read and switch off. The server has no loop, so its active mode is set beforehand."""
    registers = {0: 124, 1328: 15, 1356: 61, 1456: 61, 1556: 88, 1656: 12, 2730: 10, 2814: 10, 16568: 1782}
    registers |= _floats(r2774=-40.0, r2776=70.0, r2782=20.0, r2820=21.5)
    clock = SystemClock()
    with modbus_server(registers, FramerType.SOCKET) as url:
        controller = watlow_f4t(open_port(url, clock=clock), clock, timeout_s=2.0, pause_after_question_s=0.001)
        chamber = SupervisedChamber(controller, clock, Supervision(limits=LIMITS, safe=SafeState("hold", 25.0)))
        try:
            assert chamber.identify().model == "F4T hardware 124"
            chamber.set_temperature(-29.7222)
            reading = chamber.read()
            assert reading.temperature_degC == 21.5
            assert reading.setpoint_degC == pytest.approx(-29.7, abs=1e-5)
            assert (reading.mode, reading.alarms) == ("CONSTANT", ())
            chamber.safe_state()
            assert chamber.read().setpoint_degC == 25.0
        finally:
            chamber.close()


def _ramped(unit: str = "C") -> tuple[SupervisedChamber, SimulatedWatlowF4t]:
    clock, device = VirtualClock(), simulated_f4t(ChamberPlant())
    scpi = MemoryTransport(SimulatedF4tScpi(device, unit=unit), clock, "sim://scpi")
    controller = watlow_f4t(MemoryTransport(device, clock, "sim://chamber"), clock, ramp_port=scpi)
    return SupervisedChamber(controller, clock, Supervision(limits=LIMITS, safe=SafeState("off"))), device


def test_the_ramp_is_set_over_scpi_and_read_back() -> None:
    """In minutes, for setpoint changes."""
    chamber, device = _ramped()
    assert chamber.set_ramp_rate(2.0) is True
    assert device.ramp == {"RSCALE": "MINUTES", "RRATE": "2.0", "RACTION": "SETPOINT"}


def test_a_ramp_in_fahrenheit_is_refused() -> None:
    """The unit of communication is not that of the panel."""
    chamber, device = _ramped(unit="F")
    with pytest.raises(WrongDevice, match="°F over SCPI"):
        chamber.set_ramp_rate(2.0)
    assert device.ramp["RACTION"] == "OFF"


def test_without_its_scpi_port_there_is_no_native_ramp() -> None:
    """The host steps the setpoint then."""
    clock = VirtualClock()
    port = MemoryTransport(simulated_f4t(ChamberPlant()), clock, "sim://chamber")
    chamber = SupervisedChamber(watlow_f4t(port, clock), clock, Supervision(limits=LIMITS, safe=SafeState("off")))
    assert chamber.set_ramp_rate(2.0) is False


@pytest.mark.parametrize(
    ("rate", "scale", "action", "message"),
    [
        (b"2.5\n", b"MINUTES\n", b"SETPOINT\n", None),
        (b"2.0\n", b"MINUTES\n", b"SETPOINT\n", r"a ramp of 2 per MINUTES on SETPOINT instead of 2\.5"),
        (b"2.5\n", b"HOURS\n", b"SETPOINT\n", r"a ramp of 2\.5 per HOURS"),
        (b"2.5\n", b"MINUTES\n", b"OFF\n", r"on OFF instead"),
    ],
)
def test_the_scpi_transcript(rate: bytes, scale: bytes, action: bytes, message: str | None) -> None:
    """Unit, scale, rate, action, and all three read back: settings are not acknowledged, so one may have been lost."""
    clock = VirtualClock()
    exchanges = [
        (b":UNIT:TEMPERATURE?\n", b"C\n"),
        (b":SOURCE:CLOOP1:RSCALE MINUTES\n", b""),
        (b":SOURCE:CLOOP1:RRATE 2.5\n", b""),
        (b":SOURCE:CLOOP1:RACTION SETPOINT\n", b""),
        (b":SOURCE:CLOOP1:RRATE?\n", rate),
        (b":SOURCE:CLOOP1:RSCALE?\n", scale),
        (b":SOURCE:CLOOP1:RACTION?\n", action),
    ]
    scpi = TranscriptDevice(exchanges)
    port = MemoryTransport(simulated_f4t(ChamberPlant()), clock, "sim://chamber")
    ramp_port = MemoryTransport(scpi, clock, "sim://scpi")
    controller = WatlowF4t(port, clock, shipped("watlow-f4t"), ramp_port=ramp_port)
    if message is None:
        assert controller.set_ramp_rate(2.5) is True
    else:
        with pytest.raises(ProtocolError, match=message):
            controller.set_ramp_rate(2.5)
    scpi.finish()


def test_the_air_moves_no_faster_than_the_ramp() -> None:
    """By the controller: one setpoint is written."""
    clock, plant = VirtualClock(), ChamberPlant()
    device = simulated_f4t(plant)
    scpi = MemoryTransport(SimulatedF4tScpi(device), clock, "sim://scpi")
    controller = watlow_f4t(MemoryTransport(device, clock, "sim://chamber"), clock, ramp_port=scpi)
    chamber = RampedChamber(
        SupervisedChamber(controller, clock, Supervision(limits=LIMITS, safe=SafeState("off"))), clock, degC_per_min=0.5
    )
    chamber.prepare()
    assert chamber.native is True
    chamber.set_temperature(52.0)
    clock.sleep(1800.0)
    assert chamber.read().temperature_degC == pytest.approx(37.0, abs=0.5)
    assert device.setpoint_degC == pytest.approx(52.0)


@pytest.mark.parametrize(
    ("question", "answer"),
    [
        (b":SOURCE:CLOOP1:PVALUE?\n", b"22.0\n"),
        (b":SOURce:CLOop1:PVALue?\n", b"22.0\n"),
        (b":SOURCE:CLOOP1:SPOINT?\r\n", b"23.0\n"),
        (b":SOURCE:CLOOP1:ERROR?\n", b"NONE\n"),
        (b":UNIT:TEMPERATURE:DISPLAY?\n", b"C\n"),
        (b":OUTPUT1:STATE?\n", b"OFF\n"),
        (b"*IDN?\n", b"Watlow Electric,F4T,SIMULATED,04:07:0012\n"),
    ],
)
def test_its_scpi_port_answers_what_public_clients_ask(question: bytes, answer: bytes) -> None:
    """Temperature, setpoint, error, units and output, as they write the questions; the air is left alone."""
    device = simulated_f4t(ChamberPlant(), mode="CONSTANT")
    scpi = SimulatedF4tScpi(device)
    assert device.plant.commanded_degC == 23.0
    device.mode = "OFF"
    scpi.receive(question, 0.0)
    assert scpi.transmit(1.0) == answer
