"""What stands around a text: frames with block checks as other people's devices send them."""

from __future__ import annotations

import pytest

from drivers.clock import VirtualClock
from drivers.errors import DeviceTimeout
from drivers.simulators.memory import MemoryTransport
from drivers.transports.framing import BlockCheck, Frame, Line, Silence
from tests.drivers.transcript import TranscriptDevice

# The SB22's sum is published with its bytes; the exclusive or behind ETX, as EI-Bisynch has it, is worked out by hand.
SB22 = Frame(("STX", "text", "check", "ETX"), BlockCheck("sum", ("STX", "text"), "hex", negated=True))
BISYNCH = Frame(("STX", "text", "ETX", "check"), BlockCheck("xor", ("text", "ETX")))


@pytest.mark.parametrize(
    ("frame", "text", "whole"),
    [
        (SB22, b"1?", bytes.fromhex("02 31 3f 38 45 03")),
        (SB22, b"1T025.0F00R0000000000000000", b"\x021T025.0F00R00000000000000008C\x03"),
        (BISYNCH, b"PV 16.4", b"\x02PV 16.4\x03\x38"),
        (Frame(("STX", "text", "ETX", "CR")), b"T?", b"\x02T?\x03\r"),
    ],
)
def test_a_text_is_packed_and_found_again(frame: Frame, text: bytes, whole: bytes) -> None:
    """Behind noise, before what follows, and not before the last byte has come."""
    assert frame.packed(text) == whole
    assert frame.cut(b"noise" + whole + b"more") == (text, b"more")
    assert [frame.cut(whole[:size]) for size in range(len(whole))] == [None] * len(whole)


@pytest.mark.parametrize("frame", [SB22, BISYNCH])
def test_one_wrong_bit_is_noticed(frame: Frame) -> None:
    """Wherever it is in the text or in the check."""
    whole = frame.packed(b"PV 16.4")
    for place in range(1, len(whole) - 2):
        damaged = bytearray(whole)
        damaged[place] ^= 0x08
        with pytest.raises(ValueError, match="wrong block check"):
            frame.cut(bytes(damaged))


def test_a_check_that_looks_like_the_end_is_no_end() -> None:
    """The exclusive or of two equal characters and ETX is ETX."""
    assert BISYNCH.packed(b"AA") == b"\x02AA\x03\x03"
    assert BISYNCH.cut(b"\x02AA\x03\x03") == (b"AA", b"")
    assert BISYNCH.cut(b"\x02AA\x03") is None


EUROTHERM = Frame(
    ("STX", "text", "ETX", "check"),
    BlockCheck("xor", ("text", "ETX")),
    address="1122",
    asked=("EOT", "address", "text", "ENQ"),
    told=("EOT", "address", "STX", "text", "ETX", "check"),
    alone=("ACK", "NAK", "EOT"),
)


def test_questions_settings_and_replies_may_stand_in_frames_of_their_own() -> None:
    """As in EI-Bisynch; what comes alone has its name. A check may be what ends a question, ENQ."""
    assert EUROTHERM.of(EUROTHERM.asked).packed(b"PV") == b"\x041122PV\x05"
    assert EUROTHERM.of(EUROTHERM.told).packed(b"SL25.0") == b"\x041122\x02SL25.0\x03\x05"
    assert EUROTHERM.packed(b"NAK") == b"\x15"
    assert EUROTHERM.cut(b"\x06\x04") == (b"ACK", b"\x04")
    assert EUROTHERM.received(_transport(b"\x04")[0], 1.0) == b"EOT"
    assert EUROTHERM.received(_transport(b"\x02PV16.4\x03\x18")[0], 1.0) == b"PV16.4"
    with pytest.raises(ValueError, match="'EXT' is no part of a frame"):
        Frame(("STX", "text", "ETX"), told=("STX", "text", "EXT"))


def _transport(reply: bytes) -> tuple[MemoryTransport, VirtualClock]:
    clock = VirtualClock()
    transport = MemoryTransport(TranscriptDevice([(b"?", reply)]), clock, "sim://box")
    transport.write(b"?")
    return transport, clock


def test_what_nothing_ends_has_a_length_or_is_followed_by_silence() -> None:
    """And what comes short is a time-out within its time."""
    assert Silence(0.2).received(_transport(b"A0 023.0 020.0xx")[0], 1.0, 14) == b"A0 023.0 020.0"
    transport, clock = _transport(b"A0 023.0")
    assert Silence(0.2).received(transport, 1.0) == b"A0 023.0"
    assert clock.now() == pytest.approx(0.25, abs=0.01)
    with pytest.raises(DeviceTimeout, match="8 of 14 bytes within 1 s"):
        Silence(0.2).received(_transport(b"A0 023.0")[0], 1.0, 14)


def test_a_line_ends_with_its_terminator() -> None:
    """Blanks around it mean nothing."""
    assert Line(b"\r\n").cut(b" 23.0 \r\n1") == (b"23.0", b"1")
    assert Line(b"\r\n").cut(b"23.0\r") is None
