"""What a night is doing, or what became of it: derived from its journal, never a flag that somebody set.

    night_status(folder)["state"]  # running, paused, complete, incomplete, aborted, failed

A night is complete if every planned step is DONE and the samples of its collects are there. It is running if the
process that owns its lock lives and has shown a sign of life lately; one that was killed leaves an incomplete night.
"""

import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from datetime import timedelta
from itertools import groupby
from pathlib import Path
from typing import Any

from drivers.clock import SystemClock
from hil.records.damage import lost_blocks
from hil.records.live import SILENCE_BORNE_S, age_s, read_heartbeat, read_live
from hil.records.reader import JournalReader, reading
from hil.records.requests import chamber_within, forsaken_chamber
from hil.records.rows import Attempt
from hil.records.troubles import troubles
from hil.records.units import unit_folder
from procedures.journal_protocol import Outcome
from procedures.plan import Plan, StepKind, lasting_s
from procedures.safe_air import Left, Word
from procedures.words import counted, hours_minutes, listed, plural, step_in_words

_UNSAFE = "safe-state-not-reached"
VERDICT = "verdict"
WORKING = ("running", "paused")
STALE_AFTER_S = 180.0
"""A living controller without a heartbeat file that has written nothing for so long is not called running."""

_KEPT_FREE_BYTES = 20e6
_NOT_TOLD = "whether the chamber is safe cannot be told from a damaged journal: look at it"
_MISSING = {
    StepKind.IDENTIFY: "identification of the devices",
    StepKind.SETPOINT: "setpoint {0.temperature_degC:.1f} °C",
    StepKind.RESTABILISE: "restabilisation",
    StepKind.INDEX: "index to position {0.position}",
    StepKind.COLLECT: "collect at position {0.position}",
    StepKind.SAFE_STATE: "the last step, which brings the chamber to its safe state",
}
_OF_A_UNIT = ("state", "reason", "set_aside", "self_calibrations_done", "self_calibrations_total", "in_spec")
_UNTOUCHED = re.compile(
    r"(?P<whose>units? .*: )?self-calibration (?P<run>\d+) (?P<at>at .*): all of it|setpoint \S+ °C"
)


def night_status(folder: Path | str) -> dict[str, Any]:
    """Return the document hil.status/1 of a night; raise `InputError` where the folder holds none."""
    with reading(Path(folder), damaged_too=True) as journal:
        return _document(_Facts(journal))


def state_of(journal: JournalReader) -> tuple[str, str]:
    """Return the `state` and the `reason` of the same document."""
    return _state(_Facts(journal))


class _Facts:
    """What the journal said at one instant."""

    def __init__(self, journal: JournalReader) -> None:
        self.journal, self.owner, self.events = journal, journal.owner, journal.events()
        self.attempts, self.lost = journal.attempts(), lost_blocks(journal, read=False)
        self.done = {each.step_key: each for each in self.attempts if each.outcome is Outcome.DONE}
        self.controller = next(reversed(journal.controllers()), None)
        self.last_s = self.controller.seen_s if self.controller else 0.0
        beat = read_heartbeat(journal.folder)
        self.beat = beat if beat and self.owner and beat.pid == self.owner.pid else None

    @property
    def silence(self) -> str:
        """For how long the living controller has shown no sign of life, in words; empty where it is not too long."""
        now = SystemClock().utc()
        if self.beat is not None:
            silent_s = (now - self.beat.at).total_seconds()
            hangs = silent_s > SILENCE_BORNE_S + self.beat.silent_s
            return f"has shown no sign of life for {silent_s:.0f} s" if hangs else ""
        silent_s = (now - self.controller.seen_utc).total_seconds() if self.controller else 0.0
        return f"has written nothing for {silent_s / 60.0:.0f} min" if silent_s > STALE_AFTER_S else ""


