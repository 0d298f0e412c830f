"""The text drivers' own bytes: one transcript per conversation, and nothing left over."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from drivers.chambers import ChamberLimits, SafeState
from drivers.chambers.controller import Controller
from drivers.chambers.controllers.voetsch_ascii import AsciiLayout, VoetschAscii
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, ProtocolError
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport
from tests.drivers.chambers.shipped import julabo, simserv, simulated_simserv, simulated_thermotron, thermotron
from tests.drivers.transcript import TranscriptDevice

LIMITS = ChamberLimits(-35.0, 65.0)


def _chamber(
    kind: Callable[..., Controller],
    exchanges: Sequence[tuple[str, str | None]],
    ends: tuple[str, str] = ("\r", "\r"),
    **settings: Any,
) -> tuple[SupervisedChamber, TranscriptDevice]:
    clock = VirtualClock()
    device = TranscriptDevice(
        [
            ((request + ends[0]).encode("latin-1"), b"" if reply is None else (reply + ends[1]).encode("latin-1"))
            for request, reply in exchanges
        ]
    )
    controller = kind(MemoryTransport(device, clock, "sim://chamber"), clock, **settings)
    chamber = SupervisedChamber(
        controller,
        clock,
        Supervision(limits=LIMITS, safe=SafeState("off"), native_margin_degC=5.0, celsius_confirmed=True),
    )
    return chamber, device


def _ascii2(setpoint: str, bits: str) -> tuple[str, str]:
    return ("$00I", f"{setpoint} 0023.0 0001.0 0023.0 0000.0 0023.0 0000.0 0023.0 0000.0 0023.0 {bits}")


def test_ascii2_starts_and_keeps_what_is_not_its_own() -> None:
    """The second value and dry air (bit 6) are written back as they were; start and temperature bit come last."""
    chamber, device = _chamber(
        VoetschAscii,
        [
            _ascii2("0085.0", "0000001000000000"),
            _ascii2("0085.0", "0000001000000000"),
            _ascii2("0085.0", "0000001000000000"),
            ("$00E 0023.0 0001.0 0000.0 0000.0 0000.0 0000001000000000", "0"),
            _ascii2("0023.0", "0000001000000000"),
            ("$00E 0023.0 0001.0 0000.0 0000.0 0000.0 0101001000000000", "0"),
            _ascii2("0023.0", "0101001000000000"),
        ],
        limits=LIMITS,
    )
    chamber.prepare()
    device.finish()


def test_ascii2_writes_its_error_bit_as_0() -> None:
    """It is an input; what the chamber would do with a 1 there nobody knows."""
    stopped = _ascii2("0023.0", "0000001000000000")
    chamber, device = _chamber(
        VoetschAscii,
        [
            *[_ascii2("0023.0", "0111001000000000"), ("$00F", "02 test spec.")] * 2,
            ("$00P0000", "0"),
            ("$00E 0023.0 0001.0 0000.0 0000.0 0000.0 0001001000000000", "0"),
            stopped,
        ],
        limits=LIMITS,
    )
    chamber.safe_state()
    device.finish()


def test_ascii2_tells_its_error_and_does_not_acknowledge_it() -> None:
    """Bit 2, then $00F; $00Q is never sent."""
    chamber, device = _chamber(
        VoetschAscii,
        [_ascii2("0023.0", "0010000000000000"), ("$00F", "01 temperature limiter test space")],
        limits=LIMITS,
    )
    assert chamber.read().alarms == ("error 01: temperature limiter test space",)
    device.finish()


def test_ascii2_stops_with_a_legal_setpoint() -> None:
    """A stop writes everything: what somebody left at 85 °C goes out as the bench's limit."""
    chamber, device = _chamber(
        VoetschAscii,
        [
            _ascii2("0085.0", "0101000000000000"),
            _ascii2("0085.0", "0101000000000000"),
            ("$00P0000", "0"),
            ("$00E 0065.0 0001.0 0000.0 0000.0 0000.0 0001000000000000", "0"),
            _ascii2("0065.0", "0001000000000000"),
        ],
        limits=LIMITS,
    )
    chamber.safe_state()
    device.finish()


