"""The journal of a night: the truth, in SQLite. When a call returns, what it recorded survives a power failure.

What several units do at once begins and ends at once. The order of `end` is: data blocks (hil.records.blocks), then one
transaction with the results and the names of the blocks. A crash before the transaction leaves attempts that never
ended and perhaps orphan blocks, never half a result. Then the write-ahead log is emptied: it holds one stage at most.

Heartbeats are the one exception to durability: they survive the death of the process, but the last of them may be lost
with the power. They are the only thing that is written while nothing happens, and an fsync a minute buys nothing.
"""

import contextlib
import json
import os
import socket
import sqlite3
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, astuple
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Self

from drivers.clock import Clock, SystemClock
from hil.errors import InputError
from hil.files.durable import RealDisk
from hil.files.lock import FolderLock
from hil.records import schema as journal_schema
from hil.records.blocks import BLOCKS, Block, BlockWriter
from hil.records.ledger import Ledger
from hil.records.reader import JOURNAL_NAME, JournalReader, journal_of, reading
from hil.records.rows import Night, digest_of, step_row, to_json
from hil.records.witnesses import ENDED
from procedures.journal_protocol import Ended, StepResult
from procedures.plan import Plan, Step
from procedures.requests import Request, RequestKind

_BUSY_S = 30.0
_NO_OUTCOME = "incomplete: the controller ended without an outcome"

Listener = Callable[[str, Mapping[str, Any]], None]
"""Is told what happened, and its facts: the log, after every commit."""


