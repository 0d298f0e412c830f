"""What is wrong with a night at this moment, worst first, what was wrong and is over, and what to do: in sentences.

Both come from the events of the newest controller alone. Times are of the campaign, as everywhere in a journal.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Any

from hil.records.rows import Event, Night
from hil.records.units import night_of
from procedures.words import counted, hours_minutes

_BY_VERDICT = {
    "PASS": "nothing; hil report {} has the parameters",
    "OUT OF SPEC": "with the measurement nothing, but the unit is out of spec: hil report {} has the limits",
    "MARGINAL": "read the reasons before its numbers are used: hil report {}",
    "FAIL": "use no number that FAILED; hil report {} names them, why, and what to do",
    "INCONCLUSIVE": "measure again what could not be told; hil report {} names it and why",
}


def to_do(place: Path, status: Mapping[str, Any]) -> str:
    """Return what has to be done about a night (hil.status/1, and the `verdict` on it): first about its chamber."""
    own, folder = quote(str(place)), quote(str(night_of(place)))
    if status["prompt"]:
        return f"answer it: hil confirm {folder}{' --text …' if status['prompt']['wants_words'] else ''}, or --no"
    if status["state"] == "paused":
        return f"hil continue {folder} carries on; until then the chamber is held"
    if status["state"] == "running":
        bad = status["problems"] or status["old"]
        return "see to it; the controller tries on, or ends with the chamber safe" if bad else "nothing"
    if status.get("set_aside") and status["working"]:
        return f"see to this unit; the others go on. When the night has ended, hil resume {folder} tries it again"
    if status["working"]:
        return "wait until the chamber has been made safe, and look again"
    if status["killed"]:
        return made_safe(night_of(place), within=status["chamber"] == "SAFE")
    first = "go to the chamber and stop it there; then " if status["chamber"] not in (None, "SAFE") else ""
    if status["reason"].startswith("ERROR"):
        return (
            f"{first}use no number of it: hil repair {folder} --out NEW brings back what is proven, where its plan is"
        )
    verdict, left = (status["verdict"] or {}).get("verdict", ""), status["steps_total"] - status["steps_done"]
    if status["state"] == "complete":
        if verdict == "PASS" and (status.get("in_spec") or {}).get("verdict") == "out of spec":
            verdict = "OUT OF SPEC"
        return first + _BY_VERDICT.get(verdict, "hil report {} judges it").format(own)
    if not left:
        return f"{first}hil resume {folder} measures again what rests on the damage; use no number of it before"
    first += "mend what ended it; then " if status["state"] == "failed" and not first else ""
    return f"{first}hil resume {folder} carries on: {counted(left, 'step')} left"


def made_safe(folder: Path, *, within: bool) -> str:
    """Return what is to be done where nobody commands the chamber any more; `within`: it died with its controller."""
    named = quote(str(folder))
    return f"{'' if within else f'hil watchdog {named} brings it to its safe state, '}hil resume {named} carries on"


def troubles(night: Night, events: Sequence[Event], last_s: float, trying: str) -> tuple[list[str], list[str]]:
    """Return what stands at `last_s`, and what stands no more; `trying`: the key of the step under way, or empty."""
    standing: dict[str, Event] = {}
    over: dict[str, str] = {}
    for event in events:
        name = event.message.partition(" cleared" if event.kind == "interlock-cleared" else ": ")[0]
        if event.kind == "interlock-suspected":
            standing.setdefault(name, event)
        elif event.kind == "interlock-cleared" and name in standing:
            began = standing.pop(name)
            lasted = hours_minutes(event.at_s - began.at_s)
            over[name] = f"{began.message.partition(': ')[2]}: over since {_at(night, event.at_s)}, after {lasted}"
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
    suspected = event.message.partition(": ")[2]  # by an interlock, and when that would end the night
    return f"trying again {since}: {event.message}" if event.kind == "retry" else f"{suspected}; {since}"


def _at(night: Night, at_s: float) -> str:
    return f"{night.utc(at_s):%H:%M:%S} UTC"