def _document(facts: _Facts) -> dict[str, Any]:
    night, plan = facts.journal.night, facts.journal.plan
    state, reason = _state(facts)
    runs = plan.self_calibrations
    working = state in WORKING
    going_on, newest = [each for each in facts.attempts if each.outcome is None], facts.controller
    present = going_on[-1] if working and going_on and newest and going_on[-1].controller == newest.number else None
    standing, over = _troubles(facts)
    left, forsaken = _left(facts), forsaken_chamber(facts.journal) if facts.owner is None else ""
    if forsaken and chamber_within(facts.journal):
        left = Left()
    return {
        "schema": "hil.status/1",
        "state": state,
        "reason": reason,
        "working": facts.owner is not None,
        "title": night.title,
        "steps_done": len(facts.done),
        "steps_total": len(plan.steps),
        "self_calibrations_done": sum(all(step.key in facts.done for step in steps) for steps in runs.values()),
        "self_calibrations_total": len(runs),
        "eta_utc": _eta(facts, present) if working else None,
        "missing": missing_in_words(plan, facts.done, facts.attempts),
        "simulated": night.simulated,
        "identity": facts.journal.identity(),
        "units": [] if facts.journal.unit else _units(facts),
        "set_aside": facts.journal.unit in _aside(facts) and state == "incomplete",
        "began_utc": night.began_utc.isoformat(),
        "last_utc": night.utc(facts.last_s).isoformat(),
        "step": present.step_key if present else None,
        "step_in_words": step_in_words(facts.journal.steps_by_key()[present.step_key]) if present else "",
        **_readings(facts, working=working),
        "paused": _paused(facts) if state == "paused" else None,
        "prompt": _prompt(facts) if state == "running" else None,
        "killed": facts.owner is None and facts.controller is not None and facts.controller.ended is None,
        "in_spec": None if facts.journal.found else recorded_end(facts.journal).get("in_spec"),
        "chamber": left.word.value if left else None,
        "chamber_in_words": forsaken or str(left or (_NOT_TOLD if facts.journal.found else "")),
        "problems": [
            *([forsaken] if forsaken else []),
            *([str(left)] if left and not left.safe else []),
            *standing,
            *facts.journal.found,
            *map(str, facts.lost),
            *(_filling(facts) if working else []),
        ],
        "over": over,
    }


def without_samples(status: dict[str, Any]) -> dict[str, Any]:
    """Return the status of a night (hil.status/1) whose samples are found damaged: it is not complete."""
    damaged = {"state": "incomplete", "reason": "every planned step was done, but records are damaged"}
    return status | {"in_spec": None} | (damaged if status["state"] == "complete" else {})


def recorded_end(journal: JournalReader, unit: str | None = None) -> Mapping[str, Any]:
    """Return what the newest controller recorded at the end of `unit` (or the night); empty where it did not."""
    unit = journal.unit if unit is None else unit
    newest = max((controller.number for controller in journal.controllers()), default=0)
    ends = (e.evidence for e in reversed(journal.events()) if e.kind == VERDICT and e.controller == newest)
    return next((each for each in ends if each.get("unit", "") == unit), {})


def recorded_verdict(journal: JournalReader) -> dict[str, str] | None:
    """Return whether the night is good, which is another question than whether it is complete: `verdict`, `reason`."""
    end = recorded_end(journal)
    return {key: end[key] for key in ("verdict", "reason")} if end else None


def _left(facts: _Facts) -> Left | None:
    """How the newest controller, or its watchdog, left the chamber; None where that has not come yet."""
    for kind, other in () if facts.journal.found else ((_UNSAFE, "safe-state"), ("safe-state", _UNSAFE)):
        if (event := facts.journal.standing(kind, other)) is not None:
            usual = Word.NOT_SAFE if event.kind == _UNSAFE else Word.SAFE
            return Left(Word(event.evidence.get("chamber", usual)), event.message)
    return None


def _troubles(facts: _Facts) -> tuple[list[str], list[str]]:
    """Return what stands and what is over, of the newest controller."""
    newest = facts.controller
    if newest is None:
        return [], []
    last = facts.attempts[-1].step_key if facts.attempts else ""
    events = [event for event in facts.events if event.controller == newest.number]
    now, over = troubles(facts.journal.night, events, facts.last_s, "" if last in facts.done else last)
    return (now if newest.ended is None and facts.owner is not None else []), over


