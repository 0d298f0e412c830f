"""The ESPEC reply grammar: golden data, three spellings of OK, two of NA, and every error text as a sentence."""

from __future__ import annotations

import math

import pytest

from drivers.chambers.controllers import espec as replies
from drivers.chambers.controllers.espec import meaning_of, understood
from drivers.errors import CommandRefused, ProtocolError

DEVICE = "chamber on /dev/ttyUSB0"

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
    **{f"PRGM WRITE ERR-{n}": f"reason {n} of its manual" for n in range(1, 16)},
}


def test_temperatures_setpoint_and_alarm_limits() -> None:
    """`TEMP?` of the recorded dialog, and of a GL."""
    assert understood(DEVICE, "TEMP?", replies.temperatures, "26.4,0.0,140.0,-50.0") == (26.4, 0.0, 140.0, -50.0)
    assert understood(DEVICE, "TEMP?", replies.temperatures, "23.0,85.0,105.0,-75.0") == (23.0, 85.0, 105.0, -75.0)


def test_status_with_and_without_humidity() -> None:
    """`MON?` of the EHS manual; a chamber without humidity leaves the field blank."""
    assert understood(DEVICE, "1,MON?", replies.status, "24.1,100,CONSTANT,0") == ("CONSTANT", 0)
    assert understood(DEVICE, "MON?", replies.status, "-30.2,,STANDBY,2") == ("STANDBY", 2)


def test_alarms_may_be_a_single_character() -> None:
    """`0` is the whole reply where there is none."""
    assert understood(DEVICE, "ALARM?", replies.codes, "0") == ()
    assert understood(DEVICE, "ALARM?", replies.codes, "2,19,40") == ("19", "40")


def test_type_names_controller_and_highest_temperature() -> None:
    """With one bulb, with two, and without a highest temperature."""
    assert understood(DEVICE, "TYPE?", replies.chamber_type, "T,T,S2,160.0") == ("S2", 160.0)
    assert understood(DEVICE, "TYPE?", replies.chamber_type, "T,GL,185.0") == ("GL", 185.0)
    assert understood(DEVICE, "TYPE?", replies.chamber_type, "T,T,S2") == ("S2", None)


@pytest.mark.parametrize(
    "line", ["OK:TEMP,S25", "OK:1,temp,s85.0", "OK : 1,TEMP,S25", "OK:01,TEMP,S25", "OK:1,mode,constant"]
)
def test_every_observed_acknowledgement_is_one(line: str) -> None:
    """The echo is spelt in three ways and is never compared."""
    assert understood(DEVICE, "TEMP,S25", replies.acknowledged, line)


@pytest.mark.parametrize("line", ["", "OK", "OKAY", "26.4,0.0,140.0,-50.0", "K:TEMP,S25", "0"])
def test_a_line_that_belongs_to_something_else_acknowledges_nothing(line: str) -> None:
    """A late reply to a monitor command is not mistaken for an acknowledgement."""
    assert not understood(DEVICE, "TEMP,S25", replies.acknowledged, line)


@pytest.mark.parametrize(("text", "advice"), ERROR_TEXTS.items())
@pytest.mark.parametrize("spelling", ["NA:{}", "NA :{}", "NA: {}"])
def test_every_error_text_becomes_advice(text: str, advice: str, spelling: str) -> None:
    """The device, the request, the controller's own words, and what to do."""
    line = spelling.format(text)
    with pytest.raises(CommandRefused) as caught:
        understood(DEVICE, "TEMP,S25", replies.acknowledged, line)
    message = str(caught.value)
    assert message.startswith("chamber on /dev/ttyUSB0 refused 'TEMP,S25' with ")
    assert text in message
    assert advice in message


def test_an_unknown_error_text_is_repeated() -> None:
    """Nothing is invented for it."""
    assert meaning_of("SOMETHING NEW") == "its manual must say what this means"
    with pytest.raises(CommandRefused, match="SOMETHING NEW"):
        understood(DEVICE, "MON?", replies.status, "NA:SOMETHING NEW")


def test_refusals_are_refusals_for_every_parser() -> None:
    """A monitor command can be refused as well."""
    for parse in (
        replies.text,
        replies.temperatures,
        replies.status,
        replies.codes,
        replies.chamber_type,
        replies.acknowledged,
    ):
        with pytest.raises(CommandRefused, match="CMD ERR"):
            understood(DEVICE, "TENMP?", parse, "NA:CMD ERR")


@pytest.mark.parametrize("line", ["", "26.4,0.0,140.0", "26.4,0.0,140.0,-50.0,1", "26.4,x,140.0,-50.0", "OK:TEMP,S25"])
def test_temperatures_of_another_shape_are_refused(line: str) -> None:
    """A cut line, or the reply to another request."""
    with pytest.raises(ProtocolError, match="TEMP"):
        understood(DEVICE, "TEMP?", replies.temperatures, line)


@pytest.mark.parametrize(
    "line",
    [
        "26.4,0.0,140.0,-50.0",
        "24.1,100,CONSTANT",
        "24.1,100,CONSTANT,x",
        "24.1,100,,0",
        "24.1,100,const,0",
        "2x.1,100,CONSTANT,0",
    ],
)
def test_a_status_of_another_shape_is_refused(line: str) -> None:
    """Above all the reply to `TEMP?`, which has four fields too."""
    with pytest.raises(ProtocolError):
        understood(DEVICE, "MON?", replies.status, line)


@pytest.mark.parametrize("line", ["", "2,19", "0,19", "x", "1,x", "-1"])
def test_alarms_of_another_shape_are_refused(line: str) -> None:
    """The count must agree with the codes: a lost code is a lost byte."""
    with pytest.raises(ProtocolError):
        understood(DEVICE, "ALARM?", replies.codes, line)


@pytest.mark.parametrize("line", ["", "OK:TEMP,S25", "P3\x07"])
def test_a_name_that_is_none_is_refused(line: str) -> None:
    """An acknowledgement or noise is no model."""
    with pytest.raises(ProtocolError):
        understood(DEVICE, "ROM?", replies.text, line)


def test_dashes_for_a_missing_sensor_are_no_number() -> None:
    """They parse as not a number, for the plausibility check to name."""
    assert math.isnan(understood(DEVICE, "TEMP?", replies.temperatures, "---.-,0.0,140.0,-50.0")[0])
