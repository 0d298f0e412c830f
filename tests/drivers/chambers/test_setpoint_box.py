"""A chamber that only a file describes: what the file may say, and the bytes that come of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.chambers import ChamberLimits, SafeState
from drivers.chambers.controllers.described import SetpointBox
from drivers.chambers.controllers.description import BoxDescription, load_box, parse_box
from drivers.chambers.controllers.questions import Question
from drivers.chambers.controllers.templates import found_in
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, InputError, ProtocolError, WrongDevice
from drivers.simulators.chambers.described import SimulatedSetpointBox
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport
from tests.drivers.chambers.chamber_benches import EXAMPLE_BOX, Wire
from tests.drivers.transcript import TranscriptDevice

LIMITS = ChamberLimits(-35.0, 65.0)

# A box with everything: units, confirmations, texts about the numbers, a standby, programs, a ramp.
FULL: dict[str, Any] = {
    "name": "oven",
    "verified": "nothing",
    "terminator": "CR",
    "reply_terminator": "CR LF",
    "limits_are": "alarm",
    "identify": {"ask": "WHO", "reply": "I AM {value}", "expect": "OVEN"},
    "unit": {"ask": "U?", "reply": "UNIT {value}", "celsius": "C", "fahrenheit": "F"},
    "temperature": {"ask": "T?", "reply": "T={value}{any}"},
    "setpoint": {"ask": "S?", "reply": "S={value} C", "send": "S={value:+07.2f}", "confirm": "OK"},
    "low_limit": {"ask": "L?", "reply": "L={value}", "send": "L={value:.1f}", "confirm": "OK"},
    "high_limit": {"ask": "H?", "reply": "H={value}", "send": "H={value:.1f}", "confirm": "OK"},
    "state": {
        "ask": "M?",
        "reply": "{value}",
        "modes": {"RUN": "CONSTANT", "IDLE": "OFF", "WAIT": "STANDBY", "P": "RUN"},
    },
    "start": {"send": "GO", "confirm": "OK"},
    "stop": {"send": "HALT", "confirm": "OK"},
    "standby": {"send": "REST", "confirm": "OK"},
    "end_program": {"send": "END", "confirm": "OK"},
    "alarms": {"ask": "A?", "reply": "ALARM {value}", "none": ["NONE", "-"]},
    "ramp_degC_per_min": {"ask": "R?", "reply": "{value}", "send": "R {value:.1f}", "confirm": "OK"},
}


def _full(**changes: Any) -> BoxDescription:
    return parse_box(yaml.safe_dump(FULL | changes), "box.yaml")


def _chamber(
    box: BoxDescription,
    exchanges: list[tuple[str, str | None]],
    safe: SafeState = SafeState("off"),  # noqa: B008
) -> tuple[SupervisedChamber, TranscriptDevice]:
    clock = VirtualClock()
    device = TranscriptDevice(
        [((ask + "\r").encode(), b"" if reply is None else (reply + "\r\n").encode()) for ask, reply in exchanges]
    )
    controller = SetpointBox(MemoryTransport(device, clock, "sim://chamber"), clock, box)
    return SupervisedChamber(controller, clock, Supervision(limits=LIMITS, safe=safe)), device


def _state(setpoint: str, mode: str = "RUN", alarm: str = "NONE", unit: str = "C") -> list[tuple[str, str | None]]:
    return [
        ("A?", f"ALARM {alarm}"),
        ("T?", "T=23.04 stable"),
        ("S?", f"S={setpoint} C"),
        ("M?", mode),
        ("L?", "L=-40.0"),
        ("H?", "H=70.0"),
        ("U?", f"UNIT {unit}"),
    ]


IDENTIFY: list[tuple[str, str | None]] = [("WHO", "I AM OVEN 7"), ("U?", "UNIT C")]


def test_it_sets_a_temperature_as_its_file_says() -> None:
    """Every text of the description, byte for byte, and the setpoint read back."""
    chamber, device = _chamber(_full(), [*IDENTIFY, *_state("20.0"), ("S=-029.70", "OK"), *_state("-29.70")])
    chamber.set_temperature((-21.5 - 32.0) / 1.8)
    device.finish()


@pytest.mark.parametrize(
    ("template", "line", "value"),
    [
        ("{value}", "23.04", "23.04"),
        ("{value}", "JULABO CF31 V5", "JULABO CF31 V5"),
        ("T={value}{any}", "T=23.04 stable", "23.04"),
        ("T={value}{any}", "T=23.04", "23.04"),
        ("{any}T={value}C{any}", "1, T=23.04C, ok", "23.04"),
        ("{any},{value},{any}", "1,23.04,2", "23.04"),
        ("{value},{any}", "23.04,1,2", "23.04"),
        ("T={value}", "S=23.04", None),
        ("SW>{hex}", "SW>801f", "32799"),
        ("SW>{hex}", "SW>80G0", None),
        ("(.*) {value}", "x 1", None),
    ],
)
def test_a_value_is_found_where_the_template_says(template: str, line: str, value: str | None) -> None:
    """All of it, and not its first character; what is no placeholder is taken literally."""
    assert found_in(Question(ask="?", reply=template).reply, line) == value


def test_it_refuses_another_box_and_another_unit() -> None:
    """Before anything is written."""
    chamber, device = _chamber(_full(), [("WHO", "I AM FRIDGE")])
    with pytest.raises(WrongDevice, match="'FRIDGE', its description expects 'OVEN'"):
        chamber.set_temperature(25.0)
    device.finish()
    chamber, device = _chamber(_full(), [IDENTIFY[0], ("U?", "UNIT F")])
    with pytest.raises(WrongDevice, match="set to °F"):
        chamber.set_temperature(25.0)
    device.finish()


def test_it_stands_by_and_ends_programs() -> None:
    """A program that runs is ended first."""
    exchanges = [*_state("20.0", "P"), *_state("20.0", "P"), ("END", "OK"), ("REST", "OK"), *_state("20.0", "WAIT")]
    chamber, device = _chamber(_full(), exchanges, SafeState("standby"))
    chamber.safe_state()
    device.finish()


def test_its_alarms_are_words_and_unknown_states_are_errors() -> None:
    """What is none of the words for no alarm is one."""
    chamber, device = _chamber(_full(), _state("20.0", alarm="DOOR"))
    reading = chamber.read()
    assert (reading.alarms, reading.temperature_degC) == (("alarm DOOR",), 23.04)
    device.finish()
    chamber, device = _chamber(_full(), [*_state("20.0")[:3], *[("M?", "DANCE")] * 3])
    with pytest.raises(ProtocolError, match="in state 'DANCE', which its description does not have"):
        chamber.read()
    device.finish()


def test_a_reply_that_the_description_does_not_expect_names_both() -> None:
    """So that the file can be corrected."""
    chamber, device = _chamber(_full(), [("A?", "ALARM NONE"), *[("T?", "23.0")] * 3])
    with pytest.raises(
        ProtocolError, match=r"answered 'T\?' with '23\.0', its description expects 'T=\{value\}\{any\}'"
    ):
        chamber.read()
    device.finish()


def test_its_ramp_and_its_timer_are_read_back() -> None:
    """And are missing where the description has none."""
    chamber, device = _chamber(_full(), [*IDENTIFY, ("R 2.5", "OK"), ("R?", "2.5")])
    assert chamber.set_ramp_rate(2.5) is True
    device.finish()
    box = {key: value for key, value in FULL.items() if key != "ramp_degC_per_min"}
    chamber, device = _chamber(parse_box(yaml.safe_dump(box), "box.yaml"), IDENTIFY)
    assert chamber.set_ramp_rate(2.5) is False
    clock, simulated = VirtualClock(), SimulatedSetpointBox(ChamberPlant(), load_box(EXAMPLE_BOX))
    controller = SetpointBox(MemoryTransport(simulated, clock, "sim://chamber"), clock, load_box(EXAMPLE_BOX))
    armed = SupervisedChamber(controller, clock, Supervision(limits=LIMITS, safe=SafeState("off"), dead_man_s=10800.0))
    armed.prepare()
    assert simulated.dead_man_s == 10800.0
    none = SetpointBox(MemoryTransport(SimulatedSetpointBox(ChamberPlant(), _full()), clock, "sim://x"), clock, _full())
    unarmed = SupervisedChamber(none, clock, Supervision(limits=LIMITS, safe=SafeState("off"), dead_man_s=10800.0))
    with pytest.raises(CommandRefused, match="has no timer of its own"):
        unarmed.prepare()


def test_a_full_box_works_against_its_simulator() -> None:
    """A night's work over every text of the description."""
    clock, simulated = VirtualClock(), SimulatedSetpointBox(ChamberPlant(), _full())
    controller = SetpointBox(MemoryTransport(simulated, clock, "sim://chamber"), clock, _full())
    chamber = SupervisedChamber(controller, clock, Supervision(limits=LIMITS, safe=SafeState("standby")))
    chamber.prepare()
    chamber.set_temperature(-29.7)
    clock.sleep(3600.0)
    assert chamber.read().temperature_degC == pytest.approx(-29.7, abs=0.1)
    chamber.safe_state()
    assert simulated.mode == "STANDBY"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"setpont": 1}, "box.yaml: unknown key 'setpont'; did you mean 'setpoint'?"),
        ({"setpoint": {"ask": "S?", "reply": "{value}"}}, "box.yaml: setpoint.send: this key is missing"),
        ({"temperature": {"ask": "T?", "reply": "T"}}, "box.yaml: temperature.reply: 'T' must hold {value} once"),
        (
            {"setpoint": FULL["setpoint"] | {"send": "S=25"}},
            "box.yaml: setpoint.send: 'S=25' must hold {value} once, as in 'SETP {value:.1f}'",
        ),
        (
            {"setpoint": FULL["setpoint"] | {"send": "S={value:.0f}"}},
            "box.yaml: setpoint.send: 'S={value:.0f}' writes '-30' for -29.7; it must keep at least one decimal",
        ),
        (
            {"setpoint": FULL["setpoint"] | {"send": "S={value:d}"}},
            "box.yaml: setpoint.send: 'S={value:d}' cannot write -29.7",
        ),
        (
            {"state": FULL["state"] | {"modes": {"1": "CONSTANT"}}},
            "box.yaml: state: modes must give a word for CONSTANT",
        ),
        (
            {"state": FULL["state"] | {"modes": {"1": "ON"}}},
            "box.yaml: state.modes.1: 'ON' is not allowed; allowed: 'OFF'",
        ),
        ({"timeout_s": 0}, "box.yaml: timeout_s: must be more than 0, not 0"),
        ({"high_limit": None}, "box.yaml: give low_limit and high_limit, or neither"),
        ({"terminator": "CRLF"}, "box.yaml: terminator: 'CRLF' is not allowed; allowed: 'CR', 'LF' or 'CR LF'"),
        (
            {"alarms": {"ask": "A?", "reply": "{value}", "none": []}},
            "box.yaml: alarms.none: must have at least 1 entry",
        ),
        ({"verified": ""}, "box.yaml: verified: must have at least 1 character"),
    ],
)
def test_a_wrong_description_is_one_sentence_that_names_file_and_key(changes: dict[str, Any], message: str) -> None:
    """So that somebody who has a manual and no driver can write one."""
    with pytest.raises(InputError) as refusal:
        _full(**changes)
    assert str(refusal.value).startswith(message)
    assert "\n" not in str(refusal.value)


