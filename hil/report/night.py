"""What a report takes from the journal of a night: what was asked and done, the soaks, the collects, what went wrong.

And where its numbers come from, those of a campaign folder too: who, when, with what, and the files' hashes.

    night = night_content(Path("night-014"))
    night.asked, night.done, night.missing     # sentences
    night.soaks[0]["decided_by"]               # "unit slope (sensor 1)"
    night.collects[0]["counts"]["ok"]          # frames

Times are hours since the night began, temperatures °C.
"""

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from drivers.given_file import opened
from hil.campaign import Campaign, FloatArray
from hil.campaign.reader import COLLECTS_FILE, HEADER_FILE, SERIES_FOLDER
from hil.config.recorded import understood
from hil.files.page import filled
from hil.records import JournalReader, reading
from hil.records.curve import temperatures
from hil.records.rows import Attempt
from hil.records.status import WORKING, night_status, recorded_end
from hil.records.troubles import to_do
from procedures.journal_protocol import Outcome
from procedures.plan import Step, StepKind
from procedures.words import counted, hours_minutes, step_in_words

_SECONDS_PER_HOUR = 3600.0
_SILENT_S, _SILENT_POINTS = 300.0, 5.0
"""A longer gap, and of more times the usual one, breaks the lines of the plot: nobody was measuring."""


@dataclass(frozen=True)
class NightContent:
    """What only a journal knows. `events` are (UTC, kind, message), `event_hours` (e,) when they were.

    `soaks` are the restabilisations that ended: when, how long each waited, and which criterion was the last to be met;
    `collects` those that count: when, where, and what the stream brought, with the decoder's `counts`; `margins` how
    near it came to its limits: what, where, how large it was, the limit, and which share of it was used.
    """

    state: str
    title: str = ""
    simulated: bool = False
    reason: str = ""
    to_do: str = ""  # about a night that is not whole, its chamber first
    asked: str = ""
    done: str = ""
    identity: Mapping[str, str] = field(default_factory=dict)  # as `JournalReader.identity` has it
    self_calibrations: tuple[int, int] = (0, 0)  # done, asked for
    missing: Sequence[str] = ()
    events: Sequence[tuple[str, str, str]] = ()
    event_hours: FloatArray = field(default_factory=lambda: np.empty(0))
    hours: FloatArray = field(default_factory=lambda: np.empty(0))
    temperatures: Mapping[str, FloatArray] = field(default_factory=dict)
    soaks: Sequence[dict[str, Any]] = ()
    collects: Sequence[dict[str, Any]] = ()
    rejected: Sequence[tuple[str, str, str]] = ()  # UTC, what, why
    margins: Sequence[dict[str, Any]] = ()  # the smallest first
    vocabulary: str = "plain"
    provenance: Sequence[tuple[str, str]] = ()
    files: Sequence[tuple[str, int, str]] = ()  # path, bytes, SHA-256


def night_content(folder: Path) -> NightContent:
    """Read everything that the report shows of the night in `folder`; raises `InputError` where there is none."""
    status = night_status(folder)
    with reading(folder) as journal:
        done = journal.done_attempts()
        steps, events = journal.steps_by_key(), journal.events()
        ended = [(steps[key], attempt) for key, attempt in done.items()]
        identity = next((each.data for step, each in ended if step.kind is StepKind.IDENTIFY), {})
        hours, series = _temperatures(*temperatures(folder, journal.heartbeats(), recorded_end(journal).get("trace")))
        words = {
            "counted": counted,
            "hours_minutes": hours_minutes,
            "local": partial(_local, journal),
            "kind": StepKind,
        }
        known = {"journal": journal, "plan": journal.plan, "status": status, "done": journal.completed()}
        asked, done_in_words = filled("hil.report", "night.txt.j2", **known, **words).splitlines()
        return NightContent(
            **{name: status[name] for name in ("state", "title", "simulated", "reason", "identity", "missing")},
            to_do=_to_do(folder, status),
            asked=asked,
            done=done_in_words,
            self_calibrations=(status["self_calibrations_done"], status["self_calibrations_total"]),
            events=[(_utc(journal, event.at_s), event.kind, event.message) for event in events],
            event_hours=np.array([event.at_s for event in events], dtype=np.float64) / _SECONDS_PER_HOUR,
            hours=hours,
            temperatures=series,
            soaks=[_soak(step, attempt) for step, attempt in ended if step.kind is StepKind.RESTABILISE],
            collects=[_collect(journal, step, each) for step, each in ended if step.kind is StepKind.COLLECT],
            margins=sorted(_margins(ended), key=lambda each: -each["used"]),
            vocabulary=str(understood(journal.night.configuration).get("sweep", {}).get("vocabulary", "plain")),
            rejected=_rejected(journal, going_on=status["state"] in WORKING),
            provenance=night_provenance(journal, identity),
            files=[(row.block.path, row.block.size, row.block.sha256) for row in journal.blocks()],
        )


