"""A chamber described in a file: what is sent and what comes back, or which registers it has.

    >>> box = load_box("configs/chambers/temptronic-ats.yaml")
    >>> box.setpoint.send
    'SETP {value:.1f}'

A box speaks text, or Modbus where its description has a section `modbus`. What is asked and told is in
`questions`, what text is made of in `templates`.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat, ValidationError

from drivers.chambers.controllers.questions import (
    Address,
    AlarmQuestion,
    Command,
    Identity,
    Listing,
    Messages,
    ModbusSection,
    Number,
    Plain,
    Quantity,
    Question,
    Ramp,
    Registers,
    Requirement,
    Several,
    StateQuestion,
    Timer,
    UnitQuestion,
    Word,
)
from drivers.chambers.controllers.templates import Reply, addressed_to
from drivers.errors import InputError
from drivers.given_file import read_text
from drivers.strict_yaml import Section, first_mistake, parse_yaml
from drivers.transports.framing import Frame, Framings, Silence, Terminator, lines
from drivers.transports.transport import Timing

Looked = Literal["alarms", "temperature", "setpoint", "state", "low_limit", "high_limit", "unit"]


Why = Literal["locked", "parameter", "value", "program"]


class SimulatedSection(Section):
    """What a simulator of it does besides: registers that it has, others that are the same, and how it refuses.

    `refuses` are its words where its panel is locked, a command has another parameter, a setpoint would lie beyond its
    limits, and no program runs that could end; for all else it has the first of `refusals`. `answers` are templates,
    in which {value} is the air's temperature; their fields stand before those of what is asked by the same text.
    """

    registers: dict[Registers, int] = Field(default_factory=dict)
    same: dict[Address, Address] = Field(default_factory=dict)
    silent_refusals: bool = False
    takes_any_setpoint: bool = False  # also beyond its limits
    refuses: dict[Why, Plain] = Field(default_factory=dict)
    limits: tuple[float, float] | None = None  # as it leaves its factory, °C
    limit_alarm: Plain | None = None  # where the air crosses them
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


class BoxDescription(Section):
    """A whole box. Times in seconds, temperatures in °C; what a box does not have is left out."""

    name: Plain
    title: str = ""
    verified: Plain  # what was seen on a real one, and what was not
    line: SerialLine = SerialLine(9600)
    modbus: ModbusSection | None = None
    address: Annotated[int, Field(ge=0, le=255)] = 1  # in its texts; that of Modbus stands in its section
    simulated: SimulatedSection = SimulatedSection()
    terminator: Terminator = "CR LF"
    reply_terminator: Terminator | None = None
    addressed: str = ""  # stands before every text, where the bench file gives an address
    frame: Frame | None = None
    silence_s: PositiveFloat | None = None  # a text is over when nothing has come for so long
    timeout_s: PositiveFloat = 2.0
    late_s: float = Field(default=3.0, ge=0.0)
    pause_after_question_s: float = Field(default=0.1, ge=0.0)
    pause_after_setting_s: float = Field(default=0.5, ge=0.0)
    resolution_degC: float = Field(default=0.1, ge=0.1, le=1.0)
    limits_are: Literal["setpoint", "alarm"] = "setpoint"
    encoding: Literal["ascii", "latin-1"] = "ascii"
    refused: Several[Reply] = ()  # what it answers where it will not
    refusals: dict[Word, Plain] = Field(default_factory=dict)  # what its codes mean; * stands for anything
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
    alarm_list: Listing | None = None
    ramp_degC_per_min: Several[Ramp] = ()  # up and down, where these are two
    dead_man_s: Timer | None = None

    @property
    def framings(self) -> Framings:
        """What stands around its texts."""
        if self.frame:
            return Framings(self.frame.of(self.frame.asked), self.frame.of(self.frame.told), self.frame, self.encoding)
        if self.silence_s:
            silence = Silence(self.silence_s)
            return Framings(silence, silence, silence, self.encoding)
        return lines(self.terminator, self.reply_terminator, self.encoding)

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

    def _check(self) -> None:
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
    terminator: Terminator | None = None,
    address: int | None = None,
    framing: str | None = None,
) -> BoxDescription:
    """Read a description, as one of its `variants`, with another address; `InputError`, which begins with `source`."""
    document = parse_yaml(text, source)
    if variant is not None:
        document |= document.get("variants", {}).get(variant, {})
    if terminator is not None:
        document["terminator"] = terminator
    if address is None:
        document.pop("addressed", None)
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
