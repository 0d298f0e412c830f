"""A chamber described in a file: what is sent and what comes back, or which registers it has.

    >>> box = load_box("configs/chambers/temptronic-ats.yaml")
    >>> box.setpoint.send
    'SETP {value:.1f}'

A box speaks text, or Modbus where its description has a section `modbus`. What text is made of is in `templates`. A
register's number is a word as a reply is: what a word means stands with the question.
"""

from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, PositiveFloat, PositiveInt, ValidationError, model_validator

from drivers.chambers.controller import Mode
from drivers.chambers.controllers.registers import (
    Address,
    Entry,
    InRegister,
    ModbusSection,
    Plain,
    Registers,
    Several,
    Word,
    off_is_a_word,
)
from drivers.chambers.controllers.templates import Order, Reply, addressed_to
from drivers.errors import InputError
from drivers.given_file import read_text
from drivers.strict_yaml import first_mistake, parse_yaml
from drivers.transports.framing import Frame, Framings, Silence, lines
from drivers.transports.transport import Timing

_TERMINATORS = {"CR": b"\r", "LF": b"\n", "CR LF": b"\r\n"}

Looked = Literal["alarms", "temperature", "setpoint", "state", "low_limit", "high_limit", "unit"]


class Question(InRegister):
    """Something that can be asked: by a text, or of a register. `length` is that of a reply that nothing ends."""

    ask: Plain | None = None
    reply: Reply = "{value}"
    length: PositiveInt | None = None
    hint: str = ""  # what to look at where it is not answered

    @model_validator(mode="after")
    def _asked_in_one_way(self) -> Self:
        if (self.ask is None) == (self.address is None) and not (self.optional and self.ask is None):
            raise ValueError("say how it is asked: ask and reply, or register")
        return self

    def meaning(self, word: str) -> Any:
        """Return what a word means; raise `ValueError`, which says what the box does, where it can mean nothing."""
        return word

    def numbered(self, number: int) -> Self:
        """Return the question about one of several, in whose text it is `{number}`."""
        return self.model_copy(update={"ask": (self.ask or "").replace("{number}", str(number))})


class Number(Question):
    """A number that can be asked."""

    numeric = True

    def meaning(self, word: str) -> float:
        """Return the number."""
        try:
            return float(word)
        except ValueError:
            raise ValueError(f"answered {self.ask!r} with {word!r}: no number") from None


class Command(InRegister):
    """Something that can be told: a text, or a value that is written to a register, a bit of it, or a coil."""

    send: Plain | None = None
    confirm: Several[str] = ()
    value: int = 1

    @model_validator(mode="after")
    def _told_in_one_way(self) -> Self:
        if (self.send is None) == (self.address is None):
            raise ValueError("say how it is told: send, or register and value")
        return self


class Quantity(Number):
    """A number that can be asked and set. `write` are the registers it is written to, if not the one that is read."""

    send: Order | None = None
    confirm: Several[str] = ()
    then_start: bool = False  # takes effect when it is started, where it runs
    step: PositiveFloat = 0.1  # in which it is held
    write: Several[Address] = ()

    @model_validator(mode="after")
    def _can_be_set(self) -> Self:
        if self.ask is not None and self.send is None:
            raise ValueError("send: this key is missing")
        return self

    @property
    def written_to(self) -> tuple[int, ...]:
        """The registers it is written to."""
        return self.write or (() if self.address is None else (self.address,))


class Setting(Quantity):
    """What is set `to` the same value whenever another quantity is."""

    to: float


class Ramp(Quantity):
    """How fast the setpoint moves, °C/min: `most` is the fastest, `also` are the settings that make it count."""

    most: PositiveFloat | None = None
    also: Several[Setting] = ()


class Requirement(Question):
    """What must be so for anything to be believed; `otherwise` goes on where a message has named the box."""

    one_of: Several[Word] = ()
    none_of: Several[Word] = ()
    otherwise: Plain

    def meaning(self, word: str) -> str:
        """Return the word."""
        if (self.one_of and word not in self.one_of) or word in self.none_of:
            raise ValueError(self.otherwise.replace("{value}", word))
        return word


