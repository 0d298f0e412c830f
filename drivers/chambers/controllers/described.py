"""A chamber that is described in a file (`.description`), for which nobody has written a driver.

    controller = SetpointBox(transport, clock, load_box("my-box.yaml"))
    chamber = SupervisedChamber(controller, clock, Supervision(limits=limits, safe=safe))

What every driver does is done here too: model and unit confirmed before anything is written where the box can tell
them, limits, read-back, alarms, the safe state. Nothing is verified byte-exact by itself and everything is inferred:
the description's key `verified` says what was seen. A reply that is a bare number does not say what it answers: after a
question without a reply the line is listened to for 3 s. Temperatures in °C; time-outs are those of the description.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from functools import partial
from typing import Any, Literal

from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Mode, Which
from drivers.chambers.controllers.description import BoxDescription
from drivers.chambers.controllers.media import RegisterMedium, TextMedium
from drivers.chambers.controllers.questions import Command, Messages, Quantity, Question
from drivers.clock import Clock
from drivers.errors import CommandRefused, ProtocolError, WrongDevice
from drivers.transports import Transport


class SetpointBox(Controller):
    """A `Controller` as a description says."""

    def __init__(self, transport: Transport, clock: Clock, description: BoxDescription) -> None:
        super().__init__(transport, "chamber" if description.modbus else description.name)
        box = self._box = description
        self.resolution_degC = box.resolution_degC
        self.limits_alarm = box.low_limit is not None and box.limits_are == "alarm"
        self.can_stop = bool(box.stop)
        self.sees_programs = any("RUN" in (*each.modes.values(), each.otherwise) for each in box.state)
        kind = TextMedium if box.modbus is None else RegisterMedium
        self._medium: TextMedium | RegisterMedium = kind(transport, clock, box, self.device)
        self._seen: Mode | None = None  # None where nobody knows
        self._known: dict[str, object] = {
            "setpoint": 0.0,
            "mode": box.state[0].word_for("CONSTANT") if box.state else "",
        }

    def identify(self) -> ControllerIdentity:
        """Ask who is there; raise `WrongDevice` where it is not the box of the description."""
        unit, identity = self._box.unit, self._box.identify
        others = [each for each in (unit, identity.hottest, identity.instead) if each is not None]
        about: dict[int, Any] = {}
        try:
            model = self._model(self._one(identity) if identity.asks else "")
        except CommandRefused:
            if identity.instead is None:
                raise
            about = self._ask(others)
            model = self._model(about[id(identity.instead)])
        try:
            self._ask(identity.requires)
        except ProtocolError as error:
            raise WrongDevice(str(error)) from error
        self._medium.begin(anew=True)
        if not identity.asks:
            return ControllerIdentity(model, self.state().unit)  # who cannot be asked must look like it
        with suppress(CommandRefused):  # an older one, which does not know these questions
            about = about or self._ask(others)
        return ControllerIdentity(model, about.get(id(unit)), about.get(id(identity.hottest)))

    def state(self) -> ControllerState:
        """Look at everything that the box can tell; raise `ProtocolError` where it contradicts itself."""
        box, self._seen = self._box, None
        self._medium.begin()
        # What reaches the wire is in the panel's step; a finer one than 0.1 °C means nothing to a chamber.
        self.resolution_degC = max(10.0 ** -(self._medium.decimals or 1), box.resolution_degC)
        found = self._ask(box.looked_at)
        low, high, unit = (found.get(id(each)) for each in (box.low_limit, box.high_limit, box.unit))
        if low is not None and low > high:
            raise ProtocolError(
                f"{self.device} has a lower setpoint limit above its upper one; check that the bench file names the "
                "right controller"
            )
        mode, self._known["setpoint"] = self._mode(found), found[id(box.setpoint)]
        alarms = tuple(alarm for each in box.alarms for alarm in found[id(each)])
        if alarms and box.messages:
            alarms = tuple(self._messages(box.messages)) or alarms
        if alarms and box.alarm_list:
            alarms = self._one(box.alarm_list) or alarms
        return ControllerState(found[id(box.temperature)], found[id(box.setpoint)], mode, alarms, low, high, unit)

    def write(self, which: Which, value: float) -> None:
        quantity = {"low": self._box.low_limit, "setpoint": self._box.setpoint, "high": self._box.high_limit}[which]
        if quantity is not None:
            self._medium.set(quantity, value, self._known)
        if which == "setpoint":
            self._known["setpoint"] = value
            if self._box.setpoint.then_start and self._seen == "CONSTANT":
                self.start()

    def start(self) -> None:
        self._do(self._box.start)

    def stop(self, *, off: bool) -> None:
        self._seen = None
        self._do(self._box.stop if off or not self._box.standby else self._box.standby)

    def end_program(self) -> None:
        self._do(self._box.end_program)

    def set_ramp_rate(self, degC_per_min: float) -> bool:
        """Set the ramp, °C/min; False where there is none, where it is told no finer, or where it refuses.

        Raises `ProtocolError` where it did not take, or where only a part of it was accepted.
        """
        ramps = self._box.ramp_degC_per_min
        if any(degC_per_min < each.step for each in ramps):
            return False
        settings: list[tuple[Quantity, float]] = []
        for each in ramps:
            settings += [(each, min(degC_per_min, each.most or degC_per_min)), *((own, own.to) for own in each.also)]
        for done, (quantity, value) in enumerate(settings):
            try:
                self._set(quantity, value)
            except CommandRefused as error:
                if done:
                    raise ProtocolError(f"{self.device} took a part of its ramp only: {error}; set it there") from error
                return False
        return bool(settings)

    def arm_dead_man(self, seconds: float) -> bool:
        """Set its own timer, s; False where there is none. Raises `ProtocolError` where it did not take."""
        timer = self._box.dead_man_s
        if timer is None:
            return False
        if timer.running is not None:
            try:
                self._one(timer.running)
            except CommandRefused:
                return False
        self._do(timer.first)
        wanted_s = timer.step * math.ceil(seconds / timer.step - 1e-9)
        self._medium.set(timer, wanted_s, self._known)
        self._do(timer.then)
        try:
            left_s = self._one(timer)
            if not wanted_s - 1.01 * timer.step <= left_s <= wanted_s + 0.51 * timer.step:
                raise ProtocolError(f"it reads back {left_s:g} s where {wanted_s:g} s were set")
            if timer.running is not None and timer.number not in self._one(timer.running):
                raise ProtocolError("it is not on")
        except ProtocolError as error:
            raise ProtocolError(f"{self.device} did not take its timer, look at its panel: {error}") from error
        return True

    def _set(self, quantity: Quantity, value: float) -> None:
        self._medium.set(quantity, value, self._known)
        found = self._one(quantity)
        if not abs(found - value) <= 0.51 * quantity.step:  # so that what is no number is no confirmation
            raise ProtocolError(f"{self.device} reads back {found:g} where {value:g} was set")

    def _do(self, commands: Sequence[Command]) -> None:
        for command in commands:
            if command.where in (None, self._seen) or self._seen is None:
                with suppress(CommandRefused) if command.may_be_refused else nullcontext():
                    self._medium.tell(command, self._known)

    def _model(self, word: str) -> str:
        identity = self._box.identify
        if not word.upper().startswith(identity.expect.upper()):
            what = (
                f"says it is {word!r}, its description expects {identity.expect!r}; check the cable and the bench file"
            )
            raise WrongDevice(f"{self.device} {(identity.otherwise or what).replace('{value}', word)}")
        return identity.model.replace("{value}", word)

    def _mode(self, found: Mapping[int, Any]) -> Mode:
        """Return the first mode that a question of the state tells; a box that cannot be switched conditions."""
        for each in self._box.state:
            mode: Mode | Literal["next"] = found[id(each)]
            if mode != "next":
                self._known["mode"], self._seen = each.word_for(mode), mode
                return mode
        return "CONSTANT"

    def _messages(self, told: Messages) -> Iterator[str]:
        for number in range(1, int(self._one(told.count)) + 1):
            if all(self._one(each.numbered(number)) == 1 for each in told.only):
                yield self._one(told.text.numbered(number))

    def _one(self, question: Question) -> Any:
        return self._ask([question])[id(question)]

    def _ask(self, questions: Sequence[Question]) -> dict[int, Any]:
        """Return the meanings of the answers, by the questions' ids; what answers several is fetched once."""
        found: dict[int, Any] = {}
        for what, answered in self._medium.fetches(questions).items():
            found |= self._medium.fetch(what, partial(self._meanings, answered))  # type: ignore[arg-type]
        return found

    def _meanings(self, questions: Sequence[Question], fetched: Any) -> dict[int, Any]:
        try:
            return {id(each): each.meaning(self._medium.word(each, fetched)) for each in questions}
        except ValueError as error:
            raise ProtocolError(f"{self.device} {error}") from None
