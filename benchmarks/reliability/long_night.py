"""A night of three days at 1 kHz: whether memory stays flat, the disk bounded, and journal and status fast.

    python -m benchmarks.reliability.long_night                        # 72 h at 1 kHz
    python -m benchmarks.reliability.long_night --hours 6 --rate 200   # a quick look

It prints one JSON document. `rss_mb` is the largest resident memory of the process so far at the end of each tenth of
the night; the part that the interpreter and its libraries take stands in `rss_at_start_mb`.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

from hil.config import Bench, Sweep, load_bench, parse_bench, parse_sweep
from hil.night import start_night
from hil.records import open_readonly
from hil.records.status import night_status
from hil.records.verify import verify_night
from procedures.plan import make_plan
from procedures.progress import Progress, Snapshot

_SWEEP = """
title: Three days
temperatures: [20 degC, 40 degC]
self_calibrations_per_temperature: 1
positions: [1, 2, 3]
restabilisation: {at_least: 45 min, window: 10 min, ceiling: 2 h}
collect: {settle: 60 s, duration: 60 s}
"""


def sweep_of(hours: float) -> Sweep:
    """Return a sweep that lasts about so many hours: as many self-calibrations at each temperature as it takes."""
    for number in range(1, 200):
        sweep = parse_sweep(_SWEEP.replace("per_temperature: 1", f"per_temperature: {number}"), "long.yaml")
        if make_plan(sweep.procedure()).total_s >= 3600.0 * hours:
            return sweep
    raise SystemExit("too long a night")


def bench_at(rate_hz: float) -> Bench:
    """Return the simulated bench with a unit that streams at this rate."""
    shipped = load_bench("simulated")
    text = shipped.text.replace("  description: mfs ", f"  rate: {rate_hz:g} Hz\n  description: mfs ")
    return parse_bench(text, shipped.source)


def rss_mb() -> float:
    """Return the largest resident memory of this process so far, without what its parent had."""
    (line,) = [each for each in Path("/proc/self/status").read_text().splitlines() if each.startswith("VmHWM")]
    return float(line.split()[1]) / 1024.0


class _Scale(Progress):
    """Weighs the process at the end of each tenth of the night."""

    def __init__(self, total_s: float) -> None:
        self._total_s = total_s
        self.seen: list[float] = []

    def update(self, snapshot: Snapshot) -> None:
        while len(self.seen) < int(10.0 * snapshot.elapsed_s / self._total_s):
            self.seen.append(round(rss_mb(), 1))


def measured(hours: float, rate_hz: float, folder: Path) -> dict[str, Any]:
    """Carry out the night in `folder` and return what it took."""
    sweep, bench = sweep_of(hours), bench_at(rate_hz)
    scale = _Scale(make_plan(sweep.procedure()).total_s)
    at_start_mb, began_s = rss_mb(), time.monotonic()
    outcome = start_night(folder, sweep, bench, onlookers=[scale])
    night_s = time.monotonic() - began_s
    with open_readonly(folder) as journal:
        simulated_s = journal.controllers()[-1].seen_s
        rows = len(journal.heartbeats()) + len(journal.events()) + len(journal.attempts())
        collects = len([1 for row in journal.blocks() if row.block.kind == "samples"])
    sizes = {path.name: path.stat().st_size for path in folder.rglob("*") if path.is_file()}
    return {
        "hours": round(simulated_s / 3600.0, 1),
        "rate_hz": rate_hz,
        "state": outcome.state,
        "collects": collects,
        "wall_s": round(night_s, 1),
        "times_real_time": round(simulated_s / night_s),
        "rss_at_start_mb": round(at_start_mb, 1),
        "rss_mb": scale.seen,
        "rss_at_end_mb": round(rss_mb(), 1),
        "disk_mb": round(sum(sizes.values()) / 1e6, 1),
        "disk_per_collect_mb": round(sum(sizes.values()) / 1e6 / max(collects, 1), 2),
        "journal_mb": round(sizes["journal.sqlite"] / 1e6, 2),
        "log_mb": round(sizes["log.jsonl"] / 1e6, 2),
        "journal_rows": rows,
        "status_s": round(min(_seconds(folder) for _ in range(3)), 3),
        "verify_complete": verify_night(folder)["complete"],
    }


def _seconds(folder: Path) -> float:
    began_s = time.monotonic()
    night_status(folder)
    return time.monotonic() - began_s


def main() -> None:
    """Measure one night and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=72.0)
    parser.add_argument("--rate", type=float, default=1000.0, help="samples a second")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hil-long-") as scratch:
        print(json.dumps(measured(asked.hours, asked.rate, Path(scratch) / "night"), indent=1))


if __name__ == "__main__":
    main()
