"""How a command ends: one exit status per kind of ending, and one sentence instead of a traceback."""

from __future__ import annotations

import os
import sys
import tempfile
import traceback
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path

from drivers.errors import DeviceError
from hil.errors import InputError


class Exit(IntEnum):
    """The exit statuses of every command."""

    DONE = 0
    FAILED = 1
    BAD_INPUT = 2
    STOPPED_SAFE = 3
    INCOMPLETE = 4


def run_to_exit(command: Callable[[], int | None]) -> int:
    """Run `command` and turn whatever it raises into a sentence on standard error and an exit status."""
    try:
        return command() or Exit.DONE
    except InputError as error:
        return _say(error, Exit.BAD_INPUT)
    except DeviceError as error:
        return _say(error, Exit.STOPPED_SAFE)
    except KeyboardInterrupt:
        return _say("stopped from the keyboard", Exit.FAILED)
    except BrokenPipeError:
        # The reader (head, less) has gone; keep the interpreter from complaining when it flushes.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.DONE
    except OSError as error:
        return _say(f"{error.filename or 'system'}: {error.strerror or error}", Exit.FAILED)
    except Exception as error:  # the last net: a defect of ours must not become a traceback in a laboratory
        return _say(f"internal error: {error!r}. Please report it with {_write_traceback()}", Exit.FAILED)


def _say(what: object, status: Exit) -> int:
    print(f"hil: {what}", file=sys.stderr)  # noqa: T201 (the one sentence that a failed command leaves)
    return status


def _write_traceback() -> Path:
    """Keep the traceback in a file that can be sent to somebody, out of the technician's sight."""
    handle, name = tempfile.mkstemp(prefix="hil-error-", suffix=".txt")
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(traceback.format_exc())
    return Path(name)