def _to_do(folder: Path, status: Mapping[str, Any]) -> str:
    if status["state"] not in {"incomplete", "aborted", "failed"}:
        return ""
    chamber = status["chamber_in_words"]
    told = "" if chamber in status["reason"] else f"{chamber}. "
    return f"{told}To do: {to_do(Path(folder.name), {**status, 'verdict': None})}"


def _soak(step: Step, attempt: Attempt) -> dict[str, Any]:
    data = attempt.data
    return {
        **_where(step),
        "began_h": attempt.began_s / _SECONDS_PER_HOUR,
        "ended_h": (attempt.ended_s or attempt.began_s) / _SECONDS_PER_HOUR,
        "waited_s": float(data.get("waited_s") or 0.0),
        "decided_by": str(data.get("decided_by") or "–"),
        "reason": attempt.reason,
        "verdict": str(data.get("verdict") or ""),
        "soak_restarts": int(data.get("soak_restarts") or 0),
        "window_restarts": int(data.get("window_restarts") or 0),
    }


def _collect(journal: JournalReader, step: Step, attempt: Attempt) -> dict[str, Any]:
    data = attempt.data
    start_s, duration_s = float(data.get("start_s", attempt.began_s)), float(data.get("duration_s") or 0.0)
    return {
        **_where(step),
        "position": str(data.get("position", step.position)),
        "began_h": start_s / _SECONDS_PER_HOUR,
        "ended_h": (start_s + duration_s) / _SECONDS_PER_HOUR,
        "utc": _utc(journal, start_s),
        "duration_s": duration_s,
        "n_samples": int(data.get("n_samples") or 0),
        "n_expected": int(data.get("n_expected") or 0),
        "counts": {name: int(count) for name, count in (data.get("counts") or {}).items()},
        "verdict": str(data.get("verdict") or ""),
        "reason": str(data.get("reason") or attempt.reason),
    }


def _where(step: Step) -> dict[str, Any]:
    at = step.temperature_degC
    return {"run": step.self_calibration or 0, "temperature_degC": math.nan if at is None else at}


def _margins(ended: Sequence[tuple[Step, Attempt]]) -> Iterator[dict[str, Any]]:
    """Yield of each limit that has a number in the records the place that came nearest to it."""
    soaks = [each for each in ended if each[0].kind is StepKind.RESTABILISE and each[0].parameters.get("ceiling_s")]
    if soaks:
        step, attempt = max(soaks, key=lambda each: each[1].data.get("waited_s") or 0.0)
        waited_s, ceiling_s = float(attempt.data.get("waited_s") or 0.0), step.parameters["ceiling_s"]
        where, value = step_in_words(step), hours_minutes(waited_s)
        most, used = hours_minutes(ceiling_s), waited_s / ceiling_s
        yield {"what": "longest restabilisation", "where": where, "value": value, "limit": most, "used": used}
    drifts, lost = [], []
    for step, attempt in ended:
        if step.kind is not StepKind.COLLECT:
            continue
        limit, data = step.parameters, attempt.data
        expected = int(data.get("n_expected") or 0)
        if expected and limit["minimum_fraction"] < 1.0:
            there = min(int(data.get("n_samples") or 0) / expected, 1.0)
            lost.append(((1.0 - there) / (1.0 - limit["minimum_fraction"]), there, step))
        for number, sensor in (data.get("sensors") or {}).items():
            for channel, rate in sensor["rates"].items():
                size, se = (abs(rate.get(f"drift_{of}deg_per_hr_per_min") or 0.0) for of in ("", "se_"))
                # A drift counts where it is beyond its limit and significant: the lesser share is how near it came.
                top, sigmas = limit["drift_limit_deg_per_hr_per_min"], limit["drift_sigmas"]
                found = [(size / top, f"{size:.1f} deg/hr/min", f"{top:g}")]
                found += [(size / se / sigmas, f"{size / se:.1f} standard errors", f"{sigmas:g}")] if se else []
                drifts.append((*min(found), f"sensor {number} {channel}", step))
    if drifts:
        used, value, most, channel, step = max(drifts, key=lambda each: each[0])
        where = f"{step_in_words(step)}, {channel}"
        yield {"what": "drift within a collect", "where": where, "value": value, "limit": most, "used": used}
    if lost:
        used, there, step = max(lost, key=lambda each: each[0])
        least = f"{step.parameters['minimum_fraction']:.0%} at least".replace("%", " %")
        value, where = f"{math.floor(1e3 * there) / 10:g} %", step_in_words(step)
        yield {"what": "samples of a collect", "where": where, "value": value, "limit": least, "used": used}


