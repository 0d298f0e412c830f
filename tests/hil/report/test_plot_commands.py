"""`hil plot`: what each picture holds, and what is said where there is nothing to draw."""

from __future__ import annotations

import logging
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks.blind.cases import make_case, write_case
from hil.campaign.reader import read_campaign
from hil.cli.app import run as hil
from hil.config import load_bench, parse_sweep
from hil.files.figure import save_figure
from hil.night import start_night
from hil.records.export import campaign_of_night, export_campaign
from hil.report.plots import collect_series, draw_parameters, draw_series, draw_temperatures

SWEEP = """
title: One temperature
temperatures: [25 degC]
self_calibrations_per_temperature: 1
positions: [1, 3]
restabilisation: {at_least: 10 min, window: 5 min, ceiling: 60 min, unit_band: 5 degC, unit_slope: 2 degC/min}
collect: {settle: 5 s, duration: 20 s, drift_limit: 200 deg/hr/min}
"""


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A night of one self-calibration with two collects."""
    folder = tmp_path_factory.mktemp("plotted") / "night"
    start_night(folder, parse_sweep(SWEEP, "one.yaml"), load_bench("simulated"), who="rk")
    return folder


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign folder of 8 temperatures, averages only."""
    return write_case(make_case(7, model="matrix-6-thermal"), tmp_path_factory.mktemp("campaign") / "c")


def labels(figure: Figure) -> list[str]:
    """Return the text of every axis that has data."""
    return [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text]


def test_a_collect_shows_its_samples_and_the_average_that_was_taken(night: Path) -> None:
    """20 s at 20 Hz, two channels and the thermometer; the line stands where `hil solve` begins."""
    series = collect_series(night, sensor=2, run=1, position="3")
    rows = campaign_of_night(night).sensors[2]
    assert series.series.rates_deg_per_hr.shape == (400, 2)
    assert 0.0 <= series.series.t_s[0] < series.series.t_s[-1] < 20.1
    assert [*series.means] == ["RA", "RB"]
    for place, (mean, se) in enumerate(series.means.values()):
        assert mean == rows.rates_deg_per_hr[1, place]
        assert np.nanmean(series.series.rates_deg_per_hr[:, place]) == pytest.approx(mean)
        assert se > 0.0
    figure = draw_series(series)
    assert labels(figure) == ["RA, deg/hr", "RB, deg/hr", "time since the collect began, s", "unit, °C"]
    for axes, (mean, _) in zip(figure.axes, series.means.values(), strict=False):
        assert np.mean(axes.lines[1].get_ydata()) == pytest.approx(mean, abs=1.0)  # the short means are its own
    assert figure.axes[0].get_title(loc="left") == "SIMULATED  One temperature, collect 4: sensor 2, run 1, position 3"


def test_a_campaign_folder_s_series_is_drawn_too(night: Path, tmp_path: Path) -> None:
    """Exported means instead of samples: the same average."""
    export_campaign(night, tmp_path / "c")
    exported, recorded = (collect_series(f, sensor=2, collect=2) for f in (tmp_path / "c", night))
    assert exported.means == recorded.means
    assert len(exported.series.t_s) < len(recorded.series.t_s)


def test_the_temperatures_of_a_night_are_drawn_with_soaks_and_collects(night: Path) -> None:
    """The legend names every line and mark."""
    figure = draw_temperatures(night)
    assert labels(figure) == ["time since the night began, hours", "temperature, °C"]
    shown = {str(line.get_label()) for line in figure.axes[0].get_lines()}
    assert {"setpoint", "chamber", "unit, sensor 1", "unit, sensor 2", "collect", "event"} <= shown


