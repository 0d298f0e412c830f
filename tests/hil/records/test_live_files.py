"""What a running controller shows to other processes, and what becomes of it when something goes wrong."""

from __future__ import annotations

import json
import math
import shutil
from datetime import UTC, datetime

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.frames.counts import StreamCounts
from drivers.frames.roles import SensorRole
from hil.records.live import LIVE_NAME, TRACE_NAME, LiveFiles, TraceReader, read_live
from hil.records.units import unit_folder
from procedures.plan import Step, StepKind
from procedures.progress import Snapshot

SENSORS = {2: SensorRole(rates={"RA": "s2_ra"}, temperature="s2_t")}
STEP = Step(5, "T1/S1/C2/collect", StepKind.COLLECT, 0.0, 60.0, 23.4, 1, "2")
COLUMNS = ["t_s", "chamber_degC", "setpoint_degC", "unit_2_degC", "2.RA", "2.RA mean", "2.RA se"]


def seen(elapsed_s: float, **changes: object) -> Snapshot:
    """The state of a collect at one poll."""
    known = {
        "chamber_degC": 23.5,
        "setpoint_degC": 23.4,
        "unit_degC": {2: 31.0},
        "rates_now_deg_per_hr": {"2.RA": 11.5},
        "rates_deg_per_hr": {"2.RA": 12.0},
        "rates_se_deg_per_hr": {"2.RA": 0.5},
        "stream": StreamCounts(ok=1000, lost=2),
    }
    return Snapshot(STEP, 1, elapsed_s, 20.0, 40.0, datetime(2026, 3, 1, tzinfo=UTC), **(known | changes))


@pytest.fixture
def clock():
    """Real time, as far as the test lets it pass."""
    return VirtualClock()


def writer(folder, clock):
    """Return what writes both files."""
    return LiveFiles(folder, SENSORS, every_s=0.5, clock=clock)


def test_the_newest_state_and_a_row_for_every_second_can_be_read_while_the_night_runs(tmp_path, clock) -> None:
    """Another process sees everything that the terminal shows, a second later at the most."""
    files, trace = writer(tmp_path, clock), TraceReader(tmp_path)
    for second in range(5):
        files.update(seen(100.0 + second))
        clock.sleep(1.0)
    state = read_live(tmp_path)
    assert state["elapsed_s"] == 104.0
    assert state["step"] == STEP.key
    assert state["rates_se_deg_per_hr"] == {"2.RA": 0.5}
    assert state["stream"]["lost"] == 2
    rows = trace.read()
    assert trace.columns == COLUMNS
    assert rows[:, 0].tolist() == [100.0, 101.0, 102.0, 103.0, 104.0]
    assert rows[0, 1:].tolist() == pytest.approx([23.5, 23.4, 31.0, 11.5, 12.0, 0.5])
    assert len(trace.read()) == 0
    files.close()


def test_every_unit_sees_its_own_snapshots_only(tmp_path, clock) -> None:
    """What one unit reads never stands in another's folder."""
    units = {name: LiveFiles(tmp_path, SENSORS, every_s=0.5, unit=name, clock=clock) for name in ("a", "b")}
    for files in units.values():
        files.update(seen(100.0, unit="a"))
        files.update(seen(101.0, unit="b"))
        files.close()
    assert [read_live(unit_folder(tmp_path, name))["elapsed_s"] for name in units] == [100.0, 101.0]


def test_a_night_that_jumps_writes_its_state_by_real_time_and_its_trace_by_the_nights(tmp_path, clock) -> None:
    """A simulated night of hours costs a handful of replaced files; polls that crowd cost no rows."""
    files = writer(tmp_path, clock)
    files.update(seen(1.0))
    first = (tmp_path / LIVE_NAME).stat().st_mtime_ns
    for poll in range(100):
        files.update(seen(2.0 + 0.1 * poll))
    assert (tmp_path / LIVE_NAME).stat().st_mtime_ns == first
    files.close()
    assert read_live(tmp_path)["elapsed_s"] == pytest.approx(11.9)
    assert len(TraceReader(tmp_path).read()) == 11


def test_a_resumed_night_goes_on_after_half_a_row_that_a_killed_controller_left(tmp_path, clock) -> None:
    """Rows stay rows: what is torn is cut off."""
    files = writer(tmp_path, clock)
    files.update(seen(1.0))
    files.close()
    with (tmp_path / TRACE_NAME).open("ab") as file:
        file.write(b"\x01\x02\x03")
    trace = TraceReader(tmp_path)
    assert len(trace.read()) == 1
    resumed = writer(tmp_path, clock)
    resumed.update(seen(50.0))
    resumed.close()
    assert trace.read()[:, 0].tolist() == [50.0]


def test_what_is_not_known_is_a_gap_and_never_a_number(tmp_path, clock) -> None:
    """Before the chamber has answered, and between collects, there is nothing to draw."""
    files = writer(tmp_path, clock)
    nothing = {"unit_degC": {}, "rates_now_deg_per_hr": {}, "rates_deg_per_hr": {}, "rates_se_deg_per_hr": {}}
    files.update(seen(1.0, chamber_degC=None, setpoint_degC=None, **nothing))
    files.close()
    row = TraceReader(tmp_path).read()[0]
    assert math.isnan(row[1])
    assert np.isnan(row[1:]).all()


def test_another_units_trace_is_begun_anew_and_its_reader_notices(tmp_path, clock) -> None:
    """Columns that do not fit are not mixed."""
    (tmp_path / TRACE_NAME).write_bytes(json.dumps({"columns": ["t_s", "other"]}).encode() + b"\n" + bytes(800))
    trace = TraceReader(tmp_path)
    assert trace.read().shape == (100, 2)
    files = writer(tmp_path, clock)
    files.update(seen(7.0))
    files.close()
    assert trace.read()[:, 0].tolist() == [7.0]
    assert trace.begun_anew


def test_a_disk_that_is_full_ends_the_showing_and_nothing_else(tmp_path, clock) -> None:
    """Onlookers see old data, and the night goes on."""
    gone = tmp_path / "gone"
    gone.mkdir()
    files = writer(gone, clock)
    shutil.rmtree(gone)  # as little can be written there as to a disk that is full
    files.update(seen(1.0))
    files.update(seen(2.0))
    files.close()
    assert read_live(gone) is None


def test_no_trace_and_a_damaged_state_are_nothing_to_see(tmp_path) -> None:
    """A night that was just made, or that another version wrote."""
    assert read_live(tmp_path) is None
    assert TraceReader(tmp_path).read().size == 0
    for text in ("{", "[]", '{"schema": "other"}'):
        (tmp_path / LIVE_NAME).write_text(text)
        assert read_live(tmp_path) is None
