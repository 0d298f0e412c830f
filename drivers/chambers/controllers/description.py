"""A chamber that nobody has written a driver for, described in a file: what is sent, and what comes back.

    >>> box = load_box("configs/chambers/temptronic-ats.yaml")
    >>> box.setpoint.request(25.0)
    'SETP 25.0'
    >>> box.temperature.value("23.4")
    '23.4'

Texts are templates. In what is sent `{value}` stands for a number and says how it is written: `SETP {value:.1f}`. In
what comes back `{value}` stands for what is looked for and `{any}` for what does not matter: `T={value}C{any}`; a
value directly before `{any}` ends with its word. A
setting with `confirm` is answered with that text; one without is not answered. Settings are read back in either case.
"""

import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PositiveFloat, ValidationError, model_validator

from drivers.errors import InputError
from drivers.given_file import read_text
from drivers.strict_yaml import first_mistake, parse_yaml

_PLACE = re.compile(r"\{(value(?::[^{}]*)?|any)\}")
_PROBES = (-29.7, 0.0, 25.0, 104.0)


def _reply_pattern(template: str) -> re.Pattern[str]:
    pattern = "".join(
        re.escape(text) if place % 2 == 0 else "(?P<value>.+?)" if text == "value" else ".*"
        for place, text in enumerate(_PLACE.split(template))
    )
    # Where nothing written ends the value, it ends with the word: else it would be the first character alone.
    return re.compile(pattern.replace("(?P<value>.+?).*", r"(?P<value>[^\s,;]+).*"))


def _reply(template: str) -> str:
    if [name for name in _PLACE.findall(template) if name != "any"] != ["value"]:
        raise ValueError(f"{template!r} must hold {{value}} once, where the answer stands")
    return template


def _order(template: str) -> str:
    """Check a template that carries a temperature: it must write and give back what it was given."""
    names = _PLACE.findall(template)
    if len(names) != 1 or not names[0].startswith("value"):
        raise ValueError(f"{template!r} must hold {{value}} once, as in 'SETP {{value:.1f}}'")
    begin, end = _PLACE.search(template).span()  # type: ignore[union-attr]
    for probe in _PROBES:
        try:
            written = template[begin:end].format(value=probe)
            wrong = abs(float(written) - probe) > 0.051
        except (ValueError, TypeError) as error:
            raise ValueError(f"{template!r} cannot write {probe}: {error}") from None
        if wrong:
            raise ValueError(f"{template!r} writes {written!r} for {probe}; it must keep at least one decimal")
    return template


Order = Annotated[str, AfterValidator(_order)]
Reply = Annotated[str, AfterValidator(_reply)]
Plain = Annotated[str, Field(min_length=1)]


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Question(_Entry):
    """Something that can be asked."""

    ask: Plain
    reply: Reply

    def value(self, line: str) -> str | None:
        """Return what stands for the value in a line, None where the line is no such reply."""
        found = _reply_pattern(self.reply).fullmatch(line)
        return None if found is None else found["value"].strip()

    def answer(self, value: str) -> str:
        """Return the line that says `value`, as a simulator sends it."""
        return _PLACE.sub(lambda place: value if place[1] == "value" else "", self.reply)


class Command(_Entry):
    """Something that can be told."""

    send: Plain
    confirm: str | None = None


class Quantity(Question):
    """A number that can be asked and set."""

    send: Order
    confirm: str | None = None

    def request(self, value: float) -> str:
        """Return what sets the value."""
        return _PLACE.sub(lambda place: f"{{{place[1]}}}".format(value=value), self.send)

    def taken(self, request: str) -> float | None:
        """Return the number in a request of this form, None where it is another: for simulators."""
        head, _, tail = _PLACE.split(self.send)
        found = re.fullmatch(re.escape(head) + r"\s*([-+]?\d+(?:\.\d*)?)\s*" + re.escape(tail), request)
        return None if found is None else float(found[1])


class Identity(Question):
    """Who answers. `expect` is how the model must begin."""

    expect: str = ""


class UnitQuestion(Question):
    """The unit, with the words for °C and °F."""

    celsius: Plain
    fahrenheit: Plain


class StateQuestion(Question):
    """What the box is doing: its word for each mode."""

    modes: dict[str, Literal["OFF", "STANDBY", "CONSTANT", "RUN"]]

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if not {"CONSTANT", "OFF"} <= set(self.modes.values()):
            raise ValueError("modes must give a word for CONSTANT and one for OFF")
        return self


class AlarmQuestion(Question):
    """Alarms: the words that mean that there is none."""

    none: list[str] = Field(min_length=1)


class BoxDescription(_Entry):
    """A whole box. Times in seconds, temperatures in °C; what a box does not have is left out."""

    name: Plain
    title: str = ""
    verified: Plain  # what was seen on a real one, and what was not
    terminator: Literal["CR", "LF", "CR LF"] = "CR LF"
    reply_terminator: Literal["CR", "LF", "CR LF"] | None = None
    timeout_s: PositiveFloat = 2.0
    pause_after_question_s: float = Field(default=0.1, ge=0.0)
    pause_after_setting_s: float = Field(default=0.5, ge=0.0)
    resolution_degC: float = Field(default=0.1, ge=0.1, le=1.0)
    limits_are: Literal["setpoint", "alarm"] = "setpoint"
    identify: Identity
    unit: UnitQuestion | None = None
    temperature: Question
    setpoint: Quantity
    low_limit: Quantity | None = None
    high_limit: Quantity | None = None
    state: StateQuestion
    start: Command
    stop: Command
    standby: Command | None = None
    end_program: Command | None = None
    alarms: AlarmQuestion
    ramp_degC_per_min: Quantity | None = None
    dead_man_s: Quantity | None = None

    @model_validator(mode="after")
    def _both_limits_or_none(self) -> Self:
        if (self.low_limit is None) != (self.high_limit is None):
            raise ValueError("give low_limit and high_limit, or neither")
        return self


def load_box(path: str | Path) -> BoxDescription:
    """Read a description; raise `InputError` in one sentence that names the file and the key."""
    return parse_box(read_text(path), str(path))


def parse_box(text: str, source: str) -> BoxDescription:
    """Read a description from YAML text; `source` names it in messages. Raises `InputError` where it is none."""
    document = parse_yaml(text, source)
    try:
        return BoxDescription.model_validate(document)
    except ValidationError as error:
        raise InputError(f"{source}: {first_mistake(error, document)}") from error
