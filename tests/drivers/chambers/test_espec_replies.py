"""The ESPEC reply grammar: golden data, three spellings of OK, two of NA, and every error text as a sentence."""

from __future__ import annotations

import math

import pytest

from drivers.chambers.controller import ControllerState
from drivers.chambers.controllers.described import SetpointBox
from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, ProtocolError
from drivers.simulators.memory import MemoryTransport
from tests.drivers.chambers.shipped import espec

ERROR_TEXTS = {
    "CMD ERR": "does not know this command",
    "ADDR ERR": "address is wrong",
    "CONT NOT READY-1": "no such equipment",
    "CONT NOT READY-2": "no program is running",
    "CONT NOT READY-3": "another controller",
    "CONT NOT READY-4": "power is off",
    "CONT NOT READY-5": "time signal",
    "DATA NOT READY": "no such program",
    "PARA ERR": "parameter",
    "DATA OUT OF RANGE": "alarm limits at the panel",
    "PROTECT ON": "release it at the panel",
    "INVALID REQ": "not valid for this chamber",
    "INVLID REQ": "not valid for this chamber",
    "CHB NOT READY": "not ready: wait",
    "SOMETHING NEW": "its manual must say what this means",
    **{f"PRGM WRITE ERR-{n}": "its manual has the reason by this number" for n in range(1, 16)},
}
USUAL = {
    "ROM?": "GL-ENA 3.4.0",
    "TYPE?": "T,T,GL,185.0",
    "TEMP?": "23.0,85.0,105.0,-75.0",
    "MON?": "24.1,100,CONSTANT,0",
    "ALARM?": "0",
}
SET = "TEMP,S25.0"


class _Answers:
    """A device that answers a request always alike."""

    def __init__(self, replies: dict[str, str]) -> None:
        self._replies, self._sent = USUAL | replies, b""

    def receive(self, data: bytes, now_s: float) -> None:
        self._sent += (self._replies[data.decode().strip()] + "\r\n").encode()

    def transmit(self, now_s: float) -> bytes:
        sent, self._sent = self._sent, b""
        return sent

    def next_transmission(self, now_s: float) -> float | None:
        return now_s if self._sent else None


def _driver(**replies: str) -> SetpointBox:
    clock = VirtualClock()
    return espec(
        MemoryTransport(
            _Answers({ask.replace("_", "?"): each for ask, each in replies.items()}), clock, "sim://chamber"
        ),
        clock,
    )


def _looked(temp: str = USUAL["TEMP?"], mon: str = USUAL["MON?"], alarm: str = "0") -> ControllerState:
    return _driver(TEMP_=temp, MON_=mon, ALARM_=alarm).state()


def _set_s(line: str) -> float:
    """Return how long a setting takes that is answered so: the pause, and the time-out where nothing acknowledges."""
    clock = VirtualClock()
    espec(MemoryTransport(_Answers({SET: line}), clock, "sim://chamber"), clock).write("setpoint", 25.0)
    return clock.now()


def test_temperatures_setpoint_and_alarm_limits() -> None:
    """`TEMP?` of the recorded dialog, and of a GL."""
    for line, expected in (
        ("26.4,0.0,140.0,-50.0", (26.4, 0.0, 140.0, -50.0)),
        (USUAL["TEMP?"], (23.0, 85.0, 105.0, -75.0)),
    ):
        seen = _looked(line)
        assert (seen.temperature, seen.setpoint, seen.high, seen.low) == expected


def test_status_with_and_without_humidity() -> None:
    """`MON?` of the EHS manual; a chamber without humidity leaves the field blank."""
    assert (_looked().mode, _looked().alarms) == ("CONSTANT", ())
    seen = _looked(mon="-30.2, , STANDBY, 2", alarm="2,19,40")
    assert (seen.mode, seen.alarms) == ("STANDBY", ("alarm 19", "alarm 40"))


@pytest.mark.parametrize("mode", ["RUN", "RUN PAUSE", "RUN END HOLD", "RMT RUN"])
def test_every_kind_of_program_is_one(mode: str) -> None:
    """Also one that holds at its end."""
    assert _looked(mon=f"24.1,,{mode},0").mode == "RUN"


def test_alarms_may_be_a_single_character() -> None:
    """`0` is the whole reply where there is none; then the alarm that was counted has no code."""
    assert _looked(mon="24.1,,STANDBY,1", alarm="0").alarms == ("alarm without a code",)


