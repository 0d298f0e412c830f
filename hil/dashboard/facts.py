"""What one night's journal and live files say, in the parts that the live page shows.

Parts: `head` (what is going on now), `events`, `results`, `plan`, `temperatures` and `collect` (curves). The journal is
opened read-only, for some milliseconds, and only where its files changed. Belongs to one thread.
"""

from collections import deque
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from drivers.clock import SystemClock
from hil.analysis.night_verdict import night_solutions
from hil.config.recorded import understood
from hil.errors import Damaged
from hil.files.lock import Owner, living_owner
from hil.records import JournalReader, reading
from hil.records.curve import TEMPERATURE, Curve, rows_of
from hil.records.ledger import HEAD_NAME
from hil.records.live import LIVE_NAME, OLD_AFTER_S, Rows, TraceReader, age_s, read_heartbeat, read_live
from hil.records.reader import JOURNAL_NAME, proven_once
from hil.records.status import WORKING, night_status, recorded_verdict, without_samples
from hil.records.troubles import to_do
from hil.records.units import night_of, unit_folder
from hil.solve.document import solution_document
from procedures.journal_protocol import StepResult
from procedures.plan import Plan, Step, StepKind
from procedures.words import step_in_words

_EVENTS = 80
_ROWS_AT_ONCE = 20_000
_COLLECT_BUCKETS = 600
_MEAN, _SE = " mean", " se"
_BAD = {"interlock", "failed", "error", "aborted", "safe-state-not-reached", "incomplete", "watchdog"}
_PLAIN = {"night-begins", "night-resumed", "resumed", "restored", "continue", "prompt-ended", "safe-state", "wear"}

Part = dict[str, Any]
Stamp = tuple[object, object, Owner | None]
_SHOWN = ("sensor", "model", "verdict", "reason", "assumed", "parameters")


class NightFacts:
    """One night, looked at again and again. `identity` names it on the page and in its addresses."""

    def __init__(self, folder: Path, identity: str) -> None:
        self.identity = identity
        self.folder = folder
        self.night = night_of(folder)
        self._shows = folder  # where the live files are: of several units the first one's tells of the chamber
        self._events: deque[dict[str, Any]] = deque(maxlen=_EVENTS)
        self._last_event = 0
        self.stamp: Stamp | None = None  # `recorded` at the last look
        self._owner: Owner | None = None
        self._live: Part | None = None
        self._live_stamp: object = None
        self._status: Part = {}
        self._bench = ""
        self._recorded: Part | None = None
        self._steps: Mapping[str, str] = {}
        self._curves = NightCurves(folder)
        self._parts: Part = {}
        self._results = ResultsSoFar(folder)

    def whole(self) -> Part:
        """Return every part as it was at the last look."""
        return {**self._parts, **self._curves.whole()}

    def look(self, stamp: Stamp | None = None) -> Part:
        """Return the parts that changed (`stamp`: `recorded` from before opening); `InputError` if unreadable."""
        fresh: Part = {}
        if (stamp := stamp or self.recorded) != self.stamp:
            self._owner = stamp[-1]
            with proven_once(self.night):
                fresh = self._read_journal()
            self.stamp = stamp
        live_stamp = _stamp(self._shows / LIVE_NAME)
        if live_stamp != self._live_stamp:
            self._live, self._live_stamp = read_live(self._shows), live_stamp
        fresh["head"] = self._head()
        fresh = {name: part for name, part in fresh.items() if part != self._parts.get(name)}
        self._parts |= fresh
        return {**fresh, **self._curves.changes()}

    @property
    def recorded(self) -> Stamp:
        """What changes when the journal, or who holds its folder, does."""
        journal = self.night / JOURNAL_NAME
        return _stamp(journal), _stamp(journal.with_name(f"{JOURNAL_NAME}-wal")), living_owner(self.night)

    @property
    def report(self) -> Path | None:
        """The report that `hil report` left in the night's folder; None where there is none since the last record."""
        path = self.folder / "report.html"
        made, recorded = _stamp(path), _stamp(self.night / HEAD_NAME)
        return path if made and recorded and made[2] >= recorded[2] else None

    @property
    def working(self) -> bool:
        """True while a controller is at work."""
        return self._owner is not None

    def _read_journal(self) -> Part:
        self._status = night_status(self.folder)
        with reading(self.folder) as journal:
            if not self._steps:
                bench = understood(journal.night.configuration).get("bench")
                self._bench = str(bench.get("name", "")) if isinstance(bench, dict) else ""
                self._steps = {step.key: step_in_words(step) for step in journal.plan.steps}
            self._recorded = recorded_verdict(journal)
            on = [each["unit"] for each in self._status["units"] if not each["set_aside"]]
            self._shows = unit_folder(self.night, on[0] if on else journal.plan.units[0])
            controllers = journal.controllers()
            self._status["seen_utc"] = controllers[-1].seen_utc.isoformat() if controllers else None
            self._status["pausing"] = _pausing(journal) if self._status["state"] == "running" else None
            for event in journal.events(self._last_event):
                self._last_event, at = event.number, journal.night.utc(event.at_s)
                weight = "bad" if event.kind in _BAD else "plain" if event.kind in _PLAIN else "note"
                told = {"number": event.number, "at_utc": at.isoformat(timespec="seconds")}
                self._events.append(told | {"kind": event.kind, "message": event.message, "weight": weight})
            self._curves.take_heartbeats(journal)
            fresh: Part = {"events": list(self._events), "plan": _plan(journal.plan)}
            fresh["results"] = self._results.read(journal)
        return fresh

    def _head(self) -> Part:
        status, live, damage, verdict = self._status, self._live, self._results.damage, self._recorded
        if damage:
            status, verdict = without_samples(status), {"verdict": "ERROR", "reason": damage}
        theirs = live is not None and self._owner is not None and live["pid"] == self._owner.pid
        now = live if theirs and status["state"] in WORKING else None
        key = now["step"] if now else status["step"]
        silent_s, old = self._age(now)
        head = {
            **status,
            "bench": self._bench,
            "problems": [*status["problems"], *([f"ERROR: {damage}"] if damage else [])],
            "verdict": None if status["state"] in WORKING else verdict,
            "report": self.report is not None,
            "age_s": None if silent_s is None else round(silent_s),
            "old": old,
            "missing": status["missing"] if self._owner is None else [],
            "finishing_utc": now["finishing_utc"] if now else status["eta_utc"],
            "step": self._steps.get(key) if key else None,
            "now": _now(now) if now else None,
        }
        return head | {"to_do": to_do(self.folder, head)}

    def _age(self, now: Part | None) -> tuple[float | None, bool]:
        """Return how old what the controller at work last showed is, by the wall clock, and whether that is too old."""
        if self._owner is None:
            return None, False
        beat = read_heartbeat(self.night)
        beat = beat if beat and beat.pid == self._owner.pid else None
        if now is not None:
            return age_s(now, beat, SystemClock().utc())
        shown = [self._status["seen_utc"], beat and beat.utc]
        newest = max((datetime.fromisoformat(text) for text in shown if text), default=SystemClock().utc())
        silent_s = max((SystemClock().utc() - newest).total_seconds(), 0.0)
        return silent_s, silent_s > OLD_AFTER_S + (beat.silent_s if beat else 0.0)


