"""Defects on purpose: what the kill tests must find, or they prove nothing.

Each function breaks the running process, which is a fork that ends after one night.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import hil.files.durable
import hil.records.blocks
import hil.records.journal
from hil.files.durable import RealDisk
from hil.records import SqliteJournal, ledger
from hil.records import schema as journal_schema
from procedures.journal_protocol import Ended


def no_fsync() -> None:
    """Write blocks without synchronising them."""
    RealDisk.write = lambda _self, path, data: path.write_bytes(data)  # type: ignore


def no_folder_fsync() -> None:
    """Never synchronise a folder."""
    RealDisk.synchronise_folder = lambda _self, _folder: None  # type: ignore[method-assign]


def rename_before_fsync() -> None:
    """Give a block its name before its bytes are safe."""

    def write_durably(disk: RealDisk, path: Path, data: bytes) -> None:
        partial = path.with_name(f"{hil.files.durable.PARTIAL}{path.name}")
        partial.write_bytes(data)
        disk.rename(partial, path)
        with path.open("rb") as file:
            os.fsync(file.fileno())
        disk.synchronise_folder(path.parent)

    hil.records.blocks.write_durably = write_durably  # type: ignore[attr-defined]


def rename_after_commit() -> None:
    """Commit the names of blocks before the blocks have them."""
    waiting: list[tuple[Path, Path]] = []

    def write_durably(disk: RealDisk, path: Path, data: bytes) -> None:
        partial = path.with_name(f"{hil.files.durable.PARTIAL}{path.name}")
        disk.write(partial, data)
        waiting.append((partial, path))

    end = SqliteJournal.end

    def end_then_rename(self: SqliteJournal, *ended: Ended) -> None:
        end(self, *ended)
        while waiting:
            RealDisk().rename(*waiting.pop(0))

    hil.records.blocks.write_durably = write_durably  # type: ignore[attr-defined]
    SqliteJournal.end = end_then_rename  # type: ignore[method-assign]


def double_commit() -> None:
    """Commit every result twice, with nothing in the tables against it."""
    unique, plain = (f"CREATE {kind}INDEX a_step_is_done_once" for kind in ("UNIQUE ", ""))
    journal_schema.TABLES = journal_schema.TABLES.replace(unique, plain)
    end = SqliteJournal.end

    def end_twice(self: SqliteJournal, *ended: Ended) -> None:
        end(self, *ended)
        for step, attempt, _ in ended:
            row = (step.key, attempt + 1, self._controller, self.now_s())
            self._insert("attempts", "step_key, attempt, controller, began_s", row)
        end(self, *((step, attempt + 1, result) for step, attempt, result in ended))

    SqliteJournal.end = end_twice  # type: ignore[method-assign]


def not_synchronous() -> None:
    """Let SQLite commit without synchronising."""

    class Careless(sqlite3.Connection):
        def execute(self, sql: str, *rest: Any) -> sqlite3.Cursor:
            return super().execute(sql.replace("synchronous = FULL", "synchronous = OFF"), *rest)

    connect = sqlite3.connect
    hil.records.journal.sqlite3.connect = lambda *a, **k: connect(*a, **{"factory": Careless, **k})  # type: ignore[attr-defined]


def head_before_commit() -> None:
    """Say in the second file that an entry is durable before it is."""
    enter = ledger.enter

    def enter_and_say(connection: sqlite3.Connection, written: Iterable[tuple[str, int]]) -> tuple[int, str]:
        entry = enter(connection, written)
        journal = Path(connection.execute("PRAGMA database_list").fetchone()[2])
        journal.with_name(ledger.HEAD_NAME).write_bytes(ledger._head_text(*entry, b""))
        return entry

    ledger.enter = enter_and_say


MUTATIONS: Mapping[str, Callable[[], None]] = {
    "none": lambda: None,
    "no-fsync": no_fsync,
    "no-folder-fsync": no_folder_fsync,
    "rename-before-fsync": rename_before_fsync,
    "rename-after-commit": rename_after_commit,
    "double-commit": double_commit,
    "not-synchronous": not_synchronous,
    "head-before-commit": head_before_commit,
}
