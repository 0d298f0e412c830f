"""Values of other libraries' devices, read and set whichever way the library has; none of them is imported.

    Value(oven, "temperature")      # pymeasure, QCoDeS and the like: an attribute; a signal of ophyd: get and set
    Value(table, "user_readback")   # a signal of ophyd-async: awaited in an event loop of its own
    awaited(table.connect(), 10.0)  # which is where such a device must be connected

What a library raises becomes a `DeviceError` that names the value.
"""

import asyncio
from collections.abc import Awaitable, Callable
from functools import cache
from inspect import iscoroutinefunction
from threading import Thread
from typing import Any

from drivers.errors import DeviceError, DeviceTimeout


@cache
def _loop() -> asyncio.AbstractEventLoop:
    loop = asyncio.new_event_loop()
    Thread(target=loop.run_forever, name="borrowed devices", daemon=True).start()
    return loop


def awaited(awaitable: Awaitable[Any], timeout_s: float) -> Any:
    """Return what comes of it in the event loop of borrowed devices; `TimeoutError` where it takes longer."""
    ended = asyncio.wait_for(awaitable, timeout_s)
    return asyncio.run_coroutine_threadsafe(ended, _loop()).result(timeout_s + 1.0)


class Value:
    """One value of a device; without a `name` the device itself is what is set, as a motor is. Time-outs in seconds."""

    def __init__(self, device: Any, name: str = "", timeout_s: float = 10.0) -> None:
        self._device, self._name, self._timeout_s = device, name, timeout_s
        self._words = " ".join(filter(None, (type(device).__name__, str(getattr(device, "name", "")), name)))
        plain = isinstance(getattr(type(device), name, None), property)  # to look at one may ask the device
        found = None if plain else getattr(device, name) if name else device
        self._signal = found if hasattr(found, "get_value") or hasattr(found, "set") else None
        self._asynchronous = iscoroutinefunction(getattr(found, "connect", None))

    def get(self) -> Any:
        """Return what it is now; raise `DeviceError` where the library does, `DeviceTimeout` where it takes long."""

        def asked() -> Any:
            if self._signal is None:
                return getattr(self._device, self._name)
            return awaited(self._signal.get_value(), self._timeout_s) if self._asynchronous else self._signal.get()

        return self._guarded("read", self._timeout_s, asked)

    def put(self, value: Any, timeout_s: float | None = None) -> None:
        """Set it and wait until that is done, where the library tells it. Raises `DeviceError`, `DeviceTimeout`."""
        within_s = self._timeout_s if timeout_s is None else timeout_s

        def told() -> None:
            if self._signal is None:
                setattr(self._device, self._name, value)
            elif self._asynchronous:
                awaited(_set(self._signal, value), within_s)
            elif hasattr(status := self._signal.set(value), "wait"):
                status.wait(within_s)

        self._guarded(f"set to {value}", within_s, told)

    def _guarded(self, what: str, timeout_s: float, act: Callable[[], Any]) -> Any:
        try:
            return act()
        except TimeoutError as error:
            raise DeviceTimeout(f"{self._words}: not {what} within {timeout_s:g} s") from error
        except Exception as error:  # whatever somebody else's library may raise
            raise DeviceError(f"{self._words}: cannot be {what}: {type(error).__name__}: {error}") from error


async def _set(signal: Any, value: Any) -> None:
    await signal.set(value)  # makes its task, which only a running loop can have
