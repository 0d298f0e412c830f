"""What people ask of a running sweep: to pause, to go on, to end, and the answers to its own questions.

`Control` is where requests come from; the durable one is in `hil.records.requests`. A request is answered once, by the
controller that it was meant for: accepted, or refused with the reason.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

from procedures.stop import StopRequest


class RequestKind(StrEnum):
    """What may be asked."""

    PAUSE = "pause"  # stay where you are until somebody says continue
    CONTINUE = "continue"
    ABORT = "abort"  # bring the chamber to its safe state and end
    CONFIRM = "confirm"  # yes, to the question that stands
    REFUSE = "refuse"  # no, to the question that stands


@dataclass(frozen=True)
class Request:
    """One request. A CONFIRM or REFUSE answers the question `prompt`; `why` holds the words that one may want."""

    number: int
    kind: RequestKind
    who: str
    why: str = ""
    prompt: int | None = None

    def __str__(self) -> str:
        return f"{self.who}: {self.why}" if self.why else self.who


class PauseAsked(Exception):
    """Raised at a poll of a step that a pause interrupts at once."""


class Control(Protocol):
    """Where requests come from."""

    def asked(self) -> Sequence[Request]:
        """Return what was asked of this controller and is not answered yet, in order. Called at every poll."""

    def answer(self, request: Request, accepted: bool, message: str) -> None:
        """Record durably that a request is accepted, or why it is refused."""


@dataclass
class Prompt:
    """A question that stands. `answer` is None until somebody has given it; with `wants_words`, they are in `words`."""

    number: int
    question: str
    wants_words: bool = False
    answer: bool | None = None
    words: str = ""
    who: str = ""


@dataclass(eq=False)
class Desk:
    """Hears requests and remembers what stands: a pause, a question. An abort becomes a stop request."""

    control: Control | None
    stop: StopRequest
    record: Callable[..., None]  # takes an event: kind, message, and evidence by name
    pause: Request | None = field(default=None, init=False)
    prompt: Prompt | None = field(default=None, init=False)
    continued_by = ""
    _prompts = 0

    def hear(self, takes_effect: str) -> None:
        """Act upon what was asked since the last time; `takes_effect` says when a pause would."""
        if self.control is None:
            return
        for request in self.control.asked():
            accepted, message = self._act(request, takes_effect)
            self.control.answer(request, accepted, message)

    def _act(self, request: Request, takes_effect: str) -> tuple[bool, str]:
        match request.kind:
            case RequestKind.ABORT:
                self.stop.request(f"aborted by {request}")
                return True, "the chamber is brought to its safe state"
            case RequestKind.PAUSE:
                if self.pause is not None:
                    return False, f"paused already, by {self.pause}"
                self.pause = request
                return True, f"pauses {takes_effect}; the chamber is held"
            case RequestKind.CONTINUE:
                if self.pause is None:
                    return False, "it is not paused"
                self.pause, self.continued_by = None, str(request)
                return True, "goes on"
            case _:
                return self._take_answer(request)

    def _take_answer(self, request: Request) -> tuple[bool, str]:
        prompt = self.prompt
        if prompt is None or prompt.number != request.prompt or prompt.answer is not None:
            return False, "that question does not stand any more"
        confirmed = request.kind is RequestKind.CONFIRM
        if confirmed and prompt.wants_words and not request.why:
            return False, "that question wants an answer in words (hil confirm --text)"
        prompt.answer, prompt.words, prompt.who = confirmed, request.why, request.who
        return True, "confirmed" if confirmed else "refused"

    def put(self, question: str, timeout_s: float, *, wants_words: bool = False) -> Prompt:
        """Let a question stand, for whoever reads the journal, until `settle`."""
        self._prompts += 1
        self.prompt = Prompt(self._prompts, question, wants_words)
        self.record("prompt", question, prompt=self._prompts, timeout_s=timeout_s, wants_words=wants_words)
        return self.prompt

    def settle(self, how: str) -> None:
        """Take the question away and record how it ended: confirmed, refused, no answer, withdrawn; and by whom."""
        prompt, self.prompt = self.prompt, None
        if prompt is not None:
            by = f" by {prompt.who}" if prompt.who else ""
            self.record("prompt-ended", f"{how}{by}: {prompt.question}", prompt=prompt.number, how=how, who=prompt.who)
