"""Modbus by others: minimalmodbus as the client of our simulators, pymodbus' server as the peer of our drivers."""

from __future__ import annotations

import minimalmodbus
import pytest
from pymodbus import FramerType

from drivers.chambers import ChamberLimits, SafeState
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import SystemClock
from drivers.errors import CommandRefused, WrongDevice
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.serve import DeviceServer
from drivers.transports import open_port
from tests.drivers.chambers.modbus_peer import modbus_server
from tests.drivers.chambers.shipped import simulated_ezt570i, simulated_f4, watlow_f4
from tests.drivers.simulators.running import running

LIMITS = ChamberLimits(-35.0, 65.0)
QUICK = {"timeout_s": 2.0, "pause_after_question_s": 0.001}

# An F4 as a bank of registers: -30.0 °C with setpoint 25.0 °C, switched off.
F4 = {0: 5270, 100: -300} | dict.fromkeys(range(101, 107), 0)
F4 |= {200: 1, 300: 250, 602: -400, 603: 700, 606: 1, 608: 0, 901: 1, 1217: 0, 2000: 0}


def _client(port: str) -> minimalmodbus.Instrument:
    instrument = minimalmodbus.Instrument(port, 1, close_port_after_each_call=False)
    instrument.serial.baudrate = 9600
    instrument.serial.timeout = 5.0
    return instrument


def test_minimalmodbus_reads_and_sets_our_f4() -> None:
    """Scaled, signed reads and writes, a block, and an exception, through a pseudo-terminal."""
    device = simulated_f4(ChamberPlant(ambient_degC=-30.0), latency_s=0.0)
    with running(DeviceServer({"chamber": device}, SystemClock())) as server:
        client = _client(server.urls["chamber"])
        try:
            assert client.read_register(0) == 5270
            assert client.read_register(100, number_of_decimals=1, signed=True) == -30.0
            assert client.read_register(100, number_of_decimals=1, signed=True, functioncode=4) == -30.0
            assert client.read_registers(602, 2) == [65536 - 750, 1850]
            client.write_register(300, -30.5, number_of_decimals=1, signed=True, functioncode=6)
            client.write_registers(602, [65536 - 400, 700])
            client.write_register(2000, 1, functioncode=6)
            client.serial.timeout = 0.3  # a refusal is shorter than what it waits for
            with pytest.raises(minimalmodbus.IllegalRequestError):
                client.read_register(45)
        finally:
            client.serial.close()
    assert (device.setpoint_degC, device.limits, device.mode) == (-30.5, ChamberLimits(-40.0, 70.0), "CONSTANT")


def test_minimalmodbus_reads_and_sets_our_ezt570i() -> None:
    """The manual's own examples, and silence where there is no register."""
    device = simulated_ezt570i(ChamberPlant(ambient_degC=32.8), setpoint_degC=40.0, latency_s=0.0, pause_s=0.0)
    with running(DeviceServer({"chamber": device}, SystemClock())) as server:
        client = _client(server.urls["chamber"])
        try:
            assert client.read_registers(60, 2) == [400, 328]
            client.write_register(60, 20.0, number_of_decimals=1, signed=True, functioncode=6)
            client.serial.timeout = 0.1
            with pytest.raises(minimalmodbus.NoResponseError):
                client.read_register(4000)
        finally:
            client.serial.close()
    assert device.setpoint_degC == 20.0


@pytest.mark.parametrize("framing", ["rtu", "tcp"])
def test_our_f4_driver_works_against_pymodbus_server(framing: str) -> None:
    """RTU as a serial device server carries it, and Modbus TCP: identify, prepare, set, read."""
    clock = SystemClock()
    framer = FramerType.RTU if framing == "rtu" else FramerType.SOCKET
    with modbus_server(F4, framer) as url:
        port = open_port(url, clock=clock)
        controller = watlow_f4(port, clock, framing=framing, **QUICK)
        chamber = SupervisedChamber(controller, clock, Supervision(limits=LIMITS, safe=SafeState("off")))
        try:
            assert chamber.identify().model == "F4"
            chamber.prepare()
            chamber.set_temperature(-29.7222)
            reading = chamber.read()
            assert (reading.temperature_degC, reading.setpoint_degC) == (-30.0, -29.7)
            assert (reading.low_limit_degC, reading.high_limit_degC, reading.mode) == (-40.0, 70.0, "CONSTANT")
            chamber.safe_state()
            assert chamber.read().mode == "OFF"
        finally:
            chamber.close()


def test_our_f4_driver_understands_pymodbus_refusals() -> None:
    """A register that the server does not have is exception 2."""
    clock = SystemClock()
    with modbus_server({0: 5270, 606: 1, 608: 0, 901: 1}, FramerType.RTU) as url:
        port = open_port(url, clock=clock)
        controller = watlow_f4(port, clock, **QUICK)
        try:
            assert controller.identify().unit == "degC"
            with pytest.raises(CommandRefused, match="exception 2: it has no such register"):
                controller.state()
        finally:
            port.close()


def test_another_model_number_is_refused() -> None:
    """The 988 of the same family has number 988."""
    clock = SystemClock()
    with modbus_server({0: 988}, FramerType.RTU) as url:
        port = open_port(url, clock=clock)
        try:
            with pytest.raises(WrongDevice, match="model number 988, an F4 has 5270"):
                watlow_f4(port, clock, **QUICK).identify()
        finally:
            port.close()
