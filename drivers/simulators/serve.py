"""Simulated devices for any client: served on pseudo-terminals or TCP ports, in one loop under a real clock.

All devices of one server live in one loop, so that devices that share physics need no lock. A client that is not there
misses what is sent, as on a real line; a client that is slow has `_MOST_WAITING` bytes to fall behind.
"""

import os
import select
import socket
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field

from drivers.clock import Clock
from drivers.errors import DeviceError
from drivers.simulators import SimulatedDevice

try:
    import termios
    import tty
except ImportError:  # Windows has no such terminals
    termios = None  # type: ignore[assignment]

_LONGEST_WAIT_S = 0.02  # between looks at the lines, so that a client's coming is noticed
_SHORTEST_WAIT_S = 0.0005
_SETTING_UP_S = 0.02  # a client that has just opened a terminal has not made it raw yet
_MOST_WAITING = 1 << 20  # bytes kept for a client that does not read
_READ_SIZE = 65536


class _PtyLine:
    """A pseudo-terminal; its client's end is not held open, so that the system tells whether a client is there."""

    def __init__(self) -> None:
        if termios is None:
            raise DeviceError("this system has no pseudo-terminals; serve on TCP ports instead: --tcp")
        self._master, slave = os.openpty()
        tty.setraw(slave, termios.TCSANOW)
        self.url = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._poll = select.poll()
        self._poll.register(self._master, 0)  # a hang-up is reported without being asked for
        self._waiting = bytearray()
        self._present = self._ready = False
        self._came_s: float | None = None

    def readable(self) -> list[int]:
        return [self._master] if self._present else []

    def receive(self, now_s: float) -> bytes:
        self._present = not self._poll.poll(0)
        if not self._present or self._came_s is None:
            self._came_s = now_s
        self._ready = now_s - self._came_s >= _SETTING_UP_S
        if self._ready:
            with suppress(OSError):  # nothing there, or the client left this moment
                return os.read(self._master, _READ_SIZE)
        return b""

    def send(self, data: bytes) -> None:
        if not self._ready:
            self._waiting.clear()
            return
        self._waiting += data[: max(0, _MOST_WAITING - len(self._waiting))]
        with suppress(OSError):  # no room, or the client left this moment
            while self._waiting:
                del self._waiting[: os.write(self._master, self._waiting[:_READ_SIZE])]

    def close(self) -> None:
        os.close(self._master)


class _TcpLine:
    """The same on a TCP port with one client at a time, as serial servers have it; a new client replaces the old."""

    def __init__(self, host: str, port: int) -> None:
        self._listener = socket.create_server((host, port))
        self._listener.setblocking(False)
        host, port = self._listener.getsockname()[:2]
        self.url = f"socket://{host}:{port}"
        self._client: socket.socket | None = None
        self._waiting = bytearray()

    def readable(self) -> list[int]:
        return [self._listener.fileno()] + ([] if self._client is None else [self._client.fileno()])

    def receive(self, now_s: float) -> bytes:
        with suppress(BlockingIOError):
            client, _ = self._listener.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._drop_client()
            self._client = client
        try:
            if self._client is not None and (received := self._client.recv(_READ_SIZE)):
                return received
        except BlockingIOError:
            return b""
        except OSError:
            pass  # the client is gone
        self._drop_client()
        return b""

    def send(self, data: bytes) -> None:
        if self._client is None:
            return
        self._waiting += data[: max(0, _MOST_WAITING - len(self._waiting))]
        try:
            while self._waiting:
                del self._waiting[: self._client.send(self._waiting)]
        except BlockingIOError:
            return
        except OSError:
            self._drop_client()

    def _drop_client(self) -> None:
        self._waiting.clear()
        if self._client is not None:
            self._client.close()
        self._client = None

    def close(self) -> None:
        self._drop_client()
        self._listener.close()


@dataclass(eq=False)
class DeviceServer:
    """Serves devices by name, until one raises: on a pseudo-terminal each, or on `tcp_ports` (0: any free one)."""

    devices: Mapping[str, SimulatedDevice]
    clock: Clock
    _: KW_ONLY
    tcp_ports: Mapping[str, int] = field(default_factory=dict)
    host: str = "127.0.0.1"
    _stopping = False

    def __post_init__(self) -> None:
        self._lines: dict[str, _PtyLine | _TcpLine] = {}
        try:
            for name in self.devices:
                port = self.tcp_ports.get(name)
                self._lines[name] = _PtyLine() if port is None else _TcpLine(self.host, port)
        except OSError:
            self.close()
            raise

    @property
    def urls(self) -> Mapping[str, str]:
        """What a client opens, by device name: the terminal's path or `socket://host:port`."""
        return {name: line.url for name, line in self._lines.items()}

    def run(self) -> None:
        """Serve until `interrupt` is called, from a signal handler or another thread, then release everything."""
        try:
            while not self._stopping:
                for name, line in self._lines.items():
                    device, now_s = self.devices[name], self.clock.now()
                    if received := line.receive(now_s):
                        device.receive(received, now_s)
                    line.send(device.transmit(now_s))
                now_s = self.clock.now()
                due = [device.next_transmission(now_s) for device in self.devices.values()]
                wait_s = min([_LONGEST_WAIT_S] + [when - now_s for when in due if when is not None])
                descriptors = [fd for line in self._lines.values() for fd in line.readable()]
                select.select(descriptors, [], [], max(wait_s, _SHORTEST_WAIT_S))
        finally:
            self.close()

    def interrupt(self) -> None:
        """Ask the loop to end after its next look at the lines; returns at once."""
        self._stopping = True

    def close(self) -> None:
        """Release everything. Closing twice is allowed."""
        lines, self._lines = list(self._lines.values()), {}
        for line in lines:
            line.close()
