"""The archive's index: what `hil units` and `hil history` answer from in a second.

It is SQLite and never the truth: it is made from the folders (`hil.archive.taking_in`), and where it is lost, damaged
or of another version, made again. Whoever asks is told what is in the folders and not in it.
"""

from __future__ import annotations

import contextlib
import json
import math
import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from hil.archive.places import INDEX_NAME, check_archive, found, stamp
from hil.errors import InputError, worded

if TYPE_CHECKING:  # a list of units loads no arithmetic
    from hil.solve.uncertain import Uncertain

_VERSION = 4
_BUSY_S = 30.0
_TABLES = Path(__file__).with_name("index.sql")


@dataclass(frozen=True)
class Entry:
    """An entry as the index has it; `trouble` is why it cannot be read, and then only `name` and `serial` are known.

    `good` says that it tells something of the unit: some mean of it holds no run that is INCONCLUSIVE or FAIL.
    """

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
    good: bool = False


def calibrations(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries that count, in the order of `Index.entries`: of a night that was carried on, the fuller."""
    fullest = {each.night or each.name: each for each in entries}
    return [each for each in entries if fullest[each.night or each.name] is each]


@dataclass(frozen=True)
class ArchivedMean:
    """A parameter's mean at a temperature, and the mean of what the unit's own thermometer showed."""

    entry: str
    sensor: int
    parameter: str
    temperature_degC: float | None
    own_degC: float | None
    value: Uncertain


class Index:
    """The index, to be asked."""

    def __init__(self, archive: Path, connection: sqlite3.Connection) -> None:
        self._archive = archive
        self._connection = connection
        self._folders: dict[str | None, tuple[list[str], dict[str, str]]] = {}

    def entries(self, serial: str | None = None) -> list[Entry]:
        """Return the entries of a unit, or of all, in the order of time."""
        names = ", ".join(Entry.__dataclass_fields__)
        of = "" if serial is None else "WHERE serial = ?"
        rows = self._connection.execute(
            f"SELECT {names} FROM entries {of} ORDER BY began_utc, collects",  # noqa: S608 - our own names
            () if serial is None else (serial,),
        )
        return [Entry(*row) for row in rows]

    def units(self) -> list[dict[str, Any]]:
        """Return a row for each unit: serial, model, how often calibrated, first and last, newest verdict, troubles."""
        found: dict[tuple[str, str, bool], list[Entry]] = {}
        gone = set(self.gone())
        broken: Counter[str] = Counter()
        for each in self.entries():
            if each.trouble or each.name in gone:
                broken[each.serial] += 1
            else:
                found.setdefault((each.serial, each.model, each.simulated), []).append(each)
        found |= {(serial, "", False): [] for serial in broken.keys() - {serial for serial, _, _ in found}}
        same = [serial for serial, model, _ in found if len({m for s, m, _ in found if s == serial}) > 1]
        return [
            {
                "serial": serial,
                "model": model,
                "simulated": bool(simulated),
                "campaigns": len(of),
                "first": of[0].began_utc[:10] if of else None,
                "last": of[-1].began_utc[:10] if of else None,
                "verdict": of[-1].verdict if of else None,
                "cannot_be_read": broken[serial],
                "remark": "two units have this serial number" if serial in same else "",
            }
            for (serial, model, simulated), every in sorted(found.items())
            for of in [calibrations(every)]
        ]

    def means(self, serial: str) -> list[ArchivedMean]:
        """Return every mean of a unit, in the order of time."""
        from hil.solve.uncertain import Uncertain

        rows = self._connection.execute(
            "SELECT entry, sensor, parameter, temperature_degC, own_degC, value, sd, freedom, runs, unit, beyond "
            "FROM means JOIN entries ON name = entry WHERE serial = ? ORDER BY began_utc, means.rowid",
            (serial,),
        )
        found = []
        for entry, sensor, parameter, at, own, value, sd, freedom, *more in rows:
            known = (math.nan if sd is None else sd, math.inf if freedom is None else freedom)
            found.append(ArchivedMean(entry, sensor, parameter, at, own, Uncertain(value, *known, *more)))
        return found

    def settings(self, digests: Sequence[str]) -> dict[str, Mapping[str, Any]]:
        """Return what bench and software were, by digest."""
        marks = ", ".join("?" * len(digests))
        rows = self._connection.execute(
            f"SELECT digest, document FROM settings WHERE digest IN ({marks})",  # noqa: S608 - question marks
            tuple(digests),
        )
        return {digest: json.loads(text) for digest, text in rows}

    def behind(self, serial: str | None = None) -> list[str]:
        """Return in words what is only in the folders, or only here; of one unit also what has changed since."""
        mine = {each.name: each.stamp for each in self.entries(serial)}
        found, closed = self._there(serial)
        there = set(found)
        said = [f"{name}: cannot be read ({why}), and is not answered from" for name, why in sorted(closed.items())]
        said += [f"{name}: is not in the index yet" for name in sorted(there - mine.keys())]
        gone = [name for name in self.gone(serial) if name.partition("/")[0] not in closed]
        said += [f"{name}: is gone from the archive's folder, and not answered from" for name in gone]
        if serial is not None:
            changed = [name for name in sorted(there & mine.keys()) if mine[name] != stamp(self._archive, name)]
            said += [f"{name}: has changed since it was taken in" for name in changed]
        return said

    def gone(self, serial: str | None = None) -> list[str]:
        """Return the entries whose folder is not there any more, or cannot be looked into."""
        return sorted({each.name for each in self.entries(serial)} - set(self._there(serial)[0]))

    def _there(self, serial: str | None) -> tuple[list[str], dict[str, str]]:
        if serial not in self._folders:
            self._folders[serial] = found(self._archive, serial)
        return self._folders[serial]


@contextmanager
def opened_index(archive: Path) -> Iterator[Index]:
    """Open the index to ask it; raise `InputError` where there is none that can be read, with what to do."""
    check_archive(archive)
    with connected(archive / INDEX_NAME, new=False) as connection:
        yield Index(archive, connection)


@contextmanager
def connected(path: Path, *, new: bool) -> Iterator[sqlite3.Connection]:
    """Open an index, make it where it is `new`; raise `InputError` for what is none."""
    again = f"hil archive {path.parent} --rebuild makes it from the folders"
    if not new and not path.is_file():
        raise InputError(f"{path}: there is no index; {again}")
    with worded(InputError, f"{path}: cannot be read or written (", sqlite3.Error, f"); {again}"):
        uri = f"file:{quote(str(path.resolve()))}?mode={'rwc' if new else 'ro'}"
        with contextlib.closing(sqlite3.connect(uri, uri=True, isolation_level=None, timeout=_BUSY_S)) as connection:
            connection.execute("PRAGMA foreign_keys = ON")
            connection.execute("BEGIN IMMEDIATE" if new else "BEGIN")
            version = connection.execute("PRAGMA user_version").fetchone()[0]
            if new and version == 0:
                for statement in filter(str.strip, _TABLES.read_text("utf-8").split(";")):
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version = {_VERSION}")
            elif version != _VERSION:
                raise InputError(f"{path}: is no index of this version; {again}")
            connection.execute("COMMIT")
            yield connection
