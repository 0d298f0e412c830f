"""A computer that goes to sleep, or a process that is stopped, for an hour in the middle of each step of a night.

    python -m benchmarks.reliability.suspend                 # every step, an hour
    python -m benchmarks.reliability.suspend --hours 0.2    # twelve minutes

A tenth, half and nine tenths through a step nothing happens for that long: the clock goes on (`SystemClock` counts a
suspended computer as well as a stopped process), nobody reads the stream, nobody commands the chamber, nobody beats.
The night must end safely, say that nobody looked, call no average over the gap good, and begin the soak again. It
prints one JSON document; the exit status is 1 where anything was silent.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.reliability import nights
from hil.bench import LiveBench
from hil.config import parse_sweep
from hil.night import start_night
from hil.records import open_readonly
from hil.records.verify import verify_night
from procedures.plan import Step
from procedures.progress import Progress

SWEEP = parse_sweep(nights._SWEEP.replace("ceiling: 60 min", "ceiling: 3 h"), "suspended.yaml")
SHARES = (0.1, 0.5, 0.9)  # of each step


class Sleeper(Progress):
    """Lets the night's clock jump by `seconds` when it passes an instant, `at_s` after a step has begun."""

    def __init__(self, step: str, at_s: float, seconds: float) -> None:
        self._step, self._after_s, self._seconds = step, at_s, seconds
        self._at_s = math.inf

    def open(self, live: LiveBench) -> None:
        """Stand between the night and its clock."""
        self._clock, self._sleep = live.devices.clock, live.devices.clock.sleep
        live.devices.clock.sleep = self.sleep  # type: ignore[method-assign]

    def step_began(self, step: Step, attempt: int) -> None:
        """Set the alarm."""
        if (step.key, attempt) == (self._step, 1):
            self._at_s = self._clock.now() + self._after_s

    def sleep(self, seconds: float) -> None:
        """Sleep as asked, or an hour longer."""
        self._sleep(seconds)
        if self._clock.now() >= self._at_s:
            self._at_s = math.inf
            self._sleep(self._seconds)


def suspended(base: Path, key: str, share: float, lasts_s: float, seconds: float) -> dict[str, Any]:
    """Return what became of a night that slept so far into this step: how it ended, what was said, what is wrong."""
    sleeper, night = Sleeper(key, share * lasts_s, seconds), base / f"{key.replace('/', '_')}-{share}"
    ended = start_night(night, SWEEP, nights.bench(), who="first", onlookers=[sleeper], opened=sleeper.open)
    with open_readonly(night) as journal:
        said = [each.message for each in journal.events() if each.kind == "nobody-looked"]
        attempts = [each for each in journal.attempts() if each.step_key == key]
        collects = [each for each in journal.attempts() if "n_samples" in each.data]
        soaks = [each for each in attempts if each.step_key.endswith("restabilise")]
    wrong = [each for each in verify_night(night)["problems"] if not each.startswith("missing: ")]
    wrong += [] if said or key == "safe-state" else ["nobody said that nobody had looked"]
    wrong += ["the chamber was left as it was"] if ended.exit_status in (5, 6) else []
    for each in collects:
        if each.data["duration_s"] > seconds and each.data["verdict"] not in ("INCONCLUSIVE", "FAIL"):
            wrong.append(f"{each.step_key} was averaged over the gap")
    for each in soaks:
        if (each.ended_s or 0.0) - each.began_s < seconds + SWEEP.restabilisation.at_least_s:
            wrong.append("the soak counted the time in which nobody looked")
    return {
        "ended": f"{ended.state}: {ended.reason}",
        "said": said,
        "attempts": [f"{each.outcome}: {each.reason}"[:160] for each in attempts],
        "wrong": wrong,
    }


def main() -> None:
    """Sleep in each step and print what became of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--shares", type=float, nargs="*", default=SHARES, help="how far into each step")
    parser.add_argument("--all", action="store_true", help="print every night, not only what was wrong")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hil-suspend-") as base:
        start_night(Path(base) / "undisturbed", SWEEP, nights.bench(), who="first")
        with open_readonly(Path(base) / "undisturbed") as journal:
            lasted = {each.step_key: (each.ended_s or 0.0) - each.began_s for each in journal.attempts()}
        found = {
            f"{key} at {share:.0%}": suspended(Path(base), key, share, lasts_s, 3600.0 * asked.hours)
            for key, lasts_s in lasted.items()
            for share in asked.shares
        }
    wrong = [f"{key}: {each}" for key, what in found.items() for each in what["wrong"]]
    print(json.dumps({"nights": len(found), "found": found if asked.all else {}, "problems": wrong}, indent=1))
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
