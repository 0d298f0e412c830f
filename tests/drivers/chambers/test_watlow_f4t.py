"""The F4T driver: against pymodbus' own server, and its ramp."""

from __future__ import annotations

import struct

import pytest
from pymodbus import FramerType

from drivers.chambers import ChamberLimits, SafeState
from drivers.chambers.ramp import RampedChamber
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import SystemClock, VirtualClock
from drivers.errors import ProtocolError
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport
from drivers.transports import open_port
from tests.drivers.chambers.modbus_peer import modbus_server
from tests.drivers.chambers.shipped import simulated_f4t, watlow_f4t
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


def _sent(number: int, words: str) -> bytes:
    """Modbus TCP: the transaction's number, what follows as hex, to unit 1."""
    body = bytes.fromhex(f"01 {words}")
    return struct.pack(">HHH", number, 0, len(body)) + body


RATE = [("10 0A EE 00 02 04 00 00 40 20", "10 0A EE 00 02"), ("03 0A EE 00 02", "03 04 00 00 40 20")]  # 2.5, low first
SCALE = [("06 0A EC 00 39", "06 0A EC 00 39"), ("03 0A EC 00 01", "03 02 00 39")]  # 57: per minute
ACTION = [("06 0A EA 00 55", "06 0A EA 00 55"), ("03 0A EA 00 01", "03 02 00 55")]  # 85: where the setpoint changes


@pytest.mark.parametrize(
    ("exchanges", "message"),
    [
        ([*RATE, *SCALE, *ACTION], None),
        ([RATE[0], (RATE[1][0], "03 04 00 00 40 00")], "reads back 2 where 2.5 was set"),
        ([*RATE, SCALE[0], (SCALE[1][0], "03 02 00 27")], "reads back 39 where 57 was set"),
        ([*RATE, *SCALE, ACTION[0], (ACTION[1][0], "03 02 00 3E")], "reads back 62 where 85 was set"),
        ([*RATE, (SCALE[0][0], "86 02")], "took a part of its ramp only"),
    ],
)
def test_the_ramp_is_a_rate_a_scale_and_an_action(exchanges: list[tuple[str, str]], message: str | None) -> None:
    """All three are read back: where one is not taken the chamber would go as fast as it can."""
    clock = VirtualClock()
    device = TranscriptDevice([(_sent(n, ask), _sent(n, reply)) for n, (ask, reply) in enumerate(exchanges, start=1)])
    controller = watlow_f4t(MemoryTransport(device, clock, "sim://chamber"), clock)
    if message is None:
        assert controller.set_ramp_rate(2.5) is True
    else:
        with pytest.raises(ProtocolError, match=message):
            controller.set_ramp_rate(2.5)
    device.finish()


def test_an_f4t_that_refuses_a_ramp_has_none() -> None:
    """The host steps the setpoint then."""
    clock = VirtualClock()
    device = TranscriptDevice([(_sent(1, RATE[0][0]), _sent(1, "90 02"))])
    controller = watlow_f4t(MemoryTransport(device, clock, "sim://chamber"), clock)
    assert controller.set_ramp_rate(0.04) is False  # finer than it is told: as good as none, and nothing is sent
    assert controller.set_ramp_rate(2.5) is False
    device.finish()


def test_the_air_moves_no_faster_than_the_ramp() -> None:
    """By the controller: one setpoint is written."""
    clock, device = VirtualClock(), simulated_f4t(ChamberPlant())
    controller = watlow_f4t(MemoryTransport(device, clock, "sim://chamber"), clock)
    chamber = RampedChamber(
        SupervisedChamber(controller, clock, Supervision(limits=LIMITS, safe=SafeState("off"))), clock, degC_per_min=0.5
    )
    chamber.prepare()
    assert chamber.native is True
    assert device.settings == {"setting 0.0": 57.0, "setting 0.1": 85.0}
    chamber.set_temperature(52.0)
    clock.sleep(1800.0)
    assert chamber.read().temperature_degC == pytest.approx(37.0, abs=0.5)
    assert device.setpoint_degC == pytest.approx(52.0)
