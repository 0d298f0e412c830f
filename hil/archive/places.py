"""Where things are in an archive: units' folders, entries, and what tells that an entry's files have changed."""

import os
from collections.abc import Iterator
from contextlib import suppress
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
        lost = f"its {MARK} is lost; hil archive {archive} --found founds it again over the same folders"
        new = "name one, or a new folder, of which hil archive FOLDER --found makes one"
        raise InputError(f"{archive}: is no archive (no {MARK}); {lost if found(archive)[0] else new}")


def check_usable(archive: Path) -> None:
    """Raise `InputError` where nothing could be taken up: no archive, or one that cannot be written."""
    check_archive(archive)
    closed = [each for each in (archive, archive / INDEX_NAME) if each.exists() and not os.access(each, os.W_OK)]
    if closed:
        raise InputError(f"{closed[0]}: cannot be written; see who owns it, and that its disk is not read-only")


def found(archive: Path, serial: str | None = None) -> tuple[list[str], dict[str, str]]:
    """Return the entries that are there, of one unit or of all, and what cannot be looked into, with the reason."""
    units = [each.name for each in os.scandir(archive) if each.name.startswith(_UNIT) and each.is_dir()]
    there, closed = [], {}
    for unit in units if serial is None else {folder_of(serial)} & set(units):
        try:
            there += [f"{unit}/{each.name}" for each in os.scandir(archive / unit) if each.is_dir()]
        except OSError as error:
            closed[unit] = str(error.strerror)
    return sorted(name for name in there if PARTIAL not in name), closed


def stamp(archive: Path, entry: str) -> str:
    """Return what changes with an entry's files, without reading them."""
    stats = []
    for name in (ENTRY, *HASHED):
        with suppress(OSError):  # who reads it says what is wrong
            stats.append((archive / entry / name).stat())
    return " ".join(f"{each.st_size}:{each.st_mtime_ns}" for each in stats)


def interrupted(archive: Path) -> Iterator[str]:
    """Yield what a killed process left behind: no entries, and nothing is read from them."""
    for unit in archive.glob(f"{_UNIT}*"):
        with suppress(OSError):
            yield from (f"{unit.name}/{name}" for name in os.listdir(unit) if name.startswith(PARTIAL))
