"""Requests over lines: paced, drained, retried for reads only."""

from __future__ import annotations

import pytest

from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, DeviceTimeout, ProtocolError, TransportError
from drivers.simulators.memory import MemoryTransport
from drivers.transports.framing import lines
from drivers.transports.lines import LineExchange
from drivers.transports.transport import Timing
from tests.drivers.transcript import TranscriptDevice

TIMING = Timing(timeout_s=2.0, pause_after_query_s=0.3, pause_after_command_s=0.5)


def _exchange(*exchanges: tuple[bytes, bytes]) -> tuple[LineExchange, TranscriptDevice, VirtualClock]:
    clock = VirtualClock()
    device = TranscriptDevice(exchanges)
    transport = MemoryTransport(device, clock, "sim://chamber")
    return LineExchange(transport, clock, device="chamber", framings=lines("CR LF"), timing=TIMING), device, clock


def _number(line: str) -> float:
    try:
        return float(line)
    except ValueError:
        raise ProtocolError(f"{line!r} is no number") from None


def _ok(line: str) -> bool:
    if line.startswith("NA"):
        raise CommandRefused(line)
    return line.startswith("OK")


def test_requests_are_paced_by_the_clock() -> None:
    """0.3 s after a query's reply, 0.5 s after a command's; the first waits for nothing."""
    exchange, device, _ = _exchange((b"T?\r\n", b"1\r\n"), (b"S1\r\n", b"OK\r\n"), (b"T?\r\n", b"2\r\n"))
    assert exchange.query("T?", _number) == 1.0
    assert exchange.command("S1", _ok)
    assert exchange.query("T?", _number) == 2.0
    device.finish()
    assert device.received_at_s == pytest.approx([0.0, 0.35, 0.9])


def test_no_more_waiting_than_the_pause_needs() -> None:
    """Where the pause has passed by itself, the next request goes at once."""
    exchange, device, clock = _exchange((b"T?\r\n", b"1\r\n"), (b"T?\r\n", b"2\r\n"))
    exchange.query("T?", _number)
    clock.sleep(10.0)
    exchange.query("T?", _number)
    assert device.received_at_s == pytest.approx([0.0, 10.05])


@pytest.mark.parametrize("bad", [b"", b"noise\r\n", b"\xff\xfe\r\n", b"1"])
def test_a_read_is_asked_again(bad: bytes) -> None:
    """After silence, garbage, bytes that are no text, and a line that breaks off."""
    exchange, device, _ = _exchange((b"T?\r\n", bad), (b"T?\r\n", b"5\r\n"))
    assert exchange.query("T?", _number) == 5.0
    device.finish()


@pytest.mark.parametrize(("bad", "error"), [(b"", DeviceTimeout), (b"noise\r\n", ProtocolError)])
def test_a_read_is_asked_a_bounded_number_of_times(bad: bytes, error: type[Exception]) -> None:
    """Three times, then its last error says so."""
    exchange, device, clock = _exchange(*[(b"T?\r\n", bad)] * 3)
    with pytest.raises(error, match="asked 3 times"):
        exchange.query("T?", _number)
    device.finish()
    assert clock.now() < 3 * (2.0 + 0.3) + 0.1


@pytest.mark.parametrize("reply", [b"", b"noise\r\n", b"\xff\xfe\r\n", b"OK"])
def test_a_write_is_sent_once(reply: bytes) -> None:
    """Whatever came back or did not: that it is not acknowledged is all that can be said."""
    exchange, device, clock = _exchange((b"S1\r\n", reply))
    assert exchange.command("S1", _ok) is False
    device.finish()
    assert clock.now() == pytest.approx(2.0)


def test_a_refused_write_is_not_sent_again() -> None:
    """The refusal goes to the caller, and the pause is kept all the same."""
    exchange, device, _ = _exchange((b"S1\r\n", b"NA\r\n"), (b"T?\r\n", b"1\r\n"))
    with pytest.raises(CommandRefused):
        exchange.command("S1", _ok)
    exchange.query("T?", _number)
    device.finish()
    assert device.received_at_s[1] == pytest.approx(0.55)


