"""Where something stands in a Modbus controller, as a description says it: its register, type, scale and bit.

    >>> ModbusSection(words="high first").number(InRegister(register=100, type="int32"), [0xFFFF, 0xFED4])
    -300

A number that is not said to be one (a state, a bit field) is unsigned and has no scale.
"""

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, TypeVar

from pydantic import BeforeValidator, Field, PositiveFloat

from drivers.strict_yaml import Section
from drivers.transports.modbus import Framing, NumberType, Table, decoded, encoded, width


def off_is_a_word(given: object) -> object:
    """Return what is meant by an unquoted OFF."""
    return "OFF" if given is False else given  # YAML reads an unquoted off as false


Item = TypeVar("Item")
Plain = Annotated[str, Field(min_length=1)]
Word = Annotated[str, BeforeValidator(lambda it: str(it) if isinstance(it, int) and not isinstance(it, bool) else it)]
Several = Annotated[tuple[Item, ...], BeforeValidator(lambda it: it if isinstance(it, list | tuple) else [it])]


def _registers(given: object) -> object:
    """Return the first and the last of what is written as 300 or 100-106."""
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
