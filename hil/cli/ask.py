"""Asking the operator on the terminal, with a time-out."""

from __future__ import annotations

import select
import sys

from hil.cli.output import messages

_YES, _NO = {"y", "yes"}, {"n", "no"}


def ask_on_terminal(question: str, timeout_s: float) -> bool | None:
    """Put a question to whoever sits at the terminal; return None where no answer came within `timeout_s` seconds.

    Anything but yes or no is asked again. Where standard input has ended nobody can answer.
    """
    console = messages()
    console.print(f"{question}  [yes/no, within {timeout_s / 60.0:.0f} min] ", end="")
    while select.select([sys.stdin], [], [], timeout_s)[0]:
        line = sys.stdin.readline()
        if not line:
            return None
        answer = line.strip().lower()
        if answer in _YES | _NO:
            return answer in _YES
        console.print("please answer yes or no: ", end="")
    return None
