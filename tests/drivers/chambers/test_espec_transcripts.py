"""The ESPEC driver's own bytes: one transcript per conversation, and nothing left over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from drivers.chambers import ChamberLimits, ChamberReading, SafeState
from drivers.chambers.chamber import ChamberIdentity
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, ProtocolError, SetpointOutOfLimits, WrongDevice
from drivers.simulators.memory import MemoryTransport
from drivers.transports.framing import Terminator
from tests.drivers.chambers.shipped import espec
from tests.drivers.transcript import TranscriptDevice

LIMITS = ChamberLimits(-35.0, 65.0)


def _look(temperatures: str, mode: str = "CONSTANT", *alarms: str) -> list[tuple[str, str]]:
    """One look at everything: alarms are asked for where MON? counts any."""
    status = f"{temperatures.split(',')[0]},,{mode},{len(alarms)}"
    codes = [("ALARM?", ",".join((str(len(alarms)), *alarms)))] if alarms else []
    return [("TEMP?", temperatures), ("MON?", status), *codes]


MODEL = [("ROM?", "GL-ENA 3.4.0"), ("TYPE?", "T,T,GL,185.0")]
IDENTIFY = [*MODEL, *_look("23.0,23.0,70.0,-40.0", "OFF")]


def _chamber(
    exchanges: Sequence[tuple[str, str]], terminator: Terminator = "CR LF", address: int | None = None, **settings: Any
) -> tuple[SupervisedChamber, TranscriptDevice]:
    clock, end = VirtualClock(), "".join({"CR": "\r", "LF": "\n"}[each] for each in terminator.split())
    device = TranscriptDevice(
        [((request + end).encode(), (reply + end).encode() if reply else b"") for request, reply in exchanges]
    )
    transport = MemoryTransport(device, clock, "sim://chamber")
    controller = espec(transport, clock, address=address, terminator=terminator)
    settings = {"limits": LIMITS, "safe": SafeState("hold", 25.0)} | settings
    return SupervisedChamber(controller, clock, Supervision(**settings)), device


def test_identify() -> None:
    """Model, type and whether it can be speaking °C."""
    chamber, device = _chamber(IDENTIFY, expected_model="gl-ena")
    assert chamber.identify() == ChamberIdentity(model="GL-ENA 3.4.0", unit="degC")
    device.finish()


def test_identify_asks_the_type_where_the_model_is_not_known() -> None:
    """The recorded SH-641 answers TYPE?; its controller is then the name."""
    chamber, device = _chamber(
        [("ROM?", "NA:CMD ERR")] * 3 + [("TYPE?", "T,T,S2,160.0"), *_look("23.0,0.0,140.0,-50.0", "OFF")],
        expected_model="S2",
    )
    assert chamber.identify().model == "S2"
    device.finish()


def test_another_model_is_refused_before_anything_is_written() -> None:
    """The message names the port, who answered, and whom the bench file expects."""
    chamber, device = _chamber(MODEL * 2, expected_model="P3")
    with pytest.raises(WrongDevice, match=r"sim://chamber says it is 'GL-ENA 3\.4\.0', the bench file expects 'P3'"):
        chamber.set_temperature(25.0)
    device.finish()


def test_an_idle_chamber_at_72_is_refused_until_a_person_has_looked_at_its_panel() -> None:
    """72 °F is a room; the protocol has no command for the unit."""
    chamber, device = _chamber([*MODEL, *_look("72.0,72.0,160.0,-40.0", "STANDBY")])
    with pytest.raises(WrongDevice, match="72, which as °F is a room at 22 °C"):
        chamber.identify()
    device.finish()
    confirmed, device = _chamber(MODEL, celsius_confirmed=True)
    assert confirmed.identify().unit == "degC"
    device.finish()


def test_read() -> None:
    """Two questions, and a third only where there are alarms; alarms are not acknowledged, and stay in the reading."""
    chamber, device = _chamber(
        [
            *_look("26.4,0.0,140.0,-50.0"),
            *_look("26.4,0.0,140.0,-50.0", "STANDBY", "19", "40"),
            *_look("26.4,0.0,140.0,-50.0", "STANDBY"),
        ]
    )
    assert chamber.read() == ChamberReading(26.4, 0.0, 140.0, -50.0, "CONSTANT", ())
    assert chamber.read() == ChamberReading(26.4, 0.0, 140.0, -50.0, "STANDBY", ("alarm 19", "alarm 40"))
    assert chamber.read().alarms == ("alarm 19", "alarm 40")
    device.finish()


def test_an_alarm_without_a_code_is_still_an_alarm() -> None:
    """MON? counts one; ALARM?, a moment later, none."""
    chamber, _ = _chamber([("TEMP?", "26.4,0.0,140.0,-50.0"), ("MON?", "26.4,,STANDBY,1"), ("ALARM?", "0")])
    assert chamber.read().alarms == ("alarm without a code",)


def test_prepare_starts_an_idle_chamber_at_its_present_temperature() -> None:
    """The forgotten setpoint of 85 °C is replaced before the limits are tightened and the power comes on."""
    chamber, device = _chamber(
        [
            *IDENTIFY,
            *_look("23.04,85.0,105.0,-30.0", "OFF"),
            *_look("23.04,85.0,105.0,-30.0", "OFF"),
            ("TEMP,L-40.0", "OK:TEMP,L-40.0"),
            ("TEMP,S23.0", "OK:TEMP,S23.0"),
            ("TEMP,H70.0", "OK:TEMP,H70.0"),
            *_look("23.0,23.0,70.0,-40.0", "OFF"),
            ("POWER,ON", "OK:POWER,ON"),
            ("MODE,CONSTANT", "OK:MODE,CONSTANT"),
            *_look("23.0,23.0,70.0,-40.0"),
        ]
    )
    chamber.prepare()
    device.finish()


def test_prepare_leaves_a_chamber_that_holds_a_legal_setpoint_alone() -> None:
    """After a crash of the controller the soak may still be good: nothing is written."""
    chamber, device = _chamber([*MODEL, *_look("60.0,60.0,70.0,-40.0") * 5])
    chamber.prepare()
    device.finish()


def test_prepare_brings_an_illegal_setpoint_inside() -> None:
    """A chamber left running at 85 °C begins at the bench's limit; its high alarm stays beyond its air of 80 °C."""
    chamber, device = _chamber(
        [
            *MODEL,
            *_look("80.0,85.0,105.0,-40.0") * 3,
            ("TEMP,S65.0", "OK:1,temp,s65.0"),
            ("TEMP,H85.0", "OK:1,temp,h85.0"),
            *_look("79.8,65.0,85.0,-40.0") * 2,
        ]
    )
    chamber.prepare()
    device.finish()


