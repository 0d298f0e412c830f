"""Where things are in an archive: units' folders, entries, and what tells that an entry's files have changed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote, unquote

from drivers.given_file import check_folder
from hil.errors import InputError
from hil.files.durable import PARTIAL

MARK, ENTRY, CONFIGURATION, CAMPAIGN = "archive.yaml", "archived.yaml", "configuration.yaml", "campaign"
INDEX_NAME = "index.sqlite"
HASHED = (f"{CAMPAIGN}/campaign.yaml", f"{CAMPAIGN}/collects.csv", CONFIGURATION)
"""An entry's files whose hashes archived.yaml has."""

_UNIT = "unit-"


def folder_of(serial: str) -> str:
    """Return the name of a unit's folder."""
    return f"{_UNIT}{quote(serial, safe='')}"


def serial_of(entry: str) -> str:
    """Return the serial number of the unit in whose folder an entry stands."""
    return unquote(entry.partition("/")[0].removeprefix(_UNIT))


def check_archive(archive: Path) -> None:
    """Raise `InputError` where the folder is no archive."""
    check_folder(archive)
    if not (archive / MARK).is_file():
        raise InputError(f"{archive}: is no archive (no {MARK}); hil archive {archive} NIGHT makes one of a new folder")


def entries(archive: Path, serial: str | None = None) -> list[str]:
    """Return the entries that are there, of one unit or of all, by name."""
    units = [each.name for each in os.scandir(archive) if each.is_dir() and each.name.startswith(_UNIT)]
    mine = units if serial is None else [name for name in units if name == folder_of(serial)]
    found = [f"{unit}/{each.name}" for unit in mine for each in os.scandir(archive / unit) if each.is_dir()]
    return sorted(name for name in found if PARTIAL not in name and (archive / name / ENTRY).is_file())


def stamp(archive: Path, entry: str) -> str:
    """Return what changes with an entry's files, without reading them."""
    stats = [(archive / entry / name).stat() for name in (ENTRY, *HASHED) if (archive / entry / name).exists()]
    return " ".join(f"{each.st_size}:{each.st_mtime_ns}" for each in stats)


def interrupted(archive: Path) -> Iterator[str]:
    """Yield what a killed process left behind: no entries, and nothing is read from them."""
    yield from (str(path.relative_to(archive)) for path in archive.glob(f"*/{PARTIAL}*"))
