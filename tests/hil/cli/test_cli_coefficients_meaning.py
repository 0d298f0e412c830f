"""What the coefficients mean, from the command line: scatter, the report given again, the budget after a night."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hil.analysis.published.scatter import published_signatures
from hil.errors import InputError


def test_a_printed_table_is_read_with_the_runs_that_its_digits_tell(hil: Any) -> None:
    """Three runs everywhere but at 100.1 °F, where the digits say five; one cell is impossible, and said to be."""
    ended = hil("scatter", "rd-gc-86-1-table-1", "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told["schema"] == "hil.scatter/1"
    cells = {(each["axis"], each["temperature_degC"]): each for each in told["signatures"]}
    assert len(cells) == 18
    runs = {round(at): each["runs"] for (axis, at), each in cells.items() if axis == "B" and at is not None}
    assert runs == {-30: 3, -14: 3, -7: 3, 6: 3, 23: 3, 38: 5, 49: 3, 60: 3}
    assert cells["B", None]["degrees_of_freedom"] == 18
    assert [axis for (axis, _), each in cells.items() if not each["probabilities"]] == ["A"]
    people = hil("scatter", "rd-gc-86-1-table-1").stdout
    assert "cannot tell" in people
    assert "sigmas contradict each other" in people


def test_a_night_says_it_with_its_solution(hil: Any, night: Path) -> None:
    """Two repeats at two temperatures: both sensors, both channels, each temperature and all together."""
    solved = json.loads(hil("solve", night, "--json").stdout)
    assert len(solved["scatter"]) == 2 * 2 * 3
    assert {each["degrees_of_freedom"] for each in solved["scatter"]} == {1, 2}
    assert solved["both_sensors"]["sensors"] == [1, 2]
    assert "what scattered from run to run" in hil("solve", night).stdout
    assert json.loads(hil("scatter", night, "--json").stdout)["signatures"] == solved["scatter"]


def test_a_table_without_sigmas_is_refused_in_a_sentence(tmp_path: Path, hil: Any) -> None:
    """What is missing and which column would hold it; and a table that is not there."""
    table = tmp_path / "means.csv"
    rows = ["temperature_C,parameter,mean", "20,BA2_matrix,1.0", "20,BA2_collins,2.0", "20,MUB2_matrix,1.0"]
    table.write_text("\n".join(rows) + "\n")
    with pytest.raises(InputError, match="column sigma_printed"):
        published_signatures(table)
    ended = hil("scatter", "no-such-table")
    assert ended.returncode == 2
    assert "no table of this name" in ended.stderr


def test_the_reports_tables_are_given_again_from_a_night(hil: Any, night: Path) -> None:
    """For people beside the printed ones; as a document; and what has not the three collects is refused."""
    told = json.loads(hil("reproduce", night, "--json").stdout)
    assert told["schema"] == "hil.reproduction/1"
    assert len(told["table_a1"]) == 4
    assert told["simulated"] is True
    people = hil("reproduce", night).stdout
    assert "SIMULATED" in people
    assert "MUA2 matrix, deg/hr/g" in people
    assert "printed 10" in people
    assert hil("reproduce", night, "--sensor", "1").returncode == 2


def test_the_budget_after_a_night_is_of_what_was_measured(hil: Any, night: Path) -> None:
    """On the night's own bench: measured standard errors and slopes, and what scattered beside what was expected."""
    told = json.loads(hil("budget", night, "--draws", "2000", "--json").stdout)
    assert told["simulated"] is True
    for sensor in told["sensors"].values():
        by_id = {each["id"]: each for each in sensor["sources"]}
        assert by_id["noise"]["origin"] == "measured standard errors"
        assert by_id["soak"]["origin"].startswith("as measured")
        assert sensor["left_out"] == []
        assert sensor["observed_run_to_run"]["BA"]["degrees_of_freedom"] == 2
        assert sensor["agrees"] is True
    people = hil("budget", night, "--draws", "2000").stdout
    assert "observed from run to run" in people
    assert "SIMULATED" in people
