"""Tables that people give, of bounded size and each column named once, and rows as CSV.

A recording is a Parquet or CSV table, columns between blanks, or a NumPy archive.
What a cell holds is not looked at; a table that this project wrote says units and whether it is simulated.
"""

import csv
import io
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import BadZipFile

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from drivers.given_file import RECORDING_MB, check_size, opened
from hil.errors import InputError
from procedures.words import counted


@dataclass(frozen=True)
class Columns:
    """A table's columns, (n,) each: of numbers with their units, of words (`texts`); `simulated` if it says so."""

    path: Path
    values: Mapping[str, NDArray[np.float64]]
    units: Mapping[str, str] = field(default_factory=dict)
    simulated: bool = False
    texts: Mapping[str, NDArray[np.str_]] = field(default_factory=dict)


def read_columns(path: Path) -> Columns:
    """Read a table's columns; raise `InputError` where it cannot be read, or has other numbers of cells than names."""
    try:
        match path.suffix.lower():
            case ".parquet":
                table = read_parquet(path)
                units = {each.name: ((each.metadata or {}).get(b"unit") or b"").decode() for each in table.schema}
                return _of_table(path, table, units, (table.schema.metadata or {}).get(b"simulated") == b"true")
            case ".npy" | ".npz":
                return _numpy(path)
            case ".csv":
                return _text(path, ",")
            case _:
                return _text(path, None)
    except UnicodeDecodeError as error:
        read = "what is read is .csv, .parquet, .npy, .npz, or columns of UTF-8 text"
        raise InputError(f"{path}: is not UTF-8 text (byte {error.start} of a line); {read}") from None
    except (pa.ArrowException, ValueError, EOFError, MemoryError, BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: cannot be read as a table of numbers ({' '.join(str(error).split())})") from None


def _of_table(path: Path, table: pa.Table, units: Mapping[str, str] | None = None, simulated: bool = False) -> Columns:
    """Return the columns of numbers, NaN where a cell is empty, and those of words, empty there."""
    numbers, words = dict[str, NDArray[np.float64]](), dict[str, NDArray[np.str_]]()
    for name, kind in zip(table.schema.names, table.schema.types, strict=True):
        plain = name.removeprefix("\ufeff").strip()
        if pa.types.is_floating(kind) or pa.types.is_integer(kind):
            numbers[plain] = np.asarray(table[name].cast(pa.float64()).to_numpy(zero_copy_only=False))
        elif pa.types.is_string(kind):
            words[plain] = np.array([cell or "" for cell in table[name].to_pylist()], dtype=np.str_)
    return Columns(path, numbers, units or {}, simulated, words)


def _numpy(path: Path) -> Columns:
    with opened(path, RECORDING_MB) as file:
        try:
            loaded = np.load(file, allow_pickle=False)
        except ValueError:
            raise ValueError("it is damaged, or holds other things than numbers") from None
        arrays = {path.stem: loaded}
        if not isinstance(loaded, np.ndarray):
            check_size(path, sum(each.file_size for each in loaded.zip.infolist()), RECORDING_MB, "unpacked, it has")
            arrays = {name: loaded[name] for name in loaded}
    values: dict[str, NDArray[np.float64]] = {}
    for name, array in arrays.items():
        if array.dtype.kind not in "fiu":
            continue
        if array.ndim == 1 and array.size > 1:
            values[name] = array.astype(np.float64)
        elif array.ndim == 2:
            values |= {f"{name}[{place}]": array[:, place].astype(np.float64) for place in range(array.shape[1])}
    return Columns(path, values)


def _text(path: Path, delimiter: str | None) -> Columns:
    """Read CSV, or columns between blanks; the first row names the columns, or they are numbered from 1."""
    with opened(path, RECORDING_MB) as file:
        lines = enumerate(line.decode("utf-8-sig") for line in file)
        before, first = next((each for each in lines if each[1].strip() and not each[1].startswith("#")), (0, ""))
        if not first:
            raise ValueError("it is empty")
        point = "."
        if delimiter == "," and ";" in first and "," not in first:  # a spreadsheet that may write commas in numbers
            delimiter, point = ";", "," if "," in next(lines, (0, ""))[1] else "."
        cells = [cell.strip() for cell in first.split(delimiter)]
        named = not all(is_number(cell) for cell in cells)
        names = cells if named else [str(place + 1) for place in range(len(cells))]
        check_names(path, names)
        file.seek(0)
        if delimiter and not before:
            table = read_csv(path, file, None if named else names, delimiter, point)
            if not table.num_rows:
                raise ValueError("no row stands under the names of its columns")
            return _of_table(path, table)
        try:
            rows = np.loadtxt(file, delimiter=delimiter, skiprows=before + named, ndmin=2, encoding="utf-8-sig")
        except ValueError:
            rows = np.empty((0, 0))  # numpy counts from the first row of numbers, and people from the top of the file
        if rows.shape[1] != len(names):
            file.seek(0)
            raise ValueError(_first_odd_row(file, delimiter, before + named, len(names)))
    return Columns(path, {name: rows[:, place] for place, name in enumerate(names)})


def _first_odd_row(file: BinaryIO, delimiter: str | None, before: int, count: int) -> str:
    """Say which row of a file, after so many `before`, is the first that does not hold `count` numbers."""
    for number, line in enumerate(file, 1):
        cells = line.decode("utf-8-sig").partition("#")[0].strip().split(delimiter)
        if number > before and any(cells) and (len(cells) != count or not all(map(is_number, cells))):
            return f"row {number}: it should have {counted(count, 'number')}, and has {' '.join(cells):.60}"
    return f"{counted(count, 'column')} named, and no row holds so many numbers"


def is_number(cell: str) -> bool:
    """Tell whether a cell holds a number, and nothing else."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


@contextmanager
def opened_parquet(path: Path, largest_mb: float | None = None) -> Iterator[pyarrow.parquet.ParquetFile]:
    """Open a Parquet file of at most so many MB; raise `InputError` where it is none, or is damaged."""
    try:
        with opened(path, largest_mb) as file, pyarrow.parquet.ParquetFile(file, pre_buffer=False) as found:
            yield found
    except pa.ArrowException as error:
        raise InputError(f"{path}: it is no Parquet file that can be read ({' '.join(str(error).split())})") from error


def read_parquet(path: Path) -> pa.Table:
    """Return a Parquet file's table; raise `InputError` where it is none, too large, or names a column twice."""
    with opened_parquet(path, RECORDING_MB) as table:
        # A few bytes may stand for any number of equal values.
        check_size(path, 8 * table.metadata.num_rows * table.metadata.num_columns, RECORDING_MB, "read, it takes")
        check_names(path, table.schema_arrow.names)
        return table.read(use_threads=False)


def read_csv(
    path: Path, file: BinaryIO, names: list[str] | None = None, delimiter: str = ",", point: str = "."
) -> pa.Table:
    """Return the table of an opened CSV file, whose first row names the columns unless `names` are given.

    `point` is what numbers have before their decimals. Raises `InputError` where it names a column twice, and
    `pyarrow.ArrowInvalid` where it is no table.
    """
    odd: list[pyarrow.csv.InvalidRow] = []

    def at_the_first(row: pyarrow.csv.InvalidRow) -> str:
        odd.append(row)
        return "error"

    reading = pyarrow.csv.ReadOptions(column_names=names, use_threads=False)  # else no error says which row it is about
    told = pyarrow.csv.ParseOptions(delimiter=delimiter, invalid_row_handler=at_the_first)
    try:
        table = pyarrow.csv.read_csv(file, reading, told, pyarrow.csv.ConvertOptions(decimal_point=point))
    except pa.ArrowInvalid as error:
        if not odd:
            raise
        under = f"{counted(odd[0].actual_columns, 'cell')} under {counted(odd[0].expected_columns, 'column')}"
        cut = "; it seems to be cut off" * (odd[0].actual_columns < odd[0].expected_columns)
        raise pa.ArrowInvalid(f"row {odd[0].number}: {under}{cut}") from error
    check_names(path, table.column_names)
    return table


def check_names(path: Path, names: Sequence[str]) -> None:
    """Raise `InputError` where one of the names of columns stands there twice: the first would be lost."""
    for place, name in enumerate(names):
        if name in names[:place]:
            raise InputError(f"{path}, row 1: column {name} stands there twice")


def rows_as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows that have the same names as CSV, the names first; nothing of no rows."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()