def _rejected(journal: JournalReader, *, going_on: bool) -> list[tuple[str, str, str]]:
    attempts, steps = journal.attempts(), journal.steps_by_key()
    newest = attempts[-1] if attempts and going_on and attempts[-1].outcome is None else None
    found = []
    for each in attempts:
        if each is newest or each.outcome is Outcome.DONE:
            continue
        word = "withdrawn" if each.withdrawn else "never ended" if each.outcome is None else each.outcome.value.lower()
        why = each.reason or "the controller was killed, or lost its power; nothing of it is used"
        what = f"{step_in_words(steps[each.step_key])}, attempt {each.attempt}"
        found.append((_utc(journal, each.began_s), what, f"{word}: {why}"))
    return found


def _temperatures(
    names: Sequence[str], times_s: FloatArray, values: FloatArray
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return hours (t,) and setpoint, chamber and every unit thermometer (t,), NaN where unknown or nobody measured."""
    labels = {"setpoint_degC": "setpoint", "chamber_degC": "chamber"}
    labels |= {name: f"unit, sensor {name.split('_')[1]}" for name in names if name.startswith("unit")}
    steps_s = np.diff(times_s)
    usual_s = float(np.median(steps_s[steps_s > 0.0])) if np.any(steps_s) else 0.0
    silent = np.flatnonzero(steps_s > max(_SILENT_S, _SILENT_POINTS * usual_s)) + 1
    broken = np.insert(values, silent, np.nan, axis=0)
    found = {label: broken[:, names.index(name)] for name, label in labels.items() if name in names}
    return np.insert(times_s, silent, times_s[silent]) / _SECONDS_PER_HOUR, found


def _utc(journal: JournalReader, at_s: float) -> str:
    return f"{journal.night.utc(at_s):%Y-%m-%d %H:%M:%S}"


def _local(journal: JournalReader, at_s: float) -> str:
    return f"{journal.night.utc(at_s).astimezone():%Y-%m-%d %H:%M %Z}"


def night_provenance(journal: JournalReader, identity: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Return names and values for a night; `identity` is what the devices said of themselves."""
    night = journal.night
    controllers = journal.controllers()
    first = night.versions or {}
    clock = understood(night.configuration).get("bench", {}).get("clock")
    told = [
        ("folder", journal.folder.resolve().name),
        ("began (UTC)", f"{night.began_utc:%Y-%m-%d %H:%M:%S}" + " (simulated time)" * (clock == "virtual")),
        ("began by", night.who),
        ("carried on by", ", ".join(each.who for each in controllers[1:])),
        *((device, ", ".join(f"{k} {v}" for k, v in said.items() if v)) for device, said in identity.items()),
        ("seed of the simulation", "" if night.seed is None else str(night.seed)),
        ("configuration, SHA-256", hashlib.sha256(night.configuration.encode()).hexdigest()),
        ("plan and configuration, digest in the journal", night.digest(journal.plan)),
        *((f"version of {name}", version) for name, version in first.items()),
    ]
    return [(name, value) for name, value in told if value]


def campaign_files(campaign: Campaign) -> list[tuple[str, int, str]]:
    """Return path, size in bytes and SHA-256 of the files that a campaign folder was read from."""
    if campaign.folder is None:
        return []
    folder = campaign.folder
    files = []
    for path in (folder / HEADER_FILE, folder / COLLECTS_FILE, *sorted((folder / SERIES_FOLDER).glob("[0-9]*"))):
        if path.is_file():
            name = str(path.relative_to(folder)) if path.is_relative_to(folder) else path.name
            with opened(path) as file:
                files.append((name, path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest()))
    return files
