"""What stands beside a journal and says what was committed: its head, the log, the names of the blocks.

    witnesses = Witnesses.of(folder)      # before the journal is read: what they say, a sound one says by then
    list(contradictions(connection, witnesses))

After a kill one flipped bit in SQLite's write-ahead log makes every later commit in it vanish without a word. The log
and the blocks then know of attempts that the journal does not.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.files.durable import PARTIAL
from hil.records.blocks import BLOCKS, stem_of
from hil.records.ledger import read_head
from hil.records.rows import digest_of
from procedures.journal_protocol import Outcome

LOG_NAME = "log.jsonl"
ENDED = "step ends"
"""How a line of the log begins that says how an attempt ended, with everything that the journal was told of it."""


@dataclass(frozen=True)
class Witnesses:
    """What was there at one instant."""

    head: tuple[int, str] | None
    ended: Mapping[tuple[str, int], Mapping[str, Any]]  # by step key and attempt, what the log says of it
    blocks: tuple[str, ...]  # names of whole block files

    @classmethod
    def of(cls, folder: Path) -> Witnesses:
        """Look at the folder of a night."""
        head = read_head(folder)
        ended = {(line["step"], line["attempt"]): line for line in _log_lines(folder)}
        there = (folder / BLOCKS).iterdir() if (folder / BLOCKS).is_dir() else ()
        return cls(head, ended, tuple(sorted(path.name for path in there if not path.name.startswith(PARTIAL))))


def _log_lines(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the lines of the log, rotated parts too, that say how an attempt ended; what is no such line is left out."""
    for path in folder.glob(f"{LOG_NAME}*"):
        try:
            lines = [line for line in path.read_bytes().splitlines() if ENDED.encode() in line]
        except OSError:
            continue
        for text in lines:
            try:
                line = json.loads(text)
                if line["event"] == ENDED and isinstance(line["step"], str) and isinstance(line["attempt"], int):
                    yield line
            except (ValueError, TypeError, KeyError):  # cut off by a full disk, or damaged
                continue


def proven(line: Mapping[str, Any]) -> bool:
    """Tell whether a line of the log is whole: it holds the digest of what it says."""
    facts = {name: value for name, value in line.items() if name not in ("event", "utc", "who", "digest")}
    return line.get("digest") == digest_of(facts)


def contradictions(connection: sqlite3.Connection, witnesses: Witnesses) -> Iterator[str]:
    """Yield in words what log and blocks say was done, and the journal does not hold."""
    outcomes = {
        (key, attempt): (number, outcome)
        for key, attempt, outcome, number in connection.execute(
            "SELECT step_key, attempt, outcome, number FROM attempts LEFT JOIN steps ON key = step_key"
        )
    }
    for (key, attempt), line in witnesses.ended.items():
        done = line.get("outcome") == Outcome.DONE
        if done and outcomes.get((key, attempt), (0, ""))[1] != Outcome.DONE and proven(line):
            yield f"{LOG_NAME} says that {key}, attempt {attempt}, was done, and the journal does not hold it"
    known = {Path(path).name for (path,) in connection.execute("SELECT path FROM blocks")}
    begun = {
        stem_of(number or 0, key, attempt)
        for (key, attempt), (number, outcome) in outcomes.items()
        if outcome != Outcome.DONE
    }
    for name in witnesses.blocks:
        if name not in known and name.removesuffix(".parquet").removesuffix(".raw.zst") not in begun:
            yield f"{BLOCKS}/{name} was recorded, and the journal knows nothing of the attempt"
