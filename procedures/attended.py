"""Questions to people while the bench is being looked at: place the unit, confirm the position.

    attendant = Attendant(terminal)              # given to the positioner that asks
    Sequencer(..., attendant=attendant)

Every poll goes on while a question stands: interlocks, the sign of life, a stop, a pause and an abort work as ever. The
question stands in the journal, so that it can be answered from another shell or a dashboard as well as on the terminal.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Protocol

from procedures.watch import Watch


class Terminal(Protocol):
    """Somebody who may sit there. Never waits."""

    def put(self, question: str, timeout_s: float) -> None:
        """Show the question."""

    def answer(self) -> bool | None:
        """Return the answer, or None while there is none."""

    def settle(self, how: str) -> None:
        """Say that the question stands no more: confirmed, refused, no answer, withdrawn."""


class Attendant:
    """Puts questions to people, on a terminal (where there is one) and through the journal."""

    def __init__(self, terminal: Terminal | None = None) -> None:
        self._terminal = terminal
        self._watch: Watch | None = None

    def attend(self, watch: Watch) -> None:
        """Look at the bench through `watch` while a question stands."""
        self._watch = watch

    def __call__(self, question: str, timeout_s: float) -> bool | None:
        """Return True where somebody confirms, False where they refuse, None after `timeout_s`. Raises as a poll.

        Raises `ValueError` where no sweep is being watched yet: `attend` comes first.
        """
        watch = self._watch
        if watch is None:
            raise ValueError("a question before the sweep has begun")
        question = f"{watch.remark[:1].upper()}{watch.remark[1:]}. {question}" if watch.remark else question
        prompt = watch.desk.put(question, timeout_s)
        self._show(question, timeout_s)
        watch.note = question
        how = "withdrawn"
        try:
            for _ in watch.wait(watch.now_s + timeout_s):
                if prompt.answer is None:
                    prompt.answer, prompt.who = self._heard(), "the terminal"
                if prompt.answer is not None:
                    how = "confirmed" if prompt.answer else "refused"
                    return prompt.answer
            how = "no answer"
            return None
        finally:
            if how in ("withdrawn", "no answer"):
                prompt.who = ""
            watch.note = ""
            if self._terminal is not None:
                with suppress(Exception):
                    self._terminal.settle(how)
            watch.desk.settle(how)

    def _show(self, question: str, timeout_s: float) -> None:
        try:
            if self._terminal is not None:
                self._terminal.put(question, timeout_s)
        except Exception:  # a closed terminal: the question still stands in the journal
            self._terminal = None

    def _heard(self) -> bool | None:
        try:
            return None if self._terminal is None else self._terminal.answer()
        except Exception:
            self._terminal = None
            return None
