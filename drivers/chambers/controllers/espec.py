"""ESPEC ASCII controllers: P-300, P-200, SCP-220, GL (RS-232, RS-485, or a TCP port that carries the same lines).

    controller = Espec(transport, clock)
    chamber = SupervisedChamber(controller, clock, Supervision(ChamberLimits(-35.0, 65.0), SafeState("off")))
    chamber.prepare()
    chamber.set_temperature(-29.72)       # TEMP,S-29.7 on the wire, read back and compared

The high and low temperature alarms are the second safety layer; a setpoint beyond them is refused. Verified byte-exact
(recorded dialogs and vendors' examples, with CR LF): `TEMP?`, `TYPE?`, `MON?` with an address, `TEMP,S…` and its
acknowledgements, `MODE,CONSTANT`, the refusals `CMD ERR` and `DATA OUT OF RANGE`, and the order `TEMP,S` - `POWER,ON` -
`MODE,CONSTANT`. Request exact, reply inferred from the grammar: `ROM?`, `ALARM?`, `TEMP,H…`, `TEMP,L…`, `MODE,STANDBY`,
`MODE,OFF`, `POWER,ON`, `PRGM,END,STANDBY`, and of the quick timer (number 0) `TIMER WRITE`, `TIMER,ON`, `TIMER,OFF`,
`TIMER LIST?` and `TIMER ON?`, whose replies only a client's parser shows. Inferred, to be watched on hardware: that
`TEMP?` tells the constant setpoint in every mode, that a native limit that would exclude the setpoint is refused, and
that the quick timer counts from `TIMER,ON`. There is no ramp rate in constant operation: the host steps the setpoint.
The unit follows the panel. Values in 0.1 °C; reply awaited 2 s. Pauses are the vendor's: 0.3 s after a monitor command,
0.5 s after a setting.

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
from contextlib import suppress
from functools import partial

from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Mode, Which
from drivers.clock import Clock
from drivers.errors import CommandRefused, ProtocolError
from drivers.strict_yaml import packaged
from drivers.transports import Transport
from drivers.transports.framing import lines
from drivers.transports.lines import LineExchange
from drivers.transports.transport import Reply

_ACKNOWLEDGED = re.compile(r"OK\s*:")
_REFUSED = re.compile(r"NA\s*:?\s*(.*)")
_MODE = re.compile(r"[A-Z][A-Z ]*")
_QUICK_TIMER = re.compile(r"(?:0,)?(\w+)(?:,R[AO]M:\d+,STEP\d+)?,(\d+):(\d+)")

_MEANINGS: Mapping[str, str] = packaged("drivers.chambers.controllers", "espec_refusals.yaml")
_LETTER = {"low": "L", "setpoint": "S", "high": "H"}
_MODES: dict[str, Mode] = {"OFF": "OFF", "STANDBY": "STANDBY", "CONSTANT": "CONSTANT"}


class Espec(Controller):
    """A `Controller` of one chamber. `address` is for RS-485 only."""

    limits_alarm = True

    _mode: Mode | None = None

    def __init__(
        self, transport: Transport, clock: Clock, *, address: int | None = None, terminator: bytes = b"\r\n"
    ) -> None:
        super().__init__(transport)
        self._prefix = "" if address is None else f"{address},"
        self._exchange = LineExchange(transport, clock, device=self.device, framings=lines(terminator))

    def identify(self) -> ControllerIdentity:
        """Ask model and highest temperature; the unit cannot be asked."""
        try:
            model = self._query("ROM?", text)
        except CommandRefused:
            model = ""  # the oldest controllers know TYPE? alone
        controller, maximum = self._query("TYPE?", chamber_type)
        return ControllerIdentity(model or controller, maximum=maximum)

    def state(self) -> ControllerState:
        """Look at temperature, setpoint, alarm limits and mode, and at the alarms where there are any."""
        self._mode = None
        air, setpoint, high, low = self._query("TEMP?", temperatures)
        mode, count = self._query("MON?", status)
        self._mode = _MODES.get(mode, "RUN")  # RUN PAUSE, RMT RUN and the like
        standing = self._query("ALARM?", codes) if count else ()
        alarms = tuple(f"alarm {code}" for code in standing) or ("alarm without a code",) * bool(count)
        return ControllerState(air, setpoint, self._mode, alarms, low, high)

    def write(self, which: Which, value: float) -> None:
        """Send the setpoint or one of the alarm limits."""
        self._command(f"TEMP,{_LETTER[which]}{value:.1f}")

    def start(self) -> None:
        """Start constant-temperature operation, with the power first where it may be off."""
        if self._mode in ("OFF", None):
            with suppress(CommandRefused):  # controllers without this command start with the mode alone
                self._command("POWER,ON")
        self._command("MODE,CONSTANT")

    def stop(self, *, off: bool) -> None:
        """Switch off, or stand by."""
        self._command("MODE,OFF" if off else "MODE,STANDBY")

    def end_program(self) -> None:
        """End the program that runs."""
        self._command("PRGM,END,STANDBY")

    def arm_dead_man(self, seconds: float) -> bool:
        """Let the quick timer lead to STANDBY, in whole minutes; False without one, `ProtocolError` where not on."""
        minutes = math.ceil(seconds / 60.0)
        try:
            self._query("TIMER ON?", codes)
        except CommandRefused:
            return False
        with suppress(CommandRefused):  # a timer that is not on
            self._command("TIMER,OFF,0")
        self._command(f"TIMER WRITE,NO0,{minutes // 60}:{minutes % 60},STANDBY")  # in place of what it was set to
        self._command("TIMER,ON,0")
        mode, left = self._query("TIMER LIST?,0", quick_timer)
        if (
            mode != "STANDBY"
            or not minutes - 1 <= left <= minutes
            or 0 not in map(int, self._query("TIMER ON?", codes))
        ):
            raise ProtocolError(
                f"{self.device} did not take its timer: it leads to {mode} in {left} min and not to STANDBY in "
                f"{minutes} min, or is not on; look at its panel"
            )
        return True

    def _command(self, command: str) -> None:
        """Send a setting once. A lost acknowledgement is no error: what was set is read back."""
        request = self._prefix + command
        self._exchange.command(request, partial(understood, self.device, request, acknowledged))

    def _query(self, command: str, parse: Callable[[str], Reply]) -> Reply:
        request = self._prefix + command
        return self._exchange.query(request, partial(understood, self.device, request, parse))


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
