"""Tables as the page shows them: a caption, a head, and rows of cells; and how numbers are written in them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

ABSENT = "–"


@dataclass(frozen=True)
class Cell:
    """A cell: its text, what stands below it in small print (unit, uncertainty), and what it is.

    `kind` is "" for a number, "text", "wrap" for text that may break, or a verdict's word, which colours it.
    """

    text: str
    below: str = ""
    kind: str = ""


@dataclass(frozen=True)
class Grid:
    """A table. The first cell of every row is its head."""

    name: str
    caption: str
    head: Sequence[Cell]
    rows: Sequence[Sequence[Cell]]


def table(name: str, caption: str, heads: Iterable[str], rows: Iterable[Sequence[object]]) -> Grid:
    """Make a table of cells, whole numbers and texts, which may have small print behind a line's end.

    A head stands over its column: on the left where texts do.
    """
    made = [[_cell(each) for each in row] for row in rows]
    kinds = ["text" if cell.kind and cell.kind != "bold" else "" for cell in (made[0] if made else ())]
    top = [replace(_cell(head), kind=kind) for head, kind in zip_longest(heads, kinds, fillvalue="text")]
    return Grid(name, caption, top, made)


def _cell(value: object) -> Cell:
    if isinstance(value, Cell):
        return value
    first, _, small = str(value).partition("\n")
    return Cell(first, small, "" if isinstance(value, int) else "text")


def text(value: object) -> Cell:
    """Return a cell of text that does not break."""
    return Cell(str(value), kind="text")


def wrap(value: object) -> Cell:
    """Return a cell of text that may break."""
    return Cell(str(value), kind="wrap")


def number(value: float | None, decimals: int = 0, below: str = "") -> Cell:
    """Return a cell with a number, or a dash where it is not known."""
    if value is None or not math.isfinite(value):
        return Cell(ABSENT, below)
    return Cell(f"{round(value, decimals) + 0.0:.{decimals}f}", below)  # + 0.0: no minus before nothing


def estimate(value: float | None, uncertainty: float | None, decimals: int) -> Cell:
    """Return a cell with a value and, below it, its uncertainty."""
    known = value is not None and math.isfinite(value)
    plain = uncertainty is None or not math.isfinite(uncertainty)
    return number(value, decimals, "" if plain or not known else f"±{uncertainty:.{decimals}f}")


def decimals_for(uncertainties: Iterable[float | None]) -> int:
    """Return how many decimals show two digits of the smallest uncertainty: at least 2, at most 6."""
    known = [each for each in uncertainties if each is not None and math.isfinite(each) and each > 0.0]
    return min(max(2, 1 - math.floor(math.log10(min(known)))), 6) if known else 2


def degrees(temperature_degC: float | None) -> str:
    """Write a temperature in °C, or say that there is none."""
    return "all runs" if temperature_degC is None else f"{temperature_degC:.1f} °C"
