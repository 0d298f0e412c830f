"""Published and computed Modbus frames, literally: what the drivers send and understand, and what simulators answer."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.chamber import ChamberLimits
from drivers.clock import VirtualClock
from drivers.errors import CommandRefused
from drivers.modbus_exchange import Framing, ModbusExchange, float_of, registers_of
from drivers.simulators.chamber_plant import ChamberPlant
from drivers.simulators.controller import Refusal, SimulatedController
from drivers.simulators.ezt570i import SimulatedEzt570i
from drivers.simulators.memory import MemoryTransport
from drivers.simulators.modbus import ILLEGAL_ADDRESS, ILLEGAL_VALUE, SimulatedModbus
from drivers.simulators.transcript import TranscriptDevice
from drivers.simulators.watlow_f4 import SimulatedWatlowF4

Act = Callable[[ModbusExchange], object]


class _Bank(SimulatedModbus):
    """A unit of the family with a few registers and no chamber: the 988 of the guide, a Binder, an F4T."""

    def __init__(self, registers: dict[int, int], **settings: Any) -> None:
        self._known = registers
        super().__init__(ChamberPlant(), **settings)

    def _register(self, address: int, now_s: float) -> int:
        if address not in self._known:
            raise Refusal(ILLEGAL_ADDRESS)
        return self._known[address]

    def _set_register(self, address: int, value: int) -> None:
        if address not in self._known:
            raise Refusal(ILLEGAL_ADDRESS)
        if address == 7 and value == 12000:
            raise Refusal(ILLEGAL_VALUE)
        self._known[address] = value


def _f4(air: float = 22.0, **settings: Any) -> SimulatedController:
    settings = {"limits": ChamberLimits(-40.0, 130.0), "latency_s": 0.0} | settings
    return SimulatedWatlowF4(ChamberPlant(ambient_degC=air), **settings)


def _ezt(air: float = 22.0, **settings: Any) -> SimulatedController:
    return SimulatedEzt570i(ChamberPlant(ambient_degC=air), latency_s=0.0, **settings)


def _alarmed() -> SimulatedController:
    device = _ezt()
    device.alarms = ("32",)
    return device


def _bank(registers: dict[int, int], **settings: Any) -> Callable[[], SimulatedController]:
    return lambda: _Bank(dict(registers), latency_s=0.0, **settings)


def _read(address: int, *expected: int) -> Act:
    def act(exchange: ModbusExchange) -> None:
        assert exchange.read(address, len(expected)) == list(expected)

    return act


def _write(address: int, value: int) -> Act:
    def act(exchange: ModbusExchange) -> None:
        assert exchange.write(address, value) is True

    return act


def _refused(address: int, value: int, code: int) -> Act:
    def act(exchange: ModbusExchange) -> None:
        with pytest.raises(CommandRefused, match=f"exception {code}"):
            exchange.write(address, value)

    return act


def _read_float(address: int, expected: float) -> Act:
    def act(exchange: ModbusExchange) -> None:
        assert float_of(exchange.read(address, 2)) == expected

    return act


def _write_float(address: int, value: float) -> Act:
    def act(exchange: ModbusExchange) -> None:
        assert exchange.write_several(address, registers_of(value)) is True

    return act


PV_25 = {2820: 0x0000, 2821: 0x41C8, 2782: 0, 2783: 0}

# controller, name in the reference: request, reply, what the simulator is, what the driver does
GOLDEN: dict[tuple[str, str], tuple[str, str, Callable[[], SimulatedController], Act]] = {
    ("watlow_f4", "read_pv_25.3"): ("010300640001c5d5", "01030200fd79c5", lambda: _f4(25.3), _read(100, 253)),
    ("watlow_f4", "read_pv_-30.0"): ("010300640001c5d5", "010302fed4f87b", lambda: _f4(-30.0), _read(100, 0xFED4)),
    ("watlow_f4", "read_model_5270"): ("010300000001840a", "0103021496372a", _f4, _read(0, 5270)),
    ("watlow_f4", "write_sp_-30.0"): ("0106012cfed409c0", "0106012cfed409c0", _f4, _write(300, -300)),
    ("watlow_f4", "write_sp_60.0"): ("0106012c02584965", "0106012c02584965", _f4, _write(300, 600)),
    ("watlow_f4", "read_sp"): (
        "0103012c0001443f",
        "010302fed4f87b",
        lambda: _f4(setpoint_degC=-30.0),
        _read(300, 0xFED4),
    ),
    ("watlow_f4", "read_limits"): ("0103025a0002e5a0", "010304fe700514c95f", _f4, _read(602, 0xFE70, 1300)),
    ("watlow_f4", "read_decimals_1"): ("0103025e0001e460", "01030200017984", _f4, _read(606, 1)),
    ("watlow_f4", "event1_on"): ("010607d000014887", "010607d000014887", _f4, _write(2000, 1)),
    ("watlow_f4", "event1_off"): ("010607d000008947", "010607d000008947", _f4, _write(2000, 0)),
    ("watlow_any", "exc02"): ("0106002d0001d803", "018602c3a1", _f4, _refused(45, 1, 2)),
    ("watlow_any", "exc03"): ("010600072ee02423", "0186030261", _bank({7: 0}), _refused(7, 12000, 3)),
    ("watlow_988", "read_1_2_addr5"): (
        "050300010002944f",
        "050304006400c8ffba",
        _bank({1: 100, 2: 200}, address=5),
        _read(1, 100, 200),
    ),
    ("watlow_988", "write_7_addr9"): ("0906000700c838d5", "0906000700c838d5", _bank({7: 0}, address=9), _write(7, 200)),
    ("watlow_f4t_rtu", "read_pv_25"): (
        "01030b04000287ee",
        "010304000041c8cbf5",
        _bank(PV_25),
        _read_float(2820, 25.0),
    ),
    ("watlow_f4t_rtu", "write_sp_-30"): (
        "01100ade0002040000c1f0500b",
        "01100ade0002222a",
        _bank(PV_25),
        _write_float(2782, -30.0),
    ),
    ("watlow_f4t_tcp", "read_pv_25"): (
        "00010000000601030b040002",
        "000100000007010304000041c8",
        _bank(PV_25, framing="tcp"),
        _read_float(2820, 25.0),
    ),
    ("watlow_f4t_tcp", "write_sp_-30"): (
        "00010000000b01100ade0002040000c1f0",
        "00010000000601100ade0002",
        _bank(PV_25, framing="tcp"),
        _write_float(2782, -30.0),
    ),
    ("ezt570i", "read_pv"): ("0103003d000115c6", "01030200ecb9c9", lambda: _ezt(23.6), _read(61, 236)),
    ("ezt570i", "read_sp_pv"): (
        "0103003c00020407",
        "01030401900148fa44",
        lambda: _ezt(32.8, setpoint_degC=40.0),
        _read(60, 400, 328),
    ),
    ("ezt570i", "write_sp_20"): ("0106003c00c84850", "0106003c00c84850", _ezt, _write(60, 200)),
    ("ezt570i", "write_sp_-30"): ("0106003cfed409f9", "0106003cfed409f9", _ezt, _write(60, -300)),
    ("ezt570i", "chamber_on"): ("010600160001a9ce", "010600160001a9ce", _ezt, _write(22, 1)),
    ("ezt570i", "chamber_off"): ("010600160000680e", "010600160000680e", _ezt, _write(22, 0)),
    ("ezt570i", "alarms_none"): (
        "0103003700053407",
        "01030a0000000000000000000024b6",
        _ezt,
        _read(55, 0, 0, 0, 0, 0),
    ),
    ("ezt570i", "alarms_heater_high_limit"): (
        "0103003700053407",
        "01030a000000000001000000001976",
        _alarmed,
        _read(55, 0, 0, 1, 0, 0),
    ),
    ("binder_mk53", "read_pv_25"): (
        "010311a900021117",
        "010304000041c8cbf5",
        _bank({0x11A9: 0, 0x11AA: 0x41C8}),
        _read_float(0x11A9, 25.0),
    ),
    ("binder_mk53", "write_man_sp_-30"): (
        "011015810002040000c1f09947",
        "01101581000215ec",
        _bank({0x1581: 0, 0x1582: 0}),
        _write_float(0x1581, -30.0),
    ),
}

# The driver never sends function 2, so only the simulator can show this one.
SIMULATOR_ONLY = {("watlow_any", "exc01"): ("010200010002a80b", "0182018160", _f4)}
CONTROLLERS = {controller for controller, _ in GOLDEN}


@pytest.mark.parametrize("key", [*GOLDEN, *SIMULATOR_ONLY], ids="-".join)
def test_simulators_answer_golden_frames(key: tuple[str, str]) -> None:
    """Byte for byte, checksum included."""
    request, reply, device = (GOLDEN[key][:3]) if key in GOLDEN else SIMULATOR_ONLY[key]
    simulated = device()
    simulated.receive(bytes.fromhex(request), 0.0)
    assert simulated.transmit(0.0).hex() == reply


@pytest.mark.parametrize("key", GOLDEN, ids="-".join)
def test_the_driver_sends_and_understands_golden_frames(key: tuple[str, str]) -> None:
    """The exchange makes these very bytes and takes the reply for what it says."""
    request, reply, _, act = GOLDEN[key]
    framing: Framing = "tcp" if key[0].endswith("tcp") else "rtu"
    exchanges = [(bytes.fromhex(request), bytes.fromhex(reply))]
    unit = 5 if "addr5" in key[1] else 9 if "addr9" in key[1] else 1
    device, clock = TranscriptDevice(exchanges), VirtualClock()
    exchange = ModbusExchange(
        MemoryTransport(device, clock, "sim://chamber"), clock, device="chamber", unit=unit, framing=framing
    )
    act(exchange)
    device.finish()


def test_the_golden_frames_are_all_of_the_reference(reference: Path) -> None:
    """No vector of these controllers is left out, and none was copied wrongly."""
    vectors = json.loads((reference / "chambers_golden.json").read_text(encoding="utf-8"))
    expected = {
        (vector["controller"], vector["name"]): (vector["tx_hex"], vector["rx_hex"])
        for vector in vectors
        if vector["controller"] in CONTROLLERS
    }
    ours = {key: (row[0], row[1]) for key, row in GOLDEN.items()}
    ours |= {key: (row[0], row[1]) for key, row in SIMULATOR_ONLY.items()}
    assert ours == expected
