"""How a described box is spoken to: in lines of text, or in registers. Both give words, and are told values.

A box is looked at in fetches: one text and its reply, or one block of registers. One fetch may answer several
questions, and is made again when an answer in it cannot be.
"""

from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from typing import TypeVar

from drivers.chambers.controllers.description import BoxDescription
from drivers.chambers.controllers.questions import Command, Identity, Quantity, Question
from drivers.chambers.controllers.registers import ModbusSection
from drivers.chambers.controllers.templates import PLACE, agrees, filled, found_in
from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceTimeout, ProtocolError
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
        try:
            return self._exchange.query(self._box.addressed + text, accept, length)
        except DeviceTimeout as error:
            raise DeviceTimeout(f"{error}; {hint}" if hint else str(error)) from error

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
        del known
        self.begin()
        for address in quantity.written_to:
            self._write(address, self._map.registers(quantity, value, self.decimals))

    def tell(self, command: Command, known: dict[str, object]) -> None:
        """Write a value, or switch a coil, or one bit of a register with the others as they were last seen."""
        del known
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
        if len(registers) == 1 and self._map.writes == "single":
            self._exchange.write(address, registers[0])
        else:
            self._exchange.write_several(address, registers)

    def _known_decimals(self, registers: list[int]) -> int:
        if not 0 <= registers[0] <= 3:
            raise ProtocolError(f"{self._device} says that it shows {registers[0]} decimals; it can show 0 to 3")
        return registers[0]


def _within(block: Block, wanted: Block) -> bool:
    return block[0] == wanted[0] and block[1] <= wanted[1] and wanted[1] + wanted[2] <= block[1] + block[2]
