"""One hash chain over every row of every table of a journal; its head stands in a second file beside it.

A commit is one entry: the SHA-256 of every row that it wrote, as the row stands since, and a link, the SHA-256 of the
link before and of this entry. The head is the newest link, written after each durable commit: a journal that lost its
end is shorter than its head says. It may be longer: a crash came in between, or only heartbeats followed. Where the
night's bench names a key, and who writes can read it, the head is signed (HMAC-SHA256): without it nobody forges both.
"""

import contextlib
import hashlib
import hmac
import json
import os
import re
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from drivers.given_file import opened, read_bytes
from hil.errors import InputError

HEAD_NAME = "journal.head"
TABLES = ("night", "steps", "controllers", "attempts", "blocks", "events", "heartbeats", "requests")
"""Every table whose rows are chained. The first column of each is its row number."""

_HEAD = re.compile(rb"hil\.head/1 (\d+) ([0-9a-f]{64})(?: [0-9a-f]{64})? *")
_HEAD_SIZE = 180  # bytes, always, so that it is written in place, within one sector
_UNSIGNED_SIZE = 100  # as nights were recorded that could not be signed
_SHORTEST_KEY = 16  # bytes


class Ledger:
    """Writes the chain for one connection, which must have no other transactions than these."""

    def __init__(self, connection: sqlite3.Connection, folder: Path) -> None:
        self._connection = connection
        self._path = folder / HEAD_NAME
        self._key = b""
        from hil.config.recorded import key_file  # imported late: whoever reads a night needs no bench files

        with contextlib.suppress(InputError, AttributeError, TypeError):  # of a night without a key
            self._key = read_key(key_file(*connection.execute("SELECT configuration FROM night").fetchone()))
        self._written: set[tuple[str, int]] = set()
        connection.create_function("hil_written", 2, lambda table, row: self._written.add((table, row)))
        for table in TABLES:
            for what in ("INSERT", "UPDATE"):
                connection.execute(
                    f"CREATE TEMP TRIGGER {table}_{what} AFTER {what} ON main.{table} "
                    f"BEGIN SELECT hil_written('{table}', NEW.rowid); END"
                )

    @contextlib.contextmanager
    def transaction(self, *, durable: bool = True) -> Iterator[None]:
        """All or nothing, and its entry with it. Where it need not be `durable`, the head stays as it is."""
        self._written.clear()
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            number, link = enter(self._connection, sorted(self._written))
            self._connection.execute("COMMIT")
        except BaseException:
            # SQLite rolls back by itself after some failures (disk full); a second time would be an error.
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
            raise
        if durable:
            with contextlib.suppress(OSError):  # it is committed, whatever becomes of the second witness
                file = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
                with open(file, "wb", buffering=0) as head:
                    head.write(_head_text(number, link, self._key))
                    os.fdatasync(file)


def read_key(path: Path | None) -> bytes:
    """Return the key in a bench's file, nothing where none is named; raise `InputError` where it cannot be used."""
    key = b"" if path is None else read_bytes(path).strip()
    if path is not None and len(key) < _SHORTEST_KEY:
        raise InputError(f"{path}: is no key: it needs {_SHORTEST_KEY} bytes or more that nobody can guess")
    return key


def _signature(number: int, link: str, key: bytes) -> str:
    return hmac.new(key, f"{number} {link}".encode(), "sha256").hexdigest() if key else ""


def _head_text(number: int, link: str, key: bytes) -> bytes:
    return f"hil.head/1 {number} {link} {_signature(number, link, key)}".ljust(_HEAD_SIZE).encode()


def signed(folder: Path, key: bytes) -> bool | None:
    """Tell whether the head is signed with this key; None where it is not signed at all."""
    _, number, link, *signature = _head_bytes(folder / HEAD_NAME).decode().split()
    return hmac.compare_digest(signature[0], _signature(int(number), link, key)) if signature else None


