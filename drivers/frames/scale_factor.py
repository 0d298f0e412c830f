"""Scale factors as data sheets print them: `2^-14`, `3600*2^-14`, `1/6.25`."""

import math
import re
from typing import Any

_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TERM = re.compile(rf"\s*([*/]?)\s*([+-]?)({_NUMBER})(?:\s*\^\s*([+-]?{_NUMBER}))?\s*")


def parse_factor(value: Any) -> Any:
    """Return the number that `value` is or spells: a product or quotient of numbers and powers, left to right.

    Raise `ValueError` for anything else, and for a result that is not finite.
    """
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
