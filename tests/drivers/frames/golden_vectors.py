"""What a published conversation of a chamber controller is in these tests, and the wire on which it is played.

The conversations themselves are in golden_text and golden_modbus, by controller and name as the reference calls them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drivers.clock import Clock
from drivers.simulators import SimulatedDevice
from drivers.transports import Transport

Key = tuple[str, str]
Act = Callable[[Transport, Clock], None]


@dataclass(frozen=True)
class Vector:
    """One request and its reply, literally (empty: none).

    `simulator` builds the simulated device that gives the reply; `driver` lets a driver send the request and checks
    what it makes of the reply. Either may be a sentence instead: why there is no such device, or no driver sends it.
    """

    request: bytes
    reply: bytes
    simulator: Callable[[], SimulatedDevice] | str
    driver: Act | str


class GoldenWire:
    """A simulated device behind a wire on which one request is answered with its published reply."""

    def __init__(self, device: Any, request: bytes, reply: bytes) -> None:
        self._device = device
        self._request = request
        self._reply = reply
        self._due: list[tuple[float, bytes]] = []
        self.seen = 0

    def receive(self, data: bytes, now_s: float) -> None:
        """Pass everything on but the published request, which is counted and answered from the book."""
        if data == self._request:
            self.seen += 1
            self._due.append((now_s + 0.05, self._reply))
        else:
            self._device.receive(data, now_s)

    def transmit(self, now_s: float) -> bytes:
        """Return what is due."""
        due = b"".join(reply for at_s, reply in self._due if at_s <= now_s + 1e-9)
        self._due = [(at_s, reply) for at_s, reply in self._due if at_s > now_s + 1e-9]
        return due + bytes(self._device.transmit(now_s))

    def next_transmission(self, now_s: float) -> float | None:
        """Return when something is due next."""
        times = [at_s for at_s, reply in self._due if reply]
        other = self._device.next_transmission(now_s)
        times += [] if other is None else [other]
        return max(now_s, min(times)) if times else None