def test_ascii2_of_another_layout() -> None:
    """Actual values first, three pairs, 32 bits, the start bit alone."""
    layout = AsciiLayout(pairs=3, nominal_first=False, written=2, bits=32, start_bit=0, channel_bit=None, error_bit=2)
    off, on = "0" * 32, "1" + "0" * 31
    chamber, device = _chamber(
        VoetschAscii,
        [
            *[("$01I", f"0022.5 0050.0 0001.0 0002.0 0003.0 0004.0 {off}")] * 3,
            ("$01E 0022.5 0002.0 " + off, "0"),
            ("$01I", f"0022.5 0022.5 0001.0 0002.0 0003.0 0004.0 {off}"),
            ("$01E 0022.5 0002.0 " + on, "0"),
            ("$01I", f"0022.5 0022.5 0001.0 0002.0 0003.0 0004.0 {on}"),
        ],
        limits=LIMITS,
        address=1,
        layout=layout,
    )
    chamber.prepare()
    device.finish()


def test_ascii2_with_an_unexpected_layout_is_refused() -> None:
    """Eight bits where sixteen were expected."""
    chamber, device = _chamber(VoetschAscii, [_ascii2("0023.0", "00000000")] * 3, limits=LIMITS)
    with pytest.raises(ProtocolError, match="10 numbers and 16 bits were expected"):
        chamber.identify()
    device.finish()


def test_ascii2_has_a_ramp() -> None:
    """Ten numbers: up and down of each channel. Less than a tenth would be written as none: the host steps it."""
    gradient = "$00U 0002.5 0002.5 0000.0 0000.0 0000.0 0000.0 0000.0 0000.0 0000.0 0000.0"
    chamber, device = _chamber(VoetschAscii, [_ascii2("0023.0", "0101000000000000"), (gradient, "0")], limits=LIMITS)
    assert chamber.set_ramp_rate(0.04) is False
    assert chamber.set_ramp_rate(2.5) is True
    device.finish()


SIMSERV = ("\r", "\r\n")
SIMSERV_IDENTIFY = [("99997¶1¶1", "1¶LabEvent"), ("11023¶1¶1", "1¶°C"), ("11009¶1¶1", "1¶180.0")]


def _simserv(setpoint: str, status: str = "3", running: str = "1") -> list[tuple[str, str]]:
    return [
        ("11004¶1¶1", "1¶23.041"),
        ("11002¶1¶1", f"1¶{setpoint}"),
        ("10012¶1", f"1¶{status}"),
        ("14003¶1¶1", f"1¶{running}"),
    ]


def test_simserv_sets_a_temperature() -> None:
    """-21.5 °F: type, look, write, look again."""
    chamber, device = _chamber(
        simserv,
        [*SIMSERV_IDENTIFY, *_simserv("20.0"), ("11001¶1¶1¶-29.7", "1"), *_simserv("-29.7")],
        SIMSERV,
    )
    chamber.set_temperature((-21.5 - 32.0) / 1.8)
    device.finish()


@pytest.mark.parametrize(
    ("replies", "unit", "maximum"),
    [
        (["1¶°C", "1¶180.0"], "degC", 180.0),
        (["1¶Grad C", "1¶180.0"], "degC", 180.0),
        (["1¶°F", "1¶356.0"], "degF", 356.0),
        (["-5"] * 3, None, None),
    ],
)
def test_simserv_says_its_unit_and_how_hot_it_can_be(
    replies: list[str], unit: str | None, maximum: float | None
) -> None:
    """11023 and 11009; an older one knows neither, and a person must have seen °C."""
    asked = ["11023¶1¶1", "11009¶1¶1"] if unit else ["11023¶1¶1"] * 3
    lines = [("99997¶1¶1", "1¶LabEvent"), *zip(asked, replies, strict=True)]
    exchanges = [((ask + "\r").encode("latin-1"), (reply + "\r\n").encode("latin-1")) for ask, reply in lines]
    clock, device = VirtualClock(), TranscriptDevice(exchanges)
    identity = simserv(MemoryTransport(device, clock, "sim://chamber"), clock).identify()
    assert (identity.unit, identity.maximum) == (unit, maximum)
    device.finish()


