"""The device that plays a transcript notices every deviation: tests that rest on it can fail."""

from __future__ import annotations

import pytest

from tests.drivers.transcript import TranscriptDevice

EXCHANGES = [(b"A?\r\n", b"1\r\n"), (b"B\r\n", b"")]


def test_a_conversation_as_written() -> None:
    """In pieces, with its latency, and with silence where silence is written."""
    device = TranscriptDevice(EXCHANGES, latency_s=0.05)
    device.receive(b"A", 0.0)
    device.receive(b"?\r\n", 0.01)
    assert device.transmit(0.05) == b""
    assert device.next_transmission(0.05) == pytest.approx(0.06)
    assert device.transmit(0.06) == b"1\r\n"
    device.receive(b"B\r\n", 1.0)
    assert device.next_transmission(1.0) is None
    device.finish()
    assert device.received_at_s == [0.01, 1.0]


@pytest.mark.parametrize("sent", [b"B\r\n", b"A?\n", b"A?\r\nA?\r\n", b"a"])
def test_other_bytes_are_refused_at_once(sent: bytes) -> None:
    """Another order, another terminator, more than was written, another case."""
    with pytest.raises(AssertionError, match="expect"):
        TranscriptDevice(EXCHANGES).receive(sent, 0.0)


def test_more_than_the_transcript_is_refused() -> None:
    """After its end nothing may be sent."""
    with pytest.raises(AssertionError, match="nothing more was expected"):
        TranscriptDevice([]).receive(b"A", 0.0)


def test_what_is_left_over_is_named() -> None:
    """Requests not made, half a request, replies not fetched."""
    device = TranscriptDevice(EXCHANGES)
    with pytest.raises(AssertionError, match=r"A\?"):
        device.finish()
    device.receive(b"A?\r\n", 0.0)
    device.transmit(1.0)
    device.receive(b"B\r", 2.0)
    with pytest.raises(AssertionError, match="half a request"):
        device.finish()
    unfetched = TranscriptDevice(EXCHANGES[:1])
    unfetched.receive(b"A?\r\n", 0.0)
    with pytest.raises(AssertionError, match="left over"):
        unfetched.finish()