@pytest.mark.parametrize(
    ("mode", "alarms", "words"), [("STANDBY", ["19"], "reports alarm 19"), ("RUN PAUSE", [], "is running a program")]
)
def test_prepare_writes_nothing_where_a_person_must_come_first(mode: str, alarms: list[str], words: str) -> None:
    """An active alarm, or somebody's program."""
    chamber, device = _chamber([*IDENTIFY, *_look("23.0,25.0,70.0,-40.0", mode, *alarms)])
    with pytest.raises(CommandRefused, match=words):
        chamber.prepare()
    device.finish()


def test_a_controller_without_the_power_command_is_started_by_its_mode() -> None:
    """POWER,ON refused: what counts is the mode read at the end."""
    chamber, device = _chamber(
        [
            *IDENTIFY,
            *_look("23.0,23.0,70.0,-40.0", "OFF") * 3,
            ("POWER,ON", "NA:CMD ERR"),
            ("MODE,CONSTANT", "OK:1,mode,constant"),
            *_look("23.0,23.0,70.0,-40.0", "STANDBY"),
            *_look("23.0,23.0,70.0,-40.0"),
        ]
    )
    chamber.prepare()
    device.finish()


def test_a_chamber_that_stands_by_is_started_without_its_power() -> None:
    """That is on."""
    chamber, device = _chamber(
        [
            *MODEL,
            *_look("23.0,23.0,70.0,-40.0", "STANDBY") * 4,
            ("MODE,CONSTANT", "OK:MODE,CONSTANT"),
            *_look("23.0,23.0,70.0,-40.0"),
        ]
    )
    chamber.prepare()
    device.finish()


def test_what_it_was_seen_doing_counts_though_its_alarms_cannot_be_read() -> None:
    """It stands by: its power is not switched on."""
    unreadable = [*_look("60.0,60.0,70.0,-40.0", "STANDBY", "19")[:2], *[("ALARM?", "1")] * 3]
    exchanges = [*unreadable, ("MODE,CONSTANT", "OK:MODE,CONSTANT")]
    device = TranscriptDevice([((ask + "\r\n").encode(), (reply + "\r\n").encode()) for ask, reply in exchanges])
    controller = espec(MemoryTransport(device, clock := VirtualClock(), "sim://chamber"), clock)
    with pytest.raises(ProtocolError, match="so many codes"):
        controller.state()
    controller.start()
    device.finish()