@pytest.mark.slow
@pytest.mark.parametrize("text", ["", "- 1", "a: [", "just text", "name: X\nname: Y", "[" * 9999])
def test_a_file_that_is_no_description_is_refused(text: str, tmp_path: Path) -> None:
    """Empty, a list, broken YAML, text, a key given twice, nothing but brackets; and a file that is not there."""
    with pytest.raises(InputError, match=r"^box\.yaml(, line \d, column \d+)?: "):
        parse_box(text, "box.yaml")
    with pytest.raises(InputError, match="there is no such file"):
        load_box(tmp_path / "nothing.yaml")


def test_an_address_stands_before_every_text_where_one_is_given() -> None:
    """And its simulator knows it; a place for it in the texts is not needed then."""
    text = yaml.safe_dump(FULL | {"addressed": "#{address:02d} "})
    for address, sent in ((7, b"#07 T?\r"), (None, b"T?\r")):
        clock, box = VirtualClock(), parse_box(text, "box.yaml", address=address)
        wire = Wire(SimulatedSetpointBox(ChamberPlant(), box))
        SetpointBox(MemoryTransport(wire, clock, "sim://chamber"), clock, box).state()
        assert sent in b"\r" + wire.sent
        assert (b"#" in wire.sent) == (address is not None)


def test_a_simulated_box_answers_at_nought_degrees() -> None:
    """Which is a temperature, and not the want of one; a ramp of nought is answered too."""
    device = SimulatedSetpointBox(ChamberPlant(ambient_degC=0.0), _full(), setpoint_degC=0.0)
    for question, answer in ((b"T?\r", b"T=0.0\r\n"), (b"S?\r", b"S=0.0 C\r\n"), (b"R?\r", b"0.0\r\n")):
        device.receive(question, 0.0)
        assert device.transmit(1.0) == answer
