"""The archive's index: what `hil units` and `hil history` answer from in a second, made from the folders alone.

    report = update(Path("archive"))     # what is new, gone, or cannot be read; rebuild=True: all anew
    with opened_index(Path("archive")) as index:
        index.entries("0042"); index.means("0042")

It is SQLite and never the truth: lost, damaged or of another version, it is made again by `hil archive ARCHIVE
--rebuild`. Each entry is one transaction, so a process that is killed leaves an index of whole entries, and whoever
asks is told which are not in it. Numbers are those of `hil solve`, the means and their uncertainty what repeats show.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from hil.analysis.night_verdict import night_verdict
from hil.archive.folder import check_archive, entries, folder_of, interrupted, read_entry, serial_of, stamp
from hil.campaign import Campaign
from hil.errors import InputError
from hil.files.durable import PARTIAL, RealDisk
from hil.solve import RunSolution, repeats, solve_campaign
from hil.solve.repeats import SensorRepeats, Uncertain
from hil.solve.runs import finite

INDEX_NAME = "index.sqlite"
_VERSION = 1
_BUSY_S = 30.0
_TABLES = """
CREATE TABLE entries (
    name TEXT PRIMARY KEY, stamp TEXT NOT NULL, serial TEXT NOT NULL, trouble TEXT NOT NULL, model TEXT NOT NULL,
    simulated INTEGER NOT NULL, began_utc TEXT NOT NULL, ended_utc TEXT NOT NULL, title TEXT NOT NULL,
    verdict TEXT NOT NULL, reason TEXT NOT NULL, night TEXT NOT NULL, collects INTEGER NOT NULL, whence TEXT NOT NULL,
    settings TEXT NOT NULL
);
CREATE INDEX entries_of_unit ON entries (serial);
CREATE TABLE means (
    entry TEXT NOT NULL REFERENCES entries (name) ON DELETE CASCADE, sensor INTEGER NOT NULL, parameter TEXT NOT NULL,
    temperature_degC REAL, own_degC REAL, value REAL NOT NULL, sd REAL, freedom REAL, runs INTEGER NOT NULL,
    unit TEXT NOT NULL
);
CREATE INDEX means_of_entry ON means (entry);
CREATE TABLE settings (digest TEXT PRIMARY KEY, document TEXT NOT NULL);
"""
_NOT_COMPARED = ("seed", "serial", "notify", "text")


@dataclass(frozen=True)
class Entry:
    """An entry as the index has it; `trouble` is why it cannot be read, and then only `name` and `serial` are known."""

    name: str
    stamp: str
    serial: str
    trouble: str
    model: str = ""
    simulated: bool = False
    began_utc: str = ""
    ended_utc: str = ""
    title: str = ""
    verdict: str = ""
    reason: str = ""
    night: str = ""
    collects: int = 0
    whence: str = ""
    settings: str = ""


@dataclass(frozen=True)
class ArchivedMean:
    """A parameter's mean at a temperature, and what the unit's own thermometer showed."""

    entry: str
    sensor: int
    parameter: str
    temperature_degC: float | None
    own_degC: float | None
    value: Uncertain


@dataclass(frozen=True)
class Update:
    """What an update did: entries that are `new` or were read again, that are `gone`, that cannot be read, and why."""

    new: Sequence[str]
    gone: Sequence[str]
    broken: Mapping[str, str]
    unfinished: Sequence[str]
    all_of: int


def update(archive: Path, *, rebuild: bool = False, each: Callable[[str], object] = str) -> Update:
    """Bring the index to what is in the folders; `each` is told every entry that is read.

    A `rebuild` is made beside the old index and takes its place at the end. Raises `InputError` for no archive, an
    index that cannot be read (without `rebuild`), or one that cannot be written.
    """
    check_archive(archive)
    path = archive / INDEX_NAME
    target = path.with_name(f"{PARTIAL}{INDEX_NAME}") if rebuild else path
    if rebuild:
        target.unlink(missing_ok=True)
    there, new = entries(archive), []
    with _connected(target, new=True) as connection:
        known = dict(connection.execute("SELECT name, stamp FROM entries"))
        gone = sorted(known.keys() - set(there))
        for name in gone:
            connection.execute("DELETE FROM entries WHERE name = ?", (name,))
        for name in there:
            if known.get(name) != (now := stamp(archive, name)):
                each(name)
                _take_in(connection, archive, name, now)
                new.append(name)
        broken = dict(connection.execute("SELECT name, trouble FROM entries WHERE trouble != ''"))
    if rebuild:
        RealDisk().rename(target, path)
        RealDisk().synchronise_folder(archive)
    return Update(new, gone, broken, list(interrupted(archive)), len(there))


def take_in(archive: Path, entry: str) -> None:
    """Take one entry in, as `update` does."""
    with _connected(archive / INDEX_NAME, new=True) as connection:
        _take_in(connection, archive, entry, stamp(archive, entry))


class Index:
    """The index, to be asked."""

    def __init__(self, archive: Path, connection: sqlite3.Connection) -> None:
        self._archive = archive
        self._connection = connection

    def entries(self, serial: str | None = None) -> list[Entry]:
        """Return the entries of a unit, or of all, in the order of time."""
        names = ", ".join(Entry.__dataclass_fields__)
        of = "" if serial is None else "WHERE serial = ?"
        rows = self._connection.execute(
            f"SELECT {names} FROM entries {of} ORDER BY began_utc, collects",  # noqa: S608 - our own names
            () if serial is None else (serial,),
        )
        return [Entry(*row) for row in rows]

    def means(self, serial: str) -> list[ArchivedMean]:
        """Return every mean of a unit, in the order of time."""
        rows = self._connection.execute(
            "SELECT entry, sensor, parameter, temperature_degC, own_degC, value, sd, freedom, runs, unit FROM means "
            "JOIN entries ON name = entry WHERE serial = ? ORDER BY began_utc, means.rowid",
            (serial,),
        )
        return [
            ArchivedMean(
                entry,
                sensor,
                parameter,
                at,
                own,
                Uncertain(value, math.nan if sd is None else sd, math.inf if freedom is None else freedom, runs, unit),
            )
            for entry, sensor, parameter, at, own, value, sd, freedom, runs, unit in rows
        ]

    def settings(self, digests: Sequence[str]) -> dict[str, Mapping[str, Any]]:
        """Return what bench and software were, by digest."""
        marks = ", ".join("?" * len(digests))
        rows = self._connection.execute(
            f"SELECT digest, document FROM settings WHERE digest IN ({marks})",  # noqa: S608 - question marks
            tuple(digests),
        )
        return {digest: json.loads(text) for digest, text in rows}

    def behind(self, serial: str | None = None) -> list[str]:
        """Return in words what is in the folders and not here, or here and not in the folders: it is not answered from.

        Of one unit also what has changed since it was taken in.
        """
        mine = {each.name: each.stamp for each in self.entries(serial)}
        there = set(entries(self._archive, "*" if serial is None else folder_of(serial)))
        said = [f"{name}: is not in the index yet" for name in sorted(there - mine.keys())]
        said += [f"{name}: is gone from the archive's folder, and not answered from" for name in self.gone(serial)]
        if serial is not None:
            changed = [name for name in sorted(there & mine.keys()) if mine[name] != stamp(self._archive, name)]
            said += [f"{name}: has changed since it was taken in" for name in changed]
        return said

    def gone(self, serial: str | None = None) -> list[str]:
        """Return the entries whose folder is not there any more."""
        there = set(entries(self._archive, "*" if serial is None else folder_of(serial)))
        return sorted({each.name for each in self.entries(serial)} - there)


@contextmanager
def opened_index(archive: Path) -> Iterator[Index]:
    """Open the index to ask it; raise `InputError` where there is none that can be read, with what to do."""
    check_archive(archive)
    with _connected(archive / INDEX_NAME, new=False) as connection:
        yield Index(archive, connection)


@contextmanager
def _connected(path: Path, *, new: bool) -> Iterator[sqlite3.Connection]:
    """Open an index, make it where it is `new`; raise `InputError` for what is none."""
    again = f"hil archive {path.parent} --rebuild makes it from the folders"
    if not new and not path.is_file():
        raise InputError(f"{path}: there is no index; {again}")
    try:
        uri = f"file:{quote(str(path.resolve()))}?mode={'rwc' if new else 'ro'}"
        with contextlib.closing(sqlite3.connect(uri, uri=True, isolation_level=None, timeout=_BUSY_S)) as connection:
            connection.execute("PRAGMA foreign_keys = ON")
            connection.execute("BEGIN IMMEDIATE" if new else "BEGIN")
            version = connection.execute("PRAGMA user_version").fetchone()[0]
            if new and version == 0:
                for statement in filter(str.strip, _TABLES.split(";")):
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version = {_VERSION}")
            elif version != _VERSION:
                raise InputError(f"{path}: is no index of this version; {again}")
            connection.execute("COMMIT")
            yield connection
    except sqlite3.Error as error:
        raise InputError(f"{path}: cannot be read or written ({error}); {again}") from None


def _take_in(connection: sqlite3.Connection, archive: Path, name: str, now: str) -> None:
    """Read an entry and write what it says, or why it cannot be read, in one transaction."""
    means: list[tuple[Any, ...]] = []
    try:
        facts, campaign, configuration = read_entry(archive, name)
        solutions = solve_campaign(campaign)
        entry = _entry(name, now, facts, campaign, solutions)
        means = list(_means(name, repeats(campaign, solutions)))
        text = json.dumps(_settings(facts, configuration), sort_keys=True)
        entry = entry | {"settings": hashlib.sha256(text.encode()).hexdigest()}
    except (InputError, KeyError, TypeError, ValueError) as error:
        entry, text = vars(Entry(name, now, serial_of(name), str(error) or repr(error))), ""
    with _transaction(connection):
        connection.execute("DELETE FROM entries WHERE name = ?", (name,))
        marks = ", ".join(f":{each}" for each in entry)
        connection.execute(f"INSERT INTO entries ({', '.join(entry)}) VALUES ({marks})", entry)  # noqa: S608
        connection.executemany(f"INSERT INTO means VALUES ({', '.join('?' * 10)})", means)  # noqa: S608
        if text:
            connection.execute("INSERT OR IGNORE INTO settings VALUES (?, ?)", (entry["settings"], text))


@contextmanager
def _transaction(connection: sqlite3.Connection) -> Iterator[None]:
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
    except BaseException:
        connection.execute("ROLLBACK")
        raise
    connection.execute("COMMIT")


def _entry(
    name: str, now: str, facts: Mapping[str, Any], campaign: Campaign, solutions: Sequence[RunSolution]
) -> dict[str, Any]:
    judged = night_verdict(str(facts["state"]), solutions)
    found = Entry(
        name,
        now,
        serial=str(facts["serial"]),
        trouble="",
        model=str(facts["model"]),
        simulated=campaign.simulated,
        began_utc=str(facts["began_utc"]),
        ended_utc=str(facts["ended_utc"]),
        title=campaign.title,
        verdict=str(judged.verdict),
        reason=judged.reason,
        night=str((facts["night"] or {}).get("id", "")),
        collects=sum(map(len, campaign.sensors.values())),
        whence=str(facts["from"]),
    )
    return dict(vars(found))


def _means(name: str, shown: Mapping[int, SensorRepeats]) -> Iterator[tuple[Any, ...]]:
    for number, of_sensor in shown.items():
        for mean in of_sensor.means:
            own = None if mean.unit_degC is None else sum(mean.unit_degC) / 2.0
            for parameter, of in mean.values.items():
                known = (finite(of.sd), finite(of.freedom))
                yield name, number, parameter, mean.temperature_degC, own, of.value, *known, of.runs, of.unit


def _settings(facts: Mapping[str, Any], configuration: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a unit was measured with, flat: versions, and every key of bench and sweep; other files by hash."""
    found = {f"software.{name}": str(each) for name, each in (facts["versions"] or {}).items()}
    for name, of in configuration.items():
        if isinstance(of, dict):
            found |= dict(_flat(name, of))
        elif not name.endswith("_file") and name != "schema":
            found[f"file {name}"] = hashlib.sha256(str(of).encode()).hexdigest()[:12]
    return found | ({"limits": configuration["limits"]} if "limits" in configuration else {})


def _flat(above: str, of: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key, value in of.items():
        if isinstance(value, dict):
            yield from _flat(f"{above}.{key}", value)
        elif key not in _NOT_COMPARED:
            yield f"{above}.{key}", str(value)
