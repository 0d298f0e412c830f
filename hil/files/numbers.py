"""How numbers are written in pages: with as many decimals as their uncertainty asks for; a dash where none is known."""

import math
from collections.abc import Iterable
from typing import Any

ABSENT = "–"
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
WHOSE = {
    "setpoint_degC": "as set",
    "temperature_degC": "the unit's own",
    "case_degC": "the case's",
    "chamber_degC": "the chamber's",
}
"""Whose temperature a column has, in words."""


def number(value: float | None, decimals: int = 0) -> str:
    """Write a number, or a dash where it is not known."""
    if value is None or not math.isfinite(value):
        return ABSENT
    return f"{round(value, decimals) + 0.0:.{decimals}f}"  # + 0.0: no minus before nothing


def estimate(of: Any, decimals: int) -> tuple[str, str]:
    """Write the `value` of what is given, and its `sd` behind ±; nothing for that where it is not known."""
    known = of is not None and math.isfinite(of.value) and math.isfinite(of.sd)
    return number(None if of is None else of.value, decimals), f"±{of.sd:.{decimals}f}" if of and known else ""


def decimals_for(uncertainties: Iterable[float | None]) -> int:
    """Return how many decimals show two digits of the smallest uncertainty: at least 2, at most 6."""
    known = [each for each in uncertainties if each is not None and math.isfinite(each) and each > 0.0]
    return min(max(2, 1 - math.floor(math.log10(min(known)))), 6) if known else 2


def degrees(
    temperature_degC: float | None, temperature_of: str | None = None, unit_degC: tuple[float, float] | None = None
) -> str:
    """Write a temperature in °C, or that it is not known; whose it is, and what the unit's own thermometer showed.

    Where nobody recorded whose it would be, all runs are of one.

    >>> degrees(-0.04), degrees(None, "case_degC")
    ('0.0 °C', 'no known temperature')
    """
    if temperature_degC is None:
        return "no known temperature" if temperature_of else "all runs"
    about = [WHOSE[temperature_of]] if temperature_of in WHOSE else []
    if unit_degC and temperature_of != "temperature_degC":
        about.append(f"unit {unit_degC[0]:z.1f} … {unit_degC[1]:z.1f} °C")
    return f"{temperature_degC:z.1f} °C" + (f" ({', '.join(about)})" if about else "")


def rounded(value: float, se: float | None) -> str:
    """Write a value with as many decimals as its error has two digits; small ones with a power of ten for both.

    >>> rounded(4.6412, 2.71), rounded(-3.94e-16, 2.6e-18), rounded(0.25, None)
    ('4.6 ± 2.7', '(-3.940 ± 0.026) × 10⁻¹⁶', '0.25')
    """
    if not se or not math.isfinite(se):
        return f"{value:.3g}"
    power = math.floor(math.log10(max(abs(value), se)))
    scale = 10.0**power if power < -3 else 1.0
    digits = max(1 - math.floor(math.log10(se / scale)), 0)
    pair = f"{value / scale:.{digits}f} ± {se / scale:.{digits}f}"
    return pair if scale == 1.0 else f"({pair}) × 10{str(power).translate(_RAISED)}"
