"""How values are written in a description: bytes as hex digits, factors as products, names; and what is put in.

What the stream does not say (ranges, units, the rate) the bench file sets:

    parameters:
      acceleration_range:
        meaning: as ordered; datagram BC tells it
        unit: g
        choices:
          10: {acc_scale: 2^-19}
          30: {acc_scale: 2^-18}
        default: 30

A value is put in wherever the description says `${acc_scale}`; `${acceleration_range}` is the choice itself, and
`${rate}` the sample rate in Hz. A parameter without choices is a number.
"""

import math
import re
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BeforeValidator, InstanceOf

from drivers.frames.wire import ByteOrder as ByteOrder
from drivers.strict_yaml import Section

_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TERM = re.compile(rf"\s*([*/]?)\s*([+-]?)({_NUMBER})(?:\s*\^\s*([+-]?{_NUMBER}))?\s*")
_USE = re.compile(r"\$\{(\w*)\}")
ParameterValue = str | int | float | bool | None


def parse_factor(value: Any) -> Any:
    """Return the number that `value` spells: products and powers, left to right; `ValueError` where it is none."""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError("must be a number, or a product of numbers and powers such as 3600*2^-14")
    result = _product(value) if isinstance(value, str) else float(value)
    if not math.isfinite(result):
        raise ValueError(f"{value!r} is not a finite number")
    return result


def _product(text: str) -> float:
    result, at = 1.0, 0
    while at < len(text):
        term = _TERM.match(text, at)
        if term is None or bool(term[1]) == (at == 0):
            raise ValueError(f"{text!r} is not a number, nor a product of numbers and powers such as 3600*2^-14")
        try:
            factor = math.copysign(float(term[3]) ** float(term[4] or 1.0), -1.0 if term[2] == "-" else 1.0)
            result = result / factor if term[1] == "/" else result * factor
        except ArithmeticError:
            raise ValueError(f"{text!r} cannot be computed") from None
        at = term.end()
    if at == 0:
        raise ValueError("is empty; give a number")
    return result


def _parse_bytes(value: Any) -> Any:
    """Read `FE 81 FF 55` as bytes."""
    if isinstance(value, bytes):
        return value
    if isinstance(value, int) and not isinstance(value, bool):
        raise ValueError(f"write bytes as quoted hex digits, two per byte, not as the number {value}")
    if not isinstance(value, str):
        raise ValueError("bytes are written as hex digits, two per byte: FE 81 FF 55")
    try:
        return bytes.fromhex(value)
    except ValueError:
        raise ValueError(f"{value!r} are not hex digits, two per byte") from None


def _parse_whole(value: Any) -> Any:
    """Read `2000/125` as 16; what is no whole number is refused."""
    number = parse_factor(value)
    if number != round(number):
        raise ValueError(f"{value!r} is {number:g}, not a whole number")
    return round(number)


def _identifier(value: str) -> str:
    if not value.isidentifier():
        raise ValueError(f"{value!r} is not a name (letters, digits and _)")
    return value


HexBytes = Annotated[bytes, BeforeValidator(_parse_bytes)]
Factor = Annotated[float, BeforeValidator(parse_factor)]
WholeNumber = Annotated[int, BeforeValidator(_parse_whole)]
Name = Annotated[str, AfterValidator(_identifier)]


class Header(bytes):
    """The bytes with which a frame begins, `told` one by one: None where any byte may stand (here 0)."""

    told: tuple[int | None, ...]
    pattern: bytes
    """What matches them, as a regular expression, and `begun` what matches all but the last, or fewer."""
    begun: bytes

    def __new__(cls, told: Iterable[int | None]) -> Self:
        told = tuple(told)
        header = super().__new__(cls, (byte or 0 for byte in told))
        parts = [b"." if byte is None else re.escape(bytes([byte])) for byte in told]
        header.told, header.pattern, header.begun = told, b"".join(parts), b""
        for part in reversed(parts[:-1]):
            header.begun = part + (b"(?:" + header.begun + b")?" if header.begun else b"")
        return header

    def __str__(self) -> str:
        return " ".join("xx" if byte is None else f"{byte:02X}" for byte in self.told)