def test_a_simulated_simserv_answers_what_public_clients_ask() -> None:
    """Its unit and the limit of what may be entered."""
    device = simulated_simserv(ChamberPlant())
    device.receive("11023¶1¶1\r11009¶1¶1\r".encode("latin-1"), 0.0)
    assert device.transmit(1.0) == "1¶°C\r\n1¶185.000\r\n".encode("latin-1")


def test_simserv_names_its_alarms() -> None:
    """Only messages that are alarms and active; 17012, which would reset them, is never sent."""
    chamber, device = _chamber(
        simserv,
        [
            *_simserv("20.0", status="9", running="0"),
            ("17002¶1", "1¶3"),
            ("17005¶1¶1", "1¶2"),
            ("17005¶1¶2", "1¶1"),
            ("17009¶1¶2", "1¶1"),
            ("17007¶1¶2", "1¶Temperaturbegrenzer Prüfraum"),
            ("17005¶1¶3", "1¶1"),
            ("17009¶1¶3", "1¶0"),
        ],
        SIMSERV,
    )
    assert chamber.read().alarms == ("Temperaturbegrenzer Prüfraum",)
    device.finish()


def test_simserv_refusals_are_in_words() -> None:
    """-12: whoever is logged in may not do this; sent once."""
    chamber, device = _chamber(
        simserv,
        [*SIMSERV_IDENTIFY, *_simserv("20.0"), ("11001¶1¶1¶60", "-12")],
        SIMSERV,
    )
    with pytest.raises(CommandRefused, match="may not do this"):
        chamber.set_temperature(60.0)
    device.finish()


def test_simserv_has_a_ramp_no_faster_than_it_can() -> None:
    """4 °C/min: up as asked, down as fast as it can; both read back."""
    chamber, device = _chamber(
        simserv,
        [
            *SIMSERV_IDENTIFY,
            ("11068¶1¶1¶4", "1"),
            ("11066¶1¶1", "1¶4.0"),
            ("11072¶1¶1¶3.5", "1"),
            ("11070¶1¶1", "1¶3.5"),
        ],
        SIMSERV,
    )
    assert chamber.set_ramp_rate(4.0) is True
    device.finish()


def _thermotron(setpoint: str, mode: str = "16", alarms: str = "0") -> list[tuple[str, str]]:
    return [("PVAR1?", "23.041"), ("SETP1?", setpoint), ("MODE?", mode), ("ALRM1?", alarms)]


@pytest.mark.parametrize(("set_reply", "run_reply"), [("-29.700", None), ("0", "0"), (None, None)])
def test_thermotron_sets_a_temperature(set_reply: str | None, run_reply: str | None) -> None:
    """RUNM lets it take effect, however operations are answered."""
    chamber, device = _chamber(
        thermotron,
        [
            ("IDEN?", "THERMOTRON 8800"),
            *_thermotron("22.000"),
            ("SETP1,-29.700", set_reply),
            ("RUNM", run_reply),
            *_thermotron("-29.700"),
        ],
    )
    chamber.set_temperature((-21.5 - 32.0) / 1.8)
    device.finish()


def test_thermotron_refusals_are_not_guessed_at() -> None:
    """Any code but 0 is a refusal."""
    chamber, device = _chamber(
        thermotron, [("IDEN?", "THERMOTRON 8800"), *_thermotron("22.000"), ("SETP1,60.000", "5")]
    )
    with pytest.raises(CommandRefused, match="with code 5; look at its panel"):
        chamber.set_temperature(60.0)
    device.finish()


def test_thermotron_takes_no_code_for_a_temperature() -> None:
    """A refused question is answered with 5, which is not 5 °C."""
    chamber, device = _chamber(thermotron, [("PVAR1?", "5")] * 3)
    with pytest.raises(CommandRefused, match="refused 'PVAR1\\?' with code 5"):
        chamber.read()
    device.finish()


def test_thermotron_alarm_bits_have_names() -> None:
    """Bits 1 and 5."""
    chamber, device = _chamber(thermotron, _thermotron("22.000", mode="2", alarms="34"))
    reading = chamber.read()
    assert (reading.alarms, reading.mode) == (("high deviation", "high process"), "OFF")
    device.finish()


