"""The reply grammar of ESPEC's ASCII controllers, and their error texts as sentences a technician can act on.

Replies to monitor commands are bare data; replies to settings are `OK:` and an echo in one of three observed
spellings (`OK:TEMP,S25`, `OK:1,temp,s85.0`, `OK : 1,TEMP,S25`), so the echo is never compared; refusals are `NA:`
and a text, also seen as `NA :`.

Byte-exact from sources: the data of `TEMP?`, `TYPE?`, `MON?` and `CONSTANT SET?,TEMP`, the first two spellings of
`OK`, `NA:CMD ERR`, `NA:DATA OUT OF RANGE`. The error texts are those of the SCP-220 manual (`INVALID REQ` and
`CHB NOT READY` of the P-300). Inferred: that what the manual calls `PRGM WRITE ERR-n` looks alike on all controllers.
"""

import math
import re
from collections.abc import Callable, Mapping

from drivers.errors import CommandRefused, ProtocolError
from drivers.strict_yaml import packaged
from drivers.transports.transport import Reply

_ACKNOWLEDGED = re.compile(r"OK\s*:")
_REFUSED = re.compile(r"NA\s*:?\s*(.*)")
_MODE = re.compile(r"[A-Z][A-Z ]*")
_QUICK_TIMER = re.compile(r"(?:0,)?(\w+)(?:,R[AO]M:\d+,STEP\d+)?,(\d+):(\d+)")

_MEANINGS: Mapping[str, str] = packaged("drivers.chambers.controllers", "espec_refusals.yaml")


def meaning_of(error_text: str) -> str:
    """Return what the text after `NA:` means and what to do, as a clause."""
    text = " ".join(error_text.upper().split())
    if written := re.fullmatch(r"PRGM WRITE ERR-(\d+)", text):
        return f"a program could not be written (reason {written[1]} of its manual): end program editing at the panel"
    return _MEANINGS.get(text, "its manual must say what this means")


def understood(device: str, request: str, parse: Callable[[str], Reply], line: str) -> Reply:
    """Return what `parse` makes of a reply; `CommandRefused` for a refusal, `ProtocolError` for no reply to this."""
    if refused := _REFUSED.match(line):
        raise CommandRefused(f"{device} refused {request!r} with {line!r}: {meaning_of(refused[1])}")
    try:
        return parse(line)
    except ValueError:
        raise ProtocolError(
            f"{device} answered {request!r} with {line!r}, which its protocol does not allow there; "
            "check the line settings and the controller named in the bench file"
        ) from None


def acknowledged(line: str) -> bool:
    """Return True for `OK:`, False for a line that is no reply to a setting."""
    return _ACKNOWLEDGED.match(line) is not None


def text(line: str) -> str:
    """Return any data; `ValueError` where it is empty, noise or an acknowledgement."""
    if not line or acknowledged(line) or not line.isprintable():
        raise ValueError(line)
    return line


def temperatures(line: str) -> tuple[float, float, float, float]:
    """Return air, setpoint, high and low alarm, °C, as in `26.4,0.0,140.0,-50.0`."""
    air, setpoint, high, low = map(_number, line.split(","))
    return air, setpoint, high, low


def status(line: str) -> tuple[str, int]:
    """Return mode and number of alarms, behind temperature and humidity: `24.1,100,CONSTANT,0`; or `ValueError`."""
    temperature, _humidity, mode, count = (field.strip() for field in line.split(","))
    if not _MODE.fullmatch(mode) or not count.isdecimal():
        raise ValueError(line)
    _number(temperature)
    return mode, int(count)


def codes(line: str) -> tuple[str, ...]:
    """Return those of `n[,code,…]`, alarms or timers; `0` alone says that there is none. Else `ValueError`."""
    count, *found = (field.strip() for field in line.split(","))
    if not count.isdecimal() or not all(map(str.isdecimal, found)) or int(count) != len(found):
        raise ValueError(line)
    return tuple(found)


def quick_timer(line: str) -> tuple[str, int]:
    """Return where the quick timer leads and after how many minutes, from `STANDBY,3:00`, or `ValueError`."""
    if (found := _QUICK_TIMER.fullmatch(line)) is None:
        raise ValueError(line)
    return found[1], 60 * int(found[2]) + int(found[3])


def chamber_type(line: str) -> tuple[str, float | None]:
    """Return controller and highest temperature of `T,[T,]S2,160.0`; None where it gives no highest."""
    *_, controller, highest = (field.strip() for field in text(line).split(","))
    try:
        return controller, float(highest)
    except ValueError:
        return highest, None


def _number(field: str) -> float:
    # A field without digits stands where a number should: what a controller shows for a missing sensor.
    field = field.strip()
    return math.nan if field and not any(map(str.isalnum, field)) else float(field)