def read_head(folder: Path) -> tuple[int, str] | None:
    """Return number and link of the newest durable entry; number 0 where it is damaged, None where there is none."""
    path = folder / HEAD_NAME
    if not os.path.lexists(path):
        return None
    try:
        while (text := _head_bytes(path)) != _head_bytes(path):
            pass  # it was just being written
        found = _HEAD.fullmatch(text) if len(text) in (_HEAD_SIZE, _UNSIGNED_SIZE) else None
    except InputError:
        found = None
    return (int(found[1]), found[2].decode()) if found else (0, "damaged")


def _head_bytes(path: Path) -> bytes:
    with opened(path) as file:
        return file.read(_HEAD_SIZE + 1)


def enter(connection: sqlite3.Connection, written: Iterable[tuple[str, int]]) -> tuple[int, str]:
    """Append the entry of these rows (table, number) within a transaction; return its number and its link."""
    rows = {
        f"{table}/{row}": row_digest(connection.execute(f"SELECT * FROM {table} WHERE rowid = ?", (row,)).fetchone())  # noqa: S608
        for table, row in written
    }
    newest = connection.execute("SELECT n, link FROM ledger ORDER BY n DESC LIMIT 1").fetchone() or (0, "")
    text = json.dumps(rows, separators=(",", ":"))
    entry = newest[0] + 1, _link(newest[1], text)
    connection.execute("INSERT INTO ledger VALUES (?, ?, ?)", (entry[0], text, entry[1]))
    return entry


def enter_everything(connection: sqlite3.Connection) -> None:
    """Append one entry of all rows that there are: those that `hil repair` has brought back."""
    enter(connection, [(name, row) for name in TABLES for (row,) in connection.execute(f"SELECT rowid FROM {name}")])  # noqa: S608


def row_digest(row: Sequence[Any]) -> str:
    """Return the SHA-256 of a row's values."""
    return hashlib.sha256(json.dumps(row, default=repr).encode()).hexdigest()


def _link(before: str, text: str) -> str:
    return hashlib.sha256(f"{before}{text}".encode()).hexdigest()


def chain(connection: sqlite3.Connection, head: tuple[int, str] | None) -> tuple[dict[str, str], list[str]]:
    """Return the digest of every row by "table/number", as it was last written, and in words what breaks the chain."""
    written: dict[str, str] = {}
    found: list[str] = []
    n, link, at_head = 0, "", ""
    for number, text, recorded in connection.execute("SELECT n, rows, link FROM ledger ORDER BY n"):
        n, link = n + 1, _link(link, text)
        if (number, link) != (n, recorded):
            found.append(f"entry {n} of its ledger is not as it was written, or missing")
            n, link = number, recorded
        with contextlib.suppress(ValueError, TypeError):  # damaged, as was just found
            written.update(json.loads(text))
        if head is not None and n == head[0]:
            at_head = link
    if head is None and n > 1:
        found.append(f"{HEAD_NAME} is missing: nobody can say whether the end of the journal is")
    elif head is not None and head[0] > n:
        found.append(f"it ends with entry {n}, and {head[0]} were committed ({HEAD_NAME}): the newest were lost")
    elif head is not None and at_head != head[1]:
        found.append(f"{HEAD_NAME} is damaged, or not the head of this journal")
    return written, found


def breaks(connection: sqlite3.Connection, head: tuple[int, str] | None) -> list[str]:
    """Return in words every row and entry that is not what was written, and a lost end; empty where all is proven."""
    written, found = chain(connection, head)
    for table in TABLES:
        for row in connection.execute(f"SELECT * FROM {table}"):  # noqa: S608
            if written.pop(f"{table}/{row[0]}", "") != row_digest(row):
                what = next((value for value in row if isinstance(value, str)), "")
                found.append(f"row {row[0]} of the table {table} ({what}) is not as it was written")
    return found + ["row {1} of the table {0} was deleted".format(*key.partition("/")[::2]) for key in written]