class Identity(Question):
    """Who answers: how that must begin, and the model (`{value}` is the answer), alone where it cannot be asked."""

    optional = True
    expect: Word = ""
    model: Plain = "{value}"
    otherwise: Plain | None = None
    hottest: Number | None = None  # what it says it can be, by which a unit that it cannot tell is judged
    requires: Several[Requirement] = ()

    @property
    def asks(self) -> bool:
        """Whether it can be asked."""
        return self.ask is not None or self.address is not None

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if not self.asks and "{value}" in self.model:
            raise ValueError("say how it is asked: ask and reply, or register; or give its model")
        return self

    def meaning(self, word: str) -> str:
        """Return the word; a name that is asked by text has letters, a late reply to something else may have none."""
        if self.ask is not None and not any(map(str.isalpha, word)):
            raise ValueError(f"answered {self.ask!r} with {word!r}, which is no name")
        return word


class UnitQuestion(Question):
    """The unit, with the words for °C and °F; `*` in them stands for anything."""

    celsius: Several[Word]
    fahrenheit: Several[Word]

    @model_validator(mode="after")
    def _differ(self) -> Self:
        if both := {*self.celsius} & {*self.fahrenheit}:
            raise ValueError(f"fahrenheit: {both.pop()} means °C too; one word cannot be both")
        return self

    def meaning(self, word: str) -> str:
        """Return the unit."""
        for unit, words in (("degC", self.celsius), ("degF", self.fahrenheit)):
            if any(fnmatchcase(word, each) for each in words):
                return unit
        raise ValueError(f"says that its unit is {word!r}, which its description does not have")


class StateQuestion(Question):
    """What the box is doing: its word for each mode; `next` leaves it to the question that follows."""

    modes: dict[Word, Annotated[Mode | Literal["next"], BeforeValidator(off_is_a_word)]]
    otherwise: Mode | Literal["next"] | None = None

    def meaning(self, word: str) -> str:
        """Return the mode, or next."""
        mode = self.modes.get(word, self.otherwise)
        if mode is None:
            raise ValueError(f"is in state {word!r}, which its description does not have")
        return mode

    def word_for(self, mode: str) -> str:
        """Return the box's word for a mode; where another question tells that one, what it says beside it."""
        words: dict[str, str] = {meant: word for word, meant in reversed(self.modes.items())}
        return next((words[each] for each in (mode, "next", "CONSTANT") if each in words), "0")


class AlarmQuestion(Question):
    """Alarms: the words that mean that there is none, or the names of `bits`. `name` is how one is reported.

    In words `*` stands for anything and `?` for one character. Where `some` are given no others can be.
    """

    none: Annotated[Several[Word], Field(min_length=1)] = ("0",)
    some: Several[Word] = ("*",)
    name: Plain = "alarm {value}"
    bits: dict[Annotated[int, Field(ge=0, le=15)], Plain] | None = None

    def meaning(self, word: str) -> tuple[str, ...]:
        """Return the alarms that stand."""
        if any(fnmatchcase(word, each) for each in self.none):
            return ()
        if not any(fnmatchcase(word, each) for each in self.some):
            raise ValueError(f"answered {self.ask!r} with {word!r}, which is no alarm and not none")
        if self.bits is None:
            return (self.name.replace("{value}", word),)
        if not word.isdecimal():
            raise ValueError(f"answered {self.ask!r} with {word!r} where bits were asked for")
        standing = [bit for bit in range(16) if int(word) & (1 << bit)]
        return tuple(self.bits.get(bit, self.name.replace("{value}", f"bit {bit}")) for bit in standing)


class Messages(Entry):
    """Alarms as texts in a list: the `count`, and by `{number}` the `text` of each, if all of `only` are answered 1."""

    count: Number
    text: Question
    only: Several[Number] = ()


