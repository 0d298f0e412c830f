"""Change one byte, or one row, of a complete night, and ask everything that states a number whether it was named.

    python -m benchmarks.reliability.flips bytes     # every byte of every file, one bit of it, drawn by the seed
    python -m benchmarks.reliability.flips bytes --every 50 --only "journal.*" --seed 3 --part 1/2
    python -m benchmarks.reliability.flips rows      # every cell edited, every row deleted, exchanged, doubled

The night is as small as one can be: 40 samples a collect, and a journal of pages of 512 bytes with hardly a gap.
Status, report, solve and verify are asked through the functions that the commands call, in one process. Each must give
what it gave of the sound night, to the digit, or name a break in a sentence; anything else is a problem. It prints one
JSON document; the exit status is 1 where there is a problem.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import shutil
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import yaml

import hil.config.recorded
import hil.records.export
import hil.records.reader
import hil.records.status
import hil.report.night
from benchmarks.reliability import nights
from hil.campaign import Campaign
from hil.config import Bench, parse_bench, parse_sweep
from hil.errors import InputError
from hil.night import start_night
from hil.records.blocks import SAMPLES
from hil.records.export import campaign_of_night
from hil.records.ledger import TABLES
from hil.records.reader import JOURNAL_NAME, JournalReader, reading
from hil.records.status import night_status
from hil.records.verify import verify_night
from hil.records.witnesses import Witnesses
from hil.report.night import night_content
from hil.solve import solve_campaign
from hil.solve.document import solution_document

_WITHOUT = {"breaks": hil.records.reader, "refuse_damaged_samples": hil.records.export}
SAME, NAMED = "same", "named"


def _solution(folder: Path) -> tuple[object, list[str]]:
    return _solved(Exactly(campaign_of_night(folder))), []


class Exactly:
    """A campaign that equals another of the same digits: what follows from it need be computed only once."""

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign
        with np.printoptions(precision=17, threshold=sys.maxsize):
            self._text = repr(campaign)

    def __hash__(self) -> int:
        return hash(self._text)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Exactly) and self._text == other._text


@cache
def _solved(one: Exactly) -> object:
    return solution_document(one.campaign, solve_campaign(one.campaign))


def _document(of: Callable[[Path], dict[str, Any]], folder: Path) -> tuple[object, list[str]]:
    document = of(folder)
    return document, document["problems"]


PATHS: dict[str, Callable[[Path], tuple[object, list[str]]]] = {
    "status": lambda folder: _document(hil.records.status.night_status, folder),
    "verify": lambda folder: _document(verify_night, folder),
    "report": lambda folder: (night_content(folder), []),
    "solve and export": _solution,
}
"""What states something of a night: what it states, and the breaks that it names beside it."""


class Judge:
    """Knows what each path says of the sound night in `folder`, and judges what it says of the damaged one."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        hil.config.recorded.understood = cache(hil.config.recorded.understood)  # type: ignore[assignment]
        hil.records.export.bench_of_record = cache(hil.records.export.bench_of_record)  # type: ignore[assignment]
        self._sound = {name: repr(path(folder)) for name, path in PATHS.items()}
        self.seen: Counter[str] = Counter()
        self.problems: list[str] = []

        with reading(folder) as journal:
            done = {(key, each.attempt) for key, each in journal.done_attempts().items()}
            rows = [row for row in journal.blocks() if (row.step_key, row.attempt) in done]
        self.rests_on = {row.block.path for row in rows if row.block.kind == SAMPLES}

    def look(self, what: str, path: str = "") -> bool:
        """Ask every path; tell whether at least one has named a break. `path` is the block that was changed, if any.

        What the journal's proof says of one change is asked once, and every path is told; the status likewise.
        """
        ask, told = JournalReader.damage, list[list[str]]()

        def damage(journal: JournalReader, witnesses: Witnesses | None = None) -> list[str]:
            if not told:
                told.append(ask(journal, witnesses))
            return list(told[0])

        with (
            patch.object(JournalReader, "damage", damage),
            patch.object(Witnesses, "of", cache(Witnesses.of)),
            patch.object(hil.records.status, "night_status", cache(night_status)) as status,
            patch.object(hil.report.night, "night_status", status),
        ):
            verdicts = {name: self._verdict(name) for name in PATHS}
        if path in self.rests_on and verdicts["solve and export"] == SAME:
            self.problems.append(f"{what}: SILENT: numbers that rest on it are stated")
        for name, verdict in verdicts.items():
            if verdict not in (SAME, NAMED):
                self.problems.append(f"{what}: {name}: {verdict}")
        named = NAMED in verdicts.values()
        self.seen["named" if named else "the same to the digit"] += 1
        return named

    def clear_away(self) -> None:
        """Remove what SQLite leaves beside a journal that was read."""
        for left in ("-wal", "-shm"):
            self.folder.joinpath(f"{JOURNAL_NAME}{left}").unlink(missing_ok=True)

    def _verdict(self, name: str) -> str:
        self.clear_away()
        try:
            stated, breaks = PATHS[name](self.folder)
        except InputError as error:
            return NAMED if str(error).count("\n") == 0 else f"several lines: {error}"
        except Exception as error:  # what a technician would see as an internal error
            return f"internal error: {error!r}"
        if breaks:
            return NAMED
        return SAME if repr((stated, breaks)) == self._sound[name] else "SILENT: another result, and nothing is named"


