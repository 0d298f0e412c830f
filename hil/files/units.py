"""Quantities as people write them, turned into the project's plain floats at the boundary.

    >>> to_number("45 min", TIME)  # s
    2700.0
    >>> round(to_number("-21.5 degF", TEMPERATURE), 2)  # °C
    -29.72
    >>> to_number("0.9 degF", DIFFERENCE)  # °C: a difference has no zero point
    0.5
    >>> to_number("3 degC/min", SLOPE)  # °C/min
    3.0

A number without its unit is refused, and so is a unit of another kind: "45 kg" is no time. Only this file knows pint.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator

if TYPE_CHECKING:
    import pint


@dataclass(frozen=True)
class Kind:
    """A kind of quantity: its name in messages, the unit used inside, and examples of what is allowed."""

    name: str
    unit: str
    example: str
    is_difference: bool = False
    zero: float = -math.inf  # the smallest value that can exist


TIME = Kind("a time", "second", "45 min", zero=0.0)
TEMPERATURE = Kind("a temperature", "degC", "-21.5 degF or 20 degC", zero=-273.15)
DIFFERENCE = Kind("a temperature difference", "delta_degC", "0.5 degC", is_difference=True, zero=0.0)
SLOPE = Kind("a rate of temperature change", "delta_degC/minute", "3 degC/min", is_difference=True, zero=0.0)
ANGLE = Kind("an angle", "degree", "34.6 deg")
ACCELERATION = Kind("an acceleration", "standard_gravity", "-0.016 g")
RATE = Kind("a rotation rate", "degree/hour", "30 deg/hr")
RATE_PER_G = Kind("a drift per g", "degree/hour/standard_gravity", "4 deg/hr/g")
DRIFT = Kind("a drift of a rate", "degree/hour/minute", "10 deg/hr/min", zero=0.0)
RANDOM_WALK = Kind("an angle random walk", "degree/hour**0.5", "0.12 deg/sqrt(hr)", zero=0.0)
BIAS_SLOPE = Kind("a change of a rate with temperature", "degree/hour/delta_degC", "1.6 deg/hr/degC", True, zero=0.0)
VOLTAGE = Kind("a voltage", "volt", "28 V", zero=0.0)
FREQUENCY = Kind("a frequency", "hertz", "20 Hz", zero=0.0)

_NUMBER_AND_UNIT = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*$")
_SQUARE_ROOT = re.compile(r"sqrt\(\s*(\w+)\s*\)")
_GRAVITY = re.compile(r"(?<![A-Za-z_])(m|u|µ)?g(?![A-Za-z_])")
_POINTS = {"degree_Celsius": "delta_degree_Celsius", "degree_Fahrenheit": "delta_degree_Fahrenheit"}


@cache
def _registry() -> pint.UnitRegistry[Any]:
    import pint  # imported late, as all of it is made on first use: a command without configuration does not wait

    registry: pint.UnitRegistry[Any] = pint.UnitRegistry()
    registry.define("gee = standard_gravity")  # pint's g is the gram
    return registry


def to_number(value: object, kind: Kind) -> float:
    """Return `value` as a float in the unit of `kind`; raise `ValueError` with a sentence where it is not one."""
    match = _NUMBER_AND_UNIT.match(value.replace("−", "-")) if isinstance(value, str) else None
    if match is None:
        if isinstance(value, int | float) and not isinstance(value, bool):
            raise ValueError(f"{value} has no unit; write {kind.name} with its unit, such as {kind.example}")
        raise ValueError(f"{value!r} is not {kind.name}; write a number and a unit, such as {kind.example}")
    number, unit = float(match[1]), match[2]
    if not unit:
        raise ValueError(f"{value!r} has no unit; write {kind.name} with its unit, such as {kind.example}")
    from pint import PintError

    known = _registry()
    # A bench engineer's spelling in pint's: sqrt(hr), and g for gravity where it cannot be a gram.
    spelt = _SQUARE_ROOT.sub(r"\1**0.5", unit)
    spelt = _GRAVITY.sub(r"\1gee", spelt) if "standard_gravity" in kind.unit else spelt
    wrong = f"'{number:g} {unit}' is not {kind.name}; write it like {kind.example}"
    try:
        named = str(known.parse_units(spelt))
    except Exception as error:  # pint raises whatever its tokeniser meets: all of it means "not a unit"
        raise ValueError(f"{wrong} ({unit!r} is not a unit that is known here)") from error
    try:
        quantity = known.Quantity(number, _POINTS.get(named, named) if kind.is_difference else named).to(kind.unit)
    except PintError as error:
        raise ValueError(wrong) from error
    converted = float(quantity.magnitude)
    if not math.isfinite(converted):
        raise ValueError(f"{value!r} is too large a number; write {kind.name} like {kind.example}")
    if converted < kind.zero:
        symbol = f"{known.parse_units(kind.unit):~P}".replace("Δ", "")
        raise ValueError(f"{value!r} cannot be: {kind.name} is at least {kind.zero:g} {symbol}")
    return converted


def worth(unit: str, kind: Kind) -> float:
    """Return how much one of a column's `unit`, with a factor for counts, is in the unit of `kind`.

    >>> worth("rad/s", RATE), worth("0.05 deg/s", RATE)
    (206264.80624709636, 180.0)

    Raises `ValueError` with a sentence where it is none.
    """
    text = unit.strip()
    return to_number(text if text[:1] in "0123456789.+-−" else f"1 {text}", kind)


def _of(kind: Kind) -> BeforeValidator:
    return BeforeValidator(lambda value: to_number(value, kind))


Seconds = Annotated[float, _of(TIME)]
Celsius = Annotated[float, _of(TEMPERATURE)]
CelsiusDifference = Annotated[float, _of(DIFFERENCE)]
CelsiusPerMinute = Annotated[float, _of(SLOPE)]
Degrees = Annotated[float, _of(ANGLE)]
Gravities = Annotated[float, _of(ACCELERATION)]
DegreesPerHour = Annotated[float, _of(RATE)]
DegreesPerHourPerMinute = Annotated[float, _of(DRIFT)]
RandomWalk = Annotated[float, _of(RANDOM_WALK)]
BiasPerDegree = Annotated[float, _of(BIAS_SLOPE)]
Volts = Annotated[float, _of(VOLTAGE)]
Hertz = Annotated[float, _of(FREQUENCY)]
