"""The folder of a night: journal, blocks, live files; what is derived from them; requests to its controller."""

from hil.records.journal import SqliteJournal
from hil.records.reader import JournalReader, open_readonly, reading

__all__ = ["JournalReader", "SqliteJournal", "open_readonly", "reading"]
