r"""A conversation written down, played by a device: what must be sent, byte for byte, and what comes back.

    device = TranscriptDevice([(b"TEMP?\r\n", b"26.4,0.0,140.0,-50.0\r\n")])
    ...
    device.finish()                       # raises where something was left over

For a driver's own bytes: a simulator that is kind in the same places as the driver would hide a fault in both.
"""

from __future__ import annotations

from collections.abc import Sequence


class TranscriptDevice:
    """A `SimulatedDevice` that expects the requests of `exchanges` in order and answers each with its reply.

    An empty reply is silence. Whatever deviates raises `AssertionError` at once, naming what was sent and expected.
    """

    def __init__(self, exchanges: Sequence[tuple[bytes, bytes]], *, latency_s: float = 0.05) -> None:
        self._exchanges = list(exchanges)
        self._latency_s = latency_s
        self._next = 0
        self._received = b""
        self._pending: list[tuple[float, bytes]] = []
        self.received_at_s: list[float] = []

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes from the host; they must continue the transcript."""
        self._received += data
        if self._next >= len(self._exchanges):
            raise AssertionError(f"nothing more was expected, but {self._received!r} was sent")
        request, reply = self._exchanges[self._next]
        if not request.startswith(self._received):
            raise AssertionError(f"{self._received!r} was sent where exchange {self._next} expects {request!r}")
        if self._received == request:
            self._next += 1
            self._received = b""
            self.received_at_s.append(now_s)
            if reply:
                self._pending.append((now_s + self._latency_s, reply))

    def transmit(self, now_s: float) -> bytes:
        """Return the replies that are due."""
        due = [reply for at_s, reply in self._pending if at_s <= now_s + 1e-9]
        self._pending = self._pending[len(due) :]
        return b"".join(due)

    def next_transmission(self, now_s: float) -> float | None:
        """Return when the next reply is due, None where none is."""
        return max(now_s, self._pending[0][0]) if self._pending else None

    def finish(self) -> None:
        """Raise `AssertionError` where requests were not made or replies not fetched."""
        left = [request for request, _ in self._exchanges[self._next :]]
        if left or self._received or self._pending:
            raise AssertionError(f"left over: requests {left}, half a request {self._received!r}, {self._pending}")
