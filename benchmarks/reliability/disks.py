"""Nights on a disk that is really too small, read-only, or rots: a file system of a few hundred kilobytes in memory.

    unshare --map-root-user --mount python -m benchmarks.reliability.disks

It mounts, so it needs a mount namespace of its own, which `unshare` gives to anybody where the system allows that. For
every size the night ends with the disk full, somewhere else each time; it must end safely, say so, damage nothing, and
be carried on to its end once there is room. It prints one JSON document; the exit status is 1 where anything was wrong.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from benchmarks.reliability import nights
from hil.config import Bench, parse_bench
from hil.errors import InputError
from hil.night import resume_night, start_night
from hil.records.status import night_status
from hil.records.verify import verify_night
from procedures.plan import Step, StepKind
from procedures.progress import Progress
from procedures.stop import StopRequest

_SIZES_KB = range(240, 480, 20)
_ROOM_KB = 20_000
_MOUNT, _UMOUNT = "/bin/mount", "/bin/umount"


@cache
def bench() -> Bench:
    """The bench of the other nights, whose interlock lets a disk become as full as it can."""
    return parse_bench(f"{nights.bench().text}\ninterlocks: {{disk_low_mb: 0}}\n", "bench.yaml")


def mounted(folder: Path, options: str, *, again: bool = False) -> None:
    """Mount a file system in memory on `folder`, or change the one that is there."""
    subprocess.run(
        [_MOUNT, "-t", "tmpfs", "-o", f"{'remount,' if again else ''}{options}", "tmpfs", folder], check=True
    )


def too_small(folder: Path, size_kb: int, ended_full: list[int]) -> Iterator[str]:
    """Yield what is wrong with a night on a disk of so many kilobytes, and with its end once there is room."""
    mounted(folder, f"size={size_kb}k")
    night = folder / "night"
    try:
        outcome = start_night(night, nights.sweep(), bench(), who="first")
    except InputError as error:  # not even room to begin: then nothing may stand there
        if list(folder.iterdir()):
            yield f"refused ({error}), and left {[path.name for path in folder.iterdir()]}"
        return
    if outcome.state == "complete":
        return
    ended_full.append(size_kb)
    if "full" not in outcome.reason or outcome.exit_status in (5, 6):
        yield f"ended with {outcome.reason}"
    yield from _damage(night)
    mounted(folder, f"size={_ROOM_KB}k", again=True)
    again = resume_night(night, who="second")
    if again.state != "complete":
        yield f"carried on, it is {again.state}: {again.reason}"
    yield from (f"at the end, verify: {problem}" for problem in verify_night(night)["problems"])


def read_only(folder: Path) -> Iterator[str]:
    """Yield what is wrong with a night whose folder has become read-only: it can be read, and nothing else."""
    night = folder / "night"
    mounted(folder, "ro", again=True)
    if night_status(night)["state"] != "aborted":
        yield "the status of a night on a read-only disk is another"
    yield from _damage(night)
    try:
        outcome = resume_night(night)
        yield f"a night on a read-only disk was carried on: {outcome.state}"
    except (InputError, OSError):
        pass  # `hil` makes one sentence of either
    mounted(folder, "rw", again=True)
    if resume_night(night).state != "complete":
        yield "it could not be carried on when the disk was writable again"


def rotten(folder: Path) -> Iterator[str]:
    """Yield what is wrong where the last block of an unfinished night is damaged: it is seen, and done again."""
    night = folder / "night"
    last = max((night / "blocks").glob("*.parquet"), key=lambda path: path.name)
    data = bytearray(last.read_bytes())
    data[len(data) // 2] ^= 0x10
    last.write_bytes(data)
    if not any(last.name in problem for problem in verify_night(night)["problems"]):
        yield "verify did not see a damaged block"
    if resume_night(night).state != "complete":
        yield "a night with a damaged block could not be carried on"
    status = night_status(night)
    if status["state"] != "complete":
        yield f"after the damage was made good it is {status['state']}"
    left = [problem for problem in verify_night(night)["problems"] if last.name not in problem]
    yield from (f"after the damage was made good, verify: {problem}" for problem in left)


def _damage(night: Path) -> Iterator[str]:
    found = verify_night(night)["problems"]
    yield from (f"cut off, verify: {problem}" for problem in found if not problem.startswith("missing: "))


class _Stopper(Progress):
    """Somebody who stops a night at its second collect."""

    def __init__(self) -> None:
        self.stop = StopRequest()
        self._collects = 0

    def step_began(self, step: Step, attempt: int) -> None:
        del attempt
        self._collects += step.kind is StepKind.COLLECT
        if self._collects == 2:
            self.stop.request("that will do")


def cut_off(folder: Path) -> None:
    """Leave an unfinished night with some blocks in `folder`."""
    mounted(folder, f"size={_ROOM_KB}k")
    stopper = _Stopper()
    start_night(folder / "night", nights.sweep(), bench(), onlookers=[stopper], stop=stopper.stop)


def main() -> None:
    """Try every size, the read-only disk and the damaged block, and print what was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=1, help="only one size in so many")
    sizes = _SIZES_KB[:: parser.parse_args().every]
    wrong: list[str] = []
    ended_full: list[int] = []
    with tempfile.TemporaryDirectory(prefix="hil-disks-") as base:
        for size_kb in sizes:
            folder = Path(base) / f"{size_kb}k"
            folder.mkdir()
            problems = list(too_small(folder, size_kb, ended_full))
            wrong += [f"{size_kb} kB: {problem}" for problem in problems]
            subprocess.run([_UMOUNT, folder], check=True)
        for case in (read_only, rotten):
            folder = Path(base) / case.__name__
            folder.mkdir()
            cut_off(folder)
            wrong += [f"{case.__name__}: {problem}" for problem in case(folder)]
            subprocess.run([_UMOUNT, "-l", folder], check=True)
    print(json.dumps({"sizes": len(sizes), "ended_full_kB": ended_full, "problems": wrong}, indent=1))
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
