"""Asking the operator on the terminal, with a time-out."""

import os
import select
import sys

import typer

from hil.cli.output import messages
from hil.errors import InputError
from procedures.words import hours_minutes

_YES, _NO = {"y", "yes"}, {"n", "no"}


def ask_on_terminal(question: str, timeout_s: float) -> bool | None:
    """Put a question to whoever sits at the terminal; return None where no answer came within `timeout_s` seconds.

    Anything but yes or no is asked again. Where standard input has ended nobody can answer.
    """
    console = messages()
    asked = f"{question}  [yes/no, within {hours_minutes(timeout_s)}]"
    console.print(asked)
    while select.select([sys.stdin], [], [], timeout_s)[0]:
        line = sys.stdin.readline()
        if not line:
            return None
        answer = line.strip().lower()
        if answer in _YES | _NO:
            return answer in _YES
        console.print(f"please answer yes or no\n{asked}")
    return None


def must_agree(question: str, refused: str) -> None:
    """Raise `InputError` beginning with `refused` where whoever sits there does not say yes."""
    try:
        agreed = typer.confirm(question, err=True)
    except typer.Abort:
        agreed = False
    if not agreed:
        raise InputError(f"{refused}: answer yes, or give --yes where nobody can be asked")


def ask_words(question: str) -> str:
    """Return what is typed; raise `InputError` where nobody answers."""
    try:
        return str(typer.prompt(question, err=True))
    except typer.Abort:
        raise InputError("not begun: nobody answered") from None


class TerminalQuestions:
    """A `procedures.attended.Terminal`: shows the questions of a night, and hears answers without ever waiting."""

    _wants_words, _asked = False, ""

    def put(self, question: str, timeout_s: float, *, wants_words: bool = False) -> None:
        """Show the question."""
        self._wants_words = wants_words
        wanted = "type it, then Enter" if wants_words else "yes/no"
        self._asked = f"{question}  [{wanted}, within {hours_minutes(timeout_s)}]"
        messages().print(self._asked)

    def answer(self) -> bool | str | None:
        """Return the answer, or None while there is none. Anything but yes or no is asked again, unless words count."""
        if not _in_foreground() or not select.select([sys.stdin], [], [], 0.0)[0]:
            return None
        line = sys.stdin.readline().strip()
        answer = line.lower()
        if self._wants_words:
            return line or None
        if answer in _YES | _NO:
            return answer in _YES
        if answer:
            messages().print(f"please answer yes or no\n{self._asked}")
        return None

    def settle(self, how: str) -> None:
        """Say how it ended."""
        messages().print(how)


def _in_foreground() -> bool:
    """Tell whether this process may read its standard input: the system stops a background job that tries."""
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:
        return not sys.stdin.isatty()  # a pipe or a file: whoever wrote it has answered
    except ValueError:  # it was closed
        return False