@pytest.mark.parametrize(
    ("line", "maximum"), [("T,T,S2,160.0", 160.0), ("T,GL,185", 185.0), ("T, T, S2, 160.0", 160.0), ("T,T,S2", None)]
)
def test_type_tells_the_highest_temperature(line: str, maximum: float | None) -> None:
    """With one bulb, with two, and without a highest temperature."""
    assert _driver(TYPE_=line).identify().maximum == maximum


@pytest.mark.parametrize(("line", "model"), [("T,T,S2,160.0", "S2"), ("T,GL,185.0", "GL")])
def test_type_names_the_controller_where_nothing_else_does(line: str, model: str) -> None:
    """The oldest know no `ROM?`."""
    assert _driver(ROM_="NA:CMD ERR", TYPE_=line).identify().model == model


@pytest.mark.parametrize(
    "line", ["OK:TEMP,S25", "OK:1,temp,s85.0", "OK : 1,TEMP,S25", "OK:01,TEMP,S25", "OK:1,mode,constant"]
)
def test_every_observed_acknowledgement_is_one(line: str) -> None:
    """The echo is spelt in three ways and is never compared."""
    assert _set_s(line) < 2.0


@pytest.mark.parametrize("line", ["", "OK", "OKAY", "26.4,0.0,140.0,-50.0", "K:TEMP,S25", "0"])
def test_a_line_that_belongs_to_something_else_acknowledges_nothing(line: str) -> None:
    """A late reply to a monitor command is not mistaken for an acknowledgement."""
    assert _set_s(line) >= 2.0


@pytest.mark.parametrize(("text", "advice"), ERROR_TEXTS.items())
@pytest.mark.parametrize("spelling", ["NA:{}", "NA :{}", "NA: {}"])
def test_every_error_text_becomes_advice(text: str, advice: str, spelling: str) -> None:
    """The device, the request, the controller's own words, and what to do; nothing is invented for unknown ones."""
    with pytest.raises(CommandRefused) as caught:
        _set_s(spelling.format(text))
    message = str(caught.value)
    assert message.startswith(f"chamber on sim://chamber refused '{SET}' with ")
    assert text in message
    assert advice in message


@pytest.mark.parametrize("ask", ["TEMP?", "MON?", "ALARM?", "TYPE?"])
def test_refusals_are_refusals_of_every_question(ask: str) -> None:
    """A monitor command can be refused as well; a name is no name then."""
    refusing = {"ROM_": "NA:CMD ERR", "MON_": "24.1,,STANDBY,1", ask.replace("?", "_"): "NA:CMD ERR"}
    with pytest.raises(CommandRefused, match="CMD ERR"):
        (_driver(**refusing).identify if ask == "TYPE?" else _driver(**refusing).state)()


@pytest.mark.parametrize("line", ["", "26.4,0.0,140.0", "26.4,0.0,140.0,-50.0,1", "26.4,x,140.0,-50.0", "OK:TEMP,S25"])
def test_temperatures_of_another_shape_are_refused(line: str) -> None:
    """A cut line, or the reply to another request."""
    with pytest.raises(
        ProtocolError, match=r"answered 'TEMP\?' with .*; check the line settings|'TEMP\?' .*: no number"
    ):
        _looked(line)


@pytest.mark.parametrize(
    "line",
    [
        "26.4,0.0,140.0,-50.0",
        "24.1,100,CONSTANT",
        "24.1,100,CONSTANT,0,1",
        "24.1,100,CONSTANT,x",
        "24.1,100,,0",
        "24.1,100,const,0",
    ],
)
def test_a_status_of_another_shape_is_refused(line: str) -> None:
    """Above all the reply to `TEMP?`, which has four fields too."""
    with pytest.raises(ProtocolError):
        _looked(mon=line)


@pytest.mark.parametrize("line", ["", "2,19", "0,19", "x", "1,x", "-1"])
def test_alarms_of_another_shape_are_refused(line: str) -> None:
    """The count must agree with the codes: a lost code is a lost byte."""
    with pytest.raises(ProtocolError):
        _looked(mon="24.1,,STANDBY,1", alarm=line)


@pytest.mark.parametrize("line", ["", "OK:TEMP,S25", "P3\x07"])
def test_a_name_that_is_none_is_refused(line: str) -> None:
    """An acknowledgement or noise is no model."""
    with pytest.raises(ProtocolError):
        _driver(ROM_=line).identify()


def test_dashes_for_a_missing_sensor_are_no_number() -> None:
    """They parse as not a number, for the plausibility check to name."""
    assert math.isnan(_looked("---.-,0.0,140.0,-50.0").temperature)
