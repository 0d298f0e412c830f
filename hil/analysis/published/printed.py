"""A printed table as its cells, digits kept: the layout of Table 1 or of Table A-1 of RD-GC-86-1.

Table 1 has one line per temperature and parameter (`parameter`, `mean_printed`, `sigma_printed`, `n_stated`, and
`temperature_F` or `temperature_C`). Table A-1 has one line per run with the seven biases `A27_printed` … `A33_printed`.
Of the others only `unit` is looked at: an audit trusts the digits, not what somebody has already concluded from them.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hil.campaign import FloatArray
from hil.campaign.table import Table
from hil.errors import InputError
from procedures.words import listed

TABLE_1, TABLE_A1 = "table-1", "table-a1"
SEVEN = tuple(f"A-{number}" for number in range(27, 34))
"""The seven ways to the bias of Table A-1, eqs. (A-27)-(A-33)."""

_PARAMETER = re.compile(r"(MUA|MUB)(\d*)(?:_matrix)?|(BA|BB)(\d*)_(matrix|collins)")
_UNITS = {"", "deg/h", "deg/h/g", "°/h", "°/h/g"}
_LARGEST = 1e9  # deg/hr
_TEMPERATURES = {f"temperature_{name}": f"deg{name[-1]}" for name in ("F", "degF", "C", "degC")}


@dataclass(frozen=True)
class Cell:
    """One printed number: its text, where it stands (file row, column), and what it is called."""

    text: str
    file_row: int
    column: str
    what: str

    @property
    def value(self) -> float:
        """The number."""
        return float(self.text)

    @property
    def half_digit(self) -> float:
        """Half of the last printed digit: how far the number before printing may have been away."""
        digits = self.text.lower().partition("e")[0].partition(".")[2]
        return 0.5 * 10.0 ** -len(digits)


@dataclass(frozen=True)
class PrintedRow:
    """The cells that one set of identities ties together, by role.

    In Table 1 a row is one temperature and axis with the roles contractor, matrix, mu and sigma_contractor,
    sigma_matrix, sigma_mu (those that are printed); `group` is the temperature, whose cells share the number of runs
    `n_stated`. In Table A-1 a row is one run, with the roles A-27 … A-33.
    """

    label: str | int
    group: str
    axis: str
    cells: Mapping[str, Cell]
    n_stated: int | None = None

    def values(self) -> dict[str, float]:
        """Return the numbers by role."""
        return {role: cell.value for role, cell in self.cells.items()}


@dataclass(frozen=True)
class PrintedTable:
    """A table that was read: its layout, its rows, and what could not be used."""

    path: Path
    layout: str
    rows: Sequence[PrintedRow]
    notes: Sequence[str]


def read_printed(path: Path) -> PrintedTable:
    """Read a table in either layout; raise `InputError` naming file, row and column."""
    table = Table(path)
    if not len(table):
        raise InputError(f"{path}: the table has no rows")
    seven = {f"A-{name[1:3]}": name for name in table.header if re.fullmatch(r"A(2[789]|3[0123])(_printed)?", name)}
    if len(seven) == len(SEVEN):
        return PrintedTable(path, TABLE_A1, list(_rows_of_a1(table, seven)), ())
    mean = next((name for name in ("mean_printed", "mean") if name in table.header), None)
    temperature = next(((name, unit) for name, unit in _TEMPERATURES.items() if name in table.header), None)
    if mean is None or temperature is None or "parameter" not in table.header:
        raise InputError(
            f"{path}, row {table.header_row}: this is neither the layout of Table 1 (columns parameter, mean_printed "
            "and temperature_F or temperature_C) nor that of Table A-1 (columns A27_printed to A33_printed)"
        )
    rows, notes = _rows_of_1(table, mean, *temperature)
    if not rows:
        raise InputError(f"{path}: no temperature has contractor's bias, matrix bias and MU of one axis: {notes[0]}")
    return PrintedTable(path, TABLE_1, rows, notes)


def _rows_of_a1(table: Table, seven: Mapping[str, str]) -> Iterator[PrintedRow]:
    labels = table.texts("row") if "row" in table.header else [str(place + 1) for place in range(len(table))]
    columns = {role: _cells(table, name, role) for role, name in seven.items()}
    for place, label in enumerate(labels):
        cells = {role: columns[role][place] for role in SEVEN}
        yield PrintedRow(int(label) if label.isdigit() else label, label, "A", cells)


def _rows_of_1(table: Table, mean: str, temperature: str, unit: str) -> tuple[list[PrintedRow], list[str]]:
    check_units(table)
    names = table.texts("parameter")
    means = _cells(table, mean, "mean")
    sigma_column = next((name for name in ("sigma_printed", "sigma") if name in table.header), None)
    sigmas = _cells(table, sigma_column, "sigma", required=False) if sigma_column else None
    counts = table.texts("n_stated") if "n_stated" in table.header else [""] * len(table)
    temperatures = table.texts(temperature)
    table.numbers(temperature, required=True)
    found: dict[tuple[str, str, str], dict[str, Cell]] = {}
    stated: dict[str, int] = {}
    for line, name in enumerate(names):
        matched = _PARAMETER.fullmatch(name)
        if matched is None:
            continue
        mu, mu_sensor, bias, bias_sensor, method = matched.groups()
        sensor = mu_sensor if mu else bias_sensor
        axis = "A" if (mu or bias) in {"MUB", "BA"} else "B"
        role = "mu" if mu else "contractor" if method == "collins" else "matrix"
        row = found.setdefault((temperatures[line], sensor, axis), {})
        if role in row:
            raise table.complaint(line, "parameter", f"{name} at {temperatures[line]} {unit} stands there twice")
        row[role] = replace(means[line], what=f"{name} mean")
        if sigmas is not None and sigmas[line].text:
            if sigmas[line].value < 0:
                raise table.complaint(line, str(sigma_column), "a sigma cannot be negative")
            row[f"sigma_{role}"] = replace(sigmas[line], what=f"{name} sigma")
        if counts[line]:
            stated.setdefault(temperatures[line], _count(table, line, counts[line]))
    rows, notes = [], []
    for (degrees, sensor, axis), cells in found.items():
        label = f"{degrees} {unit}, axis {axis}" + (f", sensor {sensor}" if len({k[1] for k in found}) > 1 else "")
        missing = [role for role in ("contractor", "matrix", "mu") if role not in cells]
        if missing:
            notes.append(f"{label}: {listed(missing)} not printed, so nothing ties its cells together")
        else:
            rows.append(PrintedRow(label, f"{degrees} {unit}", axis, cells, stated.get(degrees)))
    return rows, notes or ["no parameter is named like BA2_collins, BA2_matrix or MUB2_matrix"] * (not rows)


def check_units(table: Table) -> None:
    """Raise `InputError` where the column `unit` names others than deg/hr and deg/hr/g, in which tolerances are."""
    for line, unit in enumerate(table.texts("unit") if "unit" in table.header else ()):
        if unit.replace(" ", "").replace("hr", "h") not in _UNITS:
            raise table.complaint(line, "unit", f"{unit}: biases in deg/hr and MU in deg/hr/g are needed; convert them")


def check_sizes(table: Table, column: str, values: FloatArray) -> None:
    """Raise `InputError` for a number that no table prints (an exponent slipped in); `values` (n,), one per row."""
    for line in np.flatnonzero(np.abs(values) > _LARGEST):
        raise table.complaint(int(line), column, f"{values[line]:g} deg/hr cannot be")


def _cells(table: Table, column: str, what: str, *, required: bool = True) -> list[Cell]:
    check_sizes(table, column, table.numbers(column, required=required))
    return [Cell(text, row, column, what) for text, row in zip(table.texts(column), table.rows, strict=True)]


def _count(table: Table, line: int, text: str) -> int:
    if re.fullmatch(r"[1-9]\d*(\.0*)?", text) is None:
        raise table.complaint(line, "n_stated", f"{text!r} is not a number of runs")
    return int(float(text))
