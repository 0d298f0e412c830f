"""The units of a night by their folders: of several each has its own within the night's, and is named by it.

    unit_folder(night, "0042")          # night/units/0042: its live files; what asks for a unit is given this folder
    night_and_unit(that)                # night, "0042"

All else of a night is in one place: one plan, one journal, one chain. A unit's folder opens the same journal, and sees
of it what was done to that unit and to the chamber.
"""

from pathlib import Path

UNITS = "units"


def unit_folder(night: Path, unit: str) -> Path:
    """Return the folder of a unit; that of the night for the one unit of a bench that lists none."""
    return night / UNITS / unit if unit else night


def night_and_unit(folder: Path) -> tuple[Path, str]:
    """Return the night that a folder belongs to, and the unit that it names: nothing where it is the night's own."""
    whole = folder if folder.name else folder.absolute()
    named = whole.parent.name == UNITS
    return (whole.parent.parent, whole.name) if named else (folder, "")
