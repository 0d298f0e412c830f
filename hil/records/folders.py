"""Which campaigns and nights folders hold, each read in its turn: a screen and a fleet file go through them once."""

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from drivers.given_file import check_folder
from hil.campaign import Campaign
from hil.campaign.fleet_file import pieces_of, read_piece
from hil.campaign.reader import HEADER_FILE
from hil.errors import InputError
from hil.files.processes import Map
from hil.records.export import open_source
from hil.records.reader import is_night, units_in

PIECE = 256
"""Units that a process takes at once."""
_AT_ONCE = 8  # pieces of files that are read at once; memory holds two times as many


def pieces_in(folders: Sequence[Path]) -> list[tuple[str, int]]:
    """Return what is read at once: campaigns and nights (-1), pieces of files; `InputError` for a folder of none."""
    found: list[tuple[str, int]] = []
    for folder in folders:
        if folder.suffix == ".parquet" and not folder.is_dir():
            found += [(str(folder), piece) for piece in range(pieces_of(folder))]
            continue
        check_folder(folder)
        inside = [(str(unit), -1) for each in _held(folder) for unit in (*units_in(each).values(),) or (each,)]
        if not inside:
            raise InputError(f"{folder}: no campaign folder (with {HEADER_FILE}) and no night is there")
        found += inside
    return list(dict.fromkeys(found))


def in_turn(mapped: Map, pieces: Sequence[tuple[str, int]]) -> Iterator[tuple[str, Campaign | str]]:
    """Read campaigns, each with its folder, or the sentence why it cannot be read; some at once, to spare memory."""
    folders = all(piece < 0 for _, piece in pieces)
    for read in some_at_once(mapped, _read, pieces, PIECE if folders else _AT_ONCE):
        yield from read


def _holds_one(folder: Path) -> bool:
    return (folder / HEADER_FILE).is_file() or (folder.is_dir() and is_night(folder))


def _held(folder: Path) -> Iterator[Path]:
    """Yield the campaigns and nights that a folder is or holds, in the order of their names: none holds others."""
    if _holds_one(folder):
        yield folder
        return
    for each in sorted(folder.iterdir()):
        if (each.is_dir() and not each.is_symlink()) or _holds_one(each):
            yield from _held(each)


def some_at_once(mapped: Map, function: Callable[[Any], Any], things: Sequence[Any], most: int) -> Iterator[Any]:
    """Yield what a function makes of things; the next of them are under way while these are taken."""
    ahead = mapped(function, things[:most])
    for first in range(most, len(things) + most, most):
        these, ahead = ahead, mapped(function, things[first : first + most])
        yield from these


def _read(piece: tuple[str, int]) -> list[tuple[str, Campaign | str]]:
    place, number = piece
    try:
        return [(place, open_source(Path(place)))] if number < 0 else list(read_piece(Path(place), number))
    except (InputError, OSError, sqlite3.Error) as error:
        why = str(error).removeprefix(place).lstrip("/:, ")  # the folder is said by whoever tells of it
        return [(place if number < 0 else f"{place}, row group {number}", why)]
