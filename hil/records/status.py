"""What a night is doing, or what became of it: derived from its journal, never a flag that somebody set.

    night_status(folder)["state"]  # running, paused, complete, incomplete, aborted, failed

A night is complete if every planned step is DONE and the samples of its collects are there. It is running if the
process that owns its lock lives and has shown a sign of life lately; a controller that was killed leaves a night that
is incomplete, whatever was going on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

from drivers.clock import SystemClock
from hil.files.lock import Owner, living_owner
from hil.records.damage import LostBlock, lost_blocks
from hil.records.heartbeat import SILENCE_BORNE_S, Heartbeat, read_heartbeat
from hil.records.reader import JournalReader, reading
from hil.records.requests import forsaken_chamber
from hil.records.rows import Attempt, Controller
from procedures.journal_protocol import Outcome
from procedures.plan import Plan, Step, StepKind
from procedures.safe_air import Left, Word

_UNSAFE = "safe-state-not-reached"
STALE_AFTER_S = 180.0
"""A living controller without a heartbeat file that has written nothing for so long is not called running."""


def night_status(folder: Path | str) -> dict[str, Any]:
    """Return the document hil.status/1 of a night; raise `InputError` where the folder holds none."""
    folder = Path(folder)
    owner = living_owner(folder)  # before the journal: an owner that ends in between has then written its end
    with reading(folder, damaged_too=True) as journal:
        return _document(_Facts.of(journal, owner))


@dataclass(frozen=True)
class _Facts:
    """What the journal said at one instant."""

    journal: JournalReader
    owner: Owner | None
    plan: Plan
    attempts: Sequence[Attempt]
    done: Mapping[str, Attempt]
    controller: Controller | None
    damage: Sequence[str]  # what of the journal is not as it was written
    lost: Sequence[LostBlock]
    beat: Heartbeat | None  # of the living owner

    @classmethod
    def of(cls, journal: JournalReader, owner: Owner | None) -> _Facts:
        controllers = journal.controllers()
        newest = controllers[-1] if controllers else None
        attempts = journal.attempts()
        done = {each.step_key: each for each in attempts if each.outcome is Outcome.DONE}
        beat = read_heartbeat(journal.folder)
        beat = beat if beat is not None and owner is not None and beat.pid == owner.pid else None
        return cls(
            journal, owner, journal.plan, attempts, done, newest, journal.found, lost_blocks(journal, read=False), beat
        )

    @property
    def held_by_another(self) -> bool:
        """Whether who holds the folder is not the newest controller: it has ended or died, and its watchdog acts."""
        if self.owner is None or self.controller is None or not self.owner.pid:
            return False
        return self.controller.ended is not None or self.owner.pid != self.controller.pid

    @property
    def silence(self) -> str:
        """For how long the living controller has shown no sign of life, in words; empty where it is not too long."""
        now = SystemClock().utc()
        if self.beat is not None:
            silent_s = (now - self.beat.at).total_seconds()
            return f"has shown no sign of life for {silent_s:.0f} s" if silent_s > self._borne_s else ""
        silent_s = (now - self.controller.seen_utc).total_seconds() if self.controller else 0.0
        return f"has written nothing for {silent_s / 60.0:.0f} min" if silent_s > STALE_AFTER_S else ""

    @property
    def _borne_s(self) -> float:
        return SILENCE_BORNE_S + (self.beat.silent_s if self.beat else 0.0)

    @property
    def last_s(self) -> float:
        return self.controller.seen_s if self.controller else 0.0


def _document(facts: _Facts) -> dict[str, Any]:
    night, plan = facts.journal.night, facts.plan
    state, reason = _state(facts)
    runs = plan.self_calibrations
    present = _present(facts) if state in {"running", "paused"} else None
    heartbeat = facts.journal.last_heartbeat()
    left, forsaken = _left(facts.journal), forsaken_chamber(facts.journal) if facts.owner is None else ""
    return {
        "schema": "hil.status/1",
        "state": state,
        "reason": reason,
        "title": night.title,
        "steps_done": len(facts.done),
        "steps_total": len(plan.steps),
        "self_calibrations_done": sum(all(step.key in facts.done for step in steps) for steps in runs.values()),
        "self_calibrations_total": len(runs),
        "eta_utc": _eta(facts, present) if state in {"running", "paused"} else None,
        "missing": missing_in_words(plan, facts.done, facts.attempts),
        "simulated": night.simulated,
        "began_utc": night.began_utc.isoformat(),
        "last_utc": night.utc(facts.last_s).isoformat(),
        "step": present.step_key if present else None,
        "readings": dict(heartbeat.readings) if heartbeat else {},
        "paused": _paused(facts) if state == "paused" else None,
        "prompt": _prompt(facts) if state == "running" else None,
        "chamber": left.word.value if left else None,
        "problems": [
            *facts.damage,
            *map(str, facts.lost),
            *([f"{left}; go to the chamber"] if left and not left.safe else []),
            *([forsaken] if forsaken else []),
        ],
    }


def _left(journal: JournalReader) -> Left | None:
    """How the newest controller, or its watchdog, left the chamber; None where that has not come yet."""
    for event in (journal.standing(_UNSAFE, "safe-state"), journal.standing("safe-state", _UNSAFE)):
        if event is not None:
            usual = Word.NOT_SAFE if event.kind == _UNSAFE else Word.SAFE
            return Left(Word(event.evidence.get("chamber", usual)), event.message)
    return None


def _paused(facts: _Facts) -> dict[str, Any] | None:
    """Return who paused the night, since when and why."""
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
        "since_utc": night.utc(prompt.at_s).isoformat(),
        "until_utc": night.utc(until_s).isoformat(),
    }


def _state(facts: _Facts) -> tuple[str, str]:
    if facts.damage:
        return "incomplete", f"ERROR: {facts.damage[0]}, so what is done and what is not cannot be told"
    if len(facts.done) == len(facts.plan.steps):
        lost = sum(each.samples for each in facts.lost)
        if lost:
            return "incomplete", f"every planned step was done, but the samples of {lost} collects are lost"
        return "complete", "every planned step is done"
    if facts.owner is not None and not facts.held_by_another:
        if facts.silence:
            return "incomplete", f"the controller ({facts.owner}) is there, but {facts.silence}"
        paused = facts.journal.standing("pause", "continue")
        return ("paused", paused.message) if paused else ("running", "")
    if facts.controller is None:
        return "incomplete", "it has not begun"
    beside = f"; {facts.owner} is at work here, its watchdog or who resumes it" if facts.owner else ""
    if facts.controller.ended is None:
        return "incomplete", f"the controller was killed, or lost its power{beside}"
    ending, _, reason = facts.controller.ended.partition(": ")
    return (ending if ending in {"aborted", "failed"} else "incomplete"), (reason or ending) + beside


def _present(facts: _Facts) -> Attempt | None:
    going_on = [attempt for attempt in facts.attempts if attempt.outcome is None]
    last = going_on[-1] if going_on else None
    return last if last and facts.controller and last.controller == facts.controller.number else None


def _eta(facts: _Facts, present: Attempt | None) -> str:
    """Return when the rest will be done if it takes as long as planned, from the last sign of life."""
    remaining_s = 0.0
    for step in facts.plan.steps:
        if step.key not in facts.done:
            gone_s = facts.last_s - present.began_s if present and present.step_key == step.key else 0.0
            remaining_s += max(step.duration_s - gone_s, 0.0)
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
    runs = plan.self_calibrations
    sentences: list[str] = []
    told: set[int] = set()
    for step in plan.steps:
        number = step.self_calibration
        if step.key in done or number in told:
            continue
        if number is None:
            sentences.append(_step_in_words(step) + reasons.get(step.key, ""))
            continue
        told.add(number)
        where = "" if step.temperature_degC is None else f" at {step.temperature_degC:.1f} °C"
        lacking = [each for each in runs[number] if each.key not in done]
        if len(lacking) == len(runs[number]) and not any(each.key in reasons for each in lacking):
            sentences.append(f"self-calibration {number}{where}: all of it")
        else:
            parts = [_step_in_words(each) + reasons.get(each.key, "") for each in lacking]
            sentences.append(f"self-calibration {number}{where}: {', '.join(parts)}")
    return sentences


def _step_in_words(step: Step) -> str:
    match step.kind:
        case StepKind.IDENTIFY:
            return "identification of the devices"
        case StepKind.SETPOINT:
            return f"setpoint {step.temperature_degC:.1f} °C"
        case StepKind.RESTABILISE:
            return "restabilisation"
        case StepKind.INDEX:
            return f"index to position {step.position}"
        case StepKind.COLLECT:
            return f"collect at position {step.position}"
        case StepKind.SAFE_STATE:
            return "safe state of the chamber at the end"
