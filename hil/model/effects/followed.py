"""What a coefficient may follow, as an expression that a model file can hold.

supply_V                      the condition less its reference
temperature_degC^3            its third power, about the reference
temperature_degC>23.5         one above, zero below (and < the other way round)
temperature_degC[20.0..25.0]  one inside, zero outside
position=3                    one at a position ('&' in its label is written %26, '%' is %25)
run>12                        one after a run
position=3&temperature_degC<0.0   products of these
"""

import re

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.errors import InputError

_NUMBER = r"-?[0-9.]+(?:e-?[0-9]+)?"
# A campaign may call a condition anything ("oil [bar]"), so the operator is the last one in the part.
_POWER = re.compile(r"^(.+)\^([0-9])$")
_ABOVE = re.compile(rf"^(.+)([<>])({_NUMBER})$")
_INSIDE = re.compile(rf"^(.+)\[({_NUMBER})\.\.({_NUMBER})\]$")
_LABEL = re.compile(r"^position=(.+)$")


def driver_values(expression: str, conditions: Conditions, reference: float | None = None) -> FloatArray:
    """Evaluate an expression at each row, shape (n,); cells that are empty give zero.

    `reference` is what a plain condition or a power is taken about (the median of these rows if not given). Raises
    `InputError` where the expression is not one of the forms above, or names a column that the data lacks.
    """
    out = np.ones(len(conditions))
    for part in expression.split("&"):
        out = out * _part(part.strip(), conditions, reference)
    return np.nan_to_num(out)


def driver_reference(expression: str, conditions: Conditions) -> float:
    """Return the median that a plain condition or power is taken about; 0 for steps, zones and positions.

    Raises `InputError` where the data has no such column.
    """
    if "&" in expression or any(form.match(expression) for form in (_LABEL, _ABOVE, _INSIDE)):
        return 0.0
    return _median(_column(_column_of(expression), conditions))


def driver_columns(expression: str) -> frozenset[str]:
    """Return the condition columns that an expression needs."""
    names = {_column_of(part) for part in expression.split("&") if not _LABEL.match(part)}
    return frozenset(names - {*_OF_A_ROW})


def _column_of(part: str) -> str:
    match = _POWER.match(part) or _ABOVE.match(part) or _INSIDE.match(part)
    return match.group(1) if match else part


_OF_A_ROW = ("start_s", "duration_s", "run")
"""What every row has beside its conditions."""


_DRIVERS = {
    "start_s": "time",
    "run": "time",
    "time_since_power_on_s": "time",
    "temperature_degC": "temperature",
    "case_degC": "temperature",
    "dTdt_degC_per_min": "temperature_rate",
    "time_since_setpoint_s": "temperature_history",
    "supply_V": "supply",
    "position": "pose",
}


def driver_of(expression: str) -> str:
    """Return what an expression follows, in one word: time, temperature, pose … or the name of its column."""
    columns = driver_columns(expression) | ({"run"} if expression.startswith("run>") else set())
    first = next(iter(sorted(columns)), "start_s" if expression.startswith("start_s") else "position")
    return _DRIVERS.get(first, first)


def position_is(label: str) -> str:
    """Return the expression that is one at a position, whatever its label contains."""
    return f"position={label.replace('%', '%25').replace('&', '%26')}"


def expressible(column: str) -> bool:
    """Whether a condition column can stand in an expression: one whose name looks like an operator cannot."""
    return "&" not in column and not any(form.match(column) for form in (_POWER, _ABOVE, _INSIDE, _LABEL))


def _part(part: str, conditions: Conditions, reference: float | None) -> FloatArray:
    if label := _LABEL.match(part):
        plain = label.group(1).replace("%26", "&").replace("%25", "%")
        return np.asarray(conditions.position == plain, dtype=np.float64)
    values = _column(_column_of(part), conditions)
    if power := _POWER.match(part):
        middle = _median(values) if reference is None else reference
        return np.asarray((values - middle) ** int(power.group(2)))
    if step := _ABOVE.match(part):
        edge = float(step.group(3))
        return np.asarray(values > edge if step.group(2) == ">" else values <= edge, dtype=np.float64)
    if inside := _INSIDE.match(part):
        return ((values >= float(inside.group(2))) & (values <= float(inside.group(3)))).astype(np.float64)
    return values - (_median(values) if reference is None else reference)


def _column(name: str, conditions: Conditions) -> FloatArray:
    if name in _OF_A_ROW:
        return np.asarray(getattr(conditions, name), dtype=np.float64)
    if name not in conditions.columns:
        raise InputError(f"driver {name!r}: the data has no such column")
    return np.asarray(conditions.columns[name], dtype=np.float64)


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
