"""Whether the computer's clock can be believed: synchronised, as the kernel says, and later than it must be."""

import ctypes
from datetime import UTC, datetime

EARLIEST = datetime(2024, 1, 1, tzinfo=UTC)
"""No night is recorded before this: a clock that says so has lost its battery."""

_TIME_ERROR = 5  # adjtimex(2): the clock is not synchronised to a reliable server
_TIMEX_BYTES = 512  # struct timex is 208 bytes on 64-bit Linux; zeros ask and change nothing


def synchronised() -> bool | None:
    """Return whether the kernel counts its clock as synchronised, None where it cannot be asked. Changes nothing."""
    try:
        state = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    except (OSError, AttributeError):  # no such call: not Linux
        return None
    return None if state < 0 else state != _TIME_ERROR
