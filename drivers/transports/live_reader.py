"""A thread that only drains a port, so that nothing else the controller does can make the system's buffer run over.

It is a transport like the one it drains, for benches under the system clock; a simulated bench in this process needs
none and stays in one thread. What was read waits in a bounded queue. Where nobody takes it for too long, the oldest
bytes are dropped and counted: `take_overflow` tells how many, and the IMU driver puts them into its counts.

A port that fails is opened again, again and again, until the reader is closed. Every failure is raised once to whoever
reads, after the bytes that arrived before it, and on every call while it lasts.
"""

import threading
from collections import deque

from drivers.clock import Clock
from drivers.errors import TransportError
from drivers.transports.serial_port import SerialTransport
from drivers.transports.transport import Transport

_MOST_BYTES = 1 << 24  # three minutes of 2000 frames per second of 40 bytes
_LOOK_S = 0.05  # between looks whether the reader shall end
_GATHER_S = 0.005  # between reads of a slow stream: one waking for many frames, far from what the system can hold
_GATHERED = 2048  # bytes of a read after which the next follows at once
_REOPEN_S = 0.25  # between attempts to open a port that failed


class LiveReader(Transport):
    """A `Transport` that drains `port` in a thread of its own until it is closed, and sleeps while none arrive."""

    def __init__(self, port: SerialTransport, clock: Clock, *, most_bytes: int = _MOST_BYTES) -> None:
        super().__init__(port.name, clock)
        self._port = port
        self._most_bytes = most_bytes
        self._lock = threading.Lock()
        self._queue: deque[bytes | TransportError] = deque()
        self._queued = 0
        self._overflow = 0
        self._down: TransportError | None = None  # the port's failure, while it lasts
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._drain, name=f"reader of {port.name}", daemon=True)
        self._thread.start()

    def take_overflow(self) -> int:
        """Return how many bytes were dropped since the last call because nobody read."""
        with self._lock:
            overflow, self._overflow = self._overflow, 0
        return overflow

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        self._port.close()

    def _fill(self) -> None:
        """Take over what the thread has read, up to the next failure; raise that once nothing is before it."""
        if self._ending.is_set():
            raise TransportError(f"{self.name}: the port is closed")
        with self._lock:
            while self._queue and isinstance(first := self._queue[0], bytes):
                self._queue.popleft()
                self._queued -= len(first)
                self._arrived += first
            if self._arrived:
                return
            failure = self._queue.popleft() if self._queue else self._down
        if isinstance(failure, TransportError):
            raise TransportError(str(failure)) from failure

    def _drain(self) -> None:
        """Read until the end. Nothing else happens here: what takes long would let the port run over."""
        while not self._ending.is_set():
            try:
                data = self._port.read_available() if self._port.wait(_LOOK_S) else b""
            except TransportError as failure:
                with self._lock:
                    if self._down is None:  # the first of this outage
                        self._queue.append(failure)
                    self._down = failure
                self._ending.wait(_REOPEN_S)
                continue
            with self._lock:
                self._down = None
                if data:
                    self._queue.append(data)
                    self._queued += len(data)
                self._bound()
            if 0 < len(data) < _GATHERED:
                self._ending.wait(_GATHER_S)

    def _bound(self) -> None:
        """Drop the oldest bytes that are too many, and no failure among them."""
        failures: list[TransportError] = []
        while self._queued > self._most_bytes:
            if isinstance(first := self._queue.popleft(), TransportError):
                failures = [first]  # of many, the last tells
            else:
                self._queued -= len(first)
                self._overflow += len(first)
        self._queue.extendleft(failures)
