"""A process that writes a journal and is killed with SIGKILL at any instant, again and again."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import pytest

from drivers.clock import SystemClock
from hil.errors import InputError
from hil.files.lock import living_owner
from hil.records import SqliteJournal, open_readonly
from hil.records.blocks import RAW, SAMPLES, read_raw, read_samples
from hil.records.rows import Night
from hil.records.verify import verify_night
from procedures.journal_protocol import Outcome
from procedures.plan import Plan, Step, StepKind

_STEPS = 4000

# Carries out steps for ever and says on its standard output, after each commit, which step is done.
_WRITER = """
import sys
from pathlib import Path
import numpy as np
from drivers.clock import SystemClock
from drivers.imu import SampleBlock
from hil.night.log import NightLog
from hil.records.journal import SqliteJournal
from procedures.journal_protocol import Outcome, StepResult

with SqliteJournal.open(Path(sys.argv[1]), clock=SystemClock(), who="child") as journal:
    journal.listen(NightLog(journal.folder, SystemClock(), "child").say)
    done = journal.completed()
    print("open", flush=True)
    for step in journal.plan.steps:
        if step.key in done:
            continue
        (attempt,) = journal.begin(step)
        journal.heartbeat(step, {"chamber_degC": 20.0})
        samples = SampleBlock(np.arange(20.0), {"rate": np.full(20, float(step.index))}, raw=b"%d" % step.index * 50)
        journal.end((step, attempt, StepResult(Outcome.DONE, "", {"n": step.index}, samples)))
        print(step.key, flush=True)
"""


@pytest.fixture
def long_night(tmp_path: Path) -> Path:
    """A night with more steps than the child will ever do."""
    steps = tuple(Step(i, f"T{i}/collect", StepKind.COLLECT, float(i), 1.0, position="1") for i in range(_STEPS))
    folder = tmp_path / "night"
    folder.mkdir()
    began = datetime.fromisoformat("2026-01-01T00:00:00+00:00")
    SqliteJournal.create(folder, Plan("Long", steps), Night("Long", "rk", began, simulated=True, configuration=""))
    return folder


def start(folder: Path) -> subprocess.Popen[bytes]:
    """Start a writer and wait until it has opened the journal."""
    child = subprocess.Popen([sys.executable, "-c", _WRITER, str(folder)], stdout=subprocess.PIPE)
    assert child.stdout is not None
    assert child.stdout.readline() == b"open\n"
    return child


def kill(child: subprocess.Popen[bytes]) -> list[str]:
    """Kill it, and return the keys that it had reported as committed."""
    child.send_signal(signal.SIGKILL)
    out, _ = child.communicate()
    assert child.returncode == -signal.SIGKILL
    # The last line may have been cut; a whole one is a promise.
    return [line.decode().strip() for line in out.splitlines(keepends=True) if line.endswith(b"\n")]


@pytest.mark.slow
@pytest.mark.parametrize("kills", [2, 4])
def test_what_was_committed_survives_kills_at_random_instants(long_night: Path, kills: int) -> None:
    """Every step that was reported as done is there once, with its blocks intact; nothing else is claimed."""
    promised: list[str] = []
    seed = int.from_bytes(os.urandom(4))
    instants = random.Random(seed)
    for kill_number in range(kills):
        child = start(long_night)
        assert child.stdout is not None
        # So many whole steps, then somewhere in the next one; only the first may be killed before any is whole.
        whole = instants.randrange(min(kill_number, 1), 6)
        promised += [child.stdout.readline().decode().strip() for _ in range(whole)]
        SystemClock().sleep(instants.uniform(0.0, 0.01))
        promised += kill(child)
        with open_readonly(long_night) as journal:
            completed = journal.completed()
            attempts = [each for each in journal.attempts() if each.outcome is Outcome.DONE]
            blocks = {(row.step_key, row.block.kind): row.block for row in journal.blocks()}
            numbers = {step.key: step.index for step in journal.plan.steps}
            assert journal.damage() == [], f"seed {seed}"
        assert len(set(promised)) == len(promised), f"seed {seed}: a step was done twice"
        assert set(promised) <= set(completed), f"seed {seed}: a committed step is lost"
        assert len(attempts) == len(completed)
        assert len(blocks) == 2 * len(completed)
        for key, result in completed.items():
            number = numbers[key]
            assert result.data == {"n": number}
            assert set(read_samples(long_night, blocks[key, SAMPLES]).fields["rate"]) == {float(number)}
            assert read_raw(long_night, blocks[key, RAW]) == b"%d" % number * 50
    assert promised, f"seed {seed}: nothing was ever written, so nothing was tested"


@pytest.mark.slow
def test_a_kill_between_blocks_and_commit_leaves_an_orphan_and_no_result(long_night: Path) -> None:
    """The blocks of a step whose commit never came are harmless, and the step is done again under another name."""
    killer = _WRITER.replace("import sys", "import os, signal, sys").replace(
        "    for step in", "    journal._insert = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n    for step in"
    )
    killer = killer.replace("journal._insert = lambda", "insert, journal._insert = journal._insert, lambda")
    killer = killer.replace(
        "lambda *_: os.kill", "lambda table, *rest: insert(table, *rest) if table != 'blocks' else os.kill"
    )
    child = subprocess.Popen([sys.executable, "-c", killer, str(long_night)], stdout=subprocess.DEVNULL)
    assert child.wait() == -signal.SIGKILL
    result = verify_night(long_night)
    assert len(result["notes"]) == 2
    assert all("no journal row names this block" in note for note in result["notes"])
    with open_readonly(long_night) as journal:
        assert journal.completed() == {}
        assert [(each.attempt, each.outcome) for each in journal.attempts()] == [(1, None)]
    child = start(long_night)
    assert child.stdout is not None
    assert child.stdout.readline().decode().strip() == "T0/collect"
    kill(child)
    with open_readonly(long_night) as journal:
        assert [row.attempt for row in journal.blocks()][:2] == [2, 2]
        assert journal.damage() == []


@pytest.mark.slow
def test_after_a_kill_verify_finds_nothing_but_what_is_missing(long_night: Path) -> None:
    """An attempt that was cut off and an orphan block are no damage."""
    child = start(long_night)
    assert child.stdout is not None
    child.stdout.readline()
    kill(child)
    result = verify_night(long_night)
    assert not result["complete"]
    assert all(problem.startswith("missing: ") for problem in result["problems"])


@pytest.mark.slow
def test_the_lock_dies_with_its_owner(long_night: Path) -> None:
    """While the child lives nobody else may write; at its death the lock is free and the takeover is on record."""
    child = start(long_night)
    owner = living_owner(long_night)
    assert owner is not None
    assert owner.pid == child.pid
    with pytest.raises(InputError, match=f"process {child.pid}"):
        SqliteJournal.open(long_night, clock=SystemClock())
    kill(child)
    assert living_owner(long_night) is None
    with SqliteJournal.open(long_night, clock=SystemClock()) as journal:
        assert f"process {child.pid}" in journal.events()[0].message
        ended = [controller.ended for controller in journal.controllers()]
    assert ended == [None, None]


@pytest.mark.slow
def test_a_lock_is_text_that_a_person_can_read(long_night: Path) -> None:
    """The lock file names process, host and time as JSON."""
    child = start(long_night)
    facts = json.loads((long_night / "controller.lock").read_text())
    kill(child)
    assert set(facts) >= {"pid", "host", "since_utc", "started"}
