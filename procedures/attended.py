"""Questions to people while the bench is being looked at: place the unit, confirm the position.

Every poll goes on while a question stands: interlocks, the sign of life, a stop, a pause and an abort work as ever. The
question stands in the journal, so that it can be answered from another shell or a dashboard as well as on the terminal.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from procedures.requests import Prompt
from procedures.watch import Watch

Result = TypeVar("Result")


class Terminal(Protocol):
    """Somebody who may sit there. Never waits."""

    def put(self, question: str, timeout_s: float, *, wants_words: bool) -> None:
        """Show the question."""

    def answer(self) -> bool | str | None:
        """Return the answer, words where they were wanted, or None while there is none."""

    def settle(self, how: str) -> None:
        """Say that the question stands no more: confirmed, refused, no answer, withdrawn."""


@dataclass(eq=False)
class Attendant:
    """Puts questions to people, on a terminal (where there is one) and through the journal."""

    terminal: Terminal | None = None
    _watch: Watch | None = field(default=None, init=False)

    def attend(self, watch: Watch) -> None:
        """Look at the bench through `watch` while a question stands."""
        self._watch = watch

    def __call__(self, question: str, timeout_s: float) -> bool | None:
        """Return whether somebody confirms, None after `timeout_s`. Raises as a poll; `ValueError` before `attend`."""
        return self._answer(question, timeout_s, wants_words=False).answer

    def words(self, question: str, timeout_s: float) -> tuple[str, str]:
        """Return what somebody typed, else nothing, and who. Raises `ValueError` and as a poll, as a call does."""
        prompt = self._answer(question, timeout_s, wants_words=True)
        return (prompt.words.strip() if prompt.answer else ""), prompt.who

    def _answer(self, question: str, timeout_s: float, *, wants_words: bool) -> Prompt:
        watch = self._watch
        if watch is None:
            raise ValueError("a question before the sweep has begun")
        question = f"{watch.remark[:1].upper()}{watch.remark[1:]}. {question}" if watch.remark else question
        prompt = watch.desk.put(question, timeout_s, wants_words=wants_words)
        self._at_terminal(lambda terminal: terminal.put(question, timeout_s, wants_words=wants_words))
        watch.note = question
        how = "withdrawn"
        try:
            for _ in watch.wait(watch.now_s + timeout_s):
                if prompt.answer is None and (heard := self._at_terminal(lambda each: each.answer())) is not None:
                    words = heard if isinstance(heard, str) else ""
                    prompt.answer, prompt.words, prompt.who = bool(heard), words, "the terminal"
                if prompt.answer is not None:
                    how = "confirmed" if prompt.answer else "refused"
                    return prompt
            how = "no answer"
            return prompt
        finally:
            if how in ("withdrawn", "no answer"):
                prompt.who = ""
            watch.note = ""
            self._at_terminal(lambda terminal: terminal.settle(how))
            watch.desk.settle(how)

    def _at_terminal(self, act: Callable[[Terminal], Result]) -> Result | None:
        try:
            return None if self.terminal is None else act(self.terminal)
        except Exception:  # a closed terminal: the question still stands in the journal
            self.terminal = None
            return None
