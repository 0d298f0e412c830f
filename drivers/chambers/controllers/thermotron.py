r"""Thermotron 8200, 8800, 3800 and s2200 over ASCII (serial, or TCP port 8888).

    controller = Thermotron(transport, clock)
    chamber = SupervisedChamber(controller, clock, limits=limits, safe=safe, celsius_confirmed=True)

Channel 1. A setpoint takes effect with `RUNM` (run manual), so `RUNM` follows every setpoint of a chamber that runs.

Verified byte-exact (an 8200 manual's frames, ended by CR): `PVAR1?`, `SETP1?`, `SETP1,22.000` and their replies, and
the requests `RUNM` and `STOP`. From the vendor's command page, without terminator: operations answered with a code, 0
for done, and `ALRM2?` answered with `1`. The sources disagree on what follows an operation (8200: the value echoed or
nothing; 8800 and s2200: the code), so either is taken, silence too, and what counts is read back. The bits of `MODE?`
and the pause of 1 s after every write are those of another client; the bits of `ALRM1?` the vendor's. Inferred: that
non-zero codes are refusals, that a delayed start and a held program count as programs, and the reply to `IDEN?` being
free text. `MRMP`, `STAT?` and `IERR` exist by name only and are not used: there is no native ramp, no native limit and
no timer that stops a chamber left alone. The unit follows the panel. A bare number does not say what it answers: after
a request without a reply the line is listened to for 3 s. Values with three decimals, held in 0.1 °C; reply awaited 1.5
s.
"""

import re

from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Mode, Which
from drivers.clock import Clock
from drivers.errors import CommandRefused, ProtocolError
from drivers.transports import Transport
from drivers.transports.lines import LineExchange, LineTiming

_MANUAL = 16
_PROGRAM = 1 | 8 | 32  # runs, is held, or will start
_ALARMS = {0: "low deviation", 1: "high deviation", 4: "low process", 5: "high process"}


class Thermotron(Controller):
    """A `Controller` of channel 1. `terminator` is CR on serial lines, LF or CR LF on TCP."""

    def __init__(self, transport: Transport, clock: Clock, *, terminator: bytes = b"\r") -> None:
        super().__init__(transport)
        timing = LineTiming(1.5, pause_after_query_s=0.1, pause_after_command_s=1.0, late_s=3.0)
        self._exchange = LineExchange(transport, clock, device=self.device, terminator=terminator, timing=timing)
        self._running = False

    def identify(self) -> ControllerIdentity:
        """Ask the model; the unit cannot be asked."""
        return ControllerIdentity(self._exchange.query("IDEN?", self._words))

    def state(self) -> ControllerState:
        """Look at temperature, setpoint, mode and alarms."""
        temperature = self._exchange.query("PVAR1?", self._decimal)
        setpoint = self._exchange.query("SETP1?", self._decimal)
        mode = self._mode(self._exchange.query("MODE?", self._bits))
        self._running = mode == "CONSTANT"
        alarms = self._exchange.query("ALRM1?", self._bits)
        return ControllerState(temperature, setpoint, mode, _alarms(alarms))

    def write(self, which: Which, value: float) -> None:
        """Send the setpoint, and let it take effect where the chamber runs."""
        del which  # there are no native limits
        self._do(f"SETP1,{value:.3f}")
        if self._running:
            self.start()

    def start(self) -> None:
        """Run manually."""
        self._do("RUNM")

    def stop(self, *, off: bool) -> None:
        """Stop; there is no other stop."""
        del off
        self._running = False
        self._do("STOP")

    def end_program(self) -> None:
        """Stop, which ends a program too."""
        self._do("STOP")

    def _do(self, command: str) -> None:
        self._exchange.command(command, lambda line: self._done(command, line))

    def _done(self, command: str, line: str) -> bool:
        """Take a return code or an echoed value; a code other than 0 is a refusal."""
        if re.fullmatch(r"\d{1,3}", line):
            if int(line) != 0:
                raise CommandRefused(f"{self.device} refused {command!r} with code {line}; look at its panel")
            return True
        return re.fullmatch(r"-?\d+\.\d*", line) is not None

    def _mode(self, bits: int) -> Mode:
        if bits & _PROGRAM:
            return "RUN"
        return "CONSTANT" if bits & _MANUAL else "OFF"

    def _decimal(self, line: str) -> float:
        if not re.fullmatch(r"[-+]?\d+\.\d*", line):
            raise ProtocolError(f"{self.device} answered {line!r} where a temperature was asked for")
        return float(line)

    def _bits(self, line: str) -> int:
        if not re.fullmatch(r"\d{1,3}", line):
            raise ProtocolError(f"{self.device} answered {line!r} where a number of bits was asked for")
        return int(line)

    def _words(self, line: str) -> str:
        if not any(character.isalpha() for character in line):
            raise ProtocolError(f"{self.device} answered {line!r} where its name was asked for")
        return line


def _alarms(bits: int) -> tuple[str, ...]:
    return tuple(_ALARMS.get(bit, f"alarm bit {bit}") for bit in range(8) if bits & (1 << bit))
