"""A chamber that is described in a file (`.description`), for which nobody has written a driver.

    controller = SetpointBox(transport, clock, load_box("my-box.yaml"))
    chamber = SupervisedChamber(controller, clock, Supervision(limits=limits, safe=safe))

What every driver does is done here too: model and unit confirmed before anything is written where the box can tell
them, limits, read-back, alarms, the safe state. Nothing is verified byte-exact by itself and everything is inferred:
the description's key `verified` says what was seen. A reply that is a bare number does not say what it answers: after a
question without a reply the line is listened to for 3 s. Temperatures in °C; time-outs are those of the description.

A box is spoken to in lines of text, or in registers; both media give words, and are told values. It is looked at in
fetches, one text and its reply or one block of registers, made again for an answer that cannot be.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from fnmatch import fnmatchcase
from functools import partial
from typing import Any, Literal, TypeVar

from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Mode, Which
from drivers.chambers.controllers.description import BoxDescription
from drivers.chambers.controllers.questions import Command, Identity, Messages, ModbusSection, Quantity, Question
from drivers.chambers.controllers.templates import PLACE, agrees, filled, found_in
from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceTimeout, ProtocolError, WrongDevice, worded
from drivers.transports import Transport
from drivers.transports.lines import LineExchange
from drivers.transports.modbus import ModbusExchange, Table

Answers = TypeVar("Answers")
Block = tuple[Table, int, int]  # its first register, and how many
Registers = tuple[int, list[int]]  # the first of them, and what they hold


class TextMedium:
    """A box that speaks text."""

    def __init__(self, transport: Transport, clock: Clock, box: BoxDescription, device: str) -> None:
        self._exchange = LineExchange(transport, clock, device=device, framings=box.framings, timing=box.timing)
        self.decimals: int | None = None
        self._device, self._box = device, box
        self._about = {each.ask: (each.length, each.hint) for _, each in box.named if isinstance(each, Question)}
        self._confirms = {text for _, each in box.named for text in getattr(each, "confirm", ())}

    def fetches(self, questions: Iterable[Question]) -> dict[str, list[Question]]:
        """Return the texts that must be sent, and which questions the reply to each answers."""
        found: dict[str, list[Question]] = {}
        for question in questions:
            found.setdefault(question.ask or "", []).append(question)
        return found

    def fetch(self, text: str, accept: Callable[[str], Answers]) -> Answers:
        """Send a text until its reply is accepted, a bounded number of times; raise `DeviceTimeout` with its hint."""
        length, hint = self._about.get(text, (None, ""))
        with worded(DeviceTimeout, "", DeviceTimeout, f"; {hint}" if hint else ""):
            return self._exchange.query(self._box.addressed + text, accept, length)

    def begin(self, *, anew: bool = False) -> None:
        """Ask what must be known before anything else can be understood: nothing."""

    def word(self, question: Question, line: str) -> str:
        """Return what a reply says; `CommandRefused` for a refusal, `ValueError`, which says what it did instead."""
        value = found_in(question.reply, line)
        if isinstance(question, Identity) and any(agrees(each, line) for each in self._confirms):
            value = None  # a late reply to a setting is nobody's name
        self._refuse(question.ask or "", line, answers=value is not None)
        if value is None:
            raise ValueError(
                f"answered {question.ask!r} with {line!r}, its description expects {question.reply!r}; check the line "
                "settings, and that the bench file names the right controller"
            )
        if question.bit is not None and value.isdecimal():
            return str(int(value) >> question.bit & 1)
        return value

    def set(self, quantity: Quantity, value: float, known: dict[str, object]) -> None:
        """Send the text that sets a number once; `known` are setpoint and mode as the box last had them.

        Raises `CommandRefused` where the box says no; a lost reply is no error, because what was set is read back.
        """
        confirm = [filled(each, value=value, any="{any}") for each in quantity.confirm]
        self._tell(filled(quantity.send or "", value=value, **known), confirm)

    def tell(self, command: Command, known: dict[str, object]) -> None:
        """Send a text once; raises as `set`."""
        self._tell(filled(command.send or "", **known), command.confirm)

    def _tell(self, text: str, confirm: Sequence[str]) -> None:
        request = self._box.addressed + text
        if not confirm:
            self._exchange.tell(request)
            return

        def accept(line: str) -> bool:
            if any(agrees(each, line) for each in confirm):
                return True
            self._refuse(request, line)
            return False

        self._exchange.command(request, accept, len(confirm[0]))

    def _refuse(self, request: str, line: str, *, answers: bool = False) -> None:
        """Raise `CommandRefused` where a line says no: one that `answers`, only with more than a bare code."""
        refused = (each for each in self._box.refused if not (answers and PLACE.fullmatch(each)))
        for code in filter(None, (found_in(each, line) for each in refused)):
            meanings = (meaning for known, meaning in self._box.refusals.items() if fnmatchcase(code, known))
            meaning = next(meanings, "look at its panel")
            raise CommandRefused(f"{self._device} refused {request!r} with code {code}; {meaning}")


class RegisterMedium:
    """A box that speaks Modbus."""

    def __init__(self, transport: Transport, clock: Clock, box: BoxDescription, device: str) -> None:
        self._map = box.modbus or ModbusSection()
        self._device = device
        self._exchange = ModbusExchange(
            transport,
            clock,
            device=device,
            unit=self._map.address,
            framing=self._map.framing,
            timing=box.timing,
        )
        self._seen: dict[int, int] = {}
        self.decimals: int | None = None

    def begin(self, *, anew: bool = False) -> None:
        """Ask the decimals once (`anew`: once more), because a wrong guess is a setpoint ten times off."""
        if (self.decimals is None or anew) and self._map.decimals_register is not None:
            self.decimals = self._exchange.query(self._map.decimals_register, 1, self._known_decimals)

    def fetches(self, questions: Iterable[Question]) -> dict[Block, list[Question]]:
        """Return the blocks that must be read, those of the map first, and which questions each answers."""
        found: dict[Block, list[Question]] = {
            ("holding", first, last - first + 1): [] for first, last in self._map.reads
        }
        for question in questions:
            own = (question.table, question.address or 0, self._map.width(question))
            found.setdefault(next((block for block in found if _within(block, own)), own), []).append(question)
        return {block: answered for block, answered in found.items() if answered}

    def fetch(self, block: Block, accept: Callable[[Registers], Answers]) -> Answers:
        """Read a block until it is accepted, a bounded number of times."""
        table, first, count = block

        def parse(registers: list[int]) -> Answers:
            if table == "holding":
                self._seen |= {first + place: register for place, register in enumerate(registers)}
            return accept((first, registers))

        return self._exchange.query(first, count, parse, table)

    def word(self, question: Question, fetched: Registers) -> str:
        """Return the number in the block as text: a bit, a coil, or what its type and scale make of it."""
        first, registers = fetched
        place = (question.address or 0) - first
        if question.bit is not None:
            return str(registers[place] >> question.bit & 1)
        own = registers[place : place + self._map.width(question)]
        return str(self._map.number(question, own, self.decimals))

    def set(self, quantity: Quantity, value: float, known: dict[str, object]) -> None:
        """Write a number to its registers once."""
        self.begin()
        for address in quantity.written_to:
            self._write(address, self._map.registers(quantity, value, self.decimals))

    def tell(self, command: Command, known: dict[str, object]) -> None:
        """Write a value, or switch a coil, or one bit of a register with the others as they were last seen."""
        address = command.address or 0
        if command.table == "coil":
            self._exchange.write_coil(address, on=bool(command.value))
            return
        value = command.value
        if command.bit is not None:
            others = self._seen.get(address, 0) & ~(1 << command.bit)
            value = others | (value & 1) << command.bit
        self._write(address, self._map.registers(command, value))

    def _write(self, address: int, registers: tuple[int, ...]) -> None:
        self._exchange.write(address, *registers, several=self._map.writes == "several")

    def _known_decimals(self, registers: list[int]) -> int:
        if not 0 <= registers[0] <= 3:
            raise ProtocolError(f"{self._device} says that it shows {registers[0]} decimals; it can show 0 to 3")
        return registers[0]


def _within(block: Block, wanted: Block) -> bool:
    return block[0] == wanted[0] and block[1] <= wanted[1] and wanted[1] + wanted[2] <= block[1] + block[2]


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
        with worded(WrongDevice, "", ProtocolError):
            self._ask(identity.requires)
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
        """Set the ramp, °C/min; False where that cannot be, `ProtocolError` where it took in part or not at all."""
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
        with worded(ProtocolError, f"{self.device} did not take its timer, look at its panel: ", ProtocolError):
            left_s = self._one(timer)
            if not wanted_s - 1.01 * timer.step <= left_s <= wanted_s + 0.51 * timer.step:
                raise ProtocolError(f"it reads back {left_s:g} s where {wanted_s:g} s were set")
            if timer.running is not None and timer.number not in self._one(timer.running):
                raise ProtocolError("it is not on")
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
        with worded(ProtocolError, f"{self.device} "):
            return {id(each): each.meaning(self._medium.word(each, fetched)) for each in questions}
