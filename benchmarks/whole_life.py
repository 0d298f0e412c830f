"""What is asked of a unit's whole life must end: the published night, many times over, as one campaign.

python -m benchmarks.whole_life [--runs 3000]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from hil.campaign import Campaign
from hil.campaign.writer import write_campaign
from hil.config import load_bench, load_sweep
from hil.night import start_night
from hil.records.export import campaign_of_night

COMMANDS = ("solve", "thermal", "visibility", "report")


def life(night: Campaign, runs: int) -> Campaign:
    """Return the night again and again, ten hours between two, with other noise and another bias in each run."""
    rng, sensors = np.random.default_rng(1), {}
    for number, of in night.sensors.items():
        known, rows = of.conditions, len(of)
        last, times = int(known.run.max()), -(-runs // int(known.run.max()))
        again = np.repeat(np.arange(times), rows)
        whole = of.rows(np.tile(np.arange(rows), times))
        run = whole.conditions.run + again * last
        conditions = replace(
            whole.conditions,
            run=run,
            collect=whole.conditions.collect + again * 100_000,
            start_s=whole.conditions.start_s + again * (known.start_s.max() + 36_000.0),
        )
        shape = whole.rates_deg_per_hr.shape
        rates = whole.rates_deg_per_hr + rng.normal(0.0, 1.0, shape) + rng.normal(0.0, 3.0, shape)[run]
        sensors[number] = replace(whole, conditions=conditions, rates_deg_per_hr=rates).rows(run <= runs)
    return replace(night, sensors=sensors, recorded={}, verdicts={}, contradicted={}, title=f"{runs} runs of one unit")


def main() -> None:
    """Make the life, and ask."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--runs", type=int, default=3000)
    runs = options.parse_args().runs
    with tempfile.TemporaryDirectory() as folder:
        night, out = Path(folder) / "night", Path(folder) / "life"
        start_night(night, load_sweep("rd-gc-86-1"), load_bench("simulated"), who="benchmark")
        write_campaign(life(campaign_of_night(night), runs), out)
        for command in COMMANDS:
            began, asked = time.perf_counter(), [sys.executable, "-m", "hil", command, str(out)]
            process = subprocess.Popen(asked, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            _, status, used = os.wait4(process.pid, 0)
            print(
                f"hil {command}, {runs} runs: {time.perf_counter() - began:.1f} s, {used.ru_utime:.1f} s of processor "
                f"time, {used.ru_maxrss / 1e6:.2f} GB, status {os.waitstatus_to_exitcode(status)}"
            )


if __name__ == "__main__":
    main()
