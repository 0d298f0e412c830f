"""A night's new folder: refused where there is one."""

from __future__ import annotations

from pathlib import Path

from hil.errors import InputError
from hil.files.folder import is_new
from hil.records.reader import is_night


def refuse_existing(folder: Path) -> None:
    """Raise `InputError` where `folder` is there already and holds anything."""
    if not is_new(folder):
        what = "it holds a night already" if is_night(folder) else "it exists and is not empty"
        raise InputError(f"{folder}: {what}; name a new folder, or carry the night on with hil resume")
