"""The archive's index made from the folders: new entries read and solved, those that went forgotten.

Each entry is one transaction, so a process that is killed leaves an index of whole entries. Numbers are those of `hil
solve`, the means and their uncertainty what repeats show. A mean that holds a run that is INCONCLUSIVE or FAIL is no
number to rely on, as the report says, and is not taken in; the others of its campaign are.
"""

import hashlib
import json
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Set
from pathlib import Path
from typing import Any

from hil.analysis.night_verdict import night_verdict
from hil.archive.folder import read_entry
from hil.archive.index import Entry, connected
from hil.archive.places import INDEX_NAME, check_archive, found, interrupted, serial_of, stamp
from hil.errors import InputError
from hil.files.document import plain
from hil.files.durable import PARTIAL, RealDisk
from hil.solve import repeats, solve_campaign
from hil.solve.repeats import SensorRepeats
from procedures.verdict import NOT_GOOD

_NOT_COMPARED = ("seed", "serial", "notify", "text")


def update(archive: Path, *, rebuild: bool = False, each: Callable[[str], object] = str) -> dict[str, Any]:
    """Bring the index to what is in the folders; `each` is told every entry that is read.

    Return how many `entries` there are, which were `read`, are `gone` or `unfinished`, or `cannot_be_read`, and why.
    A `rebuild` is made beside the old index and takes its place at the end. Raises `InputError` for no archive, an
    index that cannot be read (without `rebuild`), or one that cannot be written.
    """
    check_archive(archive)
    path = archive / INDEX_NAME
    target = path.with_name(f"{PARTIAL}{INDEX_NAME}") if rebuild else path
    if rebuild:
        for left in archive.glob(f"{target.name}*"):  # of somebody who was killed, its journal too
            left.unlink()
    (there, closed), new = found(archive), []
    with connected(target, new=True) as connection:
        known = dict(connection.execute("SELECT name, stamp FROM entries"))
        gone = sorted(name for name in known.keys() - set(there) if name.partition("/")[0] not in closed)
        for name in gone:
            connection.execute("DELETE FROM entries WHERE name = ?", (name,))
        for name in there:
            if known.get(name) != (now := stamp(archive, name)):
                each(name)
                _read(connection, archive, name, now)
                new.append(name)
        broken = closed | dict(connection.execute("SELECT name, trouble FROM entries WHERE trouble != ''"))
    if rebuild:
        RealDisk().rename(target, path)
        RealDisk().synchronise_folder(archive)
    done = {"entries": len(there), "read": new, "gone": gone, "cannot_be_read": broken}
    return done | {"unfinished": list(interrupted(archive))}


def take_in(archive: Path, entry: str) -> None:
    """Take one entry in, as `update` does."""
    with connected(archive / INDEX_NAME, new=True) as connection:
        _read(connection, archive, entry, stamp(archive, entry))


def _read(connection: sqlite3.Connection, archive: Path, name: str, now: str) -> None:
    """Read an entry and write what it says, or why it cannot be read, in one transaction."""
    try:
        facts, campaign, configuration = read_entry(archive, name)
        solutions = solve_campaign(campaign)
        bad = {(each.sensor, run) for each in solutions if each.verdict in NOT_GOOD for run in each.runs}
        means = list(_means(name, repeats(campaign, solutions), bad))
        text = json.dumps(_settings(facts, configuration), sort_keys=True)
        judged = night_verdict(str(facts["state"]), solutions)
        known = Entry(
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
            settings=hashlib.sha256(text.encode()).hexdigest(),
            good=bool(means),
        )
    except (InputError, OSError, KeyError, TypeError, ValueError) as error:
        known, means, text = Entry(name, now, serial_of(name), str(error) or repr(error)), [], ""
    entry = vars(known)
    with connection:  # all of it, or nothing
        connection.execute("BEGIN IMMEDIATE")
        connection.execute("DELETE FROM entries WHERE name = ?", (name,))
        marks = ", ".join(f":{each}" for each in entry)
        connection.execute(f"INSERT INTO entries ({', '.join(entry)}) VALUES ({marks})", entry)  # noqa: S608
        connection.executemany(f"INSERT INTO means VALUES ({', '.join('?' * 11)})", means)  # noqa: S608
        if text:
            connection.execute("INSERT OR IGNORE INTO settings VALUES (?, ?)", (entry["settings"], text))


def _means(name: str, shown: Mapping[int, SensorRepeats], bad: Set[tuple[int, int]]) -> Iterator[tuple[Any, ...]]:
    """Yield the means that hold none of the runs that are `bad`, by sensor."""
    for number, of_sensor in shown.items():
        for mean in of_sensor.means:
            for parameter, of in mean.values.items():
                if any((number, run) in bad for run in of_sensor.runs_of(mean, parameter)):
                    continue
                known = (plain(of.sd), plain(of.freedom), of.runs, of.unit, of.beyond)
                yield name, number, parameter, mean.temperature_degC, plain(mean.own_degC), of.value, *known


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
