"""What is wrong with a night at this moment, worst first, and what was wrong and is over: in sentences.

    now, over = troubles(journal.night, events, last_s, trying="T1/S1/setpoint")

Both come from the events of the newest controller alone. Times are of the campaign, as everywhere in a journal.
"""

from collections.abc import Sequence

from hil.records.rows import Event, Night
from procedures.words import hours_minutes


def troubles(night: Night, events: Sequence[Event], last_s: float, trying: str) -> tuple[list[str], list[str]]:
    """Return what stands `last_s` after the beginning, and what does not stand any more.

    `trying` is the key of the step that is going on, or is to be tried again; empty where none is.
    """
    standing: dict[str, Event] = {}
    over: dict[str, str] = {}
    for event in events:
        name = event.message.partition(" cleared" if event.kind == "interlock-cleared" else ": ")[0]
        if event.kind == "interlock-suspected":
            standing.setdefault(name, event)
        elif event.kind == "interlock-cleared" and name in standing:
            began = standing.pop(name)
            lasted = hours_minutes(event.at_s - began.at_s)
            over[name] = f"{_said(began)}: over since {_at(night, event.at_s)}, after {lasted}"
        elif event.kind == "safe-state-retry":
            standing.setdefault("", event)
        elif event.kind in ("safe-state", "safe-state-not-reached"):
            standing.clear()
        elif event.kind == "retry" and event.evidence.get("step") == trying:
            standing.setdefault(f"retry {trying}", event)
    worst_first = sorted(standing.items(), key=lambda each: (each[0] != "", each[1].kind == "retry"))
    return [_standing(night, event, last_s) for _, event in worst_first], list(over.values())


def _standing(night: Night, event: Event, last_s: float) -> str:
    since = f"since {_at(night, event.at_s)}, {hours_minutes(max(last_s - event.at_s, 0.0))} ago"
    if event.kind == "safe-state-retry":
        return f"THE CHAMBER IS NOT SAFE YET, go to it; trying {since}: {event.message}"
    return f"trying again {since}: {event.message}" if event.kind == "retry" else f"{_said(event)}; {since}"


def _said(event: Event) -> str:
    """Return what an interlock suspects, and when that would end the night."""
    return event.message.partition(": ")[2]


def _at(night: Night, at_s: float) -> str:
    return f"{night.utc(at_s):%H:%M:%S} UTC"
