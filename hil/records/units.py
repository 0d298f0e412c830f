"""The units of a night by their folders: of several each has its own within the night's, and is named by it.

    unit_folder(night, "0042")          # night/units/0042: its live files; what asks for a unit is given this folder
    place_of(that)                      # night, "0042"

All else of a night is in one place: one plan, one journal, one chain. A unit's folder opens the same journal, and sees
of it what was done to that unit and to the chamber.
"""

import os
from contextlib import suppress
from pathlib import Path

from hil.errors import InputError
from hil.files.durable import RealDisk, make_folders

UNITS = "units"
JOURNAL_NAME = "journal.sqlite"


def unit_folder(night: Path, unit: str) -> Path:
    """Return the folder of a unit; that of the night for the one unit of a bench that lists none."""
    return night / UNITS / unit if unit else night


def place_of(folder: Path) -> tuple[Path, str]:
    """Return the night's folder, and the unit that `folder` names where it is that of one of several units."""
    whole = folder if folder.name else folder.absolute()
    night = whole.parent.parent
    named = whole.parent.name == UNITS and os.path.lexists(night / JOURNAL_NAME)
    return (night, whole.name) if named and not os.path.lexists(folder / JOURNAL_NAME) else (folder, "")


def night_of(folder: Path) -> Path:
    """Return the folder of the night, which is the folder itself where it names no unit of one."""
    return place_of(folder)[0]


def writable(folder: Path) -> Path:
    """Return the folder of a night or a unit, made again where that was deleted; `InputError` where it is read-only."""
    if place_of(folder)[1]:
        with suppress(OSError):  # who writes in it says why not
            make_folders(RealDisk(), folder)
    if folder.is_dir() and not os.access(folder, os.W_OK):
        raise InputError(f"{folder}: is read-only; --out says where else the page is to be written")
    return folder


def refuse_unit(folder: Path) -> None:
    """Raise `InputError` where the folder names one of a night's units: that is carried on with all of them."""
    night, unit = place_of(folder)
    if unit:
        raise InputError(f"{folder}: unit {unit} is not carried on by itself; hil resume {night} carries on with all")
