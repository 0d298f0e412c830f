"""The audit of a printed table: every identity with its residual, its verdict, and what would mend it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from hil.analysis.published.identities import (
    Identity,
    identities_of_1,
    identities_of_a1,
    run_resolution,
    runs_told,
    tilt_of_a1,
)
from hil.analysis.published.printed import TABLE_A1, PrintedRow, read_printed
from hil.files.document import picked
from hil.files.strict import find_config

MINOR_DEG_PER_HR = 0.075
"""Up to here a residual beyond its tolerance is minor: a twelfth of what one collect scatters by (0.9 deg/hr).

Some digit is then wrong, and no conclusion hangs on it.
"""

_MEANS = ("contractor", "matrix", "mu")
_MOST_CANDIDATES = 40


@dataclass(frozen=True)
class Finding:
    """One identity of one row: what is left over, what rounding allows, the verdict, and what would mend it."""

    row: PrintedRow
    identity: Identity
    residual: float
    tolerance: float
    verdict: str
    candidates: Sequence[dict[str, Any]] = ()
    would_close: Sequence[dict[str, Any]] = ()
    note: str = ""

    def entry(self) -> dict[str, Any]:
        """Return the finding as it stands in the document."""
        return {
            **picked(self.row, "row=label group axis"),
            "identity": self.identity.name,
            "residual": round(self.residual, 6),
            "tolerance": round(self.tolerance, 6),
            "verdict": self.verdict,
            "cells": [
                picked(self.row.cells[role], "cell=what printed=text file_row column") for role in self.identity.roles
            ],
            **picked(self, "candidates would_close note"),
        }


class Audit:
    """Every finding of one table, given by path or by the name of one that ships.

    `runs_told` gives by group the number of runs that the digits tell, `resolution` what these were written down to.
    Raises `InputError` where the table cannot be read.
    """

    def __init__(self, name: str | Path) -> None:
        self.table = table = read_printed(find_config("tables", name))
        self.findings: list[Finding] = []
        self.resolution: float | None = None
        self.runs_told: dict[str, int | None] = {}
        if table.layout == TABLE_A1:
            for row in table.rows:
                self.findings += _judge_row(row, list(identities_of_a1(row)))
            return
        half = max(cell.half_digit for row in table.rows for role, cell in row.cells.items() if role in _MEANS)
        groups = {
            group: [row.cells[role].value for row in table.rows if row.group == group for role in _MEANS]
            for group in dict.fromkeys(row.group for row in table.rows)
        }
        self.resolution = resolution = run_resolution(list(groups.values()), half)
        for group, means in groups.items():
            self.runs_told[group] = runs_told(means, half, resolution) if resolution else None
        for row in table.rows:
            # The digits of a temperature may all lie on another lattice than the stated one: then that is the finding.
            # (1, 2 or a divisor of the stated number tell nothing.)
            digits = self.runs_told[row.group]
            believed = digits if digits and row.n_stated and row.n_stated % digits else row.n_stated
            self.findings += _judge_row(row, list(identities_of_1(row, resolution, believed or digits)))
            if resolution and believed != row.n_stated and row.n_stated:
                own = identities_of_1(row, resolution, row.n_stated)
                stated = next(each for each in own if each.name.startswith("means"))
                multiples = f"all means of this temperature are multiples of {resolution:g}/{believed}"
                note = f"{multiples}: {believed} runs, not {row.n_stated}"
                self.findings.append(Finding(row, stated, stated.gap(row.values()), 0.0, "minor", note=note))

    def of(self, verdict: str) -> list[Finding]:
        """Return the findings with a verdict: ok, minor or inconsistent."""
        return [each for each in self.findings if each.verdict == verdict]

    def document(self) -> dict[str, Any]:
        """Return what `hil audit --json` prints."""
        document: dict[str, Any] = {
            "schema": "hil.audit/1",
            "table": str(self.table.path),
            "layout": self.table.layout,
            "identities": [each.entry() for each in self.findings],
            "counts": {verdict: len(self.of(verdict)) for verdict in ("ok", "minor", "inconsistent")},
            "summary": self.summary(),
            "notes": list(self.table.notes),
        }
        if self.table.layout == TABLE_A1:
            document["rows"] = [{"row": row.label, **tilt_of_a1(row.values())} for row in self.table.rows]
        else:
            stated = {row.group: row.n_stated for row in reversed(self.table.rows)}  # by the first of each group
            document["resolution"] = self.resolution
            document["runs"] = [
                {"group": group, "stated": stated[group], "told_by_digits": told}
                for group, told in self.runs_told.items()
            ]
        return document

    def summary(self) -> str:
        """Say in one sentence what was found."""
        if len(self.of("ok")) == len(self.findings):
            return f"all {len(self.findings)} identities hold"
        parts = []
        for kind in dict.fromkeys(each.identity.kind for each in self.findings):
            same = [each for each in self.findings if each.identity.kind == kind]
            rows = [str(each.row.label) for each in same if each.verdict == "inconsistent"]
            minor = sum(each.verdict == "minor" for each in same)
            if rows or minor:
                which = f" ({'; '.join(rows)})" if rows else ""
                parts.append(f"{kind}: {len(rows)} of {len(same)} inconsistent{which}, {minor} minor")
        return ". ".join([*parts, "Nothing is corrected."])


def _judge_row(row: PrintedRow, every: Sequence[Identity]) -> list[Finding]:
    values, found = row.values(), []
    for identity in every:
        residual, tolerance = identity.gap(values), identity.tolerance(values)
        if identity.holds(values):
            found.append(Finding(row, identity, residual, tolerance, "ok"))
            continue
        verdict = "minor" if abs(residual) <= MINOR_DEG_PER_HR else "inconsistent"
        candidates = readings(row, identity, every)[:_MOST_CANDIDATES]
        found.append(Finding(row, identity, residual, tolerance, verdict, candidates, demands(row, identity, every)))
    return found


def variants(text: str) -> Iterator[tuple[str, str]]:
    """Yield every reading with one digit, the sign, or two neighbouring digits changed, and what changed."""
    yield (text[1:], "sign") if text.startswith("-") else (f"-{text.removeprefix('+')}", "sign")
    places = [place for place, character in enumerate(text) if character.isdigit()]
    for place in places:
        for digit in "0123456789":
            if digit != text[place]:
                yield text[:place] + digit + text[place + 1 :], f"{text[place]} read as {digit}"
    for first, second in pairwise(places):
        if text[first] != text[second]:
            swapped = text[:first] + text[second] + text[first + 1 : second] + text[first] + text[second + 1 :]
            yield swapped, f"{text[first]} and {text[second]} transposed"


def readings(row: PrintedRow, broken: Identity, every: Sequence[Identity]) -> list[dict[str, Any]]:
    """Return the readings of one cell that close `broken` while what held still holds, the best first.

    `mends_row` says that every identity of the row then holds; otherwise only this one does, beside those that held.
    """
    values = row.values()
    held = [each for each in every if each.holds(values)]
    found = []
    for role in broken.roles:
        cell = row.cells[role]
        for text, change in variants(cell.text):
            tried = {**values, role: float(text)}
            if tried[role] == values[role] or not broken.holds(tried):
                continue
            if role.startswith("sigma") and tried[role] < 0:
                continue
            if all(each.holds(tried) for each in held):
                mends, left = all(each.holds(tried) for each in every), broken.gap(tried)
                reading = {"cell": cell.what, "printed": cell.text, "read": text, "change": change}
                order = (not mends, round(abs(left), 9), role, text)
                found.append((order, {**reading, "residual": round(left, 6), "mends_row": mends}))
    return [reading for _, reading in sorted(found, key=lambda each: each[0])]


def demands(row: PrintedRow, broken: Identity, every: Sequence[Identity]) -> list[dict[str, Any]]:
    """Return for each cell of a linear identity the value that would close it, and whether what held then holds."""
    if not broken.linear:
        return []
    values = row.values()
    held = [each for each in every if each.holds(values)]
    found = []
    for role in broken.roles:
        if (value := _closing(broken, values, role)) is not None:
            cell = row.cells[role]
            rounded = round(value, len(cell.text.partition(".")[2]))
            tried = {**values, role: rounded}
            others = all(each.holds(tried) for each in held)
            found.append({"cell": cell.what, "value": rounded, "others_hold": others})
    return found


def _closing(broken: Identity, values: dict[str, float], role: str) -> float | None:
    """Solve the identity for one cell by a few secant steps (it is linear, or nearly so, in each)."""
    first, second = values[role], values[role] + 0.1
    for _ in range(30):
        at_first, at_second = broken.gap({**values, role: first}), broken.gap({**values, role: second})
        if abs(at_second) < 1e-9:
            return second
        if at_second == at_first:
            return None
        first, second = second, second - at_second * (second - first) / (at_second - at_first)
    return None
