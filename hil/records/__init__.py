"""The folder of a night: journal, blocks, heartbeat and live files; what is derived from it; requests to its controller."""

from __future__ import annotations

from hil.records.journal import SqliteJournal
from hil.records.reader import JournalReader, open_readonly, reading

__all__ = ["JournalReader", "SqliteJournal", "open_readonly", "reading"]
