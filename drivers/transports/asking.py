"""Asking again: a read may be repeated, because nothing changes by it."""

from collections.abc import Callable
from typing import TypeVar

from drivers.errors import CommandRefused, DeviceTimeout, ProtocolError, SensorFault, TransportError

Reply = TypeVar("Reply")


def asked(ask: Callable[[], Reply], attempts: int) -> Reply:
    """Return what `ask` does, tried at most `attempts` times; raise its last error, saying how often it was tried.

    A refusal is asked again too: noise on the line turns a good request into an unknown one; and so is a port that
    failed, because a transport opens it again where it can.
    """
    left = attempts
    while True:
        left -= 1
        try:
            return ask()
        except (DeviceTimeout, ProtocolError, SensorFault, CommandRefused, TransportError) as error:
            if left <= 0:
                raise type(error)(f"{error} (asked {attempts} times)") from error
