"""What is told of a night to somebody who is not there: that it began, how it ended, with the numbers."""

import contextlib
import sqlite3

from hil.config import Bench
from hil.night.notify import Notifier
from hil.records import SqliteJournal
from hil.records.status import recorded_end
from procedures.plan import lasting_s


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
