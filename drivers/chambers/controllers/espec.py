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
"""

import math
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Mode, Which
from drivers.chambers.controllers import espec_replies as replies
from drivers.clock import Clock
from drivers.errors import CommandRefused, ProtocolError
from drivers.transports import Transport
from drivers.transports.framing import lines
from drivers.transports.lines import LineExchange
from drivers.transports.transport import Reply

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
            model = self._query("ROM?", replies.text)
        except CommandRefused:
            model = ""  # the oldest controllers know TYPE? alone
        controller, maximum = self._query("TYPE?", replies.chamber_type)
        return ControllerIdentity(model or controller, maximum=maximum)

    def state(self) -> ControllerState:
        """Look at temperature, setpoint, alarm limits and mode, and at the alarms where there are any."""
        self._mode = None
        air, setpoint, high, low = self._query("TEMP?", replies.temperatures)
        mode, count = self._query("MON?", replies.status)
        self._mode = _MODES.get(mode, "RUN")  # RUN PAUSE, RMT RUN and the like
        codes = self._query("ALARM?", replies.codes) if count else ()
        alarms = tuple(f"alarm {code}" for code in codes) or ("alarm without a code",) * bool(count)
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
            self._query("TIMER ON?", replies.codes)
        except CommandRefused:
            return False
        with suppress(CommandRefused):  # a timer that is not on
            self._command("TIMER,OFF,0")
        self._command(f"TIMER WRITE,NO0,{minutes // 60}:{minutes % 60},STANDBY")  # in place of what it was set to
        self._command("TIMER,ON,0")
        mode, left = self._query("TIMER LIST?,0", replies.quick_timer)
        if (
            mode != "STANDBY"
            or not minutes - 1 <= left <= minutes
            or 0 not in map(int, self._query("TIMER ON?", replies.codes))
        ):
            raise ProtocolError(
                f"{self.device} did not take its timer: it leads to {mode} in {left} min and not to STANDBY in "
                f"{minutes} min, or is not on; look at its panel"
            )
        return True

    def _command(self, command: str) -> None:
        """Send a setting once. A lost acknowledgement is no error: what was set is read back."""
        request = self._prefix + command
        self._exchange.command(request, partial(replies.understood, self.device, request, replies.acknowledged))

    def _query(self, command: str, parse: Callable[[str], Reply]) -> Reply:
        request = self._prefix + command
        return self._exchange.query(request, partial(replies.understood, self.device, request, parse))
