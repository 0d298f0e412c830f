"""Kill a night at every place where it can be killed, carry it on, and say what was lost: it must be nothing.

    python -m benchmarks.reliability.kill points             # SIGKILL before every system call that changes a file
    python -m benchmarks.reliability.kill points --on journal.sqlite  # … of one file: while the log is emptied
    python -m benchmarks.reliability.kill twice --take 300   # … and again somewhere in the resume
    python -m benchmarks.reliability.kill resuming           # … in the middle, and before each one of the resume
    python -m benchmarks.reliability.kill instants --take 200 --seed 1
    python -m benchmarks.reliability.kill power --take 1000 --seed 1

It forks from a process that has everything loaded and runs no threads, one night at a time, and prints one JSON
document; the exit status is 1 where anything was found. `--mutation` breaks the program on purpose; `--until` ends
where that was found.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.reliability import nights
from benchmarks.reliability.mutations import MUTATIONS
from benchmarks.reliability.power import everything, renamed_before_safe, survivors, write_tree
from benchmarks.reliability.tracing import Trace, traceable, traced
from hil.records.verify import verify_night

_NEVER_RECORDED = "-shm"  # SQLite's index of its log: mapped memory, made anew at need


@dataclass
class Findings:
    """What a campaign of kills found.

    `outlived` counts nights that were over before their kill: the heartbeat is written by the wall clock, so that a
    night on a busier machine has some operations more.
    """

    kind: str
    kills: int = 0
    outlived: int = 0
    resumed: int = 0
    states: int = 0
    operations: int = 0
    problems: list[str] = field(default_factory=list)


class FoundOut(Exception):
    """The problem that was looked for was found."""


class Killer:
    """Kills nights below `base`. `only_new` carries on only from states of journal and files not seen before.

    Raises `FoundOut` at the first problem in whose words `until` is found.
    """

    def __init__(self, base: Path, mutation: str, *, only_new: bool = False, until: str | None = None) -> None:
        self._base = base
        self._mutate = MUTATIONS[mutation]
        self._until = until
        self._only_new = only_new
        self._seen: set[str] = set()
        nights.warm_up(base)
        with self._root() as root:
            self.trace = traced(self._mutated(nights.begin, root), root)
            if self.trace.status != 0:
                raise SystemExit("the undisturbed night did not become complete")
            self._actual = {
                str(path.relative_to(root)): path.read_bytes() if path.is_file() else None
                for path in root.rglob("*")
                if not path.name.endswith(_NEVER_RECORDED)
            }
            self.reference = _in_fork(lambda: nights.parameters(root / nights.NIGHT))

    def unrecorded(self) -> Iterator[str]:
        """Yield what the recorded operations do not explain: an instrument that misses something finds nothing."""
        told = {
            path: data for path, data in everything(self.trace.operations).items() if not path.endswith(_NEVER_RECORDED)
        }
        for path in sorted({*told, *self._actual}):
            if told.get(path, b"?") != self._actual.get(path, b"?"):
                yield f"{path}: the recorded operations do not give its contents"

    def points(self, chosen: Sequence[int], findings: Findings) -> None:
        """Kill before each of the chosen operations."""
        for point in chosen:
            with self._root() as root:
                trace = traced(self._mutated(nights.begin, root), root, kill_at=point)
                self._killed(trace, point, findings)
                self._judge(root, f"killed before {self.trace.operations[point]}", findings)

    def twice(self, chosen: Sequence[int], findings: Findings, draw: random.Random) -> None:
        """Kill before each of the chosen operations, and again at a random operation of the resume."""
        for point in chosen:
            with self._root() as root:
                self._killed(traced(self._mutated(nights.begin, root), root, kill_at=point), point, findings)
                second = draw.randrange(len(self.trace.operations))
                trace = traced(self._mutated(nights.carry_on, root), root, kill_at=second)
                what = f"killed before {self.trace.operations[point]}, and at operation {second} of the resume"
                if trace.status not in (0, -signal.SIGKILL):
                    findings.problems.append(f"{what}: the resume ended with status {trace.status}")
                self._judge(root, what, findings)

    def resuming(self, take: int | None, findings: Findings, draw: random.Random) -> None:
        """Kill once in the middle of the night, and again before each operation of its resume, or `take` of them."""
        middle, chosen = len(self.trace.operations) // 2, [-1]
        while chosen:
            with self._root() as root:
                second = chosen.pop()
                self._killed(traced(self._mutated(nights.begin, root), root, kill_at=middle), middle, findings)
                trace = traced(self._mutated(nights.carry_on, root), root, kill_at=None if second < 0 else second)
                if second < 0:
                    chosen = list(range(len(trace.operations)))
                    chosen = chosen if take is None else draw.sample(chosen, min(take, len(chosen)))
                    continue
                what = f"killed in the middle, and at operation {second} of the resume"
                if trace.status not in (0, -signal.SIGKILL):
                    findings.problems.append(f"{what}: the resume ended with status {trace.status}")
                self._judge(root, what, findings)

    def instants(self, count: int, findings: Findings, draw: random.Random) -> None:
        """Kill at random instants of the wall clock."""
        with self._root() as root:
            began_s = time.monotonic()
            os.waitpid(_fork(self._mutated(nights.begin, root)), 0)
            whole_s = time.monotonic() - began_s
        for _ in range(count):
            with self._root() as root:
                after_s = draw.uniform(0.0, whole_s)
                child = _fork(self._mutated(nights.begin, root))
                time.sleep(after_s)
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
                findings.kills += 1
                self._judge(root, f"killed after {1000.0 * after_s:.0f} ms", findings)

    def power(self, count: int, findings: Findings, draw: random.Random) -> None:
        """Rebuild what a power failure may leave at random operations, and carry on from it."""
        operations = self.trace.operations
        early = (each for each in renamed_before_safe(operations) if not nights.is_shown(each.split()[0]))
        findings.problems += early
        for _ in range(count):
            point, seed = draw.randrange(len(operations) + 1), draw.randrange(1 << 30)
            with self._root() as root:
                write_tree(survivors(operations[:point], random.Random(seed)), root)
                log = everything(operations[:point]).get(f"{nights.NIGHT}/log.jsonl") or b""
                findings.kills += 1
                self._judge(root, f"power lost at operation {point} ({seed})", findings, log)

    def _killed(self, trace: Trace, point: int, findings: Findings) -> None:
        if trace.status == 0 and len(trace.operations) <= point:
            findings.outlived += 1
            return
        findings.kills += 1
        if trace.status != -signal.SIGKILL:
            findings.problems.append(f"the child was to be killed, and ended with status {trace.status}")

    def _judge(self, root: Path, what: str, findings: Findings, log: bytes | None = None) -> None:
        """Look at what a kill left, carry on, and add what is wrong."""
        try:
            before = nights.Kept.of(root)
            state = _state(root, before)
            promises = nights.promised(nights.log_of(root) if log is None else log)
        except Exception as error:  # whatever it is, it is a finding
            findings.problems.append(f"{what}: {type(error).__name__}: {error}")
            return
        if self._only_new and state in self._seen:
            return
        self._seen.add(state)
        findings.states = len(self._seen)
        findings.resumed += 1

        def wrong() -> list[str]:
            self._mutate()
            try:
                damage = _damage(root)
                if nights.carry_on(root) != 0:
                    damage.append("it could not be carried on to its end")
                return [*damage, *nights.problems(root, before, promises, self.reference)]
            except Exception as error:
                return [f"{type(error).__name__}: {error}"]

        findings.problems += [f"{what}: {problem}" for problem in _in_fork(wrong)]
        if self._until and any(re.search(self._until, problem) for problem in findings.problems):
            raise FoundOut

    def _mutated(self, work: Callable[[Path], int], root: Path) -> Callable[[], int]:
        def mutated() -> int:
            self._mutate()
            return work(root)

        return mutated

    @contextmanager
    def _root(self) -> Iterator[Path]:
        root = Path(tempfile.mkdtemp(dir=self._base))
        try:
            yield root
        finally:
            shutil.rmtree(root)


def _damage(root: Path) -> list[str]:
    """Return what `hil verify` finds in a night that was cut off, apart from what is still to do."""
    if not (root / nights.NIGHT / nights.JOURNAL_NAME).exists():
        return []
    found = verify_night(root / nights.NIGHT)["problems"]
    return [f"before the resume, verify: {problem}" for problem in found if not problem.startswith("missing: ")]


def _state(root: Path, kept: nights.Kept) -> str:
    """Return what a resume can depend on, as one word: the journal's rows and every other file."""
    files = {
        str(path.relative_to(root)): nights._sha256(path) if path.suffix in {".zst", ".parquet", ".yaml"} else ""
        for path in root.rglob("*")
        if path.is_file()
    }
    # Wall times and process numbers are different in every run, and a resume does not look at them.
    names = sorted((name.split("-night-")[0], digest) for name, digest in files.items())
    facts = [sorted(map(str, kept.attempts.items())), [row[2:] for row in kept.events], names]
    return hashlib.sha256(json.dumps(facts, default=str).encode()).hexdigest()