def _now(live: Part) -> Part:
    """Return what the controller shows: countdown, temperatures, rates with their errors, and the stream."""
    names = ("step_elapsed_s", "step_remaining_s", "elapsed_s", "attempt", "note", "chamber_degC", "setpoint_degC")
    rates = {
        label: {"now": value, "mean": live["rates_deg_per_hr"].get(label), "se": live["rates_se_deg_per_hr"].get(label)}
        for label, value in {**live["rates_deg_per_hr"], **live["rates_now_deg_per_hr"]}.items()
    }
    counts = live["stream"]
    damaged = sum(counts[name] for name in ("bad_checksum", "bad_delimiter", "unknown_id"))
    stream = {"ok": counts["ok"], "lost": counts["lost"], "damaged": damaged, "unread_bytes": counts["overflow_bytes"]}
    stream |= {"hz": live["stream_hz"], "nominal_hz": live["stream_nominal_hz"]}
    return {**{name: live[name] for name in names}, "unit_degC": live["unit_degC"], "rates": rates, "stream": stream}


def _pausing(journal: JournalReader) -> str | None:
    """Return what was answered to a pause that does not hold yet, because a collect is finished first."""
    asked = [row for row in journal.requests() if row.kind in ("pause", "continue") and row.accepted]
    ended = max((event.at_s for event in journal.events() if event.kind == "continue"), default=-1.0)
    if not asked or asked[-1].kind != "pause" or (asked[-1].answered_s or 0.0) < ended:
        return None
    return f"{asked[-1].who} asked for a pause: {asked[-1].answer}"


def _plan(plan: Plan) -> Part:
    """Return the planned chamber temperature as corners of a line, in campaign seconds and °C, and the planned end."""
    corners: list[list[float]] = []
    for step in plan.steps:
        if step.kind is StepKind.SETPOINT and step.temperature_degC is not None:
            if corners:
                corners.append([step.starts_s, corners[-1][1]])
            corners.append([step.starts_s + step.duration_s, step.temperature_degC])
    if corners:
        corners.append([plan.total_s, corners[-1][1]])
    return {"corners": corners, "total_s": plan.total_s}


