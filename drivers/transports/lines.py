"""Requests and replies over lines of text: pacing, deadlines, stale bytes, and retries for reads only.

Most chamber controllers speak lines, one request and one reply at a time, and want a pause between them. What goes
wrong goes wrong in the same ways for all of them: a reply is lost, cut, or comes late and would answer the next
request. A read is asked again a bounded number of times. A write is sent once: when its reply is lost nobody knows
whether it was carried out, so its sender must read back.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass

from drivers.clock import Clock
from drivers.errors import DeviceTimeout, ProtocolError, TransportError
from drivers.transports.framing import Framing, Framings
from drivers.transports.transport import Reply, Timing, Transport, asked

_LONGEST_LINE = 512  # bytes; what is longer is noise
_SHOWN = 40  # bytes of it in a message


@dataclass(eq=False)
class LineExchange:
    """One request and its reply at a time. `device` begins every message: "chamber on /dev/ttyUSB0"."""

    transport: Transport
    clock: Clock
    _: KW_ONLY
    device: str
    framings: Framings
    timing: Timing = Timing()  # noqa: RUF009 - frozen
    _ready_at_s = -math.inf
    _unanswered = False

    def query(self, request: str, parse: Callable[[str], Reply], length: int | None = None) -> Reply:
        """Ask until `parse` accepts a reply, at most `ATTEMPTS` times; raise its last error, or `DeviceTimeout`.

        `parse` gets the line without its terminator and raises `ProtocolError`, `SensorFault` or `CommandRefused`.
        `length` is that of the reply, where nothing ends it.
        """

        def ask() -> Reply:
            try:
                self._send(request, self.framings.asked)
                return parse(self._receive(request, self.clock.now() + self.timing.timeout_s, length))
            finally:
                self._ready_at_s = self.clock.now() + self.timing.pause_after_query_s

        return asked(ask)

    def command(self, request: str, accept: Callable[[str], bool], length: int | None = None) -> bool:
        """Send `request` once; return whether it was acknowledged before the deadline, in a reply of this `length`.

        False means that nobody knows whether it was carried out: read back. `accept` returns True for an
        acknowledgement, False for a line that belongs to something else (a late reply to an earlier request, an
        unreadable line), and raises `CommandRefused` for a refusal. `TransportError` where it could not be sent.
        """
        self._send(request, self.framings.told)
        try:
            deadline_s = self.clock.now() + self.timing.timeout_s
            while True:
                try:
                    line = self._receive(request, deadline_s, length)
                except ProtocolError:
                    continue
                except (DeviceTimeout, TransportError):
                    return False
                if accept(line):
                    return True
        finally:
            self._ready_at_s = self.clock.now() + self.timing.pause_after_command_s

    def tell(self, request: str) -> None:
        """Send `request` once, to a controller that answers such requests with nothing: read back."""
        self._send(request, self.framings.told)
        self._ready_at_s = self.clock.now() + self.timing.pause_after_command_s

    def _send(self, request: str, framing: Framing) -> None:
        self.clock.sleep(self._ready_at_s - self.clock.now())
        if self._unanswered and self.timing.late_s > 0.0:
            with suppress(DeviceTimeout, ValueError):
                self.framings.replied.received(self.transport, self.timing.late_s)
        self._unanswered = False
        self.transport.read_available()  # so that a late reply answers nothing else
        self.transport.write(framing.packed(request.encode(self.framings.encoding)))

    def _receive(self, request: str, deadline_s: float, length: int | None) -> str:
        """Return the next line that is not the echo of the request (two-wire adapters hear themselves)."""
        while True:
            remaining_s = max(0.0, deadline_s - self.clock.now())
            try:
                received = self.framings.replied.received(self.transport, remaining_s, length)
            except ValueError as error:
                raise ProtocolError(f"{self.device} answered {request!r} with {error}; check the line") from error
            except DeviceTimeout as error:
                self._unanswered = True
                raise DeviceTimeout(
                    f"{self.device} did not answer {request!r} in {self.timing.timeout_s:g} s; check its power, the "
                    f"cable, and the line settings and delimiter on its panel ({error})"
                ) from error
            try:
                if len(received) > _LONGEST_LINE:
                    raise ValueError("longer than any reply")
                line = received.decode(self.framings.encoding)
            except ValueError as error:
                size = len(self.framings.replied.packed(received))
                raise ProtocolError(
                    f"{self.device} answered {request!r} with {size} bytes that begin with {received[:_SHOWN]!r}: no "
                    "text; check baud rate and parity"
                ) from error
            if line != request:
                return line
