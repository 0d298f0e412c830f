"""The rows of a journal as objects, and the digests that make a changed row visible."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from hil.files.document import plain
from hil.records.blocks import Block
from procedures.journal_protocol import Outcome
from procedures.plan import Plan, Step, StepKind


@dataclass(frozen=True)
class Night:
    """What a night is. Every `_s` in a journal counts from `began_utc`."""

    title: str
    who: str
    began_utc: datetime
    simulated: bool
    configuration: str
    seed: int | None = None
    versions: Mapping[str, str] | None = None

    def utc(self, at_s: float) -> datetime:
        """Return the instant that lies `at_s` seconds after the beginning."""
        return self.began_utc + timedelta(seconds=at_s)

    def digest(self, plan: Plan) -> str:
        """Return the SHA-256 over everything that was decided before the first step."""
        facts = [self.title, self.who, self.began_utc.isoformat(), self.simulated, self.configuration, self.seed]
        return digest_of([*facts, dict(self.versions or {}), [step_row(step) for step in plan.steps]])


@dataclass(frozen=True)
class Attempt:
    """One attempt at a step. `outcome` is None where it never ended: it is going on, or the controller was killed."""

    step_key: str
    attempt: int
    controller: int
    began_s: float
    ended_s: float | None
    outcome: Outcome | None
    reason: str
    data: Mapping[str, Any]
    withdrawn: str | None  # why it counts no more, where it was DONE


@dataclass(frozen=True)
class BlockRow:
    """A block, and the attempt that it belongs to."""

    step_key: str
    attempt: int
    block: Block


@dataclass(frozen=True)
class Event:
    """Something that happened."""

    number: int
    controller: int
    at_s: float
    kind: str
    message: str
    evidence: Mapping[str, Any]


@dataclass(frozen=True)
class RequestRow:
    """What somebody asked of a controller. `accepted` is None while it has not answered."""

    number: int
    controller: int
    kind: str
    who: str
    why: str
    prompt: int | None
    answered_s: float | None
    accepted: bool | None
    answer: str


@dataclass(frozen=True)
class Heartbeat:
    """A sign of life with the readings of that moment."""

    number: int
    controller: int
    at_s: float
    step_key: str
    readings: Mapping[str, float]


@dataclass(frozen=True)
class Controller:
    """One controller process that worked on the night. `ended` is None while it lives, or after it was killed."""

    number: int
    pid: int
    host: str
    who: str
    began_s: float
    seen_s: float
    seen_utc: datetime  # by the operating system's clock, in simulation too
    ended: str | None


MEANS: Mapping[str, Callable[[Any], Any]] = {
    "outcome": lambda word: word and Outcome(word),
    "accepted": lambda told: None if told is None else bool(told),
    "simulated": bool,
    "versions": json.loads,
    **dict.fromkeys(("began_utc", "seen_utc"), datetime.fromisoformat),
    **dict.fromkeys(("reason", "answer"), lambda text: text or ""),
    **dict.fromkeys(("data", "evidence", "readings"), lambda text: dict(json.loads(text)) if text else {}),
}
"""What the cells of a column stand for, by its name, where that is not what SQLite gives."""


def to_json(value: object) -> str:
    """Return `value` as JSON text in one canonical form. What is not finite becomes null: JSON has no NaN."""
    return json.dumps(plain(value), ensure_ascii=False, sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest_of(value: object) -> str:
    """Return the SHA-256 of the canonical JSON of `value`."""
    return hashlib.sha256(to_json(value).encode()).hexdigest()


def step_row(step: Step) -> tuple[Any, ...]:
    """Return a step as a row of the table `steps`."""
    degC = None if step.temperature_degC is None else float(step.temperature_degC)
    plan = (step.index, step.key, step.kind.value, float(step.starts_s), float(step.duration_s))
    return *plan, degC, step.self_calibration, step.position, to_json(step.parameters)


def step_of(row: Sequence[Any]) -> Step:
    """Return the step that `step_row` turned into a row."""
    number, key, kind, *plan, parameters = row
    return Step(*(number, key, StepKind(kind), *plan, json.loads(parameters)))
