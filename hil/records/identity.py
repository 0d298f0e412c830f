"""Which unit a night was about, who carried it out, and what they said of it: from the journal's own words."""

from collections.abc import Sequence

from hil.records.reader import JournalReader
from hil.records.rows import Event
from procedures.plan import StepKind
from procedures.words import listed


def night_identity(journal: JournalReader, events: Sequence[Event] | None = None) -> dict[str, str]:
    """Return `model` and `serial` of the unit, `operator`, `note`, and `despite`; what is not known is not there.

    What the unit tells of itself counts more than what was typed; `despite` is what `hil check` called NOT when
    somebody went on, with the reason. `events` are the journal's, where they have been read already.
    """
    found = {"operator": journal.night.who}
    notes, despite = [], []
    for event in journal.events() if events is None else events:
        said = event.evidence
        if event.kind == "night-begins":
            found |= {name: text for name, text in said.get("unit", {}).items() if text != "ask"}
        elif event.kind == "unit-serial":
            found["serial"] = said["serial"]
        elif event.kind == "despite":
            despite.append(event.message)
        notes.append(said.get("note", "") if event.kind in ("night-begins", "night-resumed") else "")
    done = journal.completed()
    identified = [done[step.key].data for step in journal.plan.of_kind(StepKind.IDENTIFY) if step.key in done]
    for name in ("model", "serial"):
        if told := dict.fromkeys(each["imu"][name] for each in identified if each.get("imu", {}).get(name)):
            found[name] = listed(told)
    found |= {"note": "; ".join(filter(None, notes)), "despite": "; ".join(despite)}
    return {name: text for name, text in found.items() if text}
