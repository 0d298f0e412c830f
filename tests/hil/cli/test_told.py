"""What people read of a document, by its template."""

from __future__ import annotations

import io

import pytest
from rich.table import Table

from hil.cli.output import Aside, Lasting, listing
from hil.cli.told import lines_of
from procedures.words import harmless

_NOISE = {
    "sensor": 2,
    "channel": "RA",
    "stated_deg_per_hr": None,
    "observed_deg_per_hr": 3.0,
    "run_offset_deg_per_hr": 1.0,
}


def _scatter(title: str, sentence: str = "they cannot tell") -> list[str | Table]:
    document = {
        "schema": "hil.scatter/1",
        "title": title,
        "simulated": True,
        "noise": [_NOISE],
        "sentences": [sentence],
    }
    return list(lines_of(document, {}))


def test_lines_and_tables_come_in_the_order_of_the_template() -> None:
    """A table is one line of the template, whatever rows it gets; a number that is not known is a dash."""
    title, table, sentence = _scatter("night 014")
    assert (title, sentence) == ("night 014  SIMULATED", "they cannot tell")
    assert isinstance(table, Table)
    assert [list(column.cells) for column in table.columns] == [["2 RA"], ["–"], ["3.00"], ["1.00"]]


def test_what_goes_beside_the_answer_is_no_line_of_it() -> None:
    """It stands where the template has it, and is known for what it is."""
    document = {"schema": "hil.fleet/1", "said": ["row 3 is odd"], "not_screened": [], "units": []}
    beside, sentence = lines_of(document, {"found": ["0 of 0 units"], "written": []})
    assert (beside, sentence) == ("warning: row 3 is odd", "0 of 0 units")
    assert (isinstance(beside, Aside), isinstance(sentence, Aside)) == (True, False)


def test_a_document_cannot_pass_for_a_line_of_the_template() -> None:
    """Titles come from others' files: what would steer a terminal, or stand for a table, is taken out."""
    title, _, sentence = _scatter("\x1f0 \x1b[2J", "\x1f1")
    assert (title, sentence) == (
        "\N{REPLACEMENT CHARACTER}0 \N{REPLACEMENT CHARACTER}[2J  SIMULATED",
        "\N{REPLACEMENT CHARACTER}1",
    )


@pytest.mark.parametrize("width", [30, 80, 9_999])
def test_no_number_is_cut_however_narrow_the_terminal(width: int) -> None:
    """Cells wrap between words; what cannot wrap goes past the edge."""
    table = listing("run", *(f"parameter {k}, deg/hr" for k in range(12)), left=())
    table.add_row("1", *(f"{-1000.5 - k} ±{k}.25" for k in range(12)))
    shown = Lasting(file=io.StringIO(), width=width)
    shown.print(table)
    assert isinstance(shown.file, io.StringIO)
    text = shown.file.getvalue()
    assert all(f"{-1000.5 - k}" in text and f"±{k}.25" in text for k in range(12))
    assert "…" not in text


def test_nothing_turns_the_direction_of_a_line() -> None:
    """Nor steers a terminal; letters of any script stay."""
    assert harmless("a\u202eb\x1b[2Jc\u2067é\tж\n") == "a\ufffdb\ufffd[2Jc\ufffdé\tж\n"
