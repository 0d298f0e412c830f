"""Published and computed Modbus frames.

Where the drivers ask for a whole block the frames of a single register are those of the exchange that they use; and so
are those of units without a driver here (the 988 of Watlow's guide, a Binder).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.chambers import ChamberLimits
from drivers.chambers.controller import Controller
from drivers.clock import Clock
from drivers.errors import CommandRefused
from drivers.simulators.chambers.controller import Refusal, SimulatedController
from drivers.simulators.chambers.modbus import ILLEGAL_ADDRESS, ILLEGAL_VALUE, SimulatedModbus
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.transports import Transport
from drivers.transports.modbus import Framing, ModbusExchange, Table, decoded, encoded
from tests.drivers.chambers.shipped import (
    ezt570i,
    simulated_ezt570i,
    simulated_f4,
    simulated_f4t,
    watlow_f4,
    watlow_f4t,
)
from tests.drivers.frames.golden_vectors import Act, Key, Vector

Build = Callable[[], SimulatedController]


class _Bank(SimulatedModbus):
    """A unit of the family with a few registers and no chamber: the 988 of the guide, a Binder."""

    def __init__(self, registers: dict[int, int], **settings: Any) -> None:
        self._known = registers
        super().__init__(ChamberPlant(), **settings)

    def _register(self, address: int, now_s: float, table: Table) -> int:
        if address not in self._known:
            raise Refusal(ILLEGAL_ADDRESS)
        return self._known[address]

    def _set_registers(self, address: int, values: list[int], table: Table) -> None:
        if address not in self._known:
            raise Refusal(ILLEGAL_ADDRESS)
        if (address, values) == (7, [12000]):
            raise Refusal(ILLEGAL_VALUE)
        self._known |= {address + place: value for place, value in enumerate(values)}


def _f4(air: float = 22.0, **settings: Any) -> Build:
    settings = {"limits": ChamberLimits(-40.0, 130.0), "latency_s": 0.0} | settings
    return lambda: simulated_f4(ChamberPlant(ambient_degC=air), **settings)


def _f4t(**settings: Any) -> Build:
    return lambda: simulated_f4t(ChamberPlant(ambient_degC=25.0), latency_s=0.0, **settings)


def _ezt(air: float = 22.0, **settings: Any) -> Build:
    return lambda: simulated_ezt570i(ChamberPlant(ambient_degC=air), latency_s=0.0, **settings)


def _alarmed() -> SimulatedController:
    device = _ezt()()
    device.alarms = ("57.0",)
    return device


def _bank(registers: dict[int, int], **settings: Any) -> Build:
    return lambda: _Bank(dict(registers), latency_s=0.0, **settings)


def _exchange(use: Callable[[ModbusExchange], object], unit: int = 1, framing: Framing = "rtu") -> Act:
    def act(transport: Transport, clock: Clock) -> None:
        use(ModbusExchange(transport, clock, device="chamber", unit=unit, framing=framing))

    return act


def _reads(address: int, *expected: int, unit: int = 1) -> Act:
    def use(exchange: ModbusExchange) -> None:
        assert exchange.query(address, len(expected), list) == list(expected)

    return _exchange(use, unit)


def _reads_float(address: int, expected: float, framing: Framing = "rtu") -> Act:
    def use(exchange: ModbusExchange) -> None:
        assert decoded(exchange.query(address, 2, list), "float32") == expected

    return _exchange(use, framing=framing)


def _is_refused(address: int, value: int, code: int) -> Act:
    def use(exchange: ModbusExchange) -> None:
        with pytest.raises(CommandRefused, match=f"exception {code}"):
            exchange.write(address, value)

    return _exchange(use)


def _does(kind: Callable[[Transport, Clock], Controller], action: Callable[[Any], object]) -> Act:
    return lambda transport, clock: action(kind(transport, clock)) and None


def _sees(kind: Callable[[Transport, Clock], Controller], **expected: object) -> Act:
    def act(transport: Transport, clock: Clock) -> None:
        state = kind(transport, clock).state()
        assert {name: getattr(state, name) for name in expected} == expected

    return act


def _rtu(transport: Transport, clock: Clock) -> Controller:
    return watlow_f4t(transport, clock, framing="rtu")


def _sets(value: float) -> Callable[[Any], object]:
    return lambda driver: driver.write("setpoint", value)


# controller, name in the reference: request, reply, the simulator that gives it, what the driver does
_FRAMES: dict[Key, tuple[str, str, Build, Act | str]] = {
    ("watlow_f4", "read_pv_25.3"): ("010300640001c5d5", "01030200fd79c5", _f4(25.3), _reads(100, 253)),
    ("watlow_f4", "read_pv_-30.0"): ("010300640001c5d5", "010302fed4f87b", _f4(-30.0), _reads(100, 0xFED4)),
    ("watlow_f4", "read_model_5270"): (
        "010300000001840a",
        "0103021496372a",
        _f4(),
        _does(watlow_f4, lambda driver: driver.identify()),
    ),
    ("watlow_f4", "write_sp_-30.0"): (
        "0106012cfed409c0",
        "0106012cfed409c0",
        _f4(),
        _does(watlow_f4, _sets(-30.0)),
    ),
    ("watlow_f4", "write_sp_60.0"): ("0106012c02584965", "0106012c02584965", _f4(), _does(watlow_f4, _sets(60.0))),
    ("watlow_f4", "read_sp"): (
        "0103012c0001443f",
        "010302fed4f87b",
        _f4(setpoint_degC=-30.0),
        _sees(watlow_f4, setpoint=-30.0),
    ),
    ("watlow_f4", "read_limits"): (
        "0103025a0002e5a0",
        "010304fe700514c95f",
        _f4(),
        _sees(watlow_f4, low=-40.0, high=130.0),
    ),
    ("watlow_f4", "read_decimals_1"): (
        "0103025e0001e460",
        "01030200017984",
        _f4(),
        _sees(watlow_f4, temperature=22.0),
    ),
    ("watlow_f4", "event1_on"): (
        "010607d000014887",
        "010607d000014887",
        _f4(),
        _does(watlow_f4, lambda driver: driver.start()),
    ),
    ("watlow_f4", "event1_off"): (
        "010607d000008947",
        "010607d000008947",
        _f4(),
        _does(watlow_f4, lambda driver: driver.stop(off=True)),
    ),
    ("watlow_any", "exc01"): ("010200010002a80b", "0182018160", _f4(), "no driver sends function 2"),
    ("watlow_any", "exc02"): ("0106002d0001d803", "018602c3a1", _f4(), _is_refused(45, 1, 2)),
    ("watlow_any", "exc03"): ("010600072ee02423", "0186030261", _bank({7: 0}), _is_refused(7, 12000, 3)),
    ("watlow_988", "read_1_2_addr5"): (
        "050300010002944f",
        "050304006400c8ffba",
        _bank({1: 100, 2: 200}, address=5),
        _reads(1, 100, 200, unit=5),
    ),
    ("watlow_988", "write_7_addr9"): (
        "0906000700c838d5",
        "0906000700c838d5",
        _bank({7: 0}, address=9),
        _exchange(lambda exchange: exchange.write(7, 200), unit=9),
    ),
    ("watlow_f4t_rtu", "read_pv_25"): (
        "01030b04000287ee",
        "010304000041c8cbf5",
        _f4t(framing="rtu"),
        _sees(_rtu, temperature=25.0),
    ),
    ("watlow_f4t_rtu", "write_sp_-30"): (
        "01100ade0002040000c1f0500b",
        "01100ade0002222a",
        _f4t(framing="rtu"),
        _does(_rtu, _sets(-30.0)),
    ),
    ("watlow_f4t_tcp", "read_pv_25"): (
        "00010000000601030b040002",
        "000100000007010304000041c8",
        _f4t(),
        _reads_float(2820, 25.0, "tcp"),  # as the first transaction, whose number is in the frame
    ),
    ("watlow_f4t_tcp", "write_sp_-30"): (
        "00010000000b01100ade0002040000c1f0",
        "00010000000601100ade0002",
        _f4t(),
        _does(watlow_f4t, _sets(-30.0)),
    ),
    ("ezt570i", "read_pv"): ("0103003d000115c6", "01030200ecb9c9", _ezt(23.6), _reads(61, 236)),
    ("ezt570i", "read_sp_pv"): (
        "0103003c00020407",
        "01030401900148fa44",
        _ezt(32.8, setpoint_degC=40.0),
        _reads(60, 400, 328),
    ),
    ("ezt570i", "write_sp_20"): ("0106003c00c84850", "0106003c00c84850", _ezt(), _does(ezt570i, _sets(20.0))),
    ("ezt570i", "write_sp_-30"): ("0106003cfed409f9", "0106003cfed409f9", _ezt(), _does(ezt570i, _sets(-30.0))),
    ("ezt570i", "chamber_on"): (
        "010600160001a9ce",
        "010600160001a9ce",
        _ezt(),
        _does(ezt570i, lambda driver: driver.start()),
    ),
    ("ezt570i", "chamber_off"): (
        "010600160000680e",
        "010600160000680e",
        _ezt(),
        _does(ezt570i, lambda driver: driver.stop(off=True)),
    ),
    ("ezt570i", "alarms_none"): (
        "0103003700053407",
        "01030a0000000000000000000024b6",
        _ezt(),
        _sees(ezt570i, alarms=()),
    ),
    ("ezt570i", "alarms_heater_high_limit"): (
        "0103003700053407",
        "01030a000000000001000000001976",
        _alarmed,
        _sees(ezt570i, alarms=("heater high limit",)),
    ),
    ("binder_mk53", "read_pv_25"): (
        "010311a900021117",
        "010304000041c8cbf5",
        _bank({0x11A9: 0, 0x11AA: 0x41C8}),
        _reads_float(0x11A9, 25.0),
    ),
    ("binder_mk53", "write_man_sp_-30"): (
        "011015810002040000c1f09947",
        "01101581000215ec",
        _bank({0x1581: 0, 0x1582: 0}),
        _exchange(lambda exchange: exchange.write(0x1581, *encoded(-30.0, "float32"))),
    ),
}
MODBUS: dict[Key, Vector] = {
    key: Vector(bytes.fromhex(request), bytes.fromhex(reply), simulator, driver)
    for key, (request, reply, simulator, driver) in _FRAMES.items()
}