class SqliteJournal(JournalReader):
    """A journal that is written: `procedures`' `Journal`, durable. Belongs to one thread of one controller.

    `block_writer` may be told what the fields of each unit are, and another disk: one that a rehearsal lets be full.
    """

    def __init__(
        self, folder: Path, connection: sqlite3.Connection, lock: FolderLock, clock: Clock, who: str, keep_raw: bool
    ) -> None:
        super().__init__(folder, connection)
        self._ledger = Ledger(connection, folder)
        self._lock = lock
        self._clock = clock
        self._system = SystemClock()
        self._listeners: list[Listener] = []
        self._others_commits = -1
        self.block_writer = BlockWriter(folder, simulated=self.night.simulated, keep_raw=keep_raw)
        # The clock may count from anywhere; the campaign counts from the beginning of the night, across a resume.
        self._offset_s = (clock.utc() - self.night.began_utc).total_seconds() - clock.now()
        last_s = max((controller.seen_s for controller in self.controllers()), default=0.0)
        backwards_s = last_s - self.now_s()
        if backwards_s > 0.0:  # somebody set the wall clock back; the campaign's time never goes backwards
            self._offset_s += backwards_s
        with self._transaction():
            row = (os.getpid(), socket.gethostname(), who, self.now_s(), self.now_s(), self._system.utc().isoformat())
            self._controller = self._insert("controllers", "pid, host, who, began_s, seen_s, seen_utc", row)
        if backwards_s > 0.0:
            message = (
                f"the wall clock stands {backwards_s:.0f} s before the last record; the campaign goes on from there"
            )
            self.event("clock_went_back", message, backwards_s=backwards_s)

    @classmethod
    def create(cls, folder: Path, plan: Plan, night: Night) -> None:
        """Write a new journal into `folder`; `InputError` where there is one, or two steps of the plan have one key."""
        path = folder / JOURNAL_NAME
        if path.exists():
            raise InputError(f"{folder}: holds a night already; choose another folder, or resume it")
        if len({step.key for step in plan.steps}) != len(plan.steps):
            raise InputError("the plan has two steps of one key, so that their results could not be told apart")
        with contextlib.closing(_connect(path)) as connection:
            connection.executescript(journal_schema.TABLES)
            with Ledger(connection, folder).transaction():
                connection.executemany(
                    "INSERT INTO steps VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", [step_row(step) for step in plan.steps]
                )
                began = (night.title, night.who, night.began_utc.isoformat(), int(night.simulated), night.seed)
                by = (to_json(night.versions or {}), night.configuration, len(plan.steps), night.digest(plan))
                connection.execute("INSERT INTO night VALUES (1, ?, ?, ?, ?, ?, ?, ?, ?, ?)", (*began, *by))
        (folder / BLOCKS).mkdir(exist_ok=True)
        RealDisk().synchronise_folder(folder)

    @classmethod
    def open(
        cls, folder: Path, *, clock: Clock, who: str = "", keep_raw: bool = True, lock: FolderLock | None = None
    ) -> Self:
        """Open a night to carry it on, as its only controller; `keep_raw` keeps the bytes beside the samples.

        `lock` is the folder's where the caller holds it already: it then belongs to the journal, also on failure.

        Raises `InputError` where there is no journal, or another controller holds it; `Damaged` where it is not what
        was written. The lock of a controller that has died is taken over, and an event says so.
        """
        path = journal_of(folder)
        lock = lock or FolderLock(folder).acquire()
        with contextlib.ExitStack() as held:
            held.callback(lock.release)
            with reading(folder):
                pass  # it is what was written
            connection = held.enter_context(contextlib.closing(_connect(path)))
            journal = cls(folder, connection, lock, clock, who, keep_raw)
            held.pop_all()
        if lock.taken_over_from is not None:
            journal.event("lock_taken_over", f"the lock of {lock.taken_over_from} was taken over: that process is gone")
        return journal

    @property
    def began_utc(self) -> datetime:
        """The instant of campaign second zero by the present clock: earlier after the wall clock was set back."""
        return self._clock.utc() - timedelta(seconds=self.now_s())

    def listen(self, listener: Listener) -> None:
        """Call `listener`, too, after every commit from now on."""
        self._listeners.append(listener)

    def now_s(self) -> float:
        """Return the seconds since the campaign began, across a resume."""
        return self._clock.now() + self._offset_s

    def begin(self, *steps: Step) -> Sequence[int]:
        """Record that steps begin, at once; return each one's attempt, from 1; `ValueError` if DONE, or not planned."""
        with self._transaction():
            attempts = [self._begin(step) for step in steps]
        for step, attempt in zip(steps, attempts, strict=True):
            self._tell("step begins", step=step.key, attempt=attempt)
        return attempts

    def _begin(self, step: Step) -> int:
        earlier = self._connection.execute(
            "SELECT count(*), total(outcome = 'DONE' AND withdrawn IS NULL) FROM attempts WHERE step_key = ?",
            (step.key,),
        ).fetchone()
        if earlier[1]:
            raise ValueError(f"step {step.key} is done; it cannot begin again")
        attempt = int(earlier[0]) + 1
        try:
            row = (step.key, attempt, self._controller, self.now_s())
            self._insert("attempts", "step_key, attempt, controller, began_s", row)
        except sqlite3.IntegrityError:
            raise ValueError(f"step {step.key} is no step of this night's plan") from None
        return attempt

    def end(self, *ended: Ended) -> None:
        """Commit results, with their samples, all of them or none, before anything else begins.

        Raises `OSError` or `sqlite3.OperationalError` where the disk is full: the attempts then never ended, and
        nothing of them counts. Raises `ValueError` where one never began or has ended already.
        """
        written = [
            (*each, () if each[2].samples is None else self.block_writer.write(*each[:2], each[2].samples))
            for each in ended
        ]
        ended_s = self.now_s()
        with self._transaction():
            facts = [self._end(*each, ended_s) for each in written]
        for each in facts:
            self._tell(ENDED, **each)
        self._empty_write_ahead_log()

    def _end(
        self, step: Step, attempt: int, result: StepResult, blocks: Sequence[Block], ended_s: float
    ) -> Mapping[str, Any]:
        """Record how an attempt ended; return the facts, and their digest."""
        going_on = "WHERE step_key = ? AND attempt = ? AND outcome IS NULL"
        begun = f"SELECT began_s FROM attempts {going_on}"  # noqa: S608
        began = self._connection.execute(begun, (step.key, attempt)).fetchone()
        if began is None:
            raise ValueError(f"attempt {attempt} of step {step.key} is not going on, so it cannot end")
        data = to_json(result.data)
        facts = {"step": step.key, "attempt": attempt, "began_s": began[0], "ended_s": ended_s}
        facts |= {"outcome": result.outcome.value, "reason": result.reason, "data": json.loads(data)}
        facts |= {"blocks": [asdict(block) for block in blocks]}
        facts |= {"digest": digest_of(facts)}
        for block in blocks:
            columns = "step_key, attempt, kind, path, sha256, size, rows, content_sha256"
            self._insert("blocks", columns, (step.key, attempt, *astuple(block)))
        self._connection.execute(
            f"UPDATE attempts SET outcome = ?, reason = ?, data = ?, ended_s = ?, digest = ? {going_on}",  # noqa: S608
            (result.outcome.value, result.reason, data, ended_s, facts["digest"], step.key, attempt),
        )
        return facts

    def _empty_write_ahead_log(self) -> None:
        """Leave nothing in it that damage could take; whoever reads at this moment is not waited for."""
        with contextlib.suppress(sqlite3.OperationalError):  # committed it is; a full disk is met at the next commit
            self._connection.execute("PRAGMA busy_timeout = 0")
            self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        self._connection.execute(f"PRAGMA busy_timeout = {_BUSY_S * 1000:.0f}")

    def event(self, kind: str, message: str, **evidence: Any) -> None:
        """Record something that happened: a retry, an alarm, a hold, a signal, a resumption."""
        text = to_json(evidence)
        with self._transaction():
            row = (self._controller, self.now_s(), kind, message, text)
            self._insert("events", "controller, at_s, kind, message, evidence", row)
        self._tell("event", kind=kind, message=message, **({"evidence": json.loads(text)} if evidence else {}))

    def heartbeat(self, step: Step, readings: Mapping[str, float]) -> None:
        """Record that the controller is alive, what it is doing and the latest readings."""
        self._connection.execute("PRAGMA synchronous = NORMAL")
        try:
            with self._transaction(durable=False):
                row = (self._controller, self.now_s(), step.key, to_json(readings))
                self._insert("heartbeats", "controller, at_s, step_key, readings", row)
        finally:
            self._connection.execute("PRAGMA synchronous = FULL")

    def asked(self) -> tuple[Request, ...]:
        """Return what was asked of this controller and is not answered yet. Costs little where nobody has written."""
        commits = int(self._connection.execute("PRAGMA data_version").fetchone()[0])
        if commits == self._others_commits:
            return ()
        rows = self._connection.execute(
            "SELECT id, kind, who, why, prompt FROM requests WHERE controller = ? AND answered_s IS NULL ORDER BY id",
            (self._controller,),
        ).fetchall()
        self._others_commits = commits
        return tuple(Request(number, RequestKind(kind), who, why, prompt) for number, kind, who, why, prompt in rows)

    def answer(self, request: Request, accepted: bool, message: str) -> None:
        """Record the answer to a request."""
        with self._transaction():
            self._answer("id = ?", request.number, accepted, message)
        self._tell(
            "request", kind=request.kind.value, by=request.who, why=request.why, accepted=accepted, answer=message
        )

    def _answer(self, which: str, value: int, accepted: bool, message: str) -> None:
        self._connection.execute(
            f"UPDATE requests SET answered_s = ?, accepted = ?, answer = ? WHERE {which} AND answered_s IS NULL",  # noqa: S608
            (self.now_s(), int(accepted), message, value),
        )

    def withdraw(self, keys: Collection[str], why: str) -> None:
        """Let the DONE results of these steps count no more, so that they are done again; all of them or none."""
        with self._transaction():
            self._connection.executemany(
                "UPDATE attempts SET withdrawn = ? WHERE step_key = ? AND outcome = 'DONE' AND withdrawn IS NULL",
                [(why, key) for key in keys],
            )
        self._tell("results withdrawn", steps=sorted(keys), why=why)

    def finish(self, how: str) -> None:
        """Record in words how this controller ended; `close` does it in default."""
        with self._transaction():
            self._connection.execute("UPDATE controllers SET ended = ? WHERE id = ?", (how, self._controller))

    def close(self) -> None:
        """Record the end, release the database and the lock. Closing twice is allowed."""
        try:
            with contextlib.suppress(sqlite3.Error), self._transaction():
                self._connection.execute(
                    "UPDATE controllers SET ended = ? WHERE id = ? AND ended IS NULL", (_NO_OUTCOME, self._controller)
                )
                self._answer("controller = ?", self._controller, False, "the controller has ended")
        finally:
            super().close()
            self._lock.release()

    @contextlib.contextmanager
    def _transaction(self, *, durable: bool = True) -> Iterator[None]:
        """All or nothing, and a sign of life with it."""
        with self._ledger.transaction(durable=durable):
            yield
            if hasattr(self, "_controller"):
                self._connection.execute(
                    "UPDATE controllers SET seen_s = ?, seen_utc = ? WHERE id = ?",
                    (self.now_s(), self._system.utc().isoformat(), self._controller),
                )

    def _insert(self, table: str, columns: str, row: tuple[Any, ...]) -> int:
        marks = ", ".join("?" * len(row))
        cursor = self._connection.execute(f"INSERT INTO {table} ({columns}) VALUES ({marks})", row)  # noqa: S608
        return int(cursor.lastrowid or 0)

    def _tell(self, what: str, **facts: Any) -> None:
        for listener in self._listeners:
            listener(what, facts)


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, timeout=_BUSY_S)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("PRAGMA foreign_keys = ON")
    return connection
