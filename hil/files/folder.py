"""A new folder, or a file that a library writes, that appears as a whole or not at all."""

import contextlib
import errno
import glob
import os
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from hil.errors import InputError
from hil.files.durable import PARTIAL, RealDisk, make_folders, remove_folders
from hil.files.lock import process_start


def is_new(folder: Path) -> bool:
    """Tell whether there is no such folder yet, or an empty one."""
    return not folder.exists() or (folder.is_dir() and not any(folder.iterdir()))


@contextlib.contextmanager
def whole_or_nothing(target: Path) -> Iterator[Path]:
    """Give a temporary folder on the same disk, which becomes `target` if nothing is raised, and vanishes otherwise.

    Raises `InputError` where it cannot be made.
    """
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
    """Give a temporary name on the same disk for a file that becomes `target` if nothing is raised, and goes otherwise.

    Raises `InputError` where it cannot be made.
    """
    partial = target.with_name(f"{PARTIAL}{target.name}-{os.getpid()}")
    _clear_away(target.parent, target.name)
    try:
        yield partial
        with partial.open("rb+") as file:
            os.fsync(file.fileno())
        RealDisk().rename(partial, target)
        RealDisk().synchronise_folder(target.parent)
    except OSError as error:
        raise InputError(f"{target}: cannot be made ({error.strerror or error})") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def _clear_away(above: Path, name: str) -> None:
    """Remove what is unfinished of this name, folders or files, whose process died while it made them."""
    for left in above.glob(f"{PARTIAL}{glob.escape(name)}-*"):
        number = left.name.rpartition("-")[2]
        if number.isdecimal() and not process_start(int(number)):
            shutil.rmtree(left, ignore_errors=True) if left.is_dir() else left.unlink(missing_ok=True)
