"""Other readings of a printed number: what the page might say instead. Candidates only; nothing is ever corrected."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from hil.analysis.published.identities import Identity
from hil.analysis.published.printed import PrintedRow


@dataclass(frozen=True)
class Reading:
    """One cell read differently: what changed (a digit, the sign, two digits transposed) and what it leaves.

    `mends_row` says that every identity of the row then holds; otherwise only this one does, beside those that held.
    """

    role: str
    what: str
    printed: str
    read: str
    change: str
    residual: float
    mends_row: bool


@dataclass(frozen=True)
class Demand:
    """The value of a cell that would close an identity exactly, and whether all that holds as printed still would."""

    role: str
    what: str
    value: float
    others_hold: bool


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


def readings(row: PrintedRow, broken: Identity, every: Sequence[Identity]) -> list[Reading]:
    """Return the readings of one cell that close `broken` while what held still holds, the best first."""
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
                mends = all(each.holds(tried) for each in every)
                found.append(Reading(role, cell.what, cell.text, text, change, broken.gap(tried), mends))
    return sorted(found, key=lambda each: (not each.mends_row, round(abs(each.residual), 9), each.role, each.read))


def demands(row: PrintedRow, broken: Identity, every: Sequence[Identity]) -> list[Demand]:
    """Return for each cell of a linear identity the value that would close it, and whether what held then holds."""
    if not broken.linear:
        return []
    values = row.values()
    held = [each for each in every if each.holds(values)]
    found = []
    for role in broken.roles:
        value = _closing(broken, values, role)
        if value is None:
            continue
        digits = len(row.cells[role].text.partition(".")[2])
        rounded = round(value, digits)
        tried = {**values, role: rounded}
        found.append(Demand(role, row.cells[role].what, rounded, all(each.holds(tried) for each in held)))
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