def _fork(work: Callable[[], object]) -> int:
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        try:
            work()
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(0)
    return child


def _in_fork(work: Callable[[], object]) -> Any:
    """Return what `work` returns in a child, through JSON."""
    read, write = os.pipe()

    def told() -> None:
        os.close(read)
        with os.fdopen(write, "w") as pipe:
            json.dump(work(), pipe)

    child = _fork(told)
    os.close(write)
    with os.fdopen(read) as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    if not text:
        raise SystemExit("a child ended without an answer")
    return json.loads(text)


def main() -> None:
    """Carry out one campaign of kills and print what it found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("points", "twice", "resuming", "instants", "power"))
    parser.add_argument("--take", type=int, help="so many, drawn with the seed; all points where not given")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--before", help="only points before operations of this kind, such as rename")
    parser.add_argument("--on", help="only points before operations on files of this name, such as journal.sqlite")
    parser.add_argument("--part", default="1/1", help="only this share of the points, such as 2/4")
    parser.add_argument("--only-new", action="store_true", help="carry on only from states that were not seen before")
    parser.add_argument("--mutation", choices=MUTATIONS, default="none")
    parser.add_argument("--until", help="end at the first problem in whose words this expression is found")
    parser.add_argument("--folder", help="where the nights are kept meanwhile; memory where there is such a disk")
    asked = parser.parse_args()
    if not traceable():
        raise SystemExit("this system does not let a process trace its child")
    sys.exit(_campaign(asked))


def _campaign(asked: argparse.Namespace) -> int:
    draw = random.Random(asked.seed)
    began_s = time.monotonic()
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None  # noqa: S108 - a folder in memory
    findings = Findings(asked.kind)
    with tempfile.TemporaryDirectory(prefix="hil-kill-", dir=asked.folder or memory) as base:
        killer = Killer(Path(base), asked.mutation, only_new=asked.only_new, until=asked.until)
        findings.operations = len(killer.trace.operations)
        findings.problems += killer.unrecorded()
        part, of = map(int, asked.part.split("/"))
        kinds = [(operation.kind, Path(operation.path).name) for operation in killer.trace.operations]
        wanted = (i for i, (kind, on) in enumerate(kinds) if asked.before in (None, kind) and asked.on in (None, on))
        points = list(wanted)[part - 1 :: of]
        chosen = points if asked.take is None else sorted(draw.sample(points, min(asked.take, len(points))))
        with suppress(FoundOut):
            match asked.kind:
                case "points":
                    killer.points(chosen, findings)
                case "twice":
                    killer.twice(chosen, findings, draw)
                case "resuming":
                    killer.resuming(asked.take, findings, draw)
                case "instants":
                    killer.instants(asked.take or 200, findings, draw)
                case _:
                    killer.power(asked.take or 1000, findings, draw)
    print(json.dumps({**vars(findings), "seconds": round(time.monotonic() - began_s, 1)}, indent=1))
    return 1 if findings.problems else 0


if __name__ == "__main__":
    main()
