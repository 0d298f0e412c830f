r"""Vötsch and Weiss chambers with S!MPAC SimServ (LabEvent, VC³, WK³): numbered commands over TCP 2049.

    controller = SimServ(transport, clock)           # transport: open_port("socket://192.0.2.5:2049", clock=clock)
    chamber = SupervisedChamber(controller, clock, limits=limits, safe=safe, celsius_confirmed=True)

A request is a number and its arguments between `\xb6`, ended by CR: `11001¶1¶1¶-30`; the reply a code and data, ended
by CR LF: `1¶23.456`. Code 1 is success, negative ones are errors. The first argument is always 1 (the chamber), the
second the control variable (1 is temperature) or the feature plus one (start is 1).

Verified byte-exact (captured from a maker's client): the requests 99997, 11001, 11002, 11004, 14001 and 14003 as sent
here. Inferred, from four independent clients that agree: every reply, and the requests 10012 (status), 17002, 17005,
17007 and 17009 (messages), 11066 to 11072 (gradients), 19015 (end the program). Inferred alone here: that a status of 3
(running) without the manual start bit is a program. 17012, which resets errors, is never sent. Neither unit nor native
setpoint limits are asked: the unit follows the panel, and the alarm limits (11014, 11015) are set there. No timer stops
a chamber left alone. A reply does not say what it answers: after a request without one the line is listened to for 3 s.
Temperatures in 0.1 °C, gradients 0.01 to 5 °C/min up and to 3.5 down; reply awaited 1.5 s, pause 0.1 s.
"""

from collections.abc import Callable
from typing import TypeVar

from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Mode, Which
from drivers.clock import Clock
from drivers.errors import CommandRefused, ProtocolError
from drivers.transports import Transport
from drivers.transports.lines import LineExchange, LineTiming

Value = TypeVar("Value")

_SEPARATOR = "\xb6"
_RUNNING, _ALARM = 3, 8
_ALARM_MESSAGE = 1
_FASTEST_UP, _FASTEST_DOWN = 5.0, 3.5
_MEANINGS = {
    -1: "the request was empty",
    -2: "the chamber's number is missing",
    -3: "the chamber's number is out of range",
    -4: "there is no such chamber: check the port",
    -5: "it does not know this command: check that the bench file names the right controller",
    -6: "the parameters are wrong: check the value against its limits",
    -7: "its server does not run: restart the control panel",
    -8: "it cannot be found or read",
    -9: "it could not be carried out: look for a message on its panel",
    -10: "the index is wrong: check the control variables of this chamber",
    -11: "nobody is logged in at its panel",
    -12: "whoever is logged in at its panel may not do this",
    -13: "somebody is logged in twice",
}


class SimServ(Controller):
    """A `Controller` behind SimServ: control variable 1 is the air's temperature."""

    def __init__(self, transport: Transport, clock: Clock) -> None:
        super().__init__(transport)
        timing = LineTiming(1.5, pause_after_query_s=0.1, pause_after_command_s=0.1, late_s=3.0)
        self._exchange = LineExchange(
            transport,
            clock,
            device=self.device,
            terminator=b"\r",
            reply_terminator=b"\r\n",
            timing=timing,
            encoding="latin-1",
        )

    def identify(self) -> ControllerIdentity:
        """Ask the chamber's type."""
        return ControllerIdentity(self._ask(self._text, 99997, 1))

    def state(self) -> ControllerState:
        """Look at temperature, setpoint, what runs, and the messages where there is an alarm."""
        temperature = self._ask(self._number, 11004, 1)
        setpoint = self._ask(self._number, 11002, 1)
        status = int(self._ask(self._number, 10012))
        return ControllerState(temperature, setpoint, self._mode(status), self._alarms() if status & _ALARM else ())

    def write(self, which: Which, value: float) -> None:
        """Send the setpoint."""
        del which  # there are no native limits
        self._do(11001, 1, f"{value:g}")

    def start(self) -> None:
        """Start manual operation."""
        self._do(14001, 1, 1)

    def stop(self, *, off: bool) -> None:
        """Stop manual operation; there is no other stop."""
        del off
        self._do(14001, 1, 0)

    def end_program(self) -> None:
        """End the program that runs."""
        self._do(19015)

    def set_ramp_rate(self, degC_per_min: float) -> bool:
        """Bound the gradients up and down, no faster than it can; raise `ProtocolError` where others are read back."""
        for write, read, rate in (
            (11068, 11066, min(degC_per_min, _FASTEST_UP)),
            (11072, 11070, min(degC_per_min, _FASTEST_DOWN)),
        ):
            wanted = max(round(rate, 2), 0.01)
            self._do(write, 1, f"{wanted:g}")
            found = self._ask(self._number, read, 1)
            if abs(found - wanted) > 0.005:
                raise ProtocolError(f"{self.device} reads back a gradient of {found:g} °C/min instead of {wanted:g}")
        return True

    def _mode(self, status: int) -> Mode:
        if int(self._ask(self._number, 14003, 1)) == 1:
            return "CONSTANT"
        return "RUN" if status & _RUNNING == _RUNNING else "OFF"

    def _alarms(self) -> tuple[str, ...]:
        """Return the texts of the alarms that are active, or say that there is one without a text."""
        found = []
        for number in range(1, int(self._ask(self._number, 17002)) + 1):
            is_alarm = int(self._ask(self._number, 17005, number)) == _ALARM_MESSAGE
            if is_alarm and int(self._ask(self._number, 17009, number)) == 1:
                found.append(self._ask(self._text, 17007, number))
        return tuple(found) or ("alarm without a text",)

    def _ask(self, parse: Callable[[str, list[str]], Value], command: int, *arguments: object) -> Value:
        request = _request(command, arguments)
        return self._exchange.query(request, lambda line: parse(request, self._data(request, line)))

    def _do(self, command: int, *arguments: object) -> None:
        """Send a command once; a refusal is an error, a lost reply is none, because what was set is read back."""
        request = _request(command, arguments)

        def accept(line: str) -> bool:
            try:
                return self._data(request, line) == []
            except ProtocolError:
                return False

        self._exchange.command(request, accept)

    def _data(self, request: str, line: str) -> list[str]:
        """Return the data behind the code; raise `CommandRefused` for an error, `ProtocolError` for no reply."""
        code, *data = line.split(_SEPARATOR)
        try:
            number = int(code)
        except ValueError:
            number = 0
        if number < 0:
            raise CommandRefused(
                f"{self.device} refused {request!r} with {line!r}: {_MEANINGS.get(number, 'see its manual')}"
            )
        if number != 1:
            raise ProtocolError(f"{self.device} answered {request!r} with {line!r}; is this SimServ?")
        return data

    def _number(self, request: str, data: list[str]) -> float:
        try:
            return float(data[0])
        except (ValueError, IndexError):
            raise ProtocolError(f"{self.device} answered {request!r} with {data}, which is no number") from None

    def _text(self, request: str, data: list[str]) -> str:
        if not data or not data[0]:
            raise ProtocolError(f"{self.device} answered {request!r} without a text")
        return data[0]


def _request(command: int, arguments: tuple[object, ...]) -> str:
    return _SEPARATOR.join(str(part) for part in (command, 1, *arguments))
