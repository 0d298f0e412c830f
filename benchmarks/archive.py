"""How long an archive takes to answer: a hundred units, ten years, a calibration every month or so.

    python -m benchmarks.archive [--every 3]      # months between two calibrations

The index is filled with the numbers that the published night has, 96 means for each calibration: drawn, not solved.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from hil.archive.index import Entry, connected
from hil.archive.places import ENTRY, INDEX_NAME, MARK, folder_of, stamp

UNITS, MONTHS = 100, 120
TEMPERATURES = (-29.7, -14.4, -6.8, 6.3, 23.4, 37.8, 48.9, 60.0)
NAMES = {"BA": "deg/hr", "BB": "deg/hr", "GSA": "deg/hr/g", "GSB": "deg/hr/g", "MUA": "deg/hr/g", "MUB": "deg/hr/g"}


def fill(archive: Path, every: int) -> int:
    """Make the folders and the index; return how many calibrations there are."""
    archive.mkdir()
    (archive / MARK).write_text("schema: hil.archive/1\n")
    rng, count = np.random.default_rng(1), 0
    with connected(archive / INDEX_NAME, new=True) as connection, connection:
        connection.execute("BEGIN IMMEDIATE")
        for number in range(UNITS):
            serial = f"{number:04d}"
            for month in range(0, MONTHS, every):
                began = datetime(2016, 1, 1, tzinfo=UTC) + timedelta(days=30.44 * month)
                name = f"{folder_of(serial)}/{began:%Y%m%dT%H%MZ}-{count:012x}"
                (archive / name).mkdir(parents=True)
                (archive / name / ENTRY).write_text("")
                entry = Entry(
                    name, stamp(archive, name), serial, "", "MFS-IMU", False, began.isoformat(), began.isoformat()
                )
                told = {**vars(entry), "title": "a night", "verdict": "PASS", "good": True, "collects": 144}
                marks = ", ".join(f":{each}" for each in told)
                connection.execute(f"INSERT INTO entries ({', '.join(told)}) VALUES ({marks})", told)  # noqa: S608
                rows = [
                    (name, sensor, parameter, at, at, rng.normal(0.01 * month, 1.5), 1.5, 16.0, 3, unit)
                    for sensor in (1, 2)
                    for at in TEMPERATURES
                    for parameter, unit in NAMES.items()
                ]
                connection.executemany(f"INSERT INTO means VALUES ({', '.join('?' * 10)})", rows)  # noqa: S608
                count += 1
    return count


def main() -> None:
    """Fill an archive and ask it."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--every", type=int, default=3)
    every = options.parse_args().every
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "archive"
        count = fill(archive, every)
        size = (archive / INDEX_NAME).stat().st_size / 1e6
        print(f"{UNITS} units, {count} calibrations, index {size:.0f} MB")
        for command in (["--version"], ["units"], ["history", "0042"], ["history", "0042", "--limits", "rd-gc-86-1"]):
            asked = [sys.executable, "-m", "hil", *command]
            best, used = math.inf, math.inf
            for _ in range(3):
                began, before = time.perf_counter(), os.times().children_user
                subprocess.run(
                    asked, env={**os.environ, "HIL_ARCHIVE": str(archive)}, check=True, stdout=subprocess.DEVNULL
                )
                best = min(best, time.perf_counter() - began)
                used = min(used, os.times().children_user - before)
            print(f"hil {' '.join(command)}: {best:.2f} s, of which {used:.2f} s of processor time")


if __name__ == "__main__":
    main()
