"""What is printed to nobody harms nothing: a night goes on when the reader of its lines has gone."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from hil.cli.output import Lasting, listing, print_json
from hil.cli.progress import panel
from hil.records.verify import verify_night


def test_a_console_outlives_its_reader() -> None:
    """The first line after the reader has gone is lost in silence, and so are all others."""
    reads, writes = os.pipe()
    with os.fdopen(writes, "w") as pipe:
        console = Lasting(file=pipe)
        console.print("seen")
        os.close(reads)
        console.print("not seen")
        console.print("nor this")
        assert console.quiet


def test_a_document_whose_reader_has_gone_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """As that of lines is none; and what is flushed at the end goes nowhere."""
    reads, writes = os.pipe()
    with os.fdopen(writes, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        os.close(reads)
        print_json({"schema": "x"})
        print_json({"schema": "y"})


def test_what_a_file_says_steers_no_terminal() -> None:
    """A title from somebody else's campaign could else clear the screen, or write into the window's title."""
    shown = io.StringIO()
    console = Lasting(file=shown, force_terminal=True, width=80, markup=False, highlight=False)
    nasty = "a\x1b[2J\x1b]0;b\x07\x9bc\rd"
    console.print(nasty)
    console.print(panel(nasty, None, nasty, simulated=False))
    told = re.sub(r"\x1b\[[0-9;]*m", "", shown.getvalue())  # what rich itself colours with
    assert told.count("a\N{REPLACEMENT CHARACTER}[2J") == 3
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", told)


@pytest.mark.slow
def test_a_command_whose_terminal_is_closed_does_its_work(tmp_path: Path) -> None:
    """A service without any output: the night is the same, and no file of it has the number of a terminal."""
    night = tmp_path / "night"
    command = f"{sys.executable} -m hil run quick --bench simulated --out {night} --yes <&- >&- 2>&-"
    assert subprocess.run(["/bin/sh", "-c", command], timeout=50, check=False).returncode == 0
    assert verify_night(night)["complete"]


@pytest.mark.slow
def test_a_terminal_without_a_degree_sign_is_no_reason_to_fail() -> None:
    """What it cannot show becomes a question mark."""
    ended = subprocess.run(
        [sys.executable, "-m", "hil", "plan", "quick", "--bench", "simulated"],
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "chamber to 23.0 ?C" in ended.stdout


def test_a_table_of_many_numbers_fits_a_terminal_of_80_columns() -> None:
    """What is words makes room first, then the gaps; no number is cut, and none where there is room is broken."""
    words = [["noise of the averages", "1 deg/hr", "1-2-3-4-4-3-2-1"], ["level of the bench", "0.0115 deg", "1-2-3"]]
    for width in (40, 80, 200):
        shown = io.StringIO()
        table = listing("source", "size", "sequence", *["GSA\ndeg/hr/g"] * 5, left=("source", "sequence"))
        for row in words:
            table.add_row(*row, *["0.387 (0.399)"] * 5)
        Lasting(file=shown, width=width).print(table)
        lines = [line.rstrip() for line in shown.getvalue().splitlines()]
        assert max(map(len, lines)) <= 80 or width == 200
        assert sum(line.count("0.387") for line in lines) == sum(line.count("(0.399)") for line in lines) == 10
        assert (len(lines) == 4) == (width == 200)
        assert sum("1-2-3-4-4-3-2-1" in line for line in lines) == 1
