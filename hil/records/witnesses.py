"""What stands beside a journal and says what was committed: its head, the log, the names of the blocks.

One flipped bit in SQLite's write-ahead log makes every later commit in it vanish without a word. These still know.
"""

import hashlib
import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from drivers.given_file import opened
from hil.errors import InputError
from hil.files.durable import PARTIAL
from hil.records.blocks import BLOCKS, SUFFIXES, stem_of
from hil.records.ledger import read_head
from hil.records.rows import digest_of
from procedures.journal_protocol import Outcome

LOG_NAME, LOG_KEPT = "log.jsonl", 4
"""The log, and how many older parts of it (`log.jsonl.1` …) are kept."""
ENDED = "step ends"
"""How a line of the log begins that says how an attempt ended, with everything that the journal was told of it."""


@dataclass(frozen=True)
class Witnesses:
    """What was there."""

    head: tuple[int, str] | None
    ended: Mapping[tuple[str, int], Mapping[str, Any]]  # by step key and attempt, the line of the log that says how
    blocks: Sequence[str]  # names of whole block files

    @classmethod
    def of(cls, folder: Path) -> Self:
        """Look at the folder of a night."""
        head, ended = read_head(folder), {}
        for path in folder.glob(f"{LOG_NAME}*"):  # rotated parts too
            for text in _bytes(path).splitlines():
                with suppress(ValueError, TypeError, KeyError):  # cut off by a full disk, or damaged
                    if ENDED.encode() in text and (line := json.loads(text))["event"] == ENDED:
                        ended[str(line["step"]), int(line["attempt"])] = line
        blocks = [path.name for path in folder.glob(f"{BLOCKS}/*") if not path.name.startswith(PARTIAL)]
        return cls(head, ended, sorted(blocks))


def _bytes(path: Path) -> bytes:
    """Return a file's bytes; none where it is no file that can be read."""
    with suppress(InputError), opened(path) as file:
        return file.read()
    return b""


def proven(line: Mapping[str, Any]) -> bool:
    """Tell whether a line of the log is whole: it holds the digest of what it says."""
    facts = {name: value for name, value in line.items() if name not in ("event", "utc", "who", "digest")}
    return line.get("digest") == digest_of(facts)


def seal(path: Path, size: int | None = None) -> dict[str, Any]:
    """Return size and SHA-256 of a file, or of its first `size` bytes; nothing where there is none."""
    data = _bytes(path)[:size]
    return {"size": len(data), "sha256": hashlib.sha256(data).hexdigest()} if data else {}


def forgotten(connection: sqlite3.Connection, folder: Path) -> Iterator[str]:
    """Yield in words what the log does not say any more of a night: it was lost, shortened or edited.

    A killed controller may not have come to say how its last attempts ended, which end together. Nothing is asked of a
    log that has become so long that its oldest part was deleted.
    """
    parts, told = list(folder.glob(f"{LOG_NAME}*")), Witnesses.of(folder).ended.items()
    if folder / f"{LOG_NAME}.{LOG_KEPT}" in parts:
        return
    said = {each: line["digest"] for each, line in told if proven(line)}
    unsaid = [
        f"{key}, attempt {n}"
        for key, n, digest in connection.execute(
            "SELECT step_key, attempt, digest FROM attempts WHERE outcome IS NOT NULL "
            "AND (controller, ended_s) NOT IN (SELECT c.id, max(a.ended_s) FROM attempts a JOIN controllers c "
            "ON c.id = controller WHERE c.ended IS NULL AND outcome IS NOT NULL GROUP BY c.id) ORDER BY id"
        )
        if said.get((key, n)) != digest
    ]
    seals = connection.execute("SELECT evidence FROM events WHERE kind = 'verdict'").fetchall()
    seals = [part for (text,) in seals for part in json.loads(text).get("log", ())]
    if unsaid:
        more = f", and {len(unsaid) - 1} more" if len(unsaid) > 1 else ""
        what = f"shortened or edited: it does not say how {unsaid[0]}, ended{more}" if parts else "lost"
    elif any(each not in (seal(path, each["size"]) for path in parts) for each in seals):
        what = "shortened or edited: it is not what it was when the night was judged"
    else:
        return
    yield f"{LOG_NAME} was {what}; nothing is computed from it, the journal has what it said"


def contradictions(connection: sqlite3.Connection, witnesses: Witnesses) -> Iterator[str]:
    """Yield in words what log and blocks say was done, and the journal does not hold."""
    steps = dict(connection.execute("SELECT key, number FROM steps"))
    known = connection.execute("SELECT step_key, attempt, outcome FROM attempts")
    outcomes = {(key, attempt): outcome for key, attempt, outcome in known}
    for attempt, line in witnesses.ended.items():
        if line.get("outcome") == Outcome.DONE and outcomes.get(attempt) != Outcome.DONE and proven(line):
            yield f"{LOG_NAME} says that {attempt[0]}, attempt {attempt[1]}, was done, and the journal does not hold it"
    named = {Path(path).name for (path,) in connection.execute("SELECT path FROM blocks")}
    named |= {
        f"{stem_of(steps.get(key, 0), key, attempt)}{suffix}"
        for (key, attempt), outcome in outcomes.items()
        for suffix in SUFFIXES.values()
        if outcome != Outcome.DONE
    }
    for name in witnesses.blocks:
        if name not in named:
            yield f"{BLOCKS}/{name} was recorded, and the journal knows nothing of the attempt"
