"""Published conversations of controllers that speak text."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.chambers import ChamberLimits
from drivers.chambers.controller import Controller
from drivers.chambers.controllers.described import SetpointBox
from drivers.chambers.controllers.description import load_box
from drivers.chambers.controllers.voetsch_ascii import VoetschAscii
from drivers.clock import Clock
from drivers.errors import CommandRefused
from drivers.simulators.chambers.controller import SimulatedController
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.chambers.voetsch_ascii import SimulatedVoetschAscii
from drivers.transports import Transport
from tests.drivers.chambers.chamber_benches import EXAMPLE_BOX
from tests.drivers.chambers.shipped import (
    espec,
    julabo,
    simserv,
    simulated_espec,
    simulated_julabo,
    simulated_simserv,
    simulated_thermotron,
    thermotron,
)
from tests.drivers.frames.golden_vectors import Act, Key, Vector

Build = Callable[[], SimulatedController]

MANUAL_READ = (
    b"0010.0 0011.2 0000.0 0011.2 0000.0 0011.2 0000.0 0011.2 0000.0 0011.2 0101010101010101\r"  # start, temperature
)
_NEVER_ASKED = "the driver asks for nothing that this tells: "


def _espec(air: float = 22.0, **settings: Any) -> Build:
    return lambda: simulated_espec(ChamberPlant(ambient_degC=air), latency_s=0.0, **settings)


def _sh641(**settings: Any) -> Build:
    limits = ChamberLimits(-50.0, 140.0)
    return _espec(26.4, limits=limits, setpoint_degC=0.0, says={"TYPE?": "T,T,S2,160.0"}, **settings)


def _voetsch(**settings: Any) -> Build:
    def build() -> SimulatedController:
        plant = ChamberPlant(ambient_degC=11.2, ripple_degC=0.0)
        return SimulatedVoetschAscii(plant, setpoint_degC=10.0, latency_s=0.0, **settings)

    return build


def _alarmed(build: Build, alarm: str) -> Build:
    def built() -> SimulatedController:
        device = build()
        device.alarms = (alarm,)
        return device

    return built


def _simserv(air: float = 22.0, **settings: Any) -> Build:
    return lambda: simulated_simserv(ChamberPlant(ambient_degC=air), latency_s=0.0, **settings)


def _thermotron(**settings: Any) -> Build:
    settings = {"setpoint_degC": 22.0, "replies": "echo"} | settings
    return lambda: simulated_thermotron(ChamberPlant(), latency_s=0.0, **settings)


def _julabo(**settings: Any) -> Build:
    return lambda: simulated_julabo(ChamberPlant(), latency_s=0.0, **settings)


def _ascii2(transport: Transport, clock: Clock) -> VoetschAscii:
    return VoetschAscii(transport, clock, limits=ChamberLimits(-40.0, 100.0))


def _sb22(transport: Transport, clock: Clock) -> SetpointBox:
    return SetpointBox(transport, clock, load_box(EXAMPLE_BOX.with_name("weiss-sb22.yaml")))


def _does(kind: Callable[[Transport, Clock], Controller], action: Callable[[Any], object]) -> Act:
    return lambda transport, clock: action(kind(transport, clock)) and None


def _sees(kind: Callable[[Transport, Clock], Controller], **expected: object) -> Act:
    """Look once, and find this in the state."""

    def act(transport: Transport, clock: Clock) -> None:
        state = kind(transport, clock).state()
        assert {name: getattr(state, name) for name in expected} == expected

    return act


def _is(kind: Callable[[Transport, Clock], Controller], model: str, maximum: float | None = None) -> Act:
    def act(transport: Transport, clock: Clock) -> None:
        found = kind(transport, clock).identify()
        assert (found.model, found.maximum) == (model, maximum)

    return act


def _is_refused(transport: Transport, clock: Clock) -> None:
    with pytest.raises(CommandRefused, match="beyond the high or low temperature alarm"):
        espec(transport, clock).write("setpoint", 9999.0)


def _is_written_back(transport: Transport, clock: Clock) -> None:
    driver = _ascii2(transport, clock)
    driver.state()
    driver.write("setpoint", 10.0)


def _sets(value: float) -> Callable[[Any], object]:
    return lambda driver: driver.write("setpoint", value)


_ESPEC: dict[str, Vector] = {
    "temp": Vector(
        b"TEMP?\r\n",
        b"26.4,0.0,140.0,-50.0\r\n",
        _sh641(),
        _sees(espec, temperature=26.4, setpoint=0.0, low=-50.0, high=140.0),
    ),
    "type": Vector(b"TYPE?\r\n", b"T,T,S2,160.0\r\n", _sh641(), _is(espec, "P300 SIMULATED 1.00", 160.0)),
    "humi": Vector(
        b"HUMI?\r\n",
        b"25,85,100,0\r\n",
        _espec(says={"HUMI?": "25,85,100,0"}),
        f"{_NEVER_ASKED}humidity is not controlled",
    ),
    "set": Vector(
        b"TEMP,S25\r\n",
        b"OK:TEMP,S25\r\n",
        _sh641(),
        "the driver writes tenths: TEMP,S25.0; the reply is that of set_neg",
    ),
    "set_neg": Vector(b"TEMP,S-30.0\r\n", b"OK:TEMP,S-30.0\r\n", _sh641(), _does(espec, _sets(-30.0))),
    "mon_addr": Vector(
        b"1,MON?\r\n",
        b"24.1,100,CONSTANT,0\r\n",
        _espec(24.1, says={"MON?": "{value},100,,"}, spoken={"address": 1}, mode="CONSTANT"),
        _sees(lambda transport, clock: espec(transport, clock, address=1), mode="CONSTANT", alarms=()),
    ),
    "cmd_err": Vector(b"TENMP?\r\n", b"NA:CMD ERR\r\n", _espec(), "a misspelt command, which no driver sends"),
    "range_err": Vector(b"TEMP,S9999.0\r\n", b"NA:DATA OUT OF RANGE\r\n", _espec(), _is_refused),
    "gl_set": Vector(
        b"TEMP,S85.0\r\n",
        b"OK:1,temp,s85.0\r\n",
        _espec(gl=True),
        _does(espec, _sets(85.0)),
    ),
    "gl_mode": Vector(
        b"MODE,CONSTANT\r\n",
        b"OK:1,mode,constant\r\n",
        _espec(gl=True),
        _does(espec, lambda driver: driver.start()),
    ),
    "const": Vector(
        b"CONSTANT SET?,TEMP\r\n", b"23.0,ON\r\n", _espec(), f"{_NEVER_ASKED}TEMP? tells the setpoint with the rest"
    ),
}
_ASCII2: dict[str, Vector] = {
    "read": Vector(
        b"$00I\r",
        MANUAL_READ,
        _voetsch(other_bits="0100010101010101", mode="CONSTANT"),
        _sees(_ascii2, temperature=11.2, setpoint=10.0, mode="CONSTANT", alarms=()),
    ),
    "write_as_printed_15bits": Vector(
        b"$00E 0010.0 0000.0 0000.0 0000.0 0000.0 101010100000101\r",
        b"0\r",
        _voetsch(),
        "a misprint: the manual's own table has 16 bits, and the driver sends what write_per_table_16bits says",
    ),
    "write_per_table_16bits": Vector(
        b"$00E 0010.0 0000.0 0000.0 0000.0 0000.0 0101010100000101\r",
        b"0\r",
        _voetsch(other_bits="0100010100000101", mode="CONSTANT"),
        _is_written_back,
    ),
    "gradient": Vector(
        b"$00U 0001.0 0002.0 0000.0 0000.0 0000.0 0000.0 0000.0 0000.0 0000.0 0000.0\r",
        b"0\r",
        _voetsch(),
        "the driver bounds heating and cooling alike; the same ten numbers with equal ones are in its transcripts",
    ),
    "error": Vector(
        b"$00F\r",
        b"01 software test spec.protection..\r",
        _alarmed(_voetsch(), "01"),
        _sees(_ascii2, alarms=("error 01: software test spec.protection..",)),
    ),
    "quit": Vector(
        b"$00Q\r", b"00\r", _alarmed(_voetsch(), "01"), "it acknowledges an error, which no driver ever does"
    ),
    "prog7": Vector(b"$00P0007\r", b"0\r", _voetsch(), "it starts somebody's program, which no driver ever does"),
}
_SIMSERV: dict[str, Vector] = {
    "info": Vector(
        b"99997\xb61\xb61\r",
        b"1\xb6LabEvent T/110/70/3\r\n",
        _simserv(says={"identity": "LabEvent T/110/70/3"}),
        _is(simserv, "LabEvent T/110/70/3", 185.0),
    ),
    "pv": Vector(b"11004\xb61\xb61\r", b"1\xb623.456\r\n", _simserv(23.456), _sees(simserv, temperature=23.456)),
    "sp": Vector(
        b"11002\xb61\xb61\r",
        b"1\xb620.0\r\n",
        _simserv(says={"decimals": 1}, setpoint_degC=20.0),
        _sees(simserv, setpoint=20.0),
    ),
    "set": Vector(b"11001\xb61\xb61\xb6-30\r", b"1\r\n", _simserv(), _does(simserv, _sets(-30.0))),
    "start": Vector(b"14001\xb61\xb61\xb61\r", b"1\r\n", _simserv(), _does(simserv, lambda driver: driver.start())),
    "stop": Vector(
        b"14001\xb61\xb61\xb60\r", b"1\r\n", _simserv(), _does(simserv, lambda driver: driver.stop(off=True))
    ),
    "running": Vector(b"14003\xb61\xb61\r", b"1\xb60\r\n", _simserv(), _sees(simserv, mode="OFF")),
}
_8200: dict[str, Vector] = {
    "pv": Vector(b"PVAR1?\r", b"22.000\r", _thermotron(), _sees(thermotron, temperature=22.0)),
    "sp": Vector(b"SETP1?\r", b"22.000\r", _thermotron(), _sees(thermotron, setpoint=22.0)),
    "set": Vector(b"SETP1,22.000\r", b"22.000\r", _thermotron(), _does(thermotron, _sets(22.0))),
    "run": Vector(b"RUNM\r", b"", _thermotron(), _does(thermotron, lambda driver: driver.start())),
    "stop": Vector(b"STOP\r", b"", _thermotron(), _does(thermotron, lambda driver: driver.stop(off=True))),
}
_NO_TERMINATOR = "the source gives no terminator, and "
_8800: dict[str, Vector] = {
    "aux_op": Vector(b"AUXE1,59", b"0", *[f"{_NO_TERMINATOR}auxiliary outputs are not used"] * 2),
    "alarm": Vector(b"ALRM2?", b"1", *[f"{_NO_TERMINATOR}channel 2 is not used"] * 2),
}
_CF31 = "JULABO CRYOCOMPACT CF31 VERSION 5.0"
_LINE_ENDS = "that simulator ends its lines with CR LF; ours ends them with LF, as the manual says"
_JULABO: dict[str, Vector] = {
    "read_sp": Vector(b"IN_SP_00\r", b"55.5\n", _julabo(setpoint_degC=55.5), _sees(julabo, setpoint=55.5)),
    "set_sp": Vector(b"OUT_SP_00 55.5\r", b"", _julabo(), _does(julabo, _sets(55.5))),
    "version": Vector(b"VERSION\r", f"{_CF31}\r\n".encode(), _LINE_ENDS, _is(julabo, _CF31)),
    "status": Vector(b"STATUS\r", b"03 REMOTE START\r\n", _LINE_ENDS, _sees(julabo, alarms=())),
}
_SB22_REASON = "its replies are not published, and ours would only be what we describe"
_SB22: dict[str, Vector] = {
    "read": Vector(b"\x021?8E\x03", b"", _SB22_REASON, "sent three times: test_described_boxes has its bytes"),
    "stop": Vector(
        b"\x021T025.0F00R00000000000000008C\x03", b"", _SB22_REASON, _does(_sb22, lambda driver: driver.stop(off=True))
    ),
}
_BY_CONTROLLER = {
    "espec": _ESPEC,
    "voetsch_ascii": _ASCII2,
    "simserv": _SIMSERV,
    "thermotron8200": _8200,
    "thermotron8800": _8800,
    "julabo": _JULABO,
    "weiss_stx": _SB22,
}
TEXT: dict[Key, Vector] = {
    (controller, name): vector for controller, vectors in _BY_CONTROLLER.items() for name, vector in vectors.items()
}
