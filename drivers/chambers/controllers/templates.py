r"""Texts with places in them, of which a box that speaks text is described.

    >>> filled("SETP {value:.1f}", value=25.0)
    'SETP 25.0'
    >>> found_in("T={value}C{any}", "T=23.04C stable")
    '23.04'

In what is sent `{value}` stands for a number and says how it is written; `{setpoint:05.1f}` is the setpoint that the
box holds, `{mode}` its word for its state. In what comes back `{value}` stands for what is looked for and `{any}` for
what does not matter: `T={value}C{any}`; a value directly before `{any}` ends with its word. `{value:5}` and `{any:2}`
are as many characters, `{field}` is what matters as little up to the next comma; `{code}` is a value that is a whole
number, `{decimal}` one that has a decimal point, `{hex}` one of hexadecimal digits, `{value:h:m}` in a setting is a
time in hours and minutes. `{address:02d}` is the address, `{group}` and `{unit}` its two digits.
"""

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator

from drivers.errors import worded

PLACE = re.compile(r"\{((?:value|setpoint)(?::[^{}]*)?|any(?::\d+)?|field|mode|code|decimal|hex)\}")
_ADDRESS = re.compile(r"\{((?:address|group|unit)(?::[^{}]*)?)\}")
_NUMBER = r"\s*(?P<{}>[-+]?\d+(?:\.\d*)?)\s*"
_DECIMAL = r"(?P<value>[-+]?\d+\.\d*)"
_OPEN = {"any": ".*", "field": "[^,]*"}
_TIME = "value:h:m"
_PROBES = (-29.7, 0.0, 25.0, 104.0)


def addressed_to(given: Any, address: Any) -> Any:
    """Return texts, and those in mappings and lists, with an address in its places, as they are where it is none."""
    if not isinstance(address, int):
        return given
    if isinstance(given, Mapping):
        return {key: addressed_to(each, address) for key, each in given.items()}
    if isinstance(given, list):
        return [addressed_to(each, address) for each in given]
    values = {"address": address, "group": address // 10, "unit": address % 10}
    return _ADDRESS.sub(lambda place: f"{{{place[1]}}}".format(**values), given) if isinstance(given, str) else given


def filled(template: str, **values: Any) -> str:
    """Return what is sent: the template with values in its places."""

    def written(place: re.Match[str]) -> str:
        if place[1] == _TIME:
            return "{}:{}".format(*divmod(round(values["value"] / 60.0), 60))
        return f"{{{place[1]}}}".format(**{**dict.fromkeys(_OPEN, ""), **values})

    return PLACE.sub(written, template)


def number_in(word: str) -> float:
    """Return the number that a word is, s where it is hours and minutes (1:30); `ValueError` where it is none.

    A word without letters and digits is what a panel shows for a sensor that is missing: not a number.
    """
    hours, is_time, minutes = word.rpartition(":")
    if is_time:
        return 3600.0 * int(hours) + 60.0 * int(minutes)
    return math.nan if word and not any(map(str.isalnum, word)) else float(word)


def taken_from(template: str, request: str) -> dict[str, str] | None:
    """Return what stands in the places of a request, None where it is another: for simulators."""
    found = re.fullmatch(_pattern(template, {"mode": "(?P<mode>.+)"}, _NUMBER), request)
    return None if found is None else found.groupdict()


def found_in(template: str, line: str) -> str | None:
    """Return what stands for the value in a reply, None where it is no such reply."""
    numbers = {"code": r"(?P<value>\d+)", "decimal": _DECIMAL, "hex": "(?P<value>[0-9A-Fa-f]+)"}
    pattern = _pattern(template, {**_OPEN, "value": "(?P<value>.+?)", **numbers}, "")
    # Where nothing written ends the value, it ends with the word: else it would be the first character alone.
    found = re.fullmatch(pattern.replace("(?P<value>.+?).*", r"(?P<value>[^\s,;]+).*"), line, re.DOTALL)
    if found is None:
        return None
    return str(int(found["value"], 16)) if "{hex}" in template else found["value"].strip()


def agrees(template: str, line: str) -> bool:
    """Tell whether a reply is of this form; it need not hold a value."""
    return re.fullmatch(_pattern(template, _OPEN, ""), line, re.DOTALL) is not None


def reply_with(template: str, value: str) -> str:
    """Return the reply that says `value`, as a simulator sends it."""

    def said(place: re.Match[str]) -> str:
        name, _, size = place[1].partition(":")
        word = "" if name in _OPEN else f"{int(value):04X}" if name == "hex" else value
        return word.rjust(int(size or 0))

    return PLACE.sub(said, template)


def _pattern(template: str, named: dict[str, str], number: str) -> str:
    def of(place: str) -> str:
        name, _, size = place.partition(":")
        if place == _TIME:
            return r"(?P<value>\d+:[0-5]?\d)"
        if name in named:
            return named[name] if not size else f"(?P<value>.{{{size}}})" if name == "value" else f".{{{size}}}"
        return number.format(name)

    split = enumerate(PLACE.split(template))
    return "".join(of(text) if place % 2 else re.escape(text) for place, text in split)


def _reply(template: str) -> str:
    names = [name for name in PLACE.findall(template) if name.partition(":")[0] not in _OPEN]
    if len(names) != 1 or not re.fullmatch(r"value(:\d+)?|code|decimal|hex", names[0]):
        raise ValueError(f"{template!r} must hold {{value}} once, where the answer stands")
    return template


def _order(template: str) -> str:
    """Check a template that carries a number: it must write and give back what it was given."""
    names = [name for name in PLACE.findall(template) if name != "mode"]
    if len(names) != 1 or not names[0].startswith("value"):
        raise ValueError(f"{template!r} must hold {{value}} once, as in 'SETP {{value:.1f}}'")
    for probe in () if names[0] == _TIME else _PROBES:
        with worded(ValueError, f"{template!r} cannot write {probe}: ", (ValueError, TypeError)):
            written = f"{{{names[0]}}}".format(value=probe)
            wrong = abs(float(written) - probe) > 0.051
        if wrong:
            raise ValueError(f"{template!r} writes {written!r} for {probe}; it must keep at least one decimal")
    return template


Order = Annotated[str, AfterValidator(_order)]
Reply = Annotated[str, AfterValidator(_reply)]
