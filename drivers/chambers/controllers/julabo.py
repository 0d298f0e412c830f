r"""Julabo circulators (Cryo-Compact CF, HighTech HL, Magio MS): a bath in place of a chamber, over RS-232.

    controller = Julabo(transport, clock)
    chamber = SupervisedChamber(controller, clock, limits=limits, safe=safe, celsius_confirmed=True)

Temperatures are those of the bath. `OUT` commands are not answered: what was sent is read back. The bath's warning
limits (`SP_03` high, `SP_04` low; on some models `SP_01` and `SP_02`, which elsewhere are other setpoints, and on some
none) are the native limits; the excess temperature protector is set by hand. After a power cut a bath that was under
remote control stays off, and must be prepared anew. Negative `STATUS` codes are alarms, except those about the last
command (-08 to -13).

Verified byte-exact (the CF31 manual): `IN_SP_00` and its reply, `OUT_SP_00 55.5`. Captured from a public simulator,
with CR LF where the manual has LF (both are taken): `VERSION`, `STATUS`. Request from the manual, reply inferred from
the simulator: `IN_PV_00`, `IN_MODE_05`, `IN_SP_03`, `IN_SP_04`, `OUT_MODE_05`, `OUT_SP_03`, `OUT_SP_04`. Inferred: that
a warning limit may be written while the setpoint lies beyond it. No timer stops a bath left alone. The unit follows the
panel. A bare number does not say what it answers: after a request without a reply the line is listened to for 3 s.
Line: 4800 baud, even parity; hardware handshake is the factory's setting and must be off. Pauses 0.25 s after OUT and
10 ms after IN; reply awaited 1.5 s; values in 0.1 °C.
"""

import re
from typing import Literal

from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, NativeLimits, Which
from drivers.clock import Clock
from drivers.errors import DeviceTimeout, ProtocolError
from drivers.transports import Transport
from drivers.transports.lines import LineExchange, LineTiming

_STATUS = re.compile(r"(-?\d{2})\s+(.*)")
_ABOUT_COMMANDS = range(-13, -7)
WarningLimits = Literal["SP_03/04", "SP_01/02", "none"]


class Julabo(Controller):
    """A `Controller` of a bath. `warning_limits` says under which parameters its model has them, high and low."""

    def __init__(self, transport: Transport, clock: Clock, *, warning_limits: WarningLimits = "SP_03/04") -> None:
        super().__init__(transport, "circulator")
        high, _, low = warning_limits.removeprefix("SP_").partition("/")
        self.native_limits: NativeLimits = "alarm" if low else "none"
        self._parameters = {"setpoint": "SP_00", **({"high": f"SP_{high}", "low": f"SP_{low}"} if low else {})}
        timing = LineTiming(1.5, pause_after_query_s=0.01, pause_after_command_s=0.25, late_s=3.0)
        self._exchange = LineExchange(
            transport, clock, device=self.device, terminator=b"\r", reply_terminator=b"\n", timing=timing
        )

    def identify(self) -> ControllerIdentity:
        """Ask the version, which names the model; the unit cannot be asked."""
        return ControllerIdentity(self._exchange.query("VERSION", self._version))

    def state(self) -> ControllerState:
        """Look at bath, setpoint, warning limits, mode and status; raise `DeviceTimeout` where one is not told."""
        return ControllerState(
            temperature=self._exchange.query("IN_PV_00", self._number),
            setpoint=self._exchange.query("IN_SP_00", self._number),
            high=self._limit("high"),
            low=self._limit("low"),
            mode="CONSTANT" if self._exchange.query("IN_MODE_05", self._switch) else "OFF",
            alarms=self._exchange.query("STATUS", self._alarms),
        )

    def write(self, which: Which, value: float) -> None:
        """Send the setpoint or a warning limit."""
        self._exchange.tell(f"OUT_{self._parameters[which]} {value:.1f}")

    def start(self) -> None:
        """Start the circulation."""
        self._exchange.tell("OUT_MODE_05 1")

    def stop(self, *, off: bool) -> None:
        """Stop the circulation; there is no other stop."""
        del off
        self._exchange.tell("OUT_MODE_05 0")

    def end_program(self) -> None:
        """Do nothing: a running profile does not show here, and stopping ends it."""

    def _limit(self, which: Which) -> float | None:
        if which not in self._parameters:
            return None
        try:
            return self._exchange.query(f"IN_{self._parameters[which]}", self._number)
        except DeviceTimeout as error:
            hint = "where its model has no such parameter, write chamber.warning_limits: SP_01/02, or none"
            raise DeviceTimeout(f"{error}; {hint}") from error

    def _version(self, line: str) -> str:
        if not any(character.isalpha() for character in line):
            raise ProtocolError(f"{self.device} answered VERSION with {line!r}, which is no name")
        return line

    def _number(self, line: str) -> float:
        if not re.fullmatch(r"[-+]?\d+(\.\d*)?", line):
            raise ProtocolError(f"{self.device} answered {line!r} where a number was asked for")
        return float(line)

    def _switch(self, line: str) -> bool:
        if line not in ("0", "1"):
            raise ProtocolError(f"{self.device} answered IN_MODE_05 with {line!r}; 0 and 1 are possible")
        return line == "1"

    def _alarms(self, line: str) -> tuple[str, ...]:
        found = _STATUS.fullmatch(line)
        if found is None:
            raise ProtocolError(f"{self.device} answered STATUS with {line!r}")
        code = int(found[1])
        return (line,) if code < 0 and code not in _ABOUT_COMMANDS else ()