def _filling(facts: _Facts) -> list[str]:
    """Say where the disk has less room than the rest of the night takes, at the rate of what is done."""
    collects = facts.journal.plan.of_kind(StepKind.COLLECT)
    done_s = sum(step.duration_s for step in collects if step.key in facts.done)
    left_s = sum(step.duration_s for step in collects) - done_s
    needed = left_s * sum(row.block.size for row in facts.journal.blocks()) / done_s if done_s else 0.0
    free = shutil.disk_usage(facts.journal.folder).free
    if free >= needed + _KEPT_FREE_BYTES:
        return []
    return [f"the disk is filling: {free / 1e6:.0f} MB are free, the rest of the night takes {needed / 1e6:.0f} MB"]


def _readings(facts: _Facts, *, working: bool) -> dict[str, Any]:
    """Return what was read last, °C, deg/hr, how old each is, s, and all that a controller shows `now` (hil.live/1)."""
    beat, folder = facts.journal.last_heartbeat(), unit_folder(facts.journal.folder, facts.journal.plan.units[0])
    readings: dict[str, float] = dict(beat.readings) if beat else {}
    ages = dict.fromkeys(readings, facts.last_s - beat.at_s) if beat and working else {}
    rates: dict[str, float] = {}
    live, told = read_live(folder), ""
    live = live if live and working and facts.owner is not None and live["pid"] == facts.owner.pid else None
    if live is not None:
        age, old = age_s(live, facts.beat, SystemClock().utc())
        told = f"The controller has shown nothing for {hours_minutes(age)}. What is below is that old." if old else ""
        air = {name: live[name] for name in ("chamber_degC", "setpoint_degC") if live[name] is not None}
        unit = {f"unit_{number}_degC": value for number, value in live["unit_degC"].items()}
        rates = live["rates_now_deg_per_hr"] | live["rates_deg_per_hr"]
        readings |= air | unit
        ages |= dict.fromkeys(air, age + (live.get("chamber_age_s") or 0.0)) | dict.fromkeys([*unit, *rates], age)
    ages = {name: round(s, 1) for name, s in ages.items()}
    return {"readings": readings, "rates_deg_per_hr": rates, "ages_s": ages, "now": live, "old": told}


def _paused(facts: _Facts) -> dict[str, Any] | None:
    pause = facts.journal.standing("pause", "continue")
    if pause is None:
        return None
    since = facts.journal.night.utc(pause.at_s).isoformat()
    return {"by": pause.evidence.get("who", ""), "since_utc": since, "why": pause.evidence.get("why", "")}


def _prompt(facts: _Facts) -> dict[str, Any] | None:
    """Return the question that waits for an answer: its number, for a request that answers it, and until when."""
    prompt = facts.journal.standing("prompt", "prompt-ended")
    if prompt is None:
        return None
    night, until_s = facts.journal.night, prompt.at_s + float(prompt.evidence["timeout_s"])
    return {
        "prompt": prompt.evidence["prompt"],
        "question": prompt.message,
        "wants_words": bool(prompt.evidence.get("wants_words")),
        "since_utc": night.utc(prompt.at_s).isoformat(),
        "until_utc": night.utc(until_s).isoformat(),
    }


def _state(facts: _Facts) -> tuple[str, str]:
    if facts.journal.found:
        return "incomplete", f"ERROR: {facts.journal.found[0]}, so what is done and what is not cannot be told"
    if len(facts.done) == len(facts.journal.plan.steps):
        lost = sum(each.samples for each in facts.lost)
        if lost:
            return "incomplete", f"every planned step was done, but the samples of {counted(lost, 'collect')} are lost"
        return "complete", "every planned step is done"
    if set_aside := _aside(facts).get(facts.journal.unit):
        return "incomplete", set_aside
    owner, newest = facts.owner, facts.controller
    # Where who holds the folder is not the newest controller, that has ended or died, and its watchdog acts.
    if owner is not None and (newest is None or not owner.pid or (newest.ended is None and owner.pid == newest.pid)):
        if facts.silence:
            return "incomplete", f"the controller ({owner}) is there, but {facts.silence}"
        paused = facts.journal.standing("pause", "continue")
        return ("paused", paused.message) if paused else ("running", "")
    if newest is None:
        return "incomplete", "it has not begun"
    beside = f"; {owner} is at work here, its watchdog or who resumes it" if owner else ""
    if newest.ended is None:
        return "incomplete", f"the controller was killed, or lost its power{beside}"
    ending, _, reason = newest.ended.partition(": ")
    return (ending if ending in {"aborted", "failed"} else "incomplete"), (reason or ending) + beside


