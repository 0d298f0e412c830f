"""What a box is asked and told, and what its words mean: a text, or a register whose number is a word as a reply is.

    >>> ModbusSection(words="high first").number(InRegister(register=100, type="int32"), [0xFFFF, 0xFED4])
    -300

A number that is not said to be one (a state, a bit field) is unsigned and has no scale.
"""

from collections.abc import Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

from pydantic import BeforeValidator, Field, PositiveFloat, PositiveInt

from drivers.chambers.controller import Mode
from drivers.chambers.controllers.templates import Order, Reply, number_in
from drivers.strict_yaml import Section
from drivers.transports.modbus import Framing, NumberType, Table, decoded, encoded, width

Item = TypeVar("Item")
Plain = Annotated[str, Field(min_length=1)]
Word = Annotated[str, BeforeValidator(lambda it: str(it) if isinstance(it, int) and not isinstance(it, bool) else it)]
Several = Annotated[tuple[Item, ...], BeforeValidator(lambda it: it if isinstance(it, list | tuple) else [it])]


def _registers(given: object) -> object:
    first, _, last = str(given).partition("-")
    if not (first.isdecimal() and (last or first).isdecimal() and int(first) <= int(last or first) <= 0xFFFF):
        raise ValueError(f"{given!r} must be a register, such as 300, or registers, such as 100-106")
    return int(first), int(last or first)


Address = Annotated[int, Field(ge=0, le=0xFFFF)]
Registers = Annotated[tuple[int, int], BeforeValidator(_registers)]


class InRegister(Section):
    """A place in a Modbus controller: `type` and `scale` are the box's own where they are not given."""

    address: Address | None = Field(default=None, alias="register")  # a class has a method of that name
    table: Table = "holding"
    type: NumberType | None = None
    scale: PositiveFloat | None = None
    bit: Annotated[int, Field(ge=0, le=15)] | None = None
    optional: ClassVar[bool] = False
    numeric: ClassVar[bool] = False


class ModbusSection(Section):
    """How registers are spoken to: what is so of each number that does not say otherwise, and what is read together."""

    framing: Framing = "rtu"
    address: Annotated[int, Field(ge=0, le=247)] = 1
    type: NumberType = "int16"
    scale: PositiveFloat = 1.0
    decimals_register: Address | None = None
    words: Literal["low first", "high first"] = "low first"  # the factory order of Watlow and Binder
    writes: Literal["single", "several"] = "single"  # function 6 where one register holds it, or always 16
    reads: tuple[Registers, ...] = ()

    def width(self, entry: InRegister) -> int:
        """Return how many registers, or coils, hold an entry."""
        return 1 if entry.table in ("coil", "discrete") else width(self._type(entry))

    def number(self, entry: InRegister, registers: Sequence[int], decimals: int | None = None) -> float:
        """Return what an entry's registers hold, where the controller shows `decimals`: whole where nothing scales."""
        return decoded(
            registers, self._type(entry), scale=self.step(entry, decimals), low_word_first=self.words == "low first"
        )

    def registers(self, entry: InRegister, value: float, decimals: int | None = None) -> tuple[int, ...]:
        """Return the registers that hold `value`; raise `ValueError` where none can."""
        step = self.step(entry, decimals)
        return encoded(value, self._type(entry), scale=step, low_word_first=self.words == "low first")

    def step(self, entry: InRegister, decimals: int | None) -> float:
        """Return the step in which an entry is counted."""
        if entry.scale is not None or not entry.numeric:
            return entry.scale or 1.0
        return self.scale if decimals is None else 10.0**-decimals

    def _type(self, entry: InRegister) -> NumberType:
        return entry.type or (self.type if entry.numeric else "uint16")


class Question(InRegister):
    """Something that can be asked: by a text, or of a register. `length` is that of a reply that nothing ends."""

    ask: Plain | None = None
    reply: Reply = "{value}"
    length: PositiveInt | None = None
    hint: str = ""  # what to look at where it is not answered

    def _check(self) -> None:
        if (self.ask is None) == (self.address is None) and not (self.optional and self.ask is None):
            raise ValueError("say how it is asked: ask and reply, or register")

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
        try:
            return number_in(word)
        except ValueError:
            raise ValueError(f"answered {self.ask!r} with {word!r}: no number") from None


class Hottest(Question):
    """The temperature that a box says it can reach, None where it says something else instead."""

    numeric = True

    def meaning(self, word: str) -> float | None:
        with suppress(ValueError):
            return number_in(word)
        return None


