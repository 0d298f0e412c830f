"""The one door for files that people give: what comes through it is a regular file, of a size that can be dealt with.

A pipe or a device may have no end, or never a beginning, and opening a serial port moves its lines. So whatever is no
file is refused before it is opened. Nothing else in the program opens what somebody else may have written.
"""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

from drivers.errors import InputError

TEXT_MB, TABLE_MB, RECORDING_MB = 4, 64, 2048
"""What is not exceeded by configuration, by a campaign's collects, by a recording that is read as a whole."""
# Windows has O_BINARY, without which its library changes line ends; other systems have the other two.
_READING = os.O_RDONLY | sum(getattr(os, flag, 0) for flag in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))

LARGER = "HIL_LARGEST_FILE_MB"
"""The environment variable that raises all of them."""

_KINDS = {
    stat.S_IFREG: "a file",
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def limit_bytes(usual_mb: float) -> int:
    """Return how many bytes are read where `usual_mb` MB are usual; raise `InputError` where the raised limit is none.

    >>> limit_bytes(TEXT_MB)
    4000000
    """
    given = os.environ.get(LARGER, "0")
    if not given.isdecimal():
        raise InputError(f"{LARGER}: {given!r} is no whole number of MB")
    return int(max(usual_mb, float(given)) * 1e6)


def check_size(path: Path | str, size: int, usual_mb: float, what: str = "it is") -> None:
    """Raise `InputError` where `size` bytes are more than is read."""
    if size > limit_bytes(usual_mb):
        raise InputError(
            f"{path}: {what} {size / 1e6:,.1f} MB, more than the {limit_bytes(usual_mb) / 1e6:g} MB that are read of "
            f"such a file; is it the right one? {LARGER}={-(-size // 1_000_000)} in the environment reads it"
        )


@contextmanager
def opened(path: Path | str, usual_mb: float | None = None) -> Iterator[BufferedReader]:
    """Open a file, of any length without `usual_mb`; `InputError` where none, too large, or unreadable, later too."""
    try:
        _check_kind(path, os.stat(path))
        # Without waiting, should it have become a pipe in the meantime.
        with os.fdopen(os.open(path, _READING), "rb") as file:
            status = os.fstat(file.fileno())
            _check_kind(path, status)
            if usual_mb is not None:
                check_size(path, status.st_size, usual_mb)
            yield file
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or ' '.join(str(error).split())})") from error


def _check_kind(path: Path | str, status: os.stat_result, wanted: int = stat.S_IFREG) -> None:
    if (kind := stat.S_IFMT(status.st_mode)) != wanted:
        what = _KINDS.get(kind, "something else")
        raise InputError(f"{path}: is {what}, not {_KINDS[wanted]}; give the name of {_KINDS[wanted]}")


def check_folder(path: Path | str) -> None:
    """Raise `InputError` where `path` is no folder, in words that say what it is instead."""
    try:
        _check_kind(path, os.stat(path), stat.S_IFDIR)
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such folder") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def read_bytes(path: Path | str, usual_mb: float = TEXT_MB) -> bytes:
    """Return all bytes of a file; raise `InputError` where it is none, is too large, or cannot be read."""
    with opened(path, usual_mb) as file:
        data = file.read(limit_bytes(usual_mb) + 1)  # a file of the kernel says that it is empty, and may have no end
    check_size(path, len(data), usual_mb, "it is at least")
    return data


def read_text(path: Path | str, usual_mb: float = TEXT_MB) -> str:
    """Return the text of a file, without byte order mark; raise `InputError` as `read_bytes` does, or for no UTF-8."""
    try:
        return read_bytes(path, usual_mb).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text (byte {error.start}); save it as UTF-8") from error