@pytest.mark.slow
def test_every_parameter_is_drawn_against_temperature_with_its_unit(campaign: Path) -> None:
    """Six panels, with a value at each of eight temperatures."""
    figure = draw_parameters(campaign, read_campaign(campaign), None)
    named = [each.partition(",")[0] for each in labels(figure) if "temperature" not in each]
    assert named == ["BA", "BB", "GSA", "GSB", "MUA", "MUB"]
    assert all("deg/hr" in each or "°C" in each for each in labels(figure))
    points = figure.axes[0].get_lines()[0].get_xdata()
    assert len(points) == 8  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        ["series", "--sensor", "2", "--collect", "2"],
        ["temperatures"],
    ],
)
def test_the_end_of_the_name_says_svg_or_png(night: Path, tmp_path: Path, arguments: list[str]) -> None:
    """Both of every picture of a night; the SVG has its text as text."""
    kind, *options = arguments
    for suffix in ("svg", "png"):
        assert hil(["plot", kind, str(night), *options, "--out", str(tmp_path / f"x.{suffix}")]) == 0
    # Whether it has a folder for its cache is no news for a technician.
    assert not logging.getLogger("matplotlib").isEnabledFor(logging.WARNING)
    assert "deg/hr" in (tmp_path / "x.svg").read_text() or "°C" in (tmp_path / "x.svg").read_text()
    picture = (tmp_path / "x.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert int.from_bytes(picture[16:20]) > 800  # its width


@pytest.mark.slow
def test_a_name_is_drawn_as_it_is(night: Path, campaign: Path, tmp_path: Path) -> None:
    """A dollar sign in a folder's name, or in a title, begins no formula."""
    odd = tmp_path / r"5$\foo$ _x^"
    shutil.copytree(night, odd)
    for command in (["plot", "temperatures", str(odd)], ["allan", str(odd), "--sensor", "2", "--channel", "RA"]):
        assert hil([*command, "--out", str(tmp_path / "odd.svg")]) == 0
        assert r"5$\foo$ _x^" in (tmp_path / "odd.svg").read_text()
    titled = replace(read_campaign(campaign), title=r"5$\foo$")
    save_figure(draw_parameters(campaign, titled, None), tmp_path / "parameters.svg")
    assert r"5$\foo$" in (tmp_path / "parameters.svg").read_text()
    figure = draw_series(replace(collect_series(night, sensor=2, run=1, position="3"), title=r"5$\foo$"))
    save_figure(figure, tmp_path / "series.svg")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["series"], "choose a sensor with --sensor; there are 1, 2"),
        (["series", "--sensor", "7"], "there is no sensor 7; there are 1, 2"),
        (["series", "--sensor", "2"], "choose one collect with --collect, or --run and --position; there are 2"),
        (["series", "--sensor", "2", "--collect", "99"], "sensor 2 has no such collect"),
        (["series", "--sensor", "2", "--run", "1", "--position", "2"], "runs 1, positions 1, 3"),
        (["parameters", "--sensor", "2"], "temperature"),
        (["series", "--out", "x.pdf"], "a plot is written as .svg or .png"),
        (["series", "--out", "no/x.svg"], "the folder no does not exist"),
    ],
)
def test_what_cannot_be_drawn_is_said_and_nothing_is_written(
    night: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    says: str,
) -> None:
    """Status 2, one sentence, with what there is to choose from."""
    monkeypatch.chdir(tmp_path)
    kind, *options = arguments
    options += [] if "--out" in options else ["--out", "x.svg"]
    assert hil(["plot", kind, str(night), *options]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert says in said
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


def test_averages_alone_have_no_series_and_a_campaign_has_no_night(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each says what is not there."""
    out = str(tmp_path / "x.svg")
    assert hil(["plot", "series", str(campaign), "--collect", "1", "--out", out]) == 2
    assert hil(["plot", "temperatures", str(campaign), "--out", out]) == 2
    assert hil(["plot", "series", str(tmp_path), "--out", out]) == 2
    said = " ".join(capsys.readouterr().err.split())
    for part in ("kept as an average only", "are in a night's folder", "neither a campaign folder"):
        assert part in said
