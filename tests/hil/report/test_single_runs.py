"""A campaign with one self-calibration at each temperature: nothing repeats, every number has its ±."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.cases import make_case, write_case
from hil.campaign.reader import read_campaign
from hil.cli.app import run
from hil.config.sweep import PUBLISHED
from hil.report.content import ReportContent, gather, largest, to_do
from hil.report.page import render
from hil.report.sensor_view import key_numbers, sensor_view
from tests.hil.audit.folders import written
from tests.hil.report.report_pages import Tables


def _without(folder: Path, left_out: set[str], *, errors: bool = True) -> ReportContent:
    """Leave out runs of the campaign, by number, and the standard errors."""
    path = folder / "collects.csv"
    rows = [line.split(",") for line in path.read_text().splitlines()]
    run, kept = rows[0].index("run"), [name for name in rows[0] if errors or "_se_" not in name]
    chosen = [row for row in rows if row[run] not in left_out]
    path.write_text("\n".join(",".join(row[rows[0].index(name)] for name in kept) for row in chosen) + "\n")
    return gather(read_campaign(folder), vocabulary=PUBLISHED)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Eight temperatures, three runs at each, as a folder."""
    return write_case(make_case(7, model="matrix-6-thermal"), tmp_path / "campaign")


REPEATED = {str(run) for run in range(1, 25) if run % 3 != 1}


@pytest.mark.slow
def test_one_run_at_each_temperature_has_its_standard_error_everywhere(folder: Path) -> None:
    """In Table 1, in the figures' bars and their words for ears, and in the sentence on the largest term."""
    content = _without(folder, REPEATED)
    sensor = content.sensors[0]
    assert [len(each.runs) for each in sensor.shown.means] == [1] * 8
    page = render(content)
    table = Tables(page).found["means-sensor-2"]
    label = {"BA, matrix": "BA", "MUB, matrix": "MUB", "BB, contractor": "BB"}
    for row in table:
        for solution, cell in zip(sensor.solutions, row[1:], strict=True) if row[0][0] in label else ():
            of = sensor.contractor[solution.run] if "contractor" in row[0][0] else solution
            shown = sensor.contractor_shown if "contractor" in row[0][0] else sensor.shown
            assert shown is not None
            found = shown.of_run(of)[label[row[0][0]]]
            assert cell == [f"{found.value:.2f}", f"±{found.sd:.2f}"]
    assert "no parameter was told twice at one temperature: what changes from run to run is not known" in page
    bars = [each for each in re.findall(r'aria-label="([^"]*)"', page) if "against temperature" in each]
    assert bars
    assert all(each.count(" ±") == each.count(" °C") for each in bars)
    (said,) = largest(content)
    assert re.search(r"= -?\d+\.\d ±\d+\.\d deg/hr/g at ", said)


@pytest.mark.slow
def test_where_only_some_were_repeated_the_scatter_stands_there_alone(folder: Path) -> None:
    """± means one thing in the whole row; the scatter of three has its own sign, and one run has none."""
    rows = sensor_view(_without(folder, {"2", "3"}).sensors[0])["table"]["rows"]
    (cells,) = (cells for label, _, cells in rows if label == "BA, matrix")
    assert [(error[0], [line[0] for line in below]) for _, error, below in cells] == [("±", []), *[("±", ["σ"])] * 7]


def test_a_mean_of_fewer_runs_says_so_and_which_of_them_are_doubtful(tmp_path: Path) -> None:
    """Of the runs at that temperature one is INCONCLUSIVE and tells GSB, but not MUA."""
    content = gather(read_campaign(written("one rate far off", tmp_path / "campaign")))
    view = sensor_view(content.sensors[0])
    (place,) = (k for k, (_, doubtful) in enumerate(view["table"]["runs"]) if doubtful)
    (mean,) = (each for each in content.sensors[0].shown.means if 5 in each.runs)
    below = {label: [lines for _, _, lines in cells] for label, _, cells in view["table"]["rows"]}
    for name, value in mean.values.items():
        others = [lines for at, lines in enumerate(below[name]) if at != place]
        assert below[name][place] == (["of 2 runs"] if value.runs == 2 else [])
        assert not any(others)
    assert {value.runs for value in mean.values.values()} == {2, 3}


def test_a_run_that_tells_nothing_stands_at_its_temperature(tmp_path: Path) -> None:
    """In no mean, and in the list of runs where it was made."""
    good = read_campaign(written("good", tmp_path / "campaign"))
    rates = good.sensors[2].rates_deg_per_hr.copy()
    rates[[4, 5]] = np.nan  # run 2
    content = gather(replace(good, sensors={2: replace(good.sensors[2], rates_deg_per_hr=rates)}))
    (sensor,) = content.sensors
    assert not any(2 in mean.runs for mean in sensor.shown.means)
    at = {run: where for run, where, *_ in sensor_view(sensor)["runs"]["rows"]}
    assert at["2"] == at["1"] == at["3"] != ""


@pytest.mark.slow
def test_where_nothing_tells_it_that_is_said(folder: Path) -> None:
    """Neither repeats nor standard errors."""
    asked = "State the standard errors of sensor 2, or repeat runs: no ± is known."
    assert asked not in to_do(_without(folder, REPEATED))
    content = _without(folder, REPEATED, errors=False)
    assert all(each.parameters["BA"].se is None for each in content.sensors[0].solutions)
    rows = {label: cells for label, _, cells in sensor_view(content.sensors[0])["table"]["rows"]}
    assert {error for _, error, _ in rows["BA, matrix"]} == {"± not known"}
    assert not any("±" in said for said in largest(content))
    assert asked in to_do(content)


def test_a_run_without_a_temperature_is_not_all_runs(folder: Path) -> None:
    """It stands by itself, and never in the place of the values nearest to room temperature."""
    path = folder / "collects.csv"
    rows = [line.split(",") for line in path.read_text().splitlines()]
    run, told = rows[0].index("run"), [k for k, name in enumerate(rows[0]) if name.endswith("_degC")]
    for row in rows[1:]:
        for column in told if row[run] == "14" else ():
            row[column] = ""
    path.write_text("\n".join(map(",".join, rows)) + "\n")
    sensors = gather(read_campaign(folder)).sensors
    heads = [at for at, _ in sensor_view(sensors[0])["table"]["heads"]]
    assert heads.count("no known temperature") == 1
    assert "all runs" not in heads
    ((_, nearest, *_),) = key_numbers(sensors)["heads"]
    assert "no known temperature" not in nearest


@pytest.mark.slow
@pytest.mark.parametrize("left_out", [set[str](), REPEATED])
def test_the_heading_of_hil_solve_claims_no_repeats_where_there_are_none(
    folder: Path, left_out: set[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """One run at each temperature: its ± has nothing of them."""
    _without(folder, left_out)
    run(["solve", str(folder)])
    said = capsys.readouterr().out
    assert ("± one standard deviation, what repeats show included" in " ".join(said.split())) is not bool(left_out)
    assert ("in no ±" in said) is bool(left_out)


@pytest.mark.slow
@pytest.mark.parametrize("left_out", [set[str](), REPEATED])
def test_the_first_table_of_a_report_claims_no_scatter_that_nothing_showed(folder: Path, left_out: set[str]) -> None:
    """Of single runs what changes from run to run is in no ±, and so it stands there."""
    page = render(_without(folder, left_out))
    assert ("scatter from run to run included." in page) is not bool(left_out)
    assert ("in which what changes from run to run is not" in page) is bool(left_out)
