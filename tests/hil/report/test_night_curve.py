"""The picture of a night is of what happened: every reading, also those between the journal's minutes."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from drivers.chambers.supervised import SupervisedChamber
from hil.config import parse_bench, parse_sweep
from hil.dashboard.facts import NightCurves
from hil.errors import Damaged
from hil.files.strict import find_config
from hil.night import start_night
from hil.records import reading
from hil.records.status import recorded_end
from hil.report.night import night_content
from tests.hil.report.report_pages import SWEEP


@pytest.fixture(scope="module")
def looked_at(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[float]]:
    """A run of twenty minutes with a step of 20 °C, looked at every two seconds, and what the chamber was read as."""
    sweep = SWEEP.replace("20 degC, 30 degC", "25 degC, 45 degC").replace("unit_band: 5", "unit_band: 30")
    sweep = sweep.replace("at_least: 10 min, window: 5 min", "at_least: 2 min, window: 1 min")
    sweep = sweep.replace("per_temperature: 2", "per_temperature: 1")
    bench = find_config("benches", "simulated").read_text()
    bench = bench.replace("interval: 30 s, read_interval: 30 s", "interval: 2 s, read_interval: 2 s")
    folder, readings = tmp_path_factory.mktemp("curve") / "night", []
    read = SupervisedChamber.read

    def noted(chamber: SupervisedChamber) -> object:
        found = read(chamber)
        readings.append(found.temperature_degC)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SupervisedChamber, "read", noted)
        assert start_night(folder, parse_sweep(sweep, "s"), parse_bench(bench, "b"), who="rk").state == "complete"
    return folder, readings


def test_the_curve_has_the_chambers_peak_and_its_steps(looked_at: tuple[Path, list[float]]) -> None:
    """The journal's marks, one a minute, clip the first and draw the second as a ramp."""
    folder, readings = looked_at
    with reading(folder) as journal:
        marks = [beat.readings["chamber_degC"] for beat in journal.heartbeats()]
    assert max(marks) < max(readings), "this night's peak is a mark: it shows nothing"
    night = night_content(folder)
    assert np.nanmax(night.temperatures["chamber"]) == max(readings)
    step = int(np.argmax(np.diff(night.temperatures["setpoint"])))
    assert 3600.0 * (night.hours[step + 1] - night.hours[step]) < 5.0


def test_report_and_live_page_draw_the_same_temperatures(looked_at: tuple[Path, list[float]]) -> None:
    """From one source: whatever is greatest or least on one is so on the other."""
    folder, _ = looked_at
    night, page = night_content(folder), NightCurves(folder)
    page.changes()
    shown = page.whole()["temperatures"]
    labels = {"chamber_degC": "chamber", "setpoint_degC": "setpoint", "unit_2_degC": "unit, sensor 2"}
    for name, label in labels.items():
        place, drawn = shown["columns"].index(name), night.temperatures[label]
        for extreme, side in ((np.nanmin, "least"), (np.nanmax, "greatest")):
            known = np.array(shown[side][place], dtype=float)
            assert extreme(known) == pytest.approx(extreme(drawn), abs=0.005)


@pytest.mark.slow
def test_a_trace_that_is_lost_or_cut_off_leaves_the_journals_minutes(
    looked_at: tuple[Path, list[float]], tmp_path: Path
) -> None:
    """It is not durable: what it lacks, the journal has."""
    copy = tmp_path / "night"
    shutil.copytree(looked_at[0], copy)
    whole = night_content(copy)
    trace = copy / "live.trace"
    data = trace.read_bytes()
    trace.write_bytes(data[: len(data) // 2])
    half = night_content(copy)
    trace.unlink()
    none = night_content(copy)
    assert len(whole.hours) > len(half.hours) > len(none.hours) > 15
    assert whole.temperatures.keys() == half.temperatures.keys() == none.temperatures.keys()
    for each in (half, none):
        assert each.hours[-1] == pytest.approx(whole.hours[-1], abs=61 / 3600)
    assert np.nanmax(none.temperatures["chamber"]) < np.nanmax(whole.temperatures["chamber"])


def test_a_trace_that_was_changed_is_not_drawn(looked_at: tuple[Path, list[float]], tmp_path: Path) -> None:
    """All of it is recorded with the verdict, its last row too; a bit anywhere is named, with what to do."""
    copy = tmp_path / "night"
    shutil.copytree(looked_at[0], copy)
    trace = copy / "live.trace"
    data = trace.read_bytes()
    with reading(copy) as journal:
        assert recorded_end(journal)["trace"]["size"] == len(data)
    for place in (30, len(data) // 2, len(data) - 1):
        trace.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        with pytest.raises(Damaged, match=r"live\.trace: is not what was written; without it"):
            night_content(copy)
    trace.unlink()
    assert night_content(copy).temperatures
