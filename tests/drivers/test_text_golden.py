"""Published conversations of controllers that speak text: what simulators answer, what drivers send and understand.

ESPEC's are in test_espec_simulator, Modbus in test_modbus_golden; together they are all of the reference, but for what
is listed here with its reason.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.chamber import ChamberLimits
from drivers.clock import VirtualClock
from drivers.controller import Controller
from drivers.julabo import Julabo
from drivers.simserv import SimServ
from drivers.simulators.chamber_plant import ChamberPlant
from drivers.simulators.controller import SimulatedController
from drivers.simulators.julabo import SimulatedJulabo
from drivers.simulators.memory import MemoryTransport
from drivers.simulators.simserv import SimulatedSimServ
from drivers.simulators.thermotron import SimulatedThermotron
from drivers.simulators.transcript import TranscriptDevice
from drivers.simulators.voetsch_ascii import SimulatedVoetschAscii
from drivers.thermotron import Thermotron
from drivers.voetsch_ascii import VoetschAscii

MANUAL_READ = (
    b"0010.0 0011.2 0000.0 0011.2 0000.0 0011.2 0000.0 0011.2 0000.0 0011.2 0101010101010101\r"  # start, temperature
)


def _voetsch(**settings: Any) -> Callable[[], SimulatedController]:
    def build() -> SimulatedController:
        plant = ChamberPlant(ambient_degC=11.2, ripple_degC=0.0)
        return SimulatedVoetschAscii(plant, setpoint_degC=10.0, latency_s=0.0, **settings)

    return build


def _alarmed(build: Callable[[], SimulatedController], alarm: str) -> Callable[[], SimulatedController]:
    def built() -> SimulatedController:
        device = build()
        device.alarms = (alarm,)
        return device

    return built


def _simserv(air: float = 22.0, **settings: Any) -> Callable[[], SimulatedController]:
    return lambda: SimulatedSimServ(ChamberPlant(ambient_degC=air), latency_s=0.0, **settings)


def _thermotron(**settings: Any) -> Callable[[], SimulatedController]:
    settings = {"setpoint_degC": 22.0, "replies": "echo"} | settings
    return lambda: SimulatedThermotron(ChamberPlant(), latency_s=0.0, **settings)


def _julabo(**settings: Any) -> Callable[[], SimulatedController]:
    return lambda: SimulatedJulabo(ChamberPlant(), latency_s=0.0, **settings)


# controller, name in the reference: request, reply (None: none), the simulator that says so
GOLDEN: dict[tuple[str, str], tuple[bytes, bytes | None, Callable[[], SimulatedController]]] = {
    ("voetsch_ascii", "read"): (b"$00I\r", MANUAL_READ, _voetsch(other_bits="0100010101010101", mode="CONSTANT")),
    ("voetsch_ascii", "write_as_printed_15bits"): (
        b"$00E 0010.0 0000.0 0000.0 0000.0 0000.0 101010100000101\r",
        b"0\r",
        _voetsch(),
    ),
    ("voetsch_ascii", "write_per_table_16bits"): (
        b"$00E 0010.0 0000.0 0000.0 0000.0 0000.0 0101010100000101\r",
        b"0\r",
        _voetsch(),
    ),
    ("voetsch_ascii", "gradient"): (
        b"$00U 0001.0 0002.0 0000.0 0000.0 0000.0 0000.0 0000.0 0000.0 0000.0 0000.0\r",
        b"0\r",
        _voetsch(),
    ),
    ("voetsch_ascii", "error"): (b"$00F\r", b"01 software test spec.protection..\r", _alarmed(_voetsch(), "01")),
    ("voetsch_ascii", "quit"): (b"$00Q\r", b"00\r", _alarmed(_voetsch(), "01")),
    ("voetsch_ascii", "prog7"): (b"$00P0007\r", b"0\r", _voetsch()),
    ("simserv", "info"): (
        b"99997\xb61\xb61\r",
        b"1\xb6LabEvent T/110/70/3\r\n",
        _simserv(model="LabEvent T/110/70/3"),
    ),
    ("simserv", "pv"): (b"11004\xb61\xb61\r", b"1\xb623.456\r\n", _simserv(23.456)),
    ("simserv", "sp"): (b"11002\xb61\xb61\r", b"1\xb620.0\r\n", _simserv(setpoint_degC=20.0)),
    ("simserv", "set"): (b"11001\xb61\xb61\xb6-30\r", b"1\r\n", _simserv()),
    ("simserv", "start"): (b"14001\xb61\xb61\xb61\r", b"1\r\n", _simserv()),
    ("simserv", "stop"): (b"14001\xb61\xb61\xb60\r", b"1\r\n", _simserv()),
    ("simserv", "running"): (b"14003\xb61\xb61\r", b"1\xb60\r\n", _simserv()),
    ("thermotron8200", "pv"): (b"PVAR1?\r", b"22.000\r", _thermotron()),
    ("thermotron8200", "sp"): (b"SETP1?\r", b"22.000\r", _thermotron()),
    ("thermotron8200", "set"): (b"SETP1,22.000\r", b"22.000\r", _thermotron()),
    ("thermotron8200", "run"): (b"RUNM\r", None, _thermotron()),
    ("thermotron8200", "stop"): (b"STOP\r", None, _thermotron()),
    ("julabo", "read_sp"): (b"IN_SP_00\r", b"55.5\n", _julabo(setpoint_degC=55.5)),
    ("julabo", "set_sp"): (b"OUT_SP_00 55.5\r", None, _julabo()),
}

ELSEWHERE = {"espec", "watlow_f4", "watlow_any", "watlow_988", "watlow_f4t_rtu", "watlow_f4t_tcp", "ezt570i"}
ELSEWHERE |= {"binder_mk53"}
NOT_SPOKEN = {
    ("julabo", "version"): "captured from a simulator; checked against that very simulator in test_julabo_oracle",
    ("julabo", "status"): "captured from a simulator; checked against that very simulator in test_julabo_oracle",
    ("thermotron8800", "aux_op"): "auxiliary outputs are not used, and the source gives no terminator",
    ("thermotron8800", "alarm"): "channel 2 is not used, and the source gives no terminator",
    ("weiss_stx", "read"): "there is no driver for the SB22 protocol: its replies are not published",
    ("weiss_stx", "stop"): "there is no driver for the SB22 protocol: its replies are not published",
}


@pytest.mark.parametrize("key", GOLDEN, ids="-".join)
def test_simulators_answer_golden_requests(key: tuple[str, str]) -> None:
    """Byte for byte, terminator included; an empty answer where the source shows none."""
    request, reply, build = GOLDEN[key]
    device = build()
    device.receive(request, 0.0)
    assert device.transmit(0.0) == (reply or b"")


def test_the_golden_conversations_are_all_of_the_reference(reference: Path) -> None:
    """No vector is left out without a reason, and none was copied wrongly.

    The manual's error text and its number belong to different errors there (01 is the temperature limiter in its
    table, `software test spec.` is 02): the printed reply is kept as it is printed.
    """
    vectors = json.loads((reference / "chambers_golden.json").read_text(encoding="utf-8"))
    expected = {
        (vector["controller"], vector["name"]): (vector["tx_hex"], vector["rx_hex"])
        for vector in vectors
        if vector["controller"] not in ELSEWHERE
    }
    ours = {key: (request.hex(), reply and reply.hex()) for key, (request, reply, _) in GOLDEN.items()}
    assert {key: pair for key, pair in expected.items() if key not in NOT_SPOKEN} == ours
    assert set(NOT_SPOKEN) <= set(expected)


def _driver(kind: Callable[..., Controller], *keys: tuple[str, str], **settings: Any) -> tuple[Any, TranscriptDevice]:
    clock = VirtualClock()
    device = TranscriptDevice([(GOLDEN[key][0], GOLDEN[key][1] or b"") for key in keys])
    return kind(MemoryTransport(device, clock, "sim://chamber"), clock, **settings), device


def test_the_ascii2_driver_speaks_the_golden_bytes() -> None:
    """It reads the manual's reply, and writes it back with all its bits; the error bit is an input, written as 0."""
    limits = ChamberLimits(-40.0, 100.0)
    driver, device = _driver(VoetschAscii, ("voetsch_ascii", "read"), limits=limits)
    driver.identify()
    device.finish()
    driver, device = _driver(VoetschAscii, ("voetsch_ascii", "write_per_table_16bits"), limits=limits)
    driver._bits = "0101010100000101"
    driver.write("setpoint", 10.0)
    device.finish()


def test_the_simserv_driver_speaks_the_golden_bytes() -> None:
    """Type, setpoint, start, stop."""
    keys = [("simserv", name) for name in ("info", "set", "start", "stop")]
    driver, device = _driver(SimServ, *keys)
    assert driver.identify().model == "LabEvent T/110/70/3"
    driver.write("setpoint", -30.0)
    driver.start()
    driver.stop(off=True)
    device.finish()


def test_the_thermotron_driver_speaks_the_golden_bytes() -> None:
    """A setpoint that is echoed, RUNM and STOP that are not answered."""
    driver, device = _driver(Thermotron, *[("thermotron8200", name) for name in ("set", "run", "stop")])
    driver.write("setpoint", 22.0)
    driver.start()
    driver.stop(off=True)
    device.finish()


def test_the_julabo_driver_speaks_the_golden_bytes() -> None:
    """A setpoint that is not answered."""
    driver, device = _driver(Julabo, ("julabo", "set_sp"))
    driver.write("setpoint", 55.5)
    device.finish()