class SimulatedSection(Entry):
    """What a simulator of it does besides: registers that it has, others that are the same, and how it refuses."""

    registers: dict[Registers, int] = Field(default_factory=dict)
    same: dict[Address, Address] = Field(default_factory=dict)
    silent_refusals: bool = False
    takes_any_setpoint: bool = False  # also beyond its limits
    pause_s: float = Field(default=0.0, ge=0.0)
    decimals: int = Field(default=1, ge=0)  # of the numbers in its texts
    identity: Plain | None = None
    alarm: Plain = "4"
    any_case: bool = False
    answers: dict[Plain, str] = Field(default_factory=dict)  # to other texts


@dataclass(frozen=True)
class SerialLine:
    """Line settings as a controller leaves its factory."""

    baud: int
    data_bits: Literal[7, 8] = 8
    parity: Literal["N", "E", "O"] = "N"


class BoxDescription(Entry):
    """A whole box. Times in seconds, temperatures in °C; what a box does not have is left out."""

    name: Plain
    title: str = ""
    verified: Plain  # what was seen on a real one, and what was not
    line: SerialLine = SerialLine(9600)
    modbus: ModbusSection | None = None
    address: Annotated[int, Field(ge=0, le=255)] = 1  # in its texts; that of Modbus stands in its section
    simulated: SimulatedSection = SimulatedSection()
    terminator: Literal["CR", "LF", "CR LF"] = "CR LF"
    reply_terminator: Literal["CR", "LF", "CR LF"] | None = None
    frame: Frame | None = None
    silence_s: PositiveFloat | None = None  # a text is over when nothing has come for so long
    timeout_s: PositiveFloat = 2.0
    late_s: float = Field(default=3.0, ge=0.0)
    pause_after_question_s: float = Field(default=0.1, ge=0.0)
    pause_after_setting_s: float = Field(default=0.5, ge=0.0)
    resolution_degC: float = Field(default=0.1, ge=0.1, le=1.0)
    limits_are: Literal["setpoint", "alarm"] = "setpoint"
    encoding: Literal["ascii", "latin-1"] = "ascii"
    refused: Reply | None = None  # what it answers where it will not
    refusals: dict[Word, Plain] = Field(default_factory=dict)  # what its codes mean
    asked: tuple[Looked, ...] = ("alarms", "temperature", "setpoint", "state", "low_limit", "high_limit", "unit")
    identify: Identity
    believe: Several[Requirement] = ()
    unit: UnitQuestion | None = None
    temperature: Number
    setpoint: Quantity
    low_limit: Quantity | None = None
    high_limit: Quantity | None = None
    state: Several[StateQuestion] = ()
    start: Several[Command] = ()
    stop: Several[Command] = ()
    standby: Several[Command] = ()
    end_program: Several[Command] = ()
    alarms: Several[AlarmQuestion] = ()
    variants: dict[Plain, dict[str, Any]] = Field(default_factory=dict)  # what is otherwise for some models
    messages: Messages | None = None
    ramp_degC_per_min: Several[Ramp] = ()  # up and down, where these are two
    dead_man_s: Quantity | None = None

    @property
    def framings(self) -> Framings:
        """What stands around its texts."""
        if self.frame:
            return Framings(self.frame.of(self.frame.asked), self.frame.of(self.frame.told), self.frame, self.encoding)
        if self.silence_s:
            silence = Silence(self.silence_s)
            return Framings(silence, silence, silence, self.encoding)
        reply = _TERMINATORS[self.reply_terminator or self.terminator]
        return lines(_TERMINATORS[self.terminator], reply, self.encoding)

    @property
    def timing(self) -> Timing:
        """How it wants to be spoken to."""
        return Timing(self.timeout_s, self.pause_after_question_s, self.pause_after_setting_s, self.late_s)

    @property
    def looked_at(self) -> list[Question]:
        """All that is asked at every look, in this order."""
        return [*self.believe, *(each for key in self.asked for each in self._entries(key))]

    def _entries(self, key: str) -> tuple[Any, ...]:
        entries = getattr(self, key)
        return entries if isinstance(entries, tuple) else () if entries is None else (entries,)

    @cached_property
    def named(self) -> tuple[tuple[str, Question | Command], ...]:
        """Everything that is asked or told, with its key."""
        entries = ((key, entry) for key in type(self).model_fields for entry in self._entries(key))
        entries = ((key, each) for key, entry in entries for each in (entry, *getattr(entry, "also", ())))
        return tuple((key, entry) for key, entry in entries if isinstance(entry, Question | Command))

    @model_validator(mode="after")
    def _hangs_together(self) -> Self:
        if (self.low_limit is None) != (self.high_limit is None):
            raise ValueError("give low_limit and high_limit, or neither")
        usual: set[str] = {key for key in type(self).model_fields["asked"].default if self._entries(key)}
        if usual - {"unit"} - set(self.asked) or len(set(self.asked)) < len(self.asked):
            raise ValueError("asked: name everything once; only the unit may be left to who is identified")
        if len({bool(self.state), bool(self.start), bool(self.stop)}) > 1:
            raise ValueError("give state, start and stop; or none of them where it cannot be switched over the line")
        if self.state:
            modes = {mode for each in self.state for mode in (*each.modes.values(), each.otherwise)}
            if not {"CONSTANT", "OFF"} <= modes:
                raise ValueError("state: modes must give a word for CONSTANT and one for OFF")
        if self.start and self.start == self.stop:
            raise ValueError("start: it tells what stop tells; what switches a box on is not what switches it off")
        if self.modbus is not None and "address" in self.model_fields_set:
            raise ValueError("address: a box with a section modbus has it there")
        if self.modbus is not None:
            self._numbers_lie_apart(self.modbus)
        for key, entry in self.named:
            if self.modbus is not None and (getattr(entry, "ask", None) or getattr(entry, "send", None)):
                raise ValueError(f"{key}: a box with a section modbus has registers and no texts")
            if entry.address is not None and self.modbus is None:
                raise ValueError(f"{key}: a box with registers needs a section modbus; modbus: {{}} is one")
        return self

    def _numbers_lie_apart(self, modbus: ModbusSection) -> None:
        """Raise `ValueError` where two numbers share a register, one stands in a coil, or all bits were alarms."""
        others = {(each.table, each.address) for _, each in self.named if isinstance(each, StateQuestion | Requirement)}
        for alarm in self.alarms:
            if alarm.bits is not None and (alarm.table, alarm.address) in others:
                raise ValueError(f"alarms: register {alarm.address} tells the state too; give each alarm its own bit")
        told: dict[tuple[str, int], str] = {}
        for key, entry in self.named:
            if not entry.numeric or entry.address is None:
                continue
            if entry.table in ("coil", "discrete"):
                raise ValueError(f"{key}: a {entry.table} holds a bit and no number")
            for register in range(entry.address, entry.address + modbus.width(entry)):
                other = told.setdefault((entry.table, register), key)
                if other != key:
                    raise ValueError(f"{key}: register {register} belongs to {other}; two numbers cannot share one")