class Command(InRegister):
    """Something that can be told: a text, or a value that is written to a register, a bit of it, or a coil."""

    send: Plain | None = None
    confirm: Several[str] = ()
    value: int = 1
    where: Mode | None = None  # told in this mode alone, and where nobody knows it
    may_be_refused: bool = False  # by one that does without

    def _check(self) -> None:
        if (self.send is None) == (self.address is None):
            raise ValueError("say how it is told: send, or register and value")


class Quantity(Number):
    """A number that can be asked and set. `write` are the registers it is written to, if not the one that is read."""

    send: Order | None = None
    confirm: Several[str] = ()
    then_start: bool = False  # takes effect when it is started, where it runs
    step: PositiveFloat = 0.1  # in which it is held
    write: Several[Address] = ()

    def _check(self) -> None:
        super()._check()
        if self.ask is not None and self.send is None:
            raise ValueError("send: this key is missing")

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


class Listing(Question):
    """Codes behind their number, `n,code,…`, or 0 alone; `name` is how one is reported."""

    name: Plain = "{value}"

    def meaning(self, word: str) -> tuple[str, ...]:
        count, *codes = (each.strip() for each in word.split(","))
        if not all(map(str.isdecimal, (count, *codes))) or int(count) != len(codes):
            raise ValueError(f"answered {self.ask!r} with {word!r}, which is no number and so many codes")
        return tuple(self.name.replace("{value}", each) for each in codes)


class Timer(Quantity):
    """Its own timer, s: `first` and `then` are told before and after; its `number` is among those `running`."""

    first: Several[Command] = ()
    then: Several[Command] = ()
    running: Listing | None = None
    number: Word = "0"


class Requirement(Question):
    """What must be so for anything to be believed; `otherwise` goes on where a message has named the box."""

    one_of: Several[Word] = ()
    none_of: Several[Word] = ()
    otherwise: Plain

    def meaning(self, word: str) -> str:
        if (self.one_of and word not in self.one_of) or word in self.none_of:
            raise ValueError(self.otherwise.replace("{value}", word))
        return word


class Identity(Question):
    """Who answers: how that must begin, and the model (`{value}` is the answer), alone where it cannot be asked."""

    optional = True
    expect: Word = ""
    model: Plain = "{value}"
    otherwise: Plain | None = None
    instead: Question | None = None  # gives the name where it refuses to
    hottest: Hottest | None = None  # what it says it can be, by which a unit that it cannot tell is judged
    requires: Several[Requirement] = ()

    @property
    def asks(self) -> bool:
        """Whether it can be asked."""
        return self.ask is not None or self.address is not None

    def _check(self) -> None:
        super()._check()
        if not self.asks and "{value}" in self.model:
            raise ValueError("say how it is asked: ask and reply, or register; or give its model")

    def meaning(self, word: str) -> str:
        """Return the word; a name that is asked by text has letters, a late reply to something else may have none."""
        if self.ask is not None and not (any(map(str.isalpha, word)) and word.isprintable()):
            raise ValueError(f"answered {self.ask!r} with {word!r}, which is no name")
        return word


class UnitQuestion(Question):
    """The unit, with the words for °C and °F; `*` in them stands for anything."""

    celsius: Several[Word]
    fahrenheit: Several[Word]

    def _check(self) -> None:
        super()._check()
        if both := {*self.celsius} & {*self.fahrenheit}:
            raise ValueError(f"fahrenheit: {both.pop()} means °C too; one word cannot be both")

    def meaning(self, word: str) -> str:
        for unit, words in (("degC", self.celsius), ("degF", self.fahrenheit)):
            if any(fnmatchcase(word, each) for each in words):
                return unit
        raise ValueError(f"says that its unit is {word!r}, which its description does not have")


class StateQuestion(Question):
    """What the box is doing: its word for each mode, with `*` for anything; `next` leaves it to what is asked next."""

    # YAML reads an unquoted off as false.
    modes: dict[Word, Annotated[Mode | Literal["next"], BeforeValidator(lambda it: "OFF" if it is False else it)]]
    otherwise: Mode | Literal["next"] | None = None

    def meaning(self, word: str) -> str:
        """Return the mode, or next."""
        mode = next((mode for said, mode in self.modes.items() if fnmatchcase(word, said)), self.otherwise)
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


class Messages(Section):
    """Alarms as texts in a list: the `count`, and by `{number}` the `text` of each, if all of `only` are answered 1."""

    count: Number
    text: Question
    only: Several[Number] = ()
