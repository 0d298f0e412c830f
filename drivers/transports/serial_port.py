"""A serial port, or a serial server over TCP, as a transport.

The URL is a device path, `socket://host:port` or `rfc2217://host:port`, whatever pyserial opens. It is opened for us
alone, and again by the next call after it failed (unplugged, connection lost): whoever retries survives a loose cable.
"""

import errno
import io
import os
import re
import select
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import serial
from serial.tools import list_ports

from drivers.clock import Clock
from drivers.errors import TransportError
from drivers.transports.transport import Transport

try:
    from termios import error as TerminalError  # noqa: N812 - pyserial lets it through, and it is no OSError
except ImportError:  # Windows has no such terminals
    TerminalError = OSError  # type: ignore[assignment, misc]

_Result = TypeVar("_Result")

_PSEUDO_TERMINALS = "/dev/pts/"
_POLL_S = 0.002  # between looks at a port that cannot wait
_WRITE_TIMEOUT_S = 2.0
_READ_SIZE = 65536
_MOST_AT_ONCE = 1 << 24  # bytes in one read_available, so that a port that never stops cannot hold it for ever


class SerialTransport(Transport):
    """A `Transport` over pyserial. Deadlines are the injected clock's.

    The frame format is 8 data bits without parity unless told otherwise (`parity` is N, E or O), and one stop bit.
    Adapters that can are asked to pass bytes on at once instead of every 16 ms.
    Opening happens here; raise `TransportError` where the port cannot be opened, saying why and what to do.
    """

    def __init__(self, url: str, *, clock: Clock, on_close: Callable[[], None] = lambda: None, **line: Any) -> None:
        super().__init__(url, clock)
        self._on_close = on_close
        self._settings: dict[str, Any] = {"baudrate": 115200, "bytesize": 8, "parity": "N", **line}
        self._settings |= {"stopbits": 1, "timeout": 0, "write_timeout": _WRITE_TIMEOUT_S}
        self._closed = False
        self._port: Any = None
        self._opening = threading.Lock()  # one thread may write while another reads
        self._open()

    def write(self, data: bytes) -> None:
        self._guarded(lambda port: port.write(data))

    def wait(self, timeout_s: float) -> bool:
        """Wait until bytes have arrived, at most `timeout_s`; tell whether they have. Costs nothing meanwhile."""
        if self._arrived:
            return True
        return self._guarded(lambda port: bool(_ready(port, self._clock, timeout_s)))

    def close(self) -> None:
        self._closed = True
        self._release()
        self._on_close()

    def _fill(self) -> None:
        while len(self._arrived) < _MOST_AT_ONCE:
            data = self._guarded(lambda port: port.read(_READ_SIZE))
            if not data:
                return
            self._arrived += data

    def _guarded(self, act: Callable[[Any], _Result]) -> _Result:
        """Do something with the open port; a failure closes it and becomes a `TransportError`."""
        if self._closed:
            raise TransportError(f"{self.name}: the port is closed")
        with self._opening:
            if self._port is None:
                self._open()
            port = self._port
        try:
            return act(port)
        except serial.SerialTimeoutException:
            raise TransportError(
                f"{self.name}: the port takes no bytes ({_WRITE_TIMEOUT_S:g} s); check flow control and the cable"
            ) from None
        except (serial.SerialException, OSError, TypeError, TerminalError) as error:
            # pyserial raises TypeError where another thread, or a lost device, took the descriptor away in a call.
            self._release()
            raise TransportError(f"{self.name}: the port failed ({error}); check its cable and power") from error

    def _open(self) -> None:
        settings = dict(self._settings)
        if "://" not in self.name:
            settings["exclusive"] = True
            if os.path.realpath(self.name).startswith(_PSEUDO_TERMINALS):
                settings |= {"bytesize": 8, "parity": "N"}  # it passes bytes on, and takes other settings only once
        try:
            self._port = serial.serial_for_url(self.name, **settings)
        except (serial.SerialException, OSError, ValueError, TerminalError) as error:
            raise TransportError(_why_not_open(self.name, error)) from error
        if sys.platform == "linux":  # the one that pyserial can ask
            with suppress(AttributeError, ValueError, OSError):  # a port that cannot
                self._port.set_low_latency_mode(True)

    def _release(self) -> None:
        port, self._port = self._port, None
        self._arrived.clear()
        if port is not None:
            with suppress(serial.SerialException, OSError, TypeError, TerminalError):
                port.close()


open_port = SerialTransport


def _ready(port: Any, clock: Clock, timeout_s: float) -> bool:
    """Tell whether bytes arrive within `timeout_s`; ports without a descriptor are asked again and again."""
    try:
        descriptor = port.fileno()
    except (AttributeError, io.UnsupportedOperation):
        descriptor = None
    if isinstance(descriptor, int):
        return bool(select.select([descriptor], [], [], timeout_s)[0])
    deadline_s = clock.now() + timeout_s
    while not port.in_waiting and clock.now() < deadline_s:
        clock.sleep(_POLL_S)
    return bool(port.in_waiting)


def existing_ports() -> list[str]:
    """Return the serial ports that this machine has, as paths a person can put in a bench file."""
    return sorted(port.device for port in list_ports.comports())


def no_such_port(port: str) -> str:
    """Say that this machine does not have a port, and which it has."""
    return f"{port}: there is no such port; the ports that exist: {', '.join(existing_ports()) or 'none'}"


def _how_to_be_permitted(port: str) -> str:
    """Say which group has a port. What has no name there, or where ports are no files, is looked up by hand."""
    try:
        group = Path(port).group()
    except (OSError, KeyError, NotImplementedError):
        group = "root"
    if group == "root":
        return "see whose it is (ls -lL), and let a group have it that this user is in"
    return f"its group is {group}: add this user to it (sudo usermod -aG {group} $USER), log in again"


def _error_number(error: BaseException) -> int | None:
    """Return the operating system's error number; pyserial sometimes only has it in its text."""
    number: int | None = getattr(error, "errno", None)
    if number is None and isinstance(error, TerminalError) and error.args:
        number = error.args[0]
    if number is None and (found := re.search(r"\[Errno (\d+)\]", str(error))):
        number = int(found[1])
    return number


def _why_not_open(url: str, error: Exception) -> str:
    number = _error_number(error)
    if "://" in url:
        if isinstance(error, ValueError) or "expected" in str(error):
            return f"{url}: is not a port; write a device path, socket://host:port or rfc2217://host:port"
        return f"{url}: cannot be reached ({error}); check the address, the port number and that the server runs"
    if isinstance(error, ValueError) or number == errno.EINVAL:
        return f"{url}: the port does not accept these settings ({error})"
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in str(error):
        return f"{url}: somebody else has the port open; close the other program (fuser {url} names it)"
    if number in (errno.EACCES, errno.EPERM):
        return f"{url}: no permission; {_how_to_be_permitted(url)}"
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return no_such_port(url)
    return f"{url}: cannot be opened ({error}); is it a serial port?"