def _aside(facts: _Facts) -> Mapping[str, str]:
    """Return why units were set aside, by name, of the newest controller: another has tried them again."""
    newest = facts.controller.number if facts.controller else 0
    said = [event for event in facts.events if event.kind == "unit-set-aside" and event.controller == newest]
    at = {event.number: f"{facts.journal.night.utc(event.at_s):%Y-%m-%d %H:%M} UTC" for event in said}
    return {event.evidence["unit"]: f"set aside at {at[event.number]}: {event.evidence['why']}" for event in said}


def _units(facts: _Facts) -> list[dict[str, Any]]:
    told = []
    for unit in filter(None, facts.journal.plan.units):
        own = _document(_Facts(facts.journal.of_unit(unit)))
        verdict = recorded_end(facts.journal, unit).get("verdict")
        folder = str(unit_folder(facts.journal.folder, unit))
        told.append({"unit": unit, "folder": folder, **{key: own[key] for key in _OF_A_UNIT}, "verdict": verdict})
    return told


def _eta(facts: _Facts, present: Attempt | None) -> str:
    """Return when the rest will be done if it takes as long as planned, from the last sign of life."""
    left = [step for step in facts.journal.plan.steps if step.key not in facts.done]
    remaining_s = lasting_s(left)
    for step in left:
        if present and present.step_key == step.key:
            remaining_s -= min(facts.last_s - present.began_s, step.duration_s)
    return (facts.journal.night.utc(facts.last_s) + timedelta(seconds=round(remaining_s))).isoformat()


def missing_in_words(plan: Plan, done: Mapping[str, object], attempts: Sequence[Attempt] = ()) -> list[str]:
    """Return one sentence for each part of the plan that is not done: self-calibrations, and the steps around them.

    `done` holds the keys of the steps that are; `attempts` tell what became of those that were tried.
    """
    reasons = {
        each.step_key: f" ({each.outcome.value.lower()}: {each.reason})"
        for each in attempts
        if each.outcome is not None
    }
    # A setpoint may be asked for twice: it is missing once.
    of_each = {unit: dict.fromkeys(_missing(plan.of_unit(unit), done, reasons)) for unit in plan.units}
    units_of: dict[str, list[str]] = {}
    for unit, sentences in of_each.items():
        for sentence in sentences:
            units_of.setdefault(sentence, []).append(unit)
    return [
        sentence if len(units) == len(of_each) else f"{plural('unit', len(units))} {listed(units)}: {sentence}"
        for sentence, units in units_of.items()
    ]


def _missing(plan: Plan, done: Mapping[str, object], reasons: Mapping[str, str]) -> Iterator[str]:
    runs = plan.self_calibrations
    told: set[int] = set()
    for step in plan.steps:
        number = step.self_calibration
        if step.key in done or number in told:
            continue
        if number is None:
            yield _MISSING[step.kind].format(step) + reasons.get(step.key, "")
            continue
        told.add(number)
        where = "" if step.temperature_degC is None else f" at {step.temperature_degC:.1f} °C"
        lacking = [each for each in runs[number] if each.key not in done]
        if len(lacking) == len(runs[number]) and not any(each.key in reasons for each in lacking):
            yield f"self-calibration {number}{where}: all of it"
        else:
            parts = [_MISSING[each.kind].format(each) + reasons.get(each.key, "") for each in lacking]
            yield f"self-calibration {number}{where}: {', '.join(parts)}"


def in_brief(missing: Sequence[str]) -> list[str]:
    """Return what is missing with neighbours that are wholly missing, and the setpoints between them, in one line."""
    told: list[str] = []
    each = [(line, _UNTOUCHED.fullmatch(line)) for line in missing]
    for whose, group in groupby(each, key=lambda pair: pair[1] and (pair[1]["whose"] or "")):
        lines, found = zip(*group, strict=True)
        whole = [one for one in found if one and one["run"]]
        if len(whole) > 1:
            first, last = whole[0], whole[-1]
            where = first["at"] if first["at"] == last["at"] else f"{first['at']} to {last['at'].removeprefix('at ')}"
            lines = (f"{whose}self-calibrations {first['run']}–{last['run']} {where}: all of them",)
        told += lines
    return told
