"""A CSV file as a person wrote it: every complaint names the file, the row as a spreadsheet counts it, and the column.

Tolerated: a byte order mark, CR LF, blank lines, empty columns at the right edge. Everything else is refused.
"""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import SupportsInt

import numpy as np

from drivers.given_file import TABLE_MB, read_text
from hil.campaign.data import FloatArray, IntArray
from hil.errors import InputError
from procedures.words import numbered, plural

ABSOLUTE_ZERO_DEGC = -273.15

LARGEST = 1e12
"""What no cell exceeds, whatever its unit: arithmetic does not bear much more."""

_NO_COMMAS = {";": "semicolons", "\t": "tabs"}
_NO_NUMBER = {",": "use a point as decimal separator, and none between thousands", "−": "its minus sign is no -"}


class Table:
    """The cells of one file: `header`, `lines`, and their `rows` as a spreadsheet numbers them (the header is 1).

    Raises `InputError` where the file cannot be read, is empty, or has unclear columns or cells outside of them.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        records = _records(path)
        if not records:
            raise InputError(f"{path}: the file is empty; its first row must name the columns")
        (self.header_row, header), *lines = records
        self.header = [name.strip() for name in header]
        while self.header and not self.header[-1]:
            self.header.pop()
        self._check_header(any(len(cells) > 1 for _, cells in lines))
        self.lines = [(row, self._padded(row, cells)) for row, cells in lines]
        self.rows = [row for row, _ in self.lines]
        self._index = {name: j for j, name in enumerate(self.header)}

    def __len__(self) -> int:
        return len(self.lines)

    def require(self, columns: Sequence[str]) -> None:
        """Raise `InputError` where one of `columns` is missing."""
        missing = [name for name in dict.fromkeys(columns) if name not in self._index]
        if missing:
            known = {name.casefold(): name for name in self.header}
            alike = [f"{known[name.casefold()]} is not {name}" for name in missing if name.casefold() in known]
            raise InputError(
                f"{self.path}, row {self.header_row}: {plural('column', len(missing))} {', '.join(missing)} "
                f"{'are' if len(missing) > 1 else 'is'} missing{''.join(f'; {each}' for each in alike)}"
            )

    def texts(self, column: str) -> list[str]:
        """Return the cells of a column as text, stripped."""
        j = self._index[column]
        return [cells[j].strip() for _, cells in self.lines]

    def holds_text(self, column: str) -> bool:
        """Tell whether a column has words in some rows, and in none what begins as a number does."""
        cells = [text for text in self.texts(column) if text]
        return bool(cells) and not any(text[0].isdigit() or text[0] in "+-−.," for text in cells)

    def numbers(self, column: str, *, required: bool = False) -> FloatArray:
        """Return the cells of a column as numbers, (n,), NaN where empty; raise `InputError` for no finite number."""
        values = np.empty(len(self.lines))
        for i, text in enumerate(self.texts(column)):
            values[i] = self._number(i, column, text, required)
        if column.endswith("_degC") and np.any(values < ABSOLUTE_ZERO_DEGC):
            i = int(np.flatnonzero(values < ABSOLUTE_ZERO_DEGC)[0])
            raise self.complaint(i, column, f"{values[i]:g} °C is below absolute zero")
        return values

    def integers(self, column: str) -> IntArray:
        """Return the cells of a column as whole numbers, (n,); raise `InputError` for others and for empty cells."""
        values = self.numbers(column, required=True)
        for i in np.flatnonzero(values != np.round(values)):
            raise self.complaint(int(i), column, f"{self.texts(column)[int(i)]!r} is not a whole number")
        return values.astype(np.int64)

    def complaint(self, line: int, column: str, what: str) -> InputError:
        """Word a complaint about the cell of the `line`-th data line."""
        return InputError(f"{self.path}, row {self.rows[line]}, column {column}: {what}")

    def _check_header(self, wider: bool) -> None:
        for character, word in _NO_COMMAS.items():
            if len(self.header) == 1 and character in self.header[0]:
                raise InputError(
                    f"{self.path}, row {self.header_row}: the columns are separated by {word}; commas are needed "
                    "between columns and points in numbers (a spreadsheet set to English saves CSV so)"
                )
        if len(self.header) == 1 and wider:
            raise InputError(
                f"{self.path}, row {self.header_row}: {self.header[0]!r} names no columns, as the first row must; "
                "take out what stands above the names"
            )
        for j, name in enumerate(self.header):
            if not name:
                raise InputError(f"{self.path}, row {self.header_row}: column number {j + 1} has no name")
            if name in self.header[:j]:
                raise InputError(f"{self.path}, row {self.header_row}: column {name} stands there twice")

    def _padded(self, row: int, cells: list[str]) -> list[str]:
        extra = [cell for cell in cells[len(self.header) :] if cell.strip()]
        if extra:
            raise InputError(
                f"{self.path}, row {row}: {len(cells)} cells under {len(self.header)} columns; "
                f"{extra[0]!r} stands beyond the last column ({self.header[-1]})"
            )
        if len(cells) < len(self.header):
            raise InputError(
                f"{self.path}, row {row}, column {self.header[len(cells)]}: the row ends before this column; "
                "it seems to be cut off (an empty cell still needs its comma)"
            )
        return cells

    def _number(self, line: int, column: str, text: str, required: bool) -> float:
        if not text:
            if required:
                raise self.complaint(line, column, "the cell is empty; a number is needed")
            return float("nan")
        try:
            value = float(text)
        except ValueError:
            value = None
        if value is None or "_" in text:
            hint = next((f" ({told})" for mark, told in _NO_NUMBER.items() if mark in text), "")
            raise self.complaint(line, column, f"{text!r} is not a number{hint}")
        if not np.isfinite(value):
            raise self.complaint(
                line, column, f"{text!r} is not finite; leave the cell empty where nothing was measured"
            )
        if abs(value) > LARGEST:
            raise self.complaint(line, column, f"{text!r} is larger than anything that is measured ({LARGEST:g})")
        return value


def _records(path: Path) -> list[tuple[int, list[str]]]:
    """Return (row number, cells) of every line that is not blank."""
    text = read_text(path, TABLE_MB)
    if "\0" in text:
        raise InputError(f"{path}: it holds zero bytes, so it is no CSV text; save the file as CSV UTF-8")
    try:
        records = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except csv.Error as error:
        raise InputError(f'{path}: it is no CSV ({error}); is a " there that is not closed?') from error
    return [(row, cells) for row, cells in enumerate(records, start=1) if any(cell.strip() for cell in cells)]


def rows_in_words(rows: Iterable[SupportsInt]) -> str:
    """Write row numbers as people do.

    >>> rows_in_words([7]), rows_in_words([2, 5, 9, 10, 11, 12])
    ('row 7', 'rows 2, 5, 9-12')
    """
    return numbered("row", map(int, rows), to="-")
