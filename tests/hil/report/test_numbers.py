"""Every number of the report can be traced: it is that of `hil solve --json`, or of `hil reproduce --json`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hil.cli.app import run as hil
from tests.hil.report.report_pages import Tables, solved


def test_every_number_of_the_self_calibrations_is_that_of_hil_solve(
    night: Path, page: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each value and standard error in the page, matrix and contractor's, to the digits that are shown."""
    tables, compared = Tables(page).found, 0
    for whose, solutions in (
        ("", solved(capsys, str(night))),
        ("contractor", [s for s in solved(capsys, str(night), "--model", "collins-4") if s["sensor"] == 2]),
    ):
        for solution in solutions:
            head, *rows = tables[f"runs-sensor-{solution['sensor']}"]
            row = next(row for row in rows if row[0] == [str(solution["run"])])
            assert whose or row[2] == [solution["verdict"]]
            for name, each in solution["parameters"].items():  # type: ignore[attr-defined]
                value, se = row[head.index([name, *([whose] if whose else []), each["unit"]])]
                digits = len(value.partition(".")[2])
                assert value == f"{each['value']:.{digits}f}"
                assert se == f"±{each['sd']:.{digits}f}"
                assert float(se[1:]) > 5 * 10**-digits  # two digits of the uncertainty, or nearly
                compared += 1
    assert compared == 2 * 4 * 6 + 4 * 4
    assert sum(len(row) - 3 for n in (1, 2) for row in tables[f"runs-sensor-{n}"][1:]) == compared


def as_shown(cell: str, number: float) -> bool:
    """Whether a cell shows a number to the digits that it has."""
    return cell == f"{round(number, digits := len(cell.partition('.')[2])) + 0.0:.{digits}f}"


@pytest.mark.slow
def test_the_means_of_table_1_are_those_of_the_runs(night: Path, page: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Both sensors, matrix and contractor's: the means of hil solve; published also the scatter of their two runs."""
    asked = {"matrix": [str(night)], "contractor": [str(night), "--model", "collins-4"]}
    models, means, compared = {model: solved(capsys, *of) for model, of in asked.items()}, {}, 0
    for model, of in asked.items():
        assert hil(["solve", *of, "--json"]) == 0
        means[model] = json.loads(capsys.readouterr().out)["repeats"]
    for sensor, rows_expected in ((2, 8), (1, 6)):
        head, count, *rows = Tables(page).found[f"means-sensor-{sensor}"]
        assert [cell[0] for cell in head[1:]] == ["20.0 °C", "30.0 °C"]
        assert count[1:] == [["2"], ["2"]]
        assert len(rows) == rows_expected
        published = rows_expected == 8
        for row in rows:
            name, _, model = row[0][0].partition(", ")
            runs = {s["run"]: s["parameters"] for s in models[model or "matrix"] if s["sensor"] == sensor}
            for place, ((mean, sd, *scatter), pair) in enumerate(zip(row[1:], ((1, 2), (3, 4)), strict=True)):
                one, two = (runs[n][name] for n in pair)  # type: ignore[index]
                told = means[model or "matrix"][str(sensor)]["means"][place]["parameters"][name]
                assert as_shown(mean, told["value"])
                assert as_shown(sd[1:], told["sd"])
                assert len(scatter) == published
                assert all(as_shown(s[2:], abs(one["value"] - two["value"]) / 2**0.5) for s in scatter)
                compared += 1
    assert compared == 2 * (8 + 6)


def test_the_scatter_is_that_of_hil_solve(night: Path, page: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Every parameter: from run to run, what standard errors leave of it, degrees of freedom."""
    tables = Tables(page).found
    capsys.readouterr()
    assert hil(["solve", str(night), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["repeats"]
    for sensor in (1, 2):
        own = found[str(sensor)]["run_to_run"]
        for row, (name, each) in zip(tables[f"scatter-sensor-{sensor}"][1:], own.items(), strict=True):
            assert row[0][0] == name
            assert as_shown(row[1][0], each["sd"])
            assert as_shown(row[2][0], each["beyond_standard_errors"])
            assert row[3] == [str(each["degrees_of_freedom"])]


def test_the_seven_biases_and_the_contractors_errors_are_those_of_hil_reproduce(
    night: Path, page: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Table A-1 row by row, and of each of the contractor's four the run in which it is worst."""
    tables = Tables(page).found
    capsys.readouterr()
    assert hil(["reproduce", str(night), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    for row, each in zip(tables["table-a-1-sensor-2"][1:], found["table_a1"], strict=True):
        numbers = [*each["biases_deg_per_hr"].values(), each["MUB_G1"], each["MUB_G3"], each["G3_over_G1"]]
        assert row[0] == [each["row"].removeprefix("run ")]
        assert all(as_shown(cell[0], number) for cell, number in zip(row[1:], numbers, strict=True))
    for row in tables["contractor-sensor-2"][1:]:
        name = row[0][0]
        worst = max(found["contractor_errors"], key=lambda each: abs(each["found"][name]))
        assert row[1] == [str(worst["run"])]
        numbers = [worst[how][name] for how in ("found", "closed_form", "g1_only")]
        assert all(as_shown(cell[0], number) for cell, number in zip(row[2:], numbers, strict=True))


def test_the_largest_term_that_is_left_out_is_that_of_hil_solve(
    night: Path, page: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The one number of the verdict, with the standard deviation of the mean."""
    runs = {s["run"]: s["parameters"] for s in solved(capsys, str(night)) if s["sensor"] == 2}
    means = {
        (name, pair): sum(runs[n][name]["value"] for n in pair) / 2  # type: ignore[index]
        for name in ("MUA", "MUB")
        for pair in ((1, 2), (3, 4))
    }
    name, pair = max(means, key=lambda each: abs(means[each]))
    sd = sum(runs[n][name]["sd"] ** 2 for n in pair) ** 0.5 / 2  # type: ignore[index]
    said = f"is {name} = {means[name, pair]:.1f} ±{sd:.1f} deg/hr/g".replace(" -", " −")
    assert said in page[: page.index("<nav")]