def smallest_bench(base: Path) -> Bench:
    """Return the simulated bench with one sensor of two rates, its files without comments, tables and what is not sent.

    The files that it names are written into `base`.
    """
    bench, shipped = yaml.safe_load(nights.bench().text), nights.bench()
    imu, model = (
        yaml.safe_load(Path(path).read_text()) for path in (shipped.imu_description, shipped.simulation_model or "")
    )
    sample, sensor = imu["frames"]["sample"], {"rates": {"RA": "rate_A2", "RB": "rate_B2"}}
    kept = ("status", "counter", "index_position", *sensor["rates"].values())
    sample["fields"] = {name: each for name, each in sample["fields"].items() if name in kept}
    sample["length"] = 2 + 1 + 1 + 2 + 1 + 4 + 4 + 4
    imu["roles"] |= {"sensors": {2: sensor}, "conditions": {}}
    del bench["sensors"][1], model["sensors"][1]
    model["noise"] = {2: {"angle_random_walk": {"unit": "deg/sqrt(hr)", "value": 0.12}}}
    model["sensors"][2] = {name: {"unit": each["unit"], "value": 5.0} for name, each in model["sensors"][2].items()}
    bench["imu"]["description"], bench["simulation"]["model"] = (
        str(base / f"{name}.yaml") for name in ("imu", "model")
    )
    for name, document in (("imu", imu), ("model", model)):
        (base / f"{name}.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    return parse_bench(yaml.safe_dump(bench, sort_keys=False), "smallest.yaml")


def smallest_night(base: Path) -> Path:
    """Carry it out, take the air out of its journal, and return its folder."""
    text = re.sub("settle.*s}", "settle: 1 s, duration: 2 s}", nights._SWEEP.replace("2 min", "1 min"))
    night = base / nights.NIGHT
    if start_night(night, parse_sweep(text, "smallest.yaml"), smallest_bench(base), who="first").state != "complete":
        raise SystemExit("the night did not become complete")
    with closing(sqlite3.connect(night / JOURNAL_NAME, isolation_level=None)) as journal:
        for statement in ("journal_mode = DELETE", "page_size = 512", "", "journal_mode = WAL"):
            journal.execute(f"PRAGMA {statement}" if statement else "VACUUM").fetchall()
    return night


def flipped_bytes(judge: Judge, every: int, seed: int, only: str = "*", part: str = "1/1") -> Iterator[str]:
    """Flip one bit of every `every`th byte of every file; yield each file's name when it is done."""
    draw, (share, of) = random.Random(seed), map(int, part.split("/"))
    judge.clear_away()
    for path in sorted(path for path in judge.folder.rglob(only) if path.is_file()):
        name, good = str(path.relative_to(judge.folder)), path.read_bytes()
        for at in range(draw.randrange(every), len(good), every):
            bit = 1 << draw.randrange(8)
            if at // every % of != share - 1:
                continue
            path.write_bytes(good[:at] + bytes([good[at] ^ bit]) + good[at + 1 :])
            judge.look(f"{name}, byte {at} ^ {bit}", name)
        path.write_bytes(good)
        yield name


def changed_rows(judge: Judge, every: int) -> Iterator[str]:
    """Edit every cell, delete, exchange and double every row of every table; yield each table's name.

    Only one such change in `every` is tried.
    """
    turns = count()
    path = judge.folder / JOURNAL_NAME
    good = path.read_bytes()

    def tried(what: str, *statements: tuple[Any, ...]) -> None:
        if next(turns) % every:
            return
        path.write_bytes(good)
        try:
            with closing(sqlite3.connect(path, isolation_level=None)) as connection:
                connection.execute("PRAGMA ignore_check_constraints = ON")
                for (trigger,) in connection.execute(
                    "SELECT name FROM sqlite_master WHERE type = 'trigger'"
                ).fetchall():
                    connection.execute(f"DROP TRIGGER {trigger}")
                for statement, *values in statements:
                    connection.execute(statement, values)
        except sqlite3.IntegrityError:  # the tables themselves do not have it
            judge.seen["refused by the tables"] += 1
            return
        if not judge.look(what):
            judge.problems.append(f"{what}: nobody has named it")

    with closing(sqlite3.connect(path)) as connection:
        tables = {table: connection.execute(f"SELECT * FROM {table}") for table in (*TABLES, "ledger")}  # noqa: S608
        rows = {
            table: ([column[0] for column in found.description], found.fetchall()) for table, found in tables.items()
        }
    for table, (columns, there) in rows.items():
        put = f"INSERT INTO {table} VALUES ({', '.join('?' * len(columns))})"  # noqa: S608
        for number, row in enumerate(there):
            where = f"WHERE {columns[0]} = {row[0]}"
            for column, value in zip(columns, row, strict=True):
                other = value + 1 if isinstance(value, int | float) else f"{value or ''}1"
                tried(f"{table} {row[0]} {column}", (f"UPDATE {table} SET {column} = ? {where}", other))  # noqa: S608
            delete = (f"DELETE FROM {table} {where}",)  # noqa: S608
            tried(f"{table} {row[0]} deleted", delete)
            tried(f"{table} {row[0]} doubled", (put, 10**6, *row[1:]))
            after = there[(number + 1) % len(there)]
            if after != row:
                delete_other = (f"DELETE FROM {table} WHERE {columns[0]} = {after[0]}",)  # noqa: S608
                exchanged = (put, row[0], *after[1:]), (put, after[0], *row[1:])
                tried(f"{table} {row[0]} exchanged with {after[0]}", delete, delete_other, *exchanged)
        yield table
    path.write_bytes(good)


def main() -> None:
    """Change what was asked for, and print what became of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("bytes", "rows"))
    parser.add_argument("--every", type=int, default=1, help="only one change in so many")
    parser.add_argument("--only", default="*", help="only files of such a name")
    parser.add_argument("--part", default="1/1", help="only this share of them, such as 1/2")
    parser.add_argument("--without", choices=sorted(_WITHOUT), help="break the program on purpose: leave this out")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    if asked.without:
        setattr(_WITHOUT[asked.without], asked.without, lambda *_: [])
    began_s = time.monotonic()
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None  # noqa: S108 - a folder in memory
    base = Path(tempfile.mkdtemp(prefix="hil-flips-", dir=memory))
    try:
        judge = Judge(smallest_night(base))
        flips = flipped_bytes(judge, asked.every, asked.seed, asked.only, asked.part)
        work = changed_rows(judge, asked.every) if asked.kind == "rows" else flips
        for name in work:
            print(name, dict(judge.seen), f"{time.monotonic() - began_s:.0f} s", file=sys.stderr)
    except KeyboardInterrupt:
        print("ended early, and this is what was seen until then", file=sys.stderr)
    finally:
        shutil.rmtree(base)
    document = {**vars(asked), **judge.seen, "problems": judge.problems}
    print(json.dumps({**document, "seconds": round(time.monotonic() - began_s, 1)}, indent=1))
    sys.exit(1 if judge.problems else 0)


if __name__ == "__main__":
    main()
