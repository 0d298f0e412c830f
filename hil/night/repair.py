"""What is proven of a damaged night, brought into a new folder; the damaged one is not touched.

A row of the journal is proven by its digest in the ledger, an attempt that the journal has lost by its line in the log,
which carries a digest of its own, a block by its hash in either. Steps whose rows are not proven are planned again from
the night's configuration. A self-calibration of which samples are lost counts no more; `hil resume` does it again.
"""

import shutil
import sqlite3
import tempfile
from collections import Counter
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from drivers.clock import VirtualClock
from drivers.given_file import opened
from hil.config.recorded import CONFIGURATION, configuration_of
from hil.config.sweep import planned
from hil.errors import Damaged, InputError
from hil.files.durable import RealDisk, whole_or_nothing, write_durably
from hil.files.lock import living_owner
from hil.night.run import judge
from hil.records import SqliteJournal, open_readonly
from hil.records import schema as journal_schema
from hil.records.blocks import BLOCKS, DamagedBlock, checked_bytes
from hil.records.damage import damaged_self_calibrations
from hil.records.ledger import TABLES, chain, enter_everything, row_digest
from hil.records.live import TRACE_NAME
from hil.records.reader import JOURNAL_NAME, journal_of
from hil.records.rows import step_row, to_json
from hil.records.witnesses import LOG_NAME, Witnesses, proven
from procedures.words import counted


def repair_night(folder: Path, out: Path, who: str = "") -> dict[str, Any]:
    """Write what is proven of the night in `folder` into the new folder `out`; return the document hil.repair/1.

    Raises `InputError` where there is no night, or somebody at work, or `out` is not new; `Damaged` without a plan.
    """
    journal_of(folder)
    if (owner := living_owner(folder)) is not None:
        raise InputError(f"{folder}: {owner} is at work here")
    witnesses = Witnesses.of(folder)
    with whole_or_nothing(out) as partial:
        with closing(sqlite3.connect(partial / JOURNAL_NAME, isolation_level=None)) as new:
            new.executescript(journal_schema.TABLES)
            new.execute("BEGIN")
            gone = _take_proven_rows(folder, new)
            restored = _take_from_the_log(new, witnesses, gone)
            enter_everything(new)
            new.execute("COMMIT")
        lost = [f"{counted(count, 'row')} of the table {table}" for table, count in gone.items() if count > 0]
        (partial / BLOCKS).mkdir()
        for path in (*folder.glob(f"{LOG_NAME}*"), folder / TRACE_NAME):  # not as sealed? That is said again
            with suppress(InputError), opened(path) as file:
                (partial / path.name).write_bytes(file.read())
        with open_readonly(partial) as night:
            for row in night.blocks():
                try:
                    write_durably(RealDisk(), partial / row.block.path, checked_bytes(folder, row.block))
                except DamagedBlock as damage:
                    lost.append(str(damage))
            broken = damaged_self_calibrations(night)
            useless = [key for key in night.completed() if night.steps_by_key()[key].self_calibration in broken]
            last_s = max((each.ended_s or each.began_s for each in night.attempts()), default=0.0)
            clock = VirtualClock(night.night.utc(last_s))  # the campaign goes on from there
            with suppress(InputError):
                configuration_of(night.night.configuration, partial / CONFIGURATION)
        with SqliteJournal.open(partial, clock=clock, who=who) as journal:
            journal.withdraw(useless, "its samples were lost")
            said = f"brought back from {folder}; lost: {'; '.join(lost) or 'nothing'}"
            journal.event("repaired", said, lost=lost, restored=restored)
            steps = {"steps_done": len(journal.completed()), "steps_total": len(journal.plan.steps)}
            state = "complete" if steps["steps_done"] == steps["steps_total"] else "incomplete"
            judge(journal, state)
            journal.finish(f"{state}: brought back from a damaged folder")
    return {"schema": "hil.repair/1", "folder": str(out), **steps, "restored": restored, "lost": lost}


def _take_proven_rows(folder: Path, new: sqlite3.Connection) -> Counter[str]:
    """Copy what the ledger proves; return how many rows of each table are gone. Raises `Damaged` without a plan."""
    written: dict[str, str] = {}

    def take(table: str, row: tuple[Any, ...]) -> None:
        key = f"{table}/{row[0]}"
        if written.get(key) == row_digest(row):
            new.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(row))})", row)  # noqa: S608
            del written[key]

    with tempfile.TemporaryDirectory(prefix="hil-") as scratch:
        for path in (folder / JOURNAL_NAME, folder / f"{JOURNAL_NAME}-wal"):
            if path.exists():  # a copy, for SQLite also writes where it only reads
                shutil.copy(path, scratch)
        with suppress(*journal_schema.UNREADABLE, Damaged), open_readonly(Path(scratch)) as old:
            written |= chain(old._connection, None)[0]
            for table in TABLES:
                with suppress(*journal_schema.UNREADABLE):  # a page that cannot be read: no more of this table
                    for row in old._connection.execute(f"SELECT * FROM {table}"):  # noqa: S608
                        take(table, row)
        night = new.execute("SELECT configuration FROM night").fetchone()
        if night is not None and any(key.startswith("steps/") for key in written):
            bench, sweep = configuration_of(night[0], Path(scratch))
            for step in planned(sweep, bench).steps:
                take("steps", step_row(step))
    gone = Counter(key.partition("/")[0] for key in written)
    if night is None or gone["steps"]:
        raise Damaged(
            f"{folder}: the plan and the configuration of this night are not proven, so nothing is brought back; its "
            f"{BLOCKS} are Parquet files that any program reads"
        )
    return gone


def _take_from_the_log(new: sqlite3.Connection, witnesses: Witnesses, gone: Counter[str]) -> list[str]:
    """Write how attempts ended of which the journal lost that; return them in words. They are not gone any more."""
    known = {(key, n): how for key, n, how in new.execute("SELECT step_key, attempt, outcome FROM attempts")}
    restored = []
    for (key, attempt), line in witnesses.ended.items():
        if not proven(line):
            continue
        for block in line["blocks"]:
            row = (key, attempt, *block.values())
            there = new.execute("INSERT OR IGNORE INTO blocks VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?)", row)
            gone["blocks"] -= there.rowcount
        if known.get((key, attempt)) is None:
            by = new.execute("SELECT coalesce(max(id), 1) FROM controllers").fetchone()
            how = (line["outcome"], line["reason"], to_json(line["data"]), line["digest"])
            row = (key, attempt, *by, line["began_s"], line["ended_s"], *how)
            new.execute("INSERT OR REPLACE INTO attempts VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?, ?, NULL)", row)
            gone["attempts"] -= (key, attempt) not in known
            restored.append(f"{key}, attempt {attempt}: {line['outcome']}")
    return restored
