"""The tables of a journal (`journal.sql`), and whether a file is one.

A journal is never rewritten: rows are added, and an attempt is closed once. Two kinds of key make a duplicate
impossible (an attempt is one row; a step is DONE at most once); the ledger makes any change visible.
"""

import sqlite3
from pathlib import Path

from hil.errors import Damaged, InputError, worded
from hil.records.ledger import HEAD_NAME

APPLICATION_ID = 0x68696C31  # "hil1": what the `file` program and `open_checked` recognise a journal by

UNREADABLE = (sqlite3.DatabaseError, UnicodeDecodeError)
"""What SQLite and its binding make of a damaged file."""

VERSION = 3
"""A journal of the first two had no chain, so that nothing in it is proven."""

TABLES = f"""
BEGIN IMMEDIATE;
{Path(__file__).with_name("journal.sql").read_text("utf-8")}
PRAGMA user_version = {VERSION};
PRAGMA application_id = {APPLICATION_ID};
COMMIT;
"""


def check(connection: sqlite3.Connection, path: Path) -> None:
    """Raise `InputError` where this is no journal, or a later one's; `Damaged` where it was one, or has no chain."""
    with worded(Damaged, f"{path}: is not a journal, or is damaged (", UNREADABLE, ")"):
        application = connection.execute("PRAGMA application_id").fetchone()[0]
        version = connection.execute("PRAGMA user_version").fetchone()[0]
    if application != APPLICATION_ID:
        what = f"{path}: is a database, but not a journal of hil"
        if path.with_name(HEAD_NAME).exists():
            raise Damaged(what)
        raise InputError(what)
    if version > VERSION:
        raise InputError(f"{path}: was written by a later hil (schema {version}, this one reads {VERSION}); update hil")
    if version < VERSION:
        raise Damaged(f"{path}: its rows are not chained (schema {version}), so nothing in it is proven")
