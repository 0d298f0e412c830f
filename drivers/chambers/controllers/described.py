"""A chamber that is described in a file (`.description`), for which nobody has written a driver.

    controller = SetpointBox(transport, clock, load_box("my-box.yaml"))
    chamber = SupervisedChamber(controller, clock, limits=limits, safe=safe)

What every driver does is done here too: model and unit confirmed before anything is written where the box can tell
them, limits, read-back, alarms, the safe state. Nothing is verified byte-exact by itself and everything is inferred:
the description's key `verified` says what was seen. A reply that is a bare number does not say what it answers: after a
question without a reply the line is listened to for 3 s. Temperatures in °C; time-outs are those of the description.
"""

from collections.abc import Callable
from typing import TypeVar

from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Mode, Unit, Which
from drivers.chambers.controllers.description import BoxDescription, Command, Quantity, Question
from drivers.clock import Clock
from drivers.errors import ProtocolError, WrongDevice
from drivers.transports import Transport
from drivers.transports.lines import LineExchange, LineTiming

Value = TypeVar("Value")

TERMINATORS = {"CR": b"\r", "LF": b"\n", "CR LF": b"\r\n"}
_LATE_S = 3.0


class SetpointBox(Controller):
    """A `Controller` as a description says."""

    def __init__(self, transport: Transport, clock: Clock, description: BoxDescription) -> None:
        super().__init__(transport, description.name)
        self.resolution_degC = description.resolution_degC
        self.native_limits = "none" if description.low_limit is None else description.limits_are
        self.sees_programs = "RUN" in description.state.modes.values()
        self._box = description
        self._exchange = LineExchange(
            transport,
            clock,
            device=self.device,
            terminator=TERMINATORS[description.terminator],
            reply_terminator=TERMINATORS[description.reply_terminator or description.terminator],
            timing=LineTiming(
                description.timeout_s,
                description.pause_after_question_s,
                description.pause_after_setting_s,
                late_s=_LATE_S,
            ),
        )

    def identify(self) -> ControllerIdentity:
        """Ask who is there; raise `WrongDevice` where it is not the box of the description."""
        model = self._ask(self._box.identify, str)
        if not model.upper().startswith(self._box.identify.expect.upper()):
            raise WrongDevice(
                f"{self.device} says it is {model!r}, its description expects {self._box.identify.expect!r}; check "
                "the cable and the bench file"
            )
        return ControllerIdentity(model, self._unit())

    def state(self) -> ControllerState:
        """Ask for everything that the box can tell."""
        box = self._box
        alarms = self._ask(box.alarms, str)
        return ControllerState(
            temperature=self._ask(box.temperature, float),
            setpoint=self._ask(box.setpoint, float),
            mode=self._ask(box.state, self._mode),
            alarms=() if alarms in box.alarms.none else (f"alarm {alarms}",),
            low=None if box.low_limit is None else self._ask(box.low_limit, float),
            high=None if box.high_limit is None else self._ask(box.high_limit, float),
            unit=self._unit(),
        )

    def write(self, which: Which, value: float) -> None:
        """Send the setpoint or a limit."""
        quantity = {"low": self._box.low_limit, "setpoint": self._box.setpoint, "high": self._box.high_limit}[which]
        if quantity is not None:
            self._tell(quantity.request(value), quantity.confirm)

    def start(self) -> None:
        """Start conditioning."""
        self._do(self._box.start)

    def stop(self, *, off: bool) -> None:
        """Stop conditioning."""
        self._do(self._box.stop if off or self._box.standby is None else self._box.standby)

    def end_program(self) -> None:
        """End a program, where the box has such a command."""
        if self._box.end_program is not None:
            self._do(self._box.end_program)

    def set_ramp_rate(self, degC_per_min: float) -> bool:
        """Set the ramp, °C/min; False where the description has none. Raises `ProtocolError` where it did not take."""
        return self._set(self._box.ramp_degC_per_min, degC_per_min)

    def arm_dead_man(self, seconds: float) -> bool:
        """Set its own timer, s; False where the description has none. Raises `ProtocolError` where it did not take."""
        return self._set(self._box.dead_man_s, seconds)

    def _set(self, quantity: Quantity | None, value: float) -> bool:
        if quantity is None:
            return False
        self._tell(quantity.request(value), quantity.confirm)
        found = self._ask(quantity, float)
        if abs(found - value) > 0.051:
            raise ProtocolError(f"{self.device} reads back {found:g} for {quantity.request(value)!r}")
        return True

    def _ask(self, question: Question, convert: Callable[[str], Value]) -> Value:
        def parse(line: str) -> Value:
            value = question.value(line)
            if value is None:
                raise ProtocolError(
                    f"{self.device} answered {question.ask!r} with {line!r}, its description expects {question.reply!r}"
                )
            try:
                return convert(value)
            except ValueError:
                raise ProtocolError(f"{self.device} answered {question.ask!r} with {line!r}: no number") from None

        return self._exchange.query(question.ask, parse)

    def _do(self, command: Command) -> None:
        self._tell(command.send, command.confirm)

    def _tell(self, request: str, confirm: str | None) -> None:
        if confirm is None:
            self._exchange.tell(request)
        else:
            self._exchange.command(request, lambda line: line == confirm)

    def _mode(self, word: str) -> Mode:
        if word not in self._box.state.modes:
            raise ProtocolError(f"{self.device} is in state {word!r}, which its description does not have")
        return self._box.state.modes[word]

    def _unit(self) -> Unit | None:
        unit = self._box.unit
        if unit is None:
            return None

        def known(word: str) -> Unit:
            if word not in (unit.celsius, unit.fahrenheit):
                raise ProtocolError(
                    f"{self.device} says that its unit is {word!r}, which its description does not have"
                )
            return "degC" if word == unit.celsius else "degF"

        return self._ask(unit, known)