def load_box(path: str | Path, **otherwise: Any) -> BoxDescription:
    """Read a description, with what a bench file says otherwise (see `parse_box`); `InputError` in a sentence."""
    return parse_box(read_text(path), str(path), **otherwise)


@cache
def parse_box(
    text: str,
    source: str,
    variant: str | None = None,
    terminator: bytes | None = None,
    address: int | None = None,
    framing: str | None = None,
) -> BoxDescription:
    """Read a description from YAML text, as one of its `variants`, with another terminator, address or framing.

    `source` names it in messages. Raises `InputError` in a sentence.
    """
    document = parse_yaml(text, source)
    if variant is not None:
        document |= document.get("variants", {}).get(variant, {})
    if terminator is not None:
        document["terminator"] = {end: name for name, end in _TERMINATORS.items()}[terminator]
    registers = document.get("modbus")
    if framing is not None and isinstance(registers, dict):
        registers["framing"] = framing
    if address is not None:
        (registers if isinstance(registers, dict) else document)["address"] = address
    try:
        said = addressed_to(document, document.get("address", 1))
        if address is not None and registers is None and said == document:
            raise InputError(f"{source}: there is no {{address}} in its texts; leave address out of the bench file")
        return BoxDescription.model_validate(said)
    except ValidationError as error:
        raise InputError(f"{source}: {first_mistake(error, document)}") from error
    except ValueError as error:
        raise InputError(f"{source}: address: {error}") from error
