"""Quantities become plain floats, and what is not the quantity asked for is refused in a sentence."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.files.units import (
    ACCELERATION,
    ANGLE,
    BIAS_SLOPE,
    DIFFERENCE,
    DRIFT,
    FREQUENCY,
    RANDOM_WALK,
    RATE,
    SLOPE,
    TEMPERATURE,
    TIME,
    VOLTAGE,
    Kind,
    to_number,
)


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("45 min", TIME, 2700.0),
        ("1.5h", TIME, 5400.0),
        ("250 ms", TIME, 0.25),
        ("-21.5 degF", TEMPERATURE, (-21.5 - 32.0) / 1.8),
        ("20 degC", TEMPERATURE, 20.0),
        ("20 °C", TEMPERATURE, 20.0),
        ("−40 °F", TEMPERATURE, -40.0),
        ("293.15 K", TEMPERATURE, 20.0),
        ("0.5 degC", DIFFERENCE, 0.5),
        ("0.9 degF", DIFFERENCE, 0.5),
        ("0.5 delta_degC", DIFFERENCE, 0.5),
        ("0.5 K", DIFFERENCE, 0.5),
        ("3 degC/min", SLOPE, 3.0),
        ("5.4 degF/min", SLOPE, 3.0),
        ("3 delta_degC/min", SLOPE, 3.0),
        ("180 K/h", SLOPE, 3.0),
        ("34.6 deg", ANGLE, 34.6),
        ("-0.016 g", ACCELERATION, -0.016),
        ("-16 mg", ACCELERATION, -0.016),
        ("9.80665 m/s^2", ACCELERATION, 1.0),
        ("30 deg/hr", RATE, 30.0),
        ("10 deg/hr/min", DRIFT, 10.0),
        ("1.6 deg/hr/degC", BIAS_SLOPE, 1.6),
        ("0.9 deg/hr/degF", BIAS_SLOPE, 1.62),
        ("0.12 deg/sqrt(hr)", RANDOM_WALK, 0.12),
        ("0.12 deg/hr**0.5", RANDOM_WALK, 0.12),
        ("28 V", VOLTAGE, 28.0),
        ("0.125 kHz", FREQUENCY, 125.0),
    ],
)
def test_a_quantity_becomes_a_float_in_the_inner_unit(text: str, kind: Kind, value: float) -> None:
    """Temperatures keep their zero point; differences and slopes have none."""
    assert to_number(text, kind) == pytest.approx(value, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("given_", "kind", "message"),
    [
        ("45 kg", TIME, "'45 kg' is not a time; write it like 45 min"),
        (45, TIME, "45 has no unit; write a time with its unit, such as 45 min"),
        ("45", TIME, "'45' has no unit"),
        ("soon", TIME, "'soon' is not a time; write a number and a unit"),
        ("45 minuets", TIME, "'minuets' is not a unit that is known here"),
        ("45 min; 3", TIME, "is not a unit that is known here"),
        ("1 h 30 min", TIME, "is not a time"),
        ("-5 min", TIME, "a time is at least 0 s"),
        ("1e999 s", TIME, "too large a number"),
        (None, TIME, "None is not a time"),
        (True, TIME, "True is not a time"),
        (["45 min"], TIME, "is not a time"),
        ("20 min", TEMPERATURE, "'20 min' is not a temperature; write it like -21.5 degF or 20 degC"),
        ("3 delta_degC", TEMPERATURE, "is not a temperature"),
        ("3 degC/min", TEMPERATURE, "is not a temperature"),
        ("-500 degF", TEMPERATURE, "a temperature is at least -273.15 °C"),
        ("3 degC", SLOPE, "is not a rate of temperature change; write it like 3 degC/min"),
        ("-1 degC", DIFFERENCE, "a temperature difference is at least 0 °C"),
        ("3 kg", ACCELERATION, "'3 kg' is not an acceleration"),
    ],
)
def test_what_is_not_the_quantity_is_refused_in_a_sentence(given_: object, kind: Kind, message: str) -> None:
    """The sentence repeats what was written and shows how to write it."""
    with pytest.raises(ValueError, match=re.escape(message)):
        to_number(given_, kind)


@given(st.floats(-100.0, 500.0))
def test_fahrenheit_and_celsius_agree(degC: float) -> None:
    """The same temperature in either unit is the same number inside."""
    assert to_number(f"{degC * 1.8 + 32.0!r} degF", TEMPERATURE) == pytest.approx(degC, abs=1e-9)


@given(st.floats(0.0, 500.0))
def test_a_difference_of_temperatures_is_their_difference(degC: float) -> None:
    """A difference in °F is 5/9 of its number, without the 32."""
    assert to_number(f"{degC * 1.8!r} degF", DIFFERENCE) == pytest.approx(degC, abs=1e-9)
