"""A transport to a simulated device in this process; under a virtual clock, a read that must wait jumps ahead."""

from drivers.clock import Clock
from drivers.errors import TransportError
from drivers.simulators import SimulatedDevice
from drivers.transports import Transport

_LEAST_WAIT_S = 1e-6  # moves the clock on even where adding the exact time is lost to rounding


class MemoryTransport(Transport):
    """A `Transport` whose far end is `device`. Nothing runs between calls."""

    def __init__(self, device: SimulatedDevice, clock: Clock, name: str) -> None:
        super().__init__(name, clock)
        self._device = device
        self._closed = False
        self.pulled_between: list[tuple[float, float]] = []
        """When the cable is pulled, and put back: every call fails meanwhile, and what the device sends is lost."""

    def write(self, data: bytes) -> None:
        self._check()
        self._device.receive(data, self._clock.now())

    def close(self) -> None:
        self._closed = True

    def _check(self) -> None:
        if self._closed:
            raise TransportError(f"{self.name}: the port is closed")
        now_s = self._clock.now()
        for span in [each for each in self.pulled_between if each[1] <= now_s]:
            self.pulled_between.remove(span)
            self._device.transmit(now_s)
            self._arrived.clear()
        if any(begins_s <= now_s for begins_s, _ in self.pulled_between):
            raise TransportError(f"{self.name}: the port is gone; check its cable")

    def _fill(self) -> None:
        self._check()
        self._arrived += self._device.transmit(self._clock.now())

    def _fill_before(self, deadline_s: float) -> bool:
        """Let time pass until the device sends or the deadline is reached; False where it was reached before."""
        now_s = self._clock.now()
        if now_s >= deadline_s:
            return False
        sends_s = self._device.next_transmission(now_s)
        until_s = deadline_s if sends_s is None else min(deadline_s, sends_s)
        self._clock.sleep(max(until_s - now_s, _LEAST_WAIT_S))
        self._fill()
        return True