SET_PREFIX = [*MODEL, *_look("23.0,23.0,70.0,-40.0") * 2]


def test_set_temperature() -> None:
    """-21.5 °F: written in tenths, read back, and the mode looked at."""
    chamber, device = _chamber(
        [*SET_PREFIX, ("TEMP,S-29.7", "OK:TEMP,S-29.7"), *_look("23.0,-29.7,70.0,-40.0")],
    )
    chamber.set_temperature((-21.5 - 32.0) / 1.8)
    device.finish()


def test_a_setpoint_that_already_holds_is_confirmed_and_not_written() -> None:
    """Two reads of it, no write."""
    chamber, device = _chamber([*SET_PREFIX, *_look("23.0,23.0,70.0,-40.0")])
    chamber.set_temperature(23.04)
    device.finish()


def test_native_limits_changed_at_the_panel_are_put_right_around_the_setpoint() -> None:
    """Widen, set, tighten: the setpoint of 60 °C would be refused under a high alarm of 50 °C."""
    chamber, device = _chamber(
        [
            *MODEL,
            *_look("23.0,23.0,50.0,-60.0") * 2,
            ("TEMP,H70.0", "OK:TEMP,H70.0"),
            ("TEMP,S60.0", "OK:TEMP,S60.0"),
            ("TEMP,L-40.0", "OK:TEMP,L-40.0"),
            *_look("23.0,60.0,70.0,-40.0"),
        ]
    )
    chamber.set_temperature(60.0)
    device.finish()


@pytest.mark.parametrize("wanted", [65.1, -35.1, 9999.0, float("nan")])
def test_a_setpoint_outside_the_limits_sends_no_byte(wanted: float) -> None:
    """Not even a question."""
    chamber, device = _chamber([])
    with pytest.raises(SetpointOutOfLimits):
        chamber.set_temperature(wanted)
    device.finish()


def test_a_setpoint_that_is_not_read_back_is_an_error() -> None:
    """Acknowledged, yet 0.1 °C off: read three times, written once."""
    chamber, device = _chamber([*SET_PREFIX, ("TEMP,S60.0", "OK:TEMP,S60.0"), *_look("23.0,60.1,70.0,-40.0") * 3])
    with pytest.raises(ProtocolError, match=r"reads back setpoint 60\.1 °C instead of 60 °C"):
        chamber.set_temperature(60.0)
    device.finish()


def test_a_late_reply_with_the_old_setpoint_is_no_mismatch() -> None:
    """Asked once more, the controller shows the new one."""
    chamber, device = _chamber(
        [
            *SET_PREFIX,
            ("TEMP,S60.0", "OK:TEMP,S60.0"),
            *_look("23.0,23.0,70.0,-40.0"),
            *_look("23.0,60.0,70.0,-40.0"),
        ]
    )
    chamber.set_temperature(60.0)
    device.finish()


@pytest.mark.parametrize("reply", ["", "\x01garbage", "26.4,0.0,140.0,-50.0"])
def test_a_write_whose_reply_is_lost_is_read_back_and_not_repeated(reply: str) -> None:
    """It was carried out: that is known from reading, and the setting is sent once."""
    chamber, device = _chamber([*SET_PREFIX, ("TEMP,S60.0", reply), *_look("23.0,60.0,70.0,-40.0")])
    chamber.set_temperature(60.0)
    device.finish()


def test_a_refused_write_is_not_repeated() -> None:
    """PROTECT ON is for an operator."""
    chamber, device = _chamber([*SET_PREFIX, ("TEMP,S60.0", "NA:PROTECT ON")])
    with pytest.raises(CommandRefused, match="an operator must release it at the panel"):
        chamber.set_temperature(60.0)
    device.finish()


def test_a_chamber_that_is_not_running_takes_no_setpoint_silently() -> None:
    """After a power cut it holds the setpoint and does nothing."""
    chamber, device = _chamber([*SET_PREFIX, ("TEMP,S60.0", "OK:"), *_look("23.0,60.0,70.0,-40.0", "OFF")])
    with pytest.raises(CommandRefused, match="mode OFF: it was stopped"):
        chamber.set_temperature(60.0)
    device.finish()


def test_an_address_goes_before_every_request() -> None:
    """RS-485: `1,MON?` as in the manual."""
    chamber, device = _chamber(
        [("1,TEMP?", "24.1,25.0,70.0,-40.0"), ("1,MON?", "24.1,100,CONSTANT,0")], address=1, terminator="CR"
    )
    assert chamber.read().temperature_degC == 24.1
    device.finish()