def test_a_late_reply_does_not_stand_for_the_acknowledgement() -> None:
    """A line that belongs to an earlier request is passed over; the acknowledgement behind it counts."""
    exchange, device, _ = _exchange((b"S1\r\n", b"26.4\r\nOK:S1\r\n"))
    assert exchange.command("S1", _ok) is True
    device.finish()


def test_stale_bytes_are_thrown_away_before_a_request() -> None:
    """What arrived after its deadline, or unasked, answers nothing."""
    exchange, device, clock = _exchange((b"T?\r\n", b"1\r\n99\r\n"), (b"T?\r\n", b"2\r\n"))
    assert exchange.query("T?", _number) == 1.0
    clock.sleep(5.0)
    assert exchange.query("T?", _number) == 2.0
    device.finish()


def test_the_echo_of_a_two_wire_adapter_is_passed_over() -> None:
    """An RS-485 adapter that hears itself returns the request first."""
    exchange, device, _ = _exchange((b"T?\r\n", b"T?\r\n7\r\n"))
    assert exchange.query("T?", _number) == 7.0
    device.finish()


class _LooseCable(MemoryTransport):
    """Fails `failures` times at the call named, as a port does that is opened again by the next call."""

    def __init__(self, device: TranscriptDevice, clock: VirtualClock, call: str, failures: int) -> None:
        super().__init__(device, clock, "sim://chamber")
        self._call = call
        self._failures = failures

    def write(self, data: bytes) -> None:
        self._fail("write")
        super().write(data)

    def read_until(self, terminator: bytes, timeout_s: float) -> bytes:
        self._fail("read_until")
        return super().read_until(terminator, timeout_s)

    def _fail(self, call: str) -> None:
        if call == self._call and self._failures:
            self._failures -= 1
            raise TransportError("sim://chamber: the port is gone")


def _loose(call: str, failures: int, *exchanges: tuple[bytes, bytes]) -> tuple[LineExchange, TranscriptDevice]:
    clock = VirtualClock()
    device = TranscriptDevice(exchanges)
    transport = _LooseCable(device, clock, call, failures)
    return LineExchange(transport, clock, device="chamber", framings=lines("CR LF"), timing=TIMING), device


def test_a_read_survives_a_port_that_comes_back() -> None:
    """Twice gone, before the request or behind it; a third time is too much."""
    for call, times in (("write", 1), ("read_until", 3)):
        exchange, device = _loose(call, 2, *[(b"T?\r\n", b"4\r\n")] * times)
        assert exchange.query("T?", _number) == 4.0
        device.finish()
    exchange, _ = _loose("write", 3)
    with pytest.raises(TransportError, match="asked 3 times"):
        exchange.query("T?", _number)


def test_a_write_is_sent_once_to_a_port_that_fails() -> None:
    """Not sent: that is an error. Sent and then gone: nobody knows, so the caller must read back."""
    exchange, device = _loose("write", 1)
    with pytest.raises(TransportError):
        exchange.command("S1", _ok)
    device.finish()
    exchange, device = _loose("read_until", 1, (b"S1\r\n", b"OK\r\n"))
    assert exchange.command("S1", _ok) is False
    device.transmit(1.0)
    device.finish()


def test_silence_names_what_to_check() -> None:
    """The device, the request, the time waited and what a person can look at."""
    exchange, _, _ = _exchange(*[(b"T?\r\n", b"")] * 3)
    with pytest.raises(DeviceTimeout, match=r"chamber did not answer 'T\?' in 2 s; check its power, the cable"):
        exchange.query("T?", _number)


@pytest.mark.parametrize(
    ("noise", "words"), [(b"\x9a" * 5000, "the first of 5000 bytes"), (b"a" * 5000 + b"\r\n", "5002 bytes that begin")]
)
def test_noise_without_end_makes_a_short_message(noise: bytes, words: str) -> None:
    """A port that spews is named in a sentence that a person can read, and does not fill the journal."""
    exchange, _, _ = _exchange(*[(b"T?\r\n", noise)] * 3)
    with pytest.raises((DeviceTimeout, ProtocolError), match=words) as caught:
        exchange.query("T?", str)
    assert len(str(caught.value)) < 600
