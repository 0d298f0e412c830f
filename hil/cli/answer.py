"""What a command answers: one document, how people read it, and its picture; on a terminal and in a notebook.

answer = solve(Path("night-014"))
answer.document["solutions"]  # what `hil solve --json` prints
answer.to_dataframe()
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any

from rich.table import Table

from drivers.outside import library
from drivers.strict_yaml import packaged
from hil.cli.output import Aside, Lasting, messages, print_json, results
from hil.errors import InputError
from hil.files.figure import drawn

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

_WIDE = 200
_Path = Sequence[tuple[str, str]]

_TABLES: Mapping[str, Mapping[str, Any]] = packaged("hil.cli", "tables.yaml")
"""Where the rows of a document are, level by level with the column that a level's keys make, and what tells them apart.

Without levels the document itself has the columns, each as long as the one that tells its rows apart.
"""


@dataclass(frozen=True)
class Picture:
    """A figure that any notebook shows, whatever its matplotlib is set to draw on."""

    figure: Figure

    def _repr_svg_(self) -> str:
        return drawn(self.figure).decode()


@dataclass(frozen=True, repr=False)
class Answer:
    """One answer: its `document`, as `--json` prints it, what its template knows `beside` it, its picture, if any."""

    document: Mapping[str, Any]
    beside: Mapping[str, Any] = field(default_factory=dict)
    drawn: Callable[[int | None], Figure] | None = None
    status: int = 0

    def _said(self) -> Iterable[str | Table]:
        from hil.cli.told import lines_of  # a program that reads JSON waits for no template

        return lines_of(self.document, self.beside)

    def show(self, *, as_json: bool) -> int:
        """Print the document, or what people read; return the command's exit status."""
        if as_json:
            print_json(self.document)
            return self.status
        beside, console = messages(), results()
        for each in self._said():
            (beside if isinstance(each, Aside) else console).print(each)
        return self.status

    def __repr__(self) -> str:
        console = Lasting(file=io.StringIO(), highlight=False, markup=False, soft_wrap=True, width=_WIDE)
        with console.capture() as text:
            for each in self._said():
                console.print(each)
        return text.get()

    def _repr_html_(self) -> str:
        return "\n".join(_html(each) for each in self._said())

    def plot(self, sensor: int | None = None) -> Picture:
        """Return the answer's picture; `sensor` says whose where there are several.

        Raises `InputError` where this answer has none, or a sensor has to be named.
        """
        if self.drawn is None:
            raise InputError("this answer has no picture; those of solve, thermal and allan have")
        return Picture(self.drawn(sensor))

    def to_dataframe(self) -> pd.DataFrame:
        """Return the document's rows, such as one for each parameter, run and sensor; `simulated` is a column.

        Raises `InputError` where pandas is not installed, or the document is no list of rows.
        """
        path, axes = self._table()
        marks = {"simulated": self.document.get("simulated", False)}
        if path:
            rows: Any = list(_rows(self.document, path, marks))
        else:
            lists = {name: of for name, of in self.document.items() if isinstance(of, list)}
            rows = {name: of for name, of in lists.items() if len(of) == len(lists[axes[0]])} | marks
        frame: pd.DataFrame = library("pandas", "notebook").DataFrame(rows)
        frame.attrs = {"schema": self.document["schema"], **marks}
        return frame

    def to_xarray(self) -> xr.Dataset:
        """Return the same rows over the axes that tell them apart, such as sensor, run and parameter.

        Raises `InputError` as `to_dataframe` does, or where xarray is not installed.
        """
        library("xarray", "notebook")
        axes, frame = list(self._table()[1]), self.to_dataframe()
        dataset: xr.Dataset = (frame.set_index(axes) if axes else frame).to_xarray()
        return dataset.assign_attrs({**frame.attrs, "simulated": int(frame.attrs["simulated"])})

    def _table(self) -> tuple[_Path, Sequence[str]]:
        schema = str(self.document["schema"])
        if schema.partition("/")[0] not in _TABLES:
            raise InputError(f"{schema} is no list of rows; use what is in .document")
        table = _TABLES[schema.partition("/")[0]]
        return list(table["levels"].items()), table["axes"]


def _rows(level: Mapping[str, Any], path: _Path, above: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a row for each record at the end of `path`, with what the records above it say."""
    if not path:
        yield dict(above)
        return
    (key, column), rest = path[0], path[1:]
    records = level[key]
    named = records.items() if isinstance(records, Mapping) else (("", each) for each in records)
    for name, record in named:
        plain = {key: value for key, value in record.items() if not isinstance(value, list | dict)}
        yield from _rows(record, rest, {**above, **({column: name} if column else {}), **plain})


def _html(each: str | Table) -> str:
    if isinstance(each, str):
        return f'<div style="white-space: pre-wrap">{escape(each)}</div>'
    columns = [[str(column.header), *map(str, column.cells)] for column in each.columns]
    rows = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in zip(*columns, strict=True))
    return f"<table>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"