ARM = [
    ("TIMER ON?", "0"),
    ("TIMER,OFF,0", "NA:PARA ERR"),  # it is not on
    ("TIMER WRITE,NO0,1:31,STANDBY", "OK:TIMER WRITE,NO0,1:31,STANDBY"),
    ("TIMER,ON,0", "OK:TIMER,ON,0"),
    ("TIMER LIST?,0", "STANDBY,1:31"),
    ("TIMER ON?", "1,0"),
]


def test_the_dead_man_is_armed_before_anything_is_set() -> None:
    """The quick timer leads to STANDBY, in whole minutes and never sooner than asked; it is read back."""
    chamber, device = _chamber(
        [*MODEL, *_look("60.0,60.0,70.0,-40.0") * 2, *ARM, *_look("60.0,60.0,70.0,-40.0") * 3],
        dead_man_s=90.5 * 60.0,
    )
    chamber.prepare()
    device.finish()


@pytest.mark.parametrize(("listed", "asked"), [("OFF,1:31", 3), ("STANDBY,0:05", 1), ("STANDBY,15:01", 1)])
def test_a_timer_that_is_not_read_back_is_an_error(listed: str, asked: int) -> None:
    """Another mode, or another time: nothing was set yet."""
    chamber, device = _chamber(
        [*MODEL, *_look("60.0,60.0,70.0,-40.0") * 2, *ARM[:4], *[("TIMER LIST?,0", listed)] * asked],
        dead_man_s=90.5 * 60.0,
    )
    with pytest.raises(ProtocolError, match="did not take its timer"):
        chamber.prepare()
    device.finish()


def test_a_controller_without_a_timer_is_named() -> None:
    """An SCP-220 may not know the command."""
    chamber, device = _chamber(
        [*MODEL, *_look("60.0,60.0,70.0,-40.0") * 2, *[("TIMER ON?", "NA:CMD ERR")] * 3], dead_man_s=3600.0
    )
    with pytest.raises(CommandRefused, match="has no timer of its own"):
        chamber.prepare()
    device.finish()


SAFE_LOOKS = "60.0,60.0,70.0,-40.0"


@pytest.mark.parametrize(
    ("safe", "exchanges"),
    [
        (SafeState("standby"), _look(SAFE_LOOKS, "STANDBY")),
        (SafeState("standby"), _look(SAFE_LOOKS, "OFF")),
        (SafeState("off"), _look(SAFE_LOOKS, "OFF")),
        (SafeState("hold", 25.0), _look("60.0,25.0,99.0,-40.0") * 2),
        (
            SafeState("standby"),
            [*_look(SAFE_LOOKS) * 2, ("MODE,STANDBY", "OK:MODE,STANDBY"), *_look(SAFE_LOOKS, "STANDBY")],
        ),
        (
            SafeState("off"),
            [
                *_look(SAFE_LOOKS, "RUN") * 2,
                ("PRGM,END,STANDBY", "OK:PRGM,END,STANDBY"),
                ("MODE,OFF", "OK:MODE,OFF"),
                *_look(SAFE_LOOKS, "OFF"),
            ],
        ),
        (
            SafeState("hold", 25.0),
            [
                *_look(SAFE_LOOKS, "OFF") * 3,
                ("TEMP,S25.0", "OK:TEMP,S25.0"),
                *_look("60.0,25.0,70.0,-40.0", "OFF"),
                ("POWER,ON", "OK:POWER,ON"),
                ("MODE,CONSTANT", "OK:MODE,CONSTANT"),
                *_look("60.0,25.0,70.0,-40.0") * 2,
            ],
        ),
        (
            SafeState("hold", 25.0),  # the native limits cannot be had: the setpoint is what matters
            [
                *_look("60.0,60.0,65.0,-40.0") * 3,
                ("TEMP,H70.0", "NA:DATA OUT OF RANGE"),
                ("TEMP,S25.0", "OK:TEMP,S25.0"),
                *_look("60.0,25.0,65.0,-40.0") * 2,
            ],
        ),
    ],
)
def test_safe_state(safe: SafeState, exchanges: list[tuple[str, str]]) -> None:
    """What is safe is left alone; otherwise the shortest way there, and read at the end. No identification first."""
    chamber, device = _chamber(exchanges, safe=safe)
    chamber.safe_state()
    device.finish()
