"""File operations that survive a power failure, in one place so that a test can make each of them fail.

A file or folder appears whole or not at all: it is written under a temporary name in the same folder, synchronised,
renamed, and the folder is synchronised, in this order. What a crash leaves behind is called `.partial-…`.
"""

import contextlib
import errno
import glob
import os
import shutil
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path

from hil.errors import InputError, worded
from hil.files.lock import process_start

PARTIAL = ".partial-"
"""How the temporary name of a file or folder begins that is not finished."""


class RealDisk:
    """The operating system's files: what durability rests upon. A rehearsal's disk is full now and then."""

    def write(self, path: Path, data: bytes) -> None:
        """Write `data` to `path` and synchronise the file; raise `OSError` where the disk is full or read-only."""
        with path.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())

    def rename(self, source: Path, target: Path) -> None:
        """Give `source` the name `target`, in one step."""
        source.replace(target)

    def synchronise_folder(self, folder: Path) -> None:
        """Make the names in `folder` durable; Windows does so by itself, and opens no folder."""
        if not hasattr(os, "O_DIRECTORY"):
            return
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write_durably(disk: RealDisk, path: Path, data: bytes) -> None:
    """Write `data` so that `path` holds all of it, or has not changed (`OSError`: disk full, read-only)."""
    partial = path.with_name(f"{PARTIAL}{path.name}")
    try:
        disk.write(partial, data)
        disk.rename(partial, path)
    except OSError:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise
    disk.synchronise_folder(path.parent)


def write_result(path: Path, data: bytes | str) -> None:
    """Write a file that somebody asked for as `write_durably` does; raise `InputError` where it cannot be written."""
    with worded(InputError, f"{path}: cannot be written: ", OSError):
        write_durably(RealDisk(), path, data.encode() if isinstance(data, str) else data)


def check_new(path: Path) -> None:
    """Raise `InputError` where a new file cannot be made: there is one already, or no folder for it."""
    if path.exists():
        raise InputError(f"{path}: exists already; give another name")
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist")


def check_file(path: Path, what: str, *endings: str) -> Path:
    """Return where a file is to be written; raise `InputError` for a folder, one in none, or a name of another kind."""
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file in it")
    if path.suffix.lower() not in endings:  # a slip must not replace a journal or a table by a page
        raise InputError(f"{path}: {what} is written as {' or '.join(endings)}; give a name that ends so")
    return path


def make_folders(disk: RealDisk, folder: Path) -> list[Path]:
    """Make `folder` and what is missing above it, durably, or nothing (`OSError`); return them, innermost first."""
    missing: list[Path] = []
    while not folder.exists():
        missing.append(folder)
        folder = folder.parent
    made: list[Path] = []
    try:
        for new in reversed(missing):
            new.mkdir()
            made.insert(0, new)
            disk.synchronise_folder(new.parent)
    except OSError:
        remove_folders(made)
        raise
    return made


def remove_folders(made: Iterable[Path]) -> None:
    """Remove what `make_folders` made, as far as it is still empty."""
    for folder in made:
        with contextlib.suppress(OSError):
            folder.rmdir()


def remove_partials(folder: Path) -> None:
    """Remove the unfinished files that a crash left in `folder`. Only its owner may do this, before it writes."""
    for path in folder.glob(f"{PARTIAL}*") if folder.is_dir() else ():
        with contextlib.suppress(OSError):
            path.unlink()


def is_new(folder: Path) -> bool:
    """Tell whether there is no such folder yet, or an empty one."""
    return not folder.exists() or (folder.is_dir() and not any(folder.iterdir()))


@contextlib.contextmanager
def whole_or_nothing(target: Path) -> Iterator[Path]:
    """Give a folder on the same disk that becomes `target` if nothing is raised; `InputError` where it cannot."""
    above = target.resolve().parent
    there = next(folder for folder in (above, *above.parents) if folder.exists())
    if not there.is_dir():
        raise InputError(f"{there}: is not a folder, so nothing can be made in it")
    made: list[Path] = []
    partial = above / f"{PARTIAL}{target.name}-{os.getpid()}"
    try:
        made = make_folders(RealDisk(), above)
        _clear_away(above, target.name)
        partial.mkdir()
        yield partial
        RealDisk().synchronise_folder(partial)
        RealDisk().rename(partial, target)
    except (OSError, sqlite3.OperationalError) as error:
        if getattr(error, "errno", None) in (errno.ENOTEMPTY, errno.EEXIST):
            raise InputError(f"{target}: it exists and is not empty; name a new folder") from error
        raise InputError(f"{target}: cannot be made ({getattr(error, 'strerror', None) or error})") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        remove_folders(made)
    RealDisk().synchronise_folder(above)


@contextlib.contextmanager
def whole_file(target: Path) -> Iterator[Path]:
    """Give a temporary name for what becomes `target` if nothing is raised; `InputError` where none can be."""
    partial = target.with_name(f"{PARTIAL}{target.name}-{os.getpid()}")
    _clear_away(target.parent, target.name)
    try:
        with worded(InputError, f"{target}: cannot be made (", OSError, ")"):
            yield partial
            with partial.open("rb+") as file:
                os.fsync(file.fileno())
            RealDisk().rename(partial, target)
            RealDisk().synchronise_folder(target.parent)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def _clear_away(above: Path, name: str) -> None:
    """Remove what is unfinished of this name, folders or files, whose process died while it made them."""
    for left in above.glob(f"{PARTIAL}{glob.escape(name)}-*"):
        number = left.name.rpartition("-")[2]
        if number.isdecimal() and not process_start(int(number)):
            shutil.rmtree(left, ignore_errors=True) if left.is_dir() else left.unlink(missing_ok=True)
