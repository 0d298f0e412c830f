"""Telling somebody who is not there: a night has started, needs you, has a fault, has finished, with the numbers.

Addresses are those of apprise (https://github.com/caronc/apprise), which is the optional extra `notify`; without it an
`http://` or `https://` address still gets a POST of JSON. They are read when a night begins and stand nowhere in its
records: what is recorded of a failure is the reference and the kind of error, never its text, which may hold the
address. Sending is the work of one thread. Whatever becomes of it, the night goes on.
"""

import contextlib
import json
import queue
import sqlite3
import threading
import urllib.request
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

from hil.config import Bench
from hil.config.people import NotifySection, addresses_of, messenger_of
from hil.errors import InputError
from hil.records import SqliteJournal
from hil.records.status import recorded_end
from procedures.plan import lasting_s

_TIMEOUT_S = 10.0
_ABOUT = {
    "started": ("night-begins", "night-resumed"),
    "needs-you": ("prompt", "pause"),
    "fault": ("interlock", "failed", "error", "safe-state-not-reached", "watchdog"),
}
"""Which kinds of events tell of a topic."""
LAST_WORDS_S = 30.0
"""How long the end of a night waits for what is still being sent."""

Send = Callable[[str, str, str], None]
"""Sends a title and a text to one address; raises whatever goes wrong."""


def send(address: str, title: str, text: str) -> None:
    """Send by apprise, or a POST of JSON. Raises `InputError` where it cannot or did not, and what a POST raises."""
    messenger = messenger_of(address)
    if messenger is None:
        body = json.dumps({"title": title, "text": text}).encode()
        asked = urllib.request.Request(address, body, {"Content-Type": "application/json"})  # noqa: S310 - http(s), see messenger_of
        urllib.request.urlopen(asked, timeout=_TIMEOUT_S).close()  # noqa: S310
    elif not messenger.notify(title=title, body=text):
        raise InputError("apprise could not deliver it")


@dataclass(eq=False)
class Notifier:
    """Tells whoever is named, each title begun by `subject`; `failed` hears, in the calling thread. Close it."""

    section: NotifySection | None
    subject: str
    failed: Callable[[str], None]
    _: KW_ONLY
    sender: Send = send
    attempts: int = 3
    wait_s: float = 10.0

    def __post_init__(self) -> None:
        self._about = frozenset(self.section.about if self.section else ())
        self._failures: queue.Queue[str] = queue.Queue()
        self._letters: queue.Queue[tuple[str, str] | None] = queue.Queue()
        self._addresses: list[tuple[str, str]] = []
        self._leaving = threading.Event()
        self._thread: threading.Thread | None = None
        for reference in self.section.to if self.section else ():
            try:
                self._addresses += [(reference, address) for address in addresses_of(reference)]
            except InputError as error:
                self._failures.put(f"{reference}: {error}")

    def tell(self, topic: str, text: str) -> None:
        """Tell it, where the section asks for the topic. Returns at once; never raises."""
        if topic in self._about and self._addresses:
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="notify", daemon=True)
                self._thread.start()
            self._letters.put((f"{self.subject}: {topic}", text))
        self._report()

    def hear(self, what: str, facts: Mapping[str, Any]) -> None:
        """Listen to a journal, and tell what somebody away from the bench must know."""
        for topic in (topic for topic, kinds in _ABOUT.items() if what == "event" and facts.get("kind") in kinds):
            self.tell(topic, str(facts["message"]))

    def close(self) -> None:
        """Send what is left, within half a minute, and report what could not be sent."""
        if self._thread is not None:
            self._letters.put(None)
            self._leaving.set()  # no more waiting between attempts
            self._thread.join(LAST_WORDS_S)
            if self._thread.is_alive():
                self._failures.put("a notification was still being sent when the night ended")
            self._thread = None
        self._report()

    def _work(self) -> None:
        while (letter := self._letters.get()) is not None:
            for reference, address in self._addresses:
                self._deliver(reference, address, *letter)

    def _deliver(self, reference: str, address: str, title: str, text: str) -> None:
        """Try a few times; note the last failure without its text, which may hold the address."""
        for left in reversed(range(self.attempts)):
            try:
                self.sender(address, title, text)
                return
            except InputError as error:
                why = str(error)
            except Exception as error:
                why = type(error).__name__
            if left:
                self._leaving.wait(self.wait_s)
        self._failures.put(f"{reference}: {title!r} was not sent: {why}")

    def _report(self) -> None:
        while not self._failures.empty():
            self.failed(self._failures.get())


def notifier_of(bench: Bench, journal: SqliteJournal) -> Notifier:
    """Return who tells of this night; what could not be sent becomes an event in its journal."""

    def failed(what: str) -> None:
        with contextlib.suppress(sqlite3.Error, OSError):  # telling somebody must never harm the night
            journal.event("notification-failed", what)

    mark = " SIMULATED" if bench.simulated else ""
    return Notifier(bench.notify, f"{bench.name}{mark}, {journal.folder.name}", failed)


def in_words_at_the_beginning(journal: SqliteJournal, who: str) -> str:
    """Say who began or carried on what, and when it will be done if it takes as long as planned."""
    done, planned = journal.completed(), journal.plan.steps
    rest_s = lasting_s(step for step in planned if step.key not in done)
    ends = journal.night.utc(journal.now_s() + rest_s)
    steps = f"{len(done)} of {len(planned)} steps done before" if done else f"{len(planned)} steps"
    return f"{journal.plan.title}: {steps}, by {who}; expected end {ends:%Y-%m-%d %H:%M} UTC"


def in_words_at_the_end(journal: SqliteJournal, how: str) -> str:
    """Say how it ended, whether it is good, with the reason and the numbers."""
    done, asked = journal.completed(), journal.plan.self_calibrations
    end = recorded_end(journal)
    unit = f"; {in_spec['verdict'].upper()}: {in_spec['reason']}" if (in_spec := end.get("in_spec")) else ""
    runs = sum(all(step.key in done for step in steps) for steps in asked.values())
    counts = f"{end.get('verdict', 'not judged')}{unit}; {runs} of {len(asked)} self-calibrations"
    return f"{how}; {counts}; {len(done)} of {len(journal.plan.steps)} steps; {journal.folder}"
