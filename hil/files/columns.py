"""The columns of a recording that people give: a Parquet or CSV table, columns between blanks, a NumPy archive.

    columns = read_columns(Path("static.csv"))
    columns.values["gx"], columns.units.get("gx")

What a cell holds is not looked at; a table that this project wrote says units and whether it is simulated.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from drivers.given_file import RECORDING_MB, check_size, opened
from hil.errors import InputError
from hil.files.tables import check_names, read_csv, read_parquet


@dataclass(frozen=True)
class Columns:
    """A table's columns of numbers, (n,) each, with the units that it states; `simulated` where it says so.

    `texts` holds its columns of words, (n,) each, empty where a cell is.
    """

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
                return _parquet(path)
            case ".npy" | ".npz":
                return _numpy(path)
            case ".csv":
                return _text(path, ",")
            case _:
                return _text(path, None)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text (byte {error.start} of a line); save it as UTF-8") from None
    except (pa.ArrowException, ValueError, EOFError, MemoryError, BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: cannot be read as a table of numbers ({' '.join(str(error).split())})") from None


def _parquet(path: Path) -> Columns:
    table = read_parquet(path)
    units = {each.name: ((each.metadata or {}).get(b"unit") or b"").decode() for each in table.schema}
    simulated = (table.schema.metadata or {}).get(b"simulated") == b"true"
    return Columns(path, _numbers(table), units, simulated, _words(table))


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
        cells = [cell.strip() for cell in first.split(delimiter)]
        named = not all(is_number(cell) for cell in cells)
        names = cells if named else [str(place + 1) for place in range(len(cells))]
        check_names(path, names)
        file.seek(0)
        if delimiter == "," and not before:
            table = read_csv(path, file, None if named else names)
            return Columns(path, _numbers(table), texts=_words(table))
        rows = np.loadtxt(file, delimiter=delimiter, skiprows=before + named, ndmin=2, encoding="utf-8-sig")
    if rows.shape[1] != len(names):
        raise ValueError(f"{len(names)} names for {rows.shape[1]} columns")
    return Columns(path, {name: rows[:, place] for place, name in enumerate(names)})


def _numbers(table: pa.Table) -> dict[str, NDArray[np.float64]]:
    """Return the columns of numbers, (n,) each, NaN where a cell is empty."""
    numeric = [each.name for each in table.schema if pa.types.is_floating(each.type) or pa.types.is_integer(each.type)]
    columns = {name: table[name].cast(pa.float64()).to_numpy(zero_copy_only=False) for name in numeric}
    return {name.removeprefix("\ufeff").strip(): np.asarray(values) for name, values in columns.items()}


def _words(table: pa.Table) -> dict[str, NDArray[np.str_]]:
    """Return the columns of words, (n,) each, empty where a cell is."""
    words = [each.name for each in table.schema if pa.types.is_string(each.type)]
    return {
        name.removeprefix("\ufeff").strip(): np.array([cell or "" for cell in table[name].to_pylist()], dtype=np.str_)
        for name in words
    }


def is_number(cell: str) -> bool:
    """Tell whether a cell holds a number, and nothing else."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
