"""Tables: those that people give, as Arrow reads them, of bounded size and each column named once; and rows as CSV."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from drivers.given_file import RECORDING_MB, check_size, opened
from hil.errors import InputError


def read_parquet(path: Path) -> pa.Table:
    """Return a Parquet file's table; raise `InputError` where it is none, too large, or names a column twice."""
    try:
        with opened(path, RECORDING_MB) as file, pyarrow.parquet.ParquetFile(file, pre_buffer=False) as table:
            # A few bytes may stand for any number of equal values.
            check_size(path, 8 * table.metadata.num_rows * table.metadata.num_columns, RECORDING_MB, "read, it takes")
            check_names(path, table.schema_arrow.names)
            return table.read(use_threads=False)
    except pa.ArrowException as error:
        raise InputError(f"{path}: it is no Parquet file that can be read ({' '.join(str(error).split())})") from error


def read_csv(path: Path, file: BinaryIO, names: list[str] | None = None) -> pa.Table:
    """Return the table of an opened CSV file, whose first row names the columns unless `names` are given.

    Raises `InputError` where it names a column twice, and `pyarrow.ArrowInvalid` where it is no table.
    """
    table = pyarrow.csv.read_csv(file, pyarrow.csv.ReadOptions(column_names=names))
    check_names(path, table.column_names)
    return table


def check_names(path: Path, names: Sequence[str]) -> None:
    """Raise `InputError` where one of the names of columns stands there twice: the first would be lost."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputError(f"{path}, row 1: column {name} stands there twice")
        seen.add(name)


def rows_as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows that have the same names as CSV, the names first; nothing of no rows."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()