@pytest.mark.parametrize(
    ("exchanges", "native"),
    [
        ([("MRMP1,2.5", "0"), ("MRMP1?", "2.5")], True),
        ([("MRMP1,2.5", "2.5"), ("MRMP1?", "2.500")], True),
        ([("MRMP1,2.5", "5")], False),
    ],
)
def test_thermotron_ramps_in_units_per_minute_where_it_knows_the_command(
    exchanges: list[tuple[str, str]], native: bool
) -> None:
    """As a public client sends it; one that refuses it is stepped by the host."""
    chamber, device = _chamber(thermotron, [("IDEN?", "THERMOTRON 8800"), *exchanges])
    assert chamber.set_ramp_rate(2.5) is native
    device.finish()


def test_thermotron_that_ramps_otherwise_than_it_was_told_is_an_error() -> None:
    """Its rate is read back."""
    exchanges = [("IDEN?", "THERMOTRON 8800"), ("MRMP1,2.5", "0"), ("MRMP1?", "5.0")]
    chamber, _ = _chamber(thermotron, exchanges)
    with pytest.raises(ProtocolError, match=r"reads back 5 where 2\.5 was set"):
        chamber.set_ramp_rate(2.5)


def test_what_is_no_number_confirms_no_setting() -> None:
    """Dashes are what a panel shows where it has no value."""
    exchanges = [("11068¶1¶1¶2.5", "1"), ("11066¶1¶1", "1¶---.-")]
    clock, replies = (
        VirtualClock(),
        [((a + "\r").encode("latin-1"), (b + "\r\n").encode("latin-1")) for a, b in exchanges],
    )
    driver = simserv(MemoryTransport(TranscriptDevice(replies), clock, "sim://chamber"), clock)
    with pytest.raises(ProtocolError, match=r"reads back nan where 2\.5 was set"):
        driver.set_ramp_rate(2.5)


def test_a_simulated_thermotron_answers_what_public_clients_ask() -> None:
    """Its version and why it stopped."""
    device = simulated_thermotron(ChamberPlant())
    device.receive(b"VRSN?\rSCOD?\r", 0.0)
    assert device.transmit(1.0) == b"SIMULATED\r0\r"


def _julabo(setpoint: str, high: str, low: str, status: str = "03 REMOTE START") -> list[tuple[str, str]]:
    return [
        ("IN_PV_00", "23.04"),
        ("IN_SP_00", setpoint),
        ("IN_SP_03", high),
        ("IN_SP_04", low),
        ("IN_MODE_05", "1"),
        ("STATUS", status),
    ]


def test_julabo_sets_its_temperature_and_its_warning_limits() -> None:
    """The high limit is widened before, the low one tightened after; nothing is answered, everything read back."""
    chamber, device = _chamber(
        julabo,
        [
            ("VERSION", "JULABO CRYOCOMPACT CF31 VERSION 5.0"),
            *_julabo("20.0", "60.00", "-50.00"),
            ("OUT_SP_03 70.0", None),
            ("OUT_SP_00 62.5", None),
            ("OUT_SP_04 -40.0", None),
            *_julabo("62.5", "70.00", "-40.00"),
        ],
        ("\r", "\n"),
    )
    chamber.set_temperature(62.5)
    device.finish()


def test_julabo_alarms_and_complaints_about_commands_are_told_apart() -> None:
    """-01 is an alarm; -10 was about the last command."""
    for status, alarms in (("-01 LOW LEVEL ALARM", ("-01 LOW LEVEL ALARM",)), ("-10 VALUE TOO SMALL", ())):
        chamber, device = _chamber(julabo, _julabo("20.0", "70.00", "-40.00", status), ("\r", "\r\n"))
        assert chamber.read().alarms == alarms
        device.finish()


def test_julabo_status_that_is_none_is_asked_again_and_no_alarm() -> None:
    """Noise in a status line must not end a night."""
    look = _julabo("20.0", "70.00", "-40.00", "p2 REMOTE STOP")
    chamber, device = _chamber(julabo, [*look, look[-1], look[-1]], ("\r", "\r\n"))
    with pytest.raises(ProtocolError, match="answered 'STATUS' with 'p2 REMOTE STOP', which is no alarm and not none"):
        chamber.read()
    device.finish()
