"""Nights that run out of memory in each step, or of file descriptors at all.

    python -m benchmarks.reliability.starved memory       # RLIMIT_AS, all of it taken but some kB, as a step begins
    python -m benchmarks.reliability.starved descriptors  # RLIMIT_NOFILE, from 4 to 40

Each night must end with a sentence or die as one that is killed, and then be carried on to its end by a process that
has enough, with sound records. It prints one JSON document; the exit status is 1 where anything was wrong.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import resource
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from benchmarks.reliability import nights
from benchmarks.reliability.kill import _in_fork
from hil.cli.app import run
from hil.night import resume_night, start_night
from hil.records.reader import JOURNAL_NAME
from hil.records.verify import verify_night
from procedures.plan import Step, make_plan
from procedures.progress import Progress

MARGINS_KB = (0, 16, 64, 256, 1024, 4096)  # of what is left
DESCRIPTORS = range(4, 41, 2)


class Starver(Progress):
    """Takes the memory away as a step begins."""

    def __init__(self, step: str, margin_kB: float) -> None:
        self._step, self._margin = step, int(margin_kB * 1e3)
        self._ballast: list[bytearray] = []

    def step_began(self, step: Step, attempt: int) -> None:
        """Allow no more than there is, and take what of it is free."""
        if (step.key, attempt) == (self._step, 1):
            margin = bytearray(self._margin)
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize(),) * 2)
            for size in (1 << 20, 1 << 16, 1 << 12, 1 << 9):
                with contextlib.suppress(MemoryError):
                    while True:
                        self._ballast.append(bytearray(size))
            del margin


def without_memory(night: Path, step: str, margin_kB: float) -> str:
    """Return how a night ends that has no more memory from this step on."""
    ended = start_night(night, nights.sweep(), nights.bench(), who="first", onlookers=[Starver(step, margin_kB)])
    return f"{ended.state}: {ended.reason}; {'NOT KNOWN to be safe' if ended.exit_status in (5, 6) else 'safe'}"


def without_descriptors(night: Path, most: int) -> str:
    """Return what `hil run` says, in one line, of a night with so many descriptors."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        resource.setrlimit(resource.RLIMIT_NOFILE, (most + 3, most + 3))  # three are this machine's own
        status = run(["run", "quick", "--bench", "simulated", "--out", str(night), "--quiet"])
    return f"{status}: {said.getvalue().strip().splitlines()[-1] if said.getvalue().strip() else 'nothing'}"


def judged(what: str, night: Path, work: Callable[[], str], ends: Counter[str]) -> list[str]:
    """Return what is wrong with a starved night, and with its end once there is enough."""
    try:
        said = str(_in_fork(work))
    except SystemExit:  # died without a word, as one that is killed
        said = "died"
    ends[said.split(":")[0]] += 1
    wrong = [f"it said: {said}"] if "internal error" in said or "Traceback" in said else []
    if (night / JOURNAL_NAME).exists():
        wrong += [each for each in verify_night(night)["problems"] if not each.startswith("missing: ")]
        again = resume_night(night)
        wrong += [] if again.state == "complete" else [f"carried on, it is {again.state}: {again.reason}"]
        wrong += verify_night(night)["problems"]
        shutil.rmtree(night)
    elif night.exists():
        wrong.append("a folder without a night was left")
    return [f"{what}: {each}" for each in wrong]


def main() -> None:
    """Starve nights, and print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("memory", "descriptors"))
    parser.add_argument("--steps", nargs="*", help="only these")
    parser.add_argument("--every", type=int, default=1, help="only one number of descriptors in so many")
    asked = parser.parse_args()
    wrong, ends, tried = list[str](), Counter[str](), 0
    with tempfile.TemporaryDirectory(prefix="hil-starved-") as scratch:
        nights.warm_up(Path(scratch))
        steps = asked.steps or [step.key for step in make_plan(nights.sweep().procedure()).steps]
        cases: list[tuple[str, float]] = [(step, margin) for step in steps for margin in MARGINS_KB]
        if asked.what == "descriptors":
            cases = [("descriptors", most) for most in DESCRIPTORS[:: asked.every]]
        for name, size in cases:
            night, tried = Path(scratch) / f"night-{tried}", tried + 1

            def work(night: Path = night, name: str = name, size: float = size) -> str:
                os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
                return (
                    without_memory(night, name, size)
                    if name != "descriptors"
                    else without_descriptors(night, int(size))
                )

            wrong += judged(f"{name} {size:g}", night, work, ends)
    print(json.dumps({"tried": tried, "ends": ends, "problems": wrong}, indent=1, ensure_ascii=False))
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