def _parse_header(value: Any) -> Any:
    """Read `91`, or `xx xx 91` where any bytes may stand before the last."""
    if isinstance(value, Header):
        return value
    known = _parse_bytes(value.replace("xx", "00") if isinstance(value, str) else value)
    marks = "".join(value.split()) if isinstance(value, str) else ""
    return Header(None if marks[2 * at : 2 * at + 2] == "xx" else byte for at, byte in enumerate(known))


HexHeader = Annotated[InstanceOf[Header], BeforeValidator(_parse_header)]


class ParameterDescription(Section):
    """One parameter: what it means, what it can be, and what it is where nobody says."""

    meaning: str
    unit: str = ""
    choices: dict[str | int | float | bool, dict[Name, ParameterValue]] | None = None
    default: str | int | float | bool

    def _check(self) -> None:
        self.chosen(self.default, "default")
        if self.choices is not None and len({frozenset(names) for names in self.choices.values()}) > 1:
            raise ValueError("choices: every choice gives values to the same names")

    def chosen(self, value: object, key: str) -> tuple[ParameterValue, Mapping[str, ParameterValue]]:
        """Return the choice and the values that come with it; raise `ValueError` where it is none."""
        text = str(value).strip()
        if self.unit and text.endswith(self.unit):
            text = text[: -len(self.unit)].strip()
        if self.choices is None:
            try:
                return parse_factor(text), {}
            except ValueError:
                raise ValueError(f"{key}: {value!r} is not a number{f' of {self.unit}' if self.unit else ''}") from None
        for choice, values in self.choices.items():
            if str(choice).lower() == text.lower() or _same_number(choice, text):
                return choice, values
        raise ValueError(f"{key}: {value!r} is none of {', '.join(map(str, self.choices))}")


def _same_number(choice: object, text: str) -> bool:
    try:
        return not isinstance(choice, bool) and float(str(choice)) == float(text)
    except ValueError:
        return False


def values_of(
    parameters: Mapping[str, ParameterDescription], given: Mapping[str, object], rate_hz: object
) -> dict[str, ParameterValue]:
    """Return every name that the description may use, with its value; raise `ValueError` naming what is wrong."""
    unknown = next((name for name in given if name not in parameters), None)
    if unknown is not None:
        known = ", ".join(parameters) or "none"
        raise ValueError(f"parameters.{unknown}: there is no such parameter; there are: {known}")
    values: dict[str, ParameterValue] = {"rate": rate_hz}  # type: ignore[dict-item]
    for name, parameter in parameters.items():
        choice, others = parameter.chosen(given.get(name, parameter.default), f"parameters.{name}")
        for key, value in {name: choice, **others}.items():
            if key in values:
                raise ValueError(f"parameters.{name}: the name {key!r} is used twice")
            values[key] = put_in(value, values, f"parameters.{name}.choices")
    return values


def put_in(content: Any, values: Mapping[str, ParameterValue], place: str = "") -> Any:
    """Return `content` with every `${name}` replaced; raise `ValueError` naming the key of one that does not exist."""
    if isinstance(content, dict):
        return {key: put_in(value, values, f"{place}.{key}" if place else str(key)) for key, value in content.items()}
    if isinstance(content, list):
        return [put_in(value, values, f"{place}.{number}") for number, value in enumerate(content)]
    if not isinstance(content, str) or "${" not in content:
        return content

    def value(use: re.Match[str]) -> ParameterValue:
        if use[1] not in values:
            raise ValueError(f"{place}: {use[0]} is not a parameter; there are: {', '.join(values)}")
        return values[use[1]]

    whole = _USE.fullmatch(content)
    return value(whole) if whole else _USE.sub(lambda use: _as_factor(value(use)), content)


def _as_factor(value: ParameterValue) -> str:
    """Write a value so that it can stand in a product: 2^-18 as the number that it is."""
    try:
        return repr(parse_factor(value))
    except ValueError:
        return str(value)