def _stamp(path: Path) -> tuple[int, int, int] | None:
    """Return what changes when a file does; an empty one, which whoever reads a journal leaves, is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return (found.st_ino, found.st_size, found.st_mtime_ns) if found.st_size else None


class ResultsSoFar:
    """The results of one night, by the call of `hil solve`: solved again when a self-calibration was finished."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.damage = ""  # which records are not what was written, so that no parameters are shown
        self._solved: tuple[int, ...] = ()
        self._solutions: dict[int, list[dict[str, Any]]] = {}

    def read(self, journal: JournalReader) -> list[dict[str, Any]]:
        """Return a row for every self-calibration that has begun; solutions only where all of its steps are done."""
        completed = journal.completed()
        begun = {
            number: steps
            for number, steps in journal.plan.self_calibrations.items()
            if any(step.key in completed for step in steps)
        }
        done = tuple(number for number, steps in begun.items() if all(step.key in completed for step in steps))
        if done != self._solved:
            self._solutions, self._solved = self._solve(), done
        return [
            {
                "number": number,
                "temperature_degC": steps[0].temperature_degC,
                "done": number in done,
                "collects": [
                    _collect(step, completed.get(step.key)) for step in steps if step.kind is StepKind.COLLECT
                ],
                "solutions": self._solutions.get(number, []) if number in done else [],
            }
            for number, steps in begun.items()
        ]

    def _solve(self) -> dict[int, list[dict[str, Any]]]:
        self.damage = ""
        try:
            campaign, solutions = night_solutions(self._folder)
        except Damaged as damage:
            self.damage = str(damage)
            return {}
        rows: dict[int, list[dict[str, Any]]] = {}
        for each in () if campaign is None else solution_document(campaign, solutions)["solutions"]:
            rows.setdefault(each["run"] or 0, []).append({key: each[key] for key in _SHOWN})
        return rows


def _collect(step: Step, result: StepResult | None) -> dict[str, Any]:
    data = result.data if result else {}
    return {"position": step.position, "verdict": data.get("verdict"), "reason": data.get("reason", "")}


class NightCurves:
    """Two curves that grow with a night: its temperatures, and the running averages of the present or last collect.

    They come from the trace that the controller writes at one second; a night without one (recorded elsewhere, or
    before there was any) is drawn from the journal's signs of life, one a minute.
    """

    def __init__(self, folder: Path) -> None:
        self._trace = TraceReader(folder)
        self._begin([])
        self._last_heartbeat = 0

    def _begin(self, columns: list[str]) -> None:
        self._columns = columns
        self._temperatures = [name for name in columns if name.endswith(TEMPERATURE)]
        self._averages = [name for name in columns if name.endswith((_MEAN, _SE))]
        self._night = Curve(len(self._temperatures))
        self._collect = Curve(len(self._averages), _COLLECT_BUCKETS, digits=4)
        self._collecting = False

    def take_heartbeats(self, journal: JournalReader) -> None:
        """Draw from the journal while there is no trace."""
        if self._trace.columns:
            return
        beats = journal.heartbeats(self._last_heartbeat)
        if not beats:
            return
        columns, rows = rows_of(beats, self._columns)
        if columns != self._columns:
            self._begin(columns)
            _, rows = rows_of(journal.heartbeats())
        self._last_heartbeat = beats[-1].number
        self._add(rows)

    def changes(self) -> dict[str, Any]:
        """Read what the trace has got meanwhile; return the curves that changed, from their first new bucket on."""
        while len(rows := self._trace.read(_ROWS_AT_ONCE)):
            if self._trace.begun_anew or self._columns != self._trace.columns:
                self._begin(self._trace.columns)
            self._add(rows)
        return self._named(self._night.changes(), self._collect.changes())

    def whole(self) -> dict[str, Any]:
        """Return both curves from their beginnings."""
        return self._named(self._night.whole(), self._collect.whole())

    def _named(self, night: Part | None, collect: Part | None) -> dict[str, Any]:
        found = {"temperatures": (self._temperatures, night), "collect": (self._averages, collect)}
        return {name: {"columns": columns, **curve} for name, (columns, curve) in found.items() if curve is not None}

    def _add(self, rows: Rows) -> None:
        """Draw rows of a trace; of collects the newest is kept, the rows since running means last began."""
        values = rows.astype(float)
        times_s, averages = values[:, 0], values[:, self._where(self._averages)]
        self._night.add(times_s, values[:, self._where(self._temperatures)])
        if not self._averages:
            return
        during = np.isfinite(averages).any(axis=1)
        begins = np.flatnonzero(during & ~np.concatenate([[self._collecting], during[:-1]]))
        if len(begins):
            self._collect = Curve(len(self._averages), _COLLECT_BUCKETS, digits=4)
            times_s, averages, during = times_s[begins[-1] :], averages[begins[-1] :], during[begins[-1] :]
        self._collect.add(times_s[during], averages[during])
        self._collecting = bool(during[-1])

    def _where(self, names: list[str]) -> list[int]:
        return [self._columns.index(name) for name in names]
