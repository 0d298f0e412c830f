"""Steps, numbers and durations as a technician would say them."""

import re
from collections.abc import Iterable, Sequence
from typing import TypeVar

from procedures.plan import Step, StepKind

_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
_STEPS = {
    StepKind.IDENTIFY: "checking who is connected",
    StepKind.SETPOINT: "chamber to {0.temperature_degC:.1f} °C",
    StepKind.RESTABILISE: "self-calibration {0.self_calibration}: restabilising{where}",
    StepKind.INDEX: "self-calibration {0.self_calibration}: indexing to position {0.position}",
    StepKind.COLLECT: "self-calibration {0.self_calibration}: Collect {0.position}{where}",
    StepKind.SAFE_STATE: "bringing the chamber to its safe state",
}
_STEERS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""Control characters but tab and newline, and what turns the direction of writing."""
_Thing = TypeVar("_Thing")
_MOST, _SHOWN = 12, 5  # numbers in a row: if there are more, so many of them are shown


def step_in_words(step: Step) -> str:
    """Say what a step does, as a technician would."""
    where = "" if step.temperature_degC is None else f" at {step.temperature_degC:.1f} °C"
    return _STEPS[step.kind].format(step, where=where) + (f", unit {step.unit}" if step.unit else "")


def hours_minutes(seconds: float) -> str:
    """Write a duration as people say it.

    >>> hours_minutes(45), hours_minutes(720), hours_minutes(11_100)
    ('45 s', '12 min', '3 h 05 min')
    """
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02d} min"


def duration(seconds: float) -> str:
    """Write a time that was calculated to three digits, in the unit a person would use: 34.1 s, 12.5 min, 3.08 h."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"


def unit_in_words(unit: str) -> str:
    """Return a unit as it is printed behind a number: what has none is a ratio, not 1."""
    return "ratio" if unit == "1" else unit.replace("degC", "°C").replace("^2", "²")


def significant(value: float, digits: int = 2) -> str:
    """Write a number to so many digits, without a power of ten below a million.

    >>> significant(112.3), significant(0.01234), significant(1730.4, 3)
    ('110', '0.012', '1730')
    """
    return f"{float(f'{value:.{digits}g}'):g}"


def spelled(number: int) -> str:
    """Write a small number as a word: no, one, two … twelve, 13."""
    return _NUMBERS[number] if number < len(_NUMBERS) else str(number)


def counted(number: int, noun: str) -> str:
    """Write how many there are: 1 run, 3 runs, 0 runs."""
    return f"{number} {plural(noun, number)}"


def plural(noun: str, number: int) -> str:
    """Return the noun as it stands behind a number."""
    return noun if number == 1 else f"{noun}s"


def ranges(numbers: Iterable[int], to: str = "–") -> str:
    """Write whole numbers as people do: 1–3, 7, 9–10. Without a `to` each stands by itself; of many the first and last.

    >>> ranges(range(1, 100, 2))
    '1, 3, 5, 7, 9, … 99 (50 of them)'
    """
    parts: list[list[int]] = []
    numbers = sorted(set(numbers))
    for each in numbers:
        if to and parts and each == parts[-1][-1] + 1:
            parts[-1][1:] = [each]
        else:
            parts.append([each])
    written = [f"{part[0]}{to}{part[-1]}" if len(part) > 1 else str(part[0]) for part in parts]
    if len(written) <= _MOST:
        return ", ".join(written)
    return f"{', '.join(written[:_SHOWN])}, … {written[-1]} ({len(numbers)} of them)"


def numbered(noun: str, numbers: Iterable[int], to: str = "–") -> str:
    """Name things by their numbers: run 4, runs 1–3, 7."""
    found = set(numbers)
    return f"{plural(noun, len(found))} {ranges(found, to)}"


def choice(numbers: Iterable[object]) -> str:
    """Write which numbers there are to choose from: all, or where they are many the first ones and the last."""
    found = [str(each) for each in numbers]
    return ", ".join(found if len(found) <= _MOST else [*found[:_SHOWN], "…", found[-1]])


def first_few(things: Sequence[_Thing], most: int) -> tuple[Sequence[_Thing], int]:
    """Return the first of things and how many are left: never one, which is told as fast as that there is one more.

    >>> first_few("abcd", 3), first_few("abcde", 3)
    (('abcd', 0), ('abc', 2))
    """
    shown = things if len(things) <= most + 1 else things[:most]
    return shown, len(things) - len(shown)


def listed(names: Iterable[object], most: int | None = None) -> str:
    """Write names one after another: A, B and C; of many the first, at `most` so many: A, B and 7 more."""
    found = [str(name) for name in names]
    shown, left = first_few(found, len(found) if most is None else most)
    *before, last = [*shown, f"{left} more"] if left else shown
    return f"{', '.join(before)} and {last}" if before else last


def percent(share: float) -> str:
    """Write a share: 50 %, and with a decimal where it is nearly all or nearly nothing, 99.5 %."""
    if 0.0 < share < 0.0005:
        return "below 0.1 %"
    return f"{100.0 * share:.0f} %" if 0.01 <= share <= 0.99 else f"{round(100.0 * share, 1) + 0.0:.1f} %"


def harmless(text: str) -> str:
    """Return `text` without what would steer a terminal or turn a line: a title may come from somebody else's file."""
    return _STEERS.sub("\N{REPLACEMENT CHARACTER}", text)
