"""What the stream does not say and the bench file sets: ranges, units, the rate.

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

import re
from collections.abc import Mapping
from typing import Any, Self

from pydantic import model_validator

from drivers.frames.notation import Name, parse_factor
from drivers.strict_yaml import Section

ParameterValue = str | int | float | bool | None
_USE = re.compile(r"\$\{(\w*)\}")


class ParameterDescription(Section):
    """One parameter: what it means, what it can be, and what it is where nobody says."""

    meaning: str
    unit: str = ""
    choices: dict[str | int | float | bool, dict[Name, ParameterValue]] | None = None
    default: str | int | float | bool

    @model_validator(mode="after")
    def _default_is_possible(self) -> Self:
        self.chosen(self.default, "default")
        if self.choices is not None and len({frozenset(names) for names in self.choices.values()}) > 1:
            raise ValueError("choices: every choice gives values to the same names")
        return self

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
