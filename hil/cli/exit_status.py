"""How a command ends: one exit status per kind of ending, and one sentence instead of a traceback."""

import errno
import functools
import inspect
import sqlite3
import sys
import tempfile
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from enum import IntEnum
from inspect import Parameter
from typing import Annotated, Any

import typer

from drivers.errors import DeviceError
from drivers.strict_yaml import packaged
from hil.cli.answer import Answer
from hil.errors import Damaged, InputError
from procedures.words import harmless

_FROM_THE_KEYBOARD, _STOPPED = 130, "stopped from the keyboard"  # what a command line ends with that was interrupted
_JSON = Parameter("as_json", Parameter.KEYWORD_ONLY, default=False, annotation=bool)
OPTIONS: Mapping[str, Any] = packaged("hil.cli", "options.yaml")
"""What the parameters of each command, and of `every` command, mean; and what commands with others below are for."""


class Exit(IntEnum):
    """The exit statuses of every command."""

    DONE = 0
    FAILED = 1
    BAD_INPUT = 2
    STOPPED_SAFE = 3
    INCOMPLETE = 4
    CHAMBER_NOT_SAFE = 5
    CHAMBER_NOT_KNOWN = 6
    OUT_OF_SPEC = 7  # this and the next only where --strict asks for it
    SPEC_NOT_TOLD = 8
    SOME_UNITS = 9  # complete for some of several units; others were set aside, and the chamber is safe


def of_unit(in_spec: Mapping[str, str] | None, strict: bool) -> Exit:
    """Return how a command ends that found a unit in spec, out of spec or neither, where that is asked for."""
    if not strict:
        return Exit.DONE
    if in_spec is None:
        return _say(
            "--strict: nobody said what the unit must be: limits in its bench file, or hil solve --limits",
            Exit.SPEC_NOT_TOLD,
        )
    return {"in spec": Exit.DONE, "out of spec": Exit.OUT_OF_SPEC}.get(in_spec["verdict"], Exit.SPEC_NOT_TOLD)


def with_status(name: str, command: Callable[..., Answer | int | None]) -> Callable[..., None]:
    """Give a command the form that the application ends with: what it answers is printed, its exit status the last.

    A command that returns an `Answer` gets the option --json; others return their exit status. What its parameters mean
    `options.yaml` says under its `name`.
    """

    @functools.wraps(command)
    def ended(*arguments: object, **options: object) -> None:
        as_json = answers and bool(options.pop(_JSON.name))
        found = command(*arguments, **options)
        raise typer.Exit(found.show(as_json=as_json) if isinstance(found, Answer) else int(found or Exit.DONE))

    told = inspect.signature(command, eval_str=True)
    answers = told.return_annotation is Answer
    meant = {**OPTIONS["every"], **OPTIONS.get(name, {})}
    every = [*told.parameters.values(), *([_JSON] if answers else [])]
    ended.__signature__ = told.replace(parameters=[_meaning(each, meant[each.name]) for each in every])  # type: ignore[attr-defined]
    return ended


def _meaning(each: Parameter, told: str | Mapping[str, Any]) -> Parameter:
    own = {"help": told} if isinstance(told, str) else dict(told)
    if "argument" in own:
        info: Any = typer.Argument(help=own.pop("argument"), **own)
    else:  # of what is so unless it is said, typer makes a --no-
        flag = own.pop("flag", f"--{each.name.replace('_', '-')}")
        info = typer.Option(*([] if each.default is True else [flag]), **own)
    return each.replace(annotation=Annotated[each.annotation, info])


def run_to_exit(application: Callable[[], object]) -> int:
    """Run the application and turn whatever it raises into a sentence on standard error and an exit status.

    Usage errors it has said and ended itself: their status passes through.
    """
    try:
        application()
    except SystemExit as ending:
        if ending.code == _FROM_THE_KEYBOARD:
            return _say(_stopped(ending), Exit.FAILED)
        return int(ending.code or Exit.DONE)
    except Damaged as error:
        return _say(f"ERROR: {error}", Exit.INCOMPLETE)
    except InputError as error:
        return _say(error, Exit.BAD_INPUT)
    except DeviceError as error:
        return _say(error, Exit.STOPPED_SAFE)
    except KeyboardInterrupt as ending:
        return _say(_stopped(ending), Exit.FAILED)
    except sqlite3.OperationalError as error:  # a full disk, a journal that cannot be opened
        return _say(f"the journal: {error}", Exit.FAILED)
    except sqlite3.DatabaseError as error:
        return _say(f"ERROR: the journal is damaged ({error}); hil verify says how far", Exit.INCOMPLETE)
    except OSError as error:
        if isinstance(error.__context__, KeyboardInterrupt):  # what was interrupted could not be tidied up
            return _say(_STOPPED, Exit.FAILED)
        given = (errno.ENAMETOOLONG, errno.EROFS, errno.EACCES, errno.EPERM)
        of_a_name = error.errno in given  # of no file that we chose
        status = Exit.BAD_INPUT if of_a_name else Exit.FAILED
        return _say(f"{error.filename or 'system'}: {error.strerror or error}", status)
    except Exception as error:  # the last net: a defect of ours must not become a traceback in a laboratory
        with tempfile.NamedTemporaryFile(
            "w", prefix="hil-error-", suffix=".txt", encoding="utf-8", delete=False
        ) as kept:
            traceback.print_exc(file=kept)  # it can be sent to somebody
        return _say(f"internal error: {error!r}. Please report it with {kept.name}", Exit.FAILED)
    return Exit.DONE


def _stopped(ending: BaseException | None) -> str:
    """Say by what a command was stopped: the keyboard, or the signal that a `KeyboardInterrupt` behind it names."""
    while ending is not None and not isinstance(ending, KeyboardInterrupt):
        ending = ending.__cause__ or ending.__context__
    return f"stopped by {ending}" if ending is not None and ending.args else _STOPPED


def _say(what: object, status: Exit) -> Exit:
    with suppress(OSError):  # a closed terminal does not change how it ended
        print(f"hil: {harmless(str(what))}", file=sys.stderr)  # noqa: T201 (the one sentence that a failed command leaves)
    return status
