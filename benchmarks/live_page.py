"""What one update of the live page costs with a long night behind it: time of the server's part, bytes, memory.

.venv/bin/python benchmarks/live_page.py [HOURS ...]     # 1, 15 and 72 where none is given
"""

from __future__ import annotations

import os
import resource
import statistics
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from drivers.clock import SystemClock, VirtualClock
from drivers.frames.roles import SensorRole
from hil.dashboard.watcher import Watcher
from hil.records import SqliteJournal
from hil.records.live import TRACE_NAME, LiveFiles, trace_columns
from hil.records.rows import Night
from procedures.plan import Step, make_plan
from procedures.progress import Snapshot
from procedures.settings import SweepProcedure

SENSORS = {number: SensorRole(rates={"RA": "a", "RB": "b"}, temperature="t") for number in (1, 2)}
UPDATES = 120


def main() -> None:
    """Print a line for every length of night."""
    print("hours  opening, ms  update, ms (median, slowest)  bytes of an update  of everything  process, MB")
    for hours in [float(each) for each in sys.argv[1:]] or [1.0, 15.0, 72.0]:
        with tempfile.TemporaryDirectory() as folder:
            print(measured(Path(folder), hours))


def measured(folder: Path, hours: float) -> str:
    """Return the line of a night of so many hours, which a controller in this process goes on with."""
    clock, wall = VirtualClock(), SystemClock()
    plan = make_plan(SweepProcedure(title="A long night", temperatures_degC=(20.0,)))
    SqliteJournal.create(folder, plan, Night(plan.title, "benchmark", clock.utc(), True, ""))
    with SqliteJournal.open(folder, clock=clock) as journal:
        journal.begin(plan.steps[0])
        LiveFiles(folder, SENSORS, every_s=0.5).close()
        seconds = round(3600 * hours)
        rows = np.random.default_rng(1).normal(20.0, 1.0, (seconds, len(trace_columns(SENSORS)))).astype("<f4")
        rows[:, 0] = np.arange(seconds)
        with (folder / TRACE_NAME).open("ab") as trace:
            trace.write(rows.tobytes())
        files, watcher = LiveFiles(folder, SENSORS, every_s=0.5, clock=clock), Watcher(folder)
        began_s = wall.now()
        watcher.frame(watcher.look())
        opening_s = wall.now() - began_s
        took_s, sizes = [], []
        for second in range(UPDATES):
            clock.sleep(1.0)  # so that what was traced is written out
            files.update(during(plan.steps[0], seconds + float(second)))
            journal.heartbeat(plan.steps[0], {"chamber_degC": 20.0})  # so that the journal is read anew each time
            began_s = wall.now()
            sizes.append(len(watcher.frame(watcher.look())))
            took_s.append(wall.now() - began_s)
        files.close()
        everything = len(watcher.frame(watcher.whole()))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    typical, slowest = 1000.0 * statistics.median(took_s), 1000.0 * max(took_s)
    return (
        f"{hours:5.0f}  {1000.0 * opening_s:11.0f}  {typical:14.1f}, {slowest:12.1f}  "
        f"{statistics.median(sizes):18.0f}  {everything:13d}  {memory:11.0f}"
    )


def during(step: Step, elapsed_s: float) -> Snapshot:
    """Return what a controller shows in the midst of a collect."""
    rates = {f"{number}.{channel}": 12.0 for number in SENSORS for channel in ("RA", "RB")}
    shows = {"rates_deg_per_hr": rates, "rates_se_deg_per_hr": rates, "rates_now_deg_per_hr": rates}
    end = datetime(1985, 10, 2, 12, tzinfo=UTC)
    return Snapshot(step, 1, elapsed_s, 10.0, 50.0, end, 19.9, 20.0, {1: 21.0, 2: 22.0}, **shows)


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main()
