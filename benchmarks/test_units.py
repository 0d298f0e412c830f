"""Sixteen units in one chamber: the published night on the virtual clock, and a real-time night over pseudo-terminals.

    pytest benchmarks/test_units.py -s

The units of the second are simulated by a process of their own, at 100 Hz each, behind sixteen terminals and a
seventeenth for the chamber; the controller opens them as it opens serial ports. No frame may be missing.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil.config import load_bench, load_sweep, parse_bench, parse_sweep
from hil.night import start_night
from hil.records import open_readonly
from procedures.plan import StepKind
from tests.hil.twin.serving import client_bench

_UNITS = 16
_SWEEP = """
title: Sixteen units in real time
temperatures: [23 degC]
self_calibrations_per_temperature: 1
positions: ["1", "2", "3"]
restabilisation: {at_least: 20 s, window: 10 s, ceiling: 30 s}
collect: {settle: 5 s, duration: 20 s}
"""


def _bench(rate: str = "") -> str:
    listed = "".join(
        f'  - {{model: MFS-IMU, serial: "{n:04d}", port: "sim://imu"{rate}}}\n' for n in range(1, _UNITS + 1)
    )
    return re.sub(r"^unit: .*$", f"units:\n{listed}", load_bench("simulated").text, flags=re.M)


@pytest.mark.timeout(900)
def test_the_published_night_of_sixteen_units(tmp_path: Path) -> None:
    """Eight temperatures, three self-calibrations at each, sixteen units: bytes to verdicts."""
    bench = parse_bench(_bench(), load_bench("simulated").source)
    begins, used = time.perf_counter(), time.process_time()
    ended = start_night(tmp_path / "night", load_sweep("rd-gc-86-1"), bench)
    elapsed, used = time.perf_counter() - begins, time.process_time() - used
    print(f"\nthe published night of {_UNITS} units: {elapsed:.1f} s, {used:.1f} s of processor time")
    assert ended.exit_status == 0


@pytest.mark.timeout(600)
def test_sixteen_units_at_100_hz_lose_no_byte(tmp_path: Path) -> None:
    """The share of one core that the controller takes, soak and collects, on the system clock."""
    path = tmp_path / "bench.yaml"
    path.write_text(_bench(", rate: 100 Hz"))
    with subprocess.Popen([sys.executable, "-m", "hil", "simulate", str(path)], stdout=subprocess.PIPE) as devices:
        try:
            assert devices.stdout is not None
            ports = json.loads(devices.stdout.readline())["ports"]
            bench = client_bench(parse_bench(path.read_text(), str(path)), ports)
            begins, used = time.perf_counter(), time.process_time()
            ended = start_night(tmp_path / "night", parse_sweep(_SWEEP, "sweep.yaml"), bench)
            elapsed, used = time.perf_counter() - begins, time.process_time() - used
        finally:
            devices.terminate()
    with open_readonly(tmp_path / "night") as journal:
        done = journal.completed()
        collects = [done[step.key].data for step in journal.plan.of_kind(StepKind.COLLECT)]
    print(f"\n{_UNITS} units at 100 Hz: {100 * used / elapsed:.0f} % of a core over {elapsed:.0f} s")
    assert ended.exit_status == 0
    counts = [each["counts"] for each in collects]
    assert len(counts) == 3 * _UNITS
    for name in ("lost", "bad_checksum", "bad_delimiter", "unknown_id", "skipped_bytes", "overflow_bytes"):
        assert not any(each[name] for each in counts), name
