"""What can go wrong, with a device or with what people give, in words for the person who stands in front of it."""

from collections.abc import Iterator
from contextlib import contextmanager

_SCREEN, _END = 1500, 300


class InputError(Exception):
    """Bad input or usage: exit status 2. Nothing was written.

    The message says what is wrong, where (file, and row, column or key where there is one) and what to do. It quotes
    what was given; where that is longer than a screen, the middle is left out wherever the message is shown.
    """

    def __str__(self) -> str:
        text = super().__str__()
        left_out = len(text) - _SCREEN
        return text if left_out <= 0 else f"{text[: _SCREEN - _END]} … ({left_out} more characters) … {text[-_END:]}"


class DeviceError(Exception):
    """A device did not do what it was asked. The message names the device, its port and what to do."""


class TransportError(DeviceError):
    """The port itself failed: it does not exist, was unplugged, or is owned by somebody else."""


class DeviceTimeout(DeviceError):
    """Nothing (or not enough) arrived before the deadline."""


class ProtocolError(DeviceError):
    """Something arrived that the protocol does not allow: garbage, a wrong echo, an unknown reply."""


class CommandRefused(DeviceError):
    """The device understood and refused: out of range, panel locked, wrong mode."""


class WrongDevice(DeviceError):
    """The device that answers is not the one the bench file describes (model, serial number or unit)."""


class SetpointOutOfLimits(DeviceError):
    """A temperature was asked for that lies outside the limits of the bench or of the chamber; nothing was sent."""


class SensorFault(DeviceError):
    """A reading that no working sensor can give: not a number, or outside what is physically possible."""


@contextmanager
def worded(
    kind: type[Exception], begin: str, caught: type[Exception] | tuple[type[Exception], ...] = ValueError, end: str = ""
) -> Iterator[None]:
    """Raise what is `caught` as a `kind`, its words between `begin` and `end`: of an error of the system its reason."""
    try:
        yield
    except caught as error:
        raise kind(f"{begin}{getattr(error, 'strerror', None) or error}{end}") from error
