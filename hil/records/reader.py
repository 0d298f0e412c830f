"""Reading a journal, also while the controller writes it: nothing here changes it; `snapshot` is one instant."""

from __future__ import annotations

import os
import sqlite3
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from textwrap import shorten
from typing import Self, TypeVar
from urllib.parse import quote

from drivers.given_file import check_folder
from hil.errors import Damaged, InputError, worded
from hil.files.durable import is_new
from hil.files.lock import Owner, living_owner
from hil.records import schema as journal_schema
from hil.records.blocks import BLOCKS, SAMPLES, SUFFIXES, Block
from hil.records.ledger import HEAD_NAME, breaks
from hil.records.rows import MEANS, Attempt, BlockRow, Controller, Event, Heartbeat, Night, RequestRow, step_of
from hil.records.units import JOURNAL_NAME as JOURNAL_NAME
from hil.records.units import night_of, place_of, unit_folder
from hil.records.witnesses import Witnesses, contradictions, forgotten
from procedures.journal_protocol import Outcome, StepResult, of_unit
from procedures.plan import Plan, Step, StepKind
from procedures.words import listed

RowT = TypeVar("RowT", Night, Attempt, Event, RequestRow, Heartbeat, Controller)

_BUSY_S = 30.0
_once = threading.local()  # its `journal` is that of the night that is proven once
_LONGEST = 200  # characters of what SQLite says: it quotes whole tables


class JournalReader:
    """A journal that is read, to be closed: of a night, or of one `unit` and its chamber as if it were alone."""

    def __init__(
        self, folder: Path, connection: sqlite3.Connection, unit: str = "", known: JournalReader | None = None
    ) -> None:
        self.folder = folder
        self.unit = unit
        self.found: Sequence[str] = known.found if known else ()  # what `reading` found damaged
        self.owner: Owner | None = known.owner if known else None  # who held the folder just before
        self._known = known  # a reader of the same instant
        self._connection = connection

    def close(self) -> None:
        """Release the database. Closing twice is allowed."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def snapshot(self) -> Iterator[None]:
        """Let all reads within see one and the same instant."""
        self._connection.execute("BEGIN")
        try:
            yield
        finally:
            self._connection.execute("ROLLBACK")

    @cached_property
    def night(self) -> Night:
        """What the night is: title, who, when, configuration, versions, seed. Raises `InputError` where damaged."""
        with self._understood("the row that describes the night"):
            found = next(self._rows(Night, "night"), None)
        if found is None:
            raise Damaged(f"{self.folder / JOURNAL_NAME}: the row that describes the night is missing")
        return found

    @cached_property
    def plan(self) -> Plan:
        """The steps of the night, or of the unit that was named. Raises `InputError` for one that is not there."""
        whole = self.whole_plan
        if self.unit and self.unit not in whole.units:
            raise InputError(f"{self.folder}: there is no unit {self.unit} in this night; {self._units_there()}")
        return whole.of_unit(self.unit) if self.unit else whole

    @property
    def one_unit(self) -> str:
        """The unit that was named, or the only one; raises `InputError` that says which there are."""
        if not self.unit and len(self.whole_plan.units) > 1:
            raise InputError(f"{self.folder}: a night of several units; {self._units_there()}")
        return self.unit or self.whole_plan.units[0] if self.plan else ""  # a unit that is not there has no plan

    def of_unit(self, unit: str) -> JournalReader:
        """Return what is read of one of the units, at the same instant."""
        return JournalReader(self.folder, self._connection, unit, self)

    def _units_there(self) -> str:
        named = ", ".join(filter(None, self.whole_plan.units))
        return f"name one by its folder: {unit_folder(self.folder, 'UNIT')}, of {named}" if named else "it lists none"

    @cached_property
    def whole_plan(self) -> Plan:
        """The steps of the night, as they were planned. Raises `InputError` where they are damaged."""
        if self._known is not None:
            return self._known.whole_plan
        rows = self._connection.execute(
            "SELECT number, key, kind, starts_s, duration_s, temperature_degC, self_calibration, position, parameters "
            "FROM steps ORDER BY number"
        )
        with self._understood("the plan"):
            return Plan(self.night.title, tuple(step_of(row) for row in rows))

    def _understood(self, what: str) -> AbstractContextManager[None, bool | None]:
        begin, edited = (
            f"{self.folder / JOURNAL_NAME}: {what} cannot be understood (",
            (ValueError, TypeError, KeyError),
        )
        return worded(Damaged, begin, edited, ")")

    def steps_by_key(self) -> Mapping[str, Step]:
        """Return the plan's steps by their key."""
        return {step.key: step for step in self.plan.steps}

    def completed(self) -> Mapping[str, StepResult]:
        """Return the results of the steps that are DONE, by step key (without samples), in the order of the plan."""
        found = self.done_attempts()
        done = ((step.key, found[step.key]) for step in self.plan.steps if step.key in found)
        return {key: StepResult(Outcome.DONE, each.reason, each.data) for key, each in done}

    @cached_property
    def _own_steps(self) -> frozenset[str]:
        return frozenset(step.key for step in self.plan.steps)

    def _rows(self, kind: type[RowT], table: str, more: str = "", *values: object) -> Iterator[RowT]:
        """Yield rows of a table as objects, whose fields are columns."""
        names = [each.name for each in fields(kind)]
        columns = ", ".join(names).replace("number", "id", 1)
        for row in self._connection.execute(f"SELECT {columns} FROM {table} {more} ORDER BY id", values):  # noqa: S608
            cells = zip(names, row, strict=True)
            yield kind(**{name: MEANS[name](cell) if name in MEANS else cell for name, cell in cells})

    def attempts(self) -> tuple[Attempt, ...]:
        """Return every attempt in order: without an outcome it never ended; withdrawn after DONE it is FAILED."""
        rows = (each for each in self._rows(Attempt, "attempts") if not self.unit or each.step_key in self._own_steps)
        return tuple(
            replace(
                each,
                outcome=Outcome.FAILED if each.withdrawn else each.outcome,
                reason=each.withdrawn or each.reason,
                data=of_unit(each.data, self.unit),
            )
            for each in rows
        )

    def done_attempts(self) -> Mapping[str, Attempt]:
        """Return the one DONE attempt of every step that has one, by step key."""
        return {each.step_key: each for each in self.attempts() if each.outcome is Outcome.DONE}

    def blocks(self, *, of_all: bool = False) -> tuple[BlockRow, ...]:
        """Return every block that was committed, in the order in which they were; `of_all`: of the other units too."""
        rows = self._connection.execute(
            "SELECT step_key, attempt, kind, path, sha256, size, rows, content_sha256 FROM blocks ORDER BY id"
        )
        return tuple(
            BlockRow(key, attempt, Block(*columns))
            for key, attempt, *columns in rows
            if of_all or not self.unit or key in self._own_steps
        )

    def events(self, after: int = 0) -> tuple[Event, ...]:
        """Return what happened, in order; only events with a number above `after`."""
        return tuple(self._rows(Event, "events", "WHERE id > ?", after))

    def requests(self) -> tuple[RequestRow, ...]:
        """Return what was asked of the controllers of this night, in order, with what they answered."""
        return tuple(self._rows(RequestRow, "requests"))

    def standing(self, begins: str, ends: str) -> Event | None:
        """Return the newest event of the kind `begins` by the newest controller, unless one of `ends` came after it.

        `standing("pause", "continue")` is the pause in effect, `standing("prompt", "prompt-ended")` what is asked.
        """
        newest = max((each.number for each in self.controllers()), default=0)
        told = [each for each in self.events() if each.controller == newest and each.kind in (begins, ends)]
        return told[-1] if told and told[-1].kind == begins else None

    def heartbeats(self, after: int = 0) -> tuple[Heartbeat, ...]:
        """Return the signs of life, in order; only those with a number above `after`."""
        beats, ours = tuple(self._rows(Heartbeat, "heartbeats", "WHERE id > ?", after)), f"unit_{self.unit}."
        if not self.unit:
            return beats
        told = [{n: v for n, v in each.readings.items() if n.startswith(ours) or n[:5] != "unit_"} for each in beats]
        named = [{name.replace(ours, "unit_"): value for name, value in of.items()} for of in told]
        return tuple(replace(each, readings=of) for each, of in zip(beats, named, strict=True))

    def last_heartbeat(self) -> Heartbeat | None:
        """Return the newest sign of life, or None before the first."""
        number = self._connection.execute("SELECT max(id) FROM heartbeats").fetchone()[0]
        return self.heartbeats(number - 1)[0] if number else None

    def controllers(self) -> tuple[Controller, ...]:
        """Return the controller processes that worked on this night, in order."""
        return tuple(self._rows(Controller, "controllers"))

    def identity(self) -> dict[str, str]:
        """Return `model` and `serial` of the unit, `operator`, `note`, and `despite`; what is not known is not there.

        What the unit tells of itself counts more than what was typed; `despite`: what was NOT, and why one went on.
        """
        found = {"operator": self.night.who}
        notes, despite = [], []
        for event in self.events():
            said = event.evidence
            if event.kind == "night-begins":
                found |= {name: text for name, text in said.get("unit", {}).items() if text != "ask"}
            elif event.kind == "unit-serial":
                found["serial"] = said["serial"]
            elif event.kind == "despite":
                despite.append(event.message)
            notes.append(said.get("note", "") if event.kind in ("night-begins", "night-resumed") else "")
        done = self.completed()
        identified = [done[step.key].data for step in self.plan.of_kind(StepKind.IDENTIFY) if step.key in done]
        for name in ("model", "serial"):
            if told := dict.fromkeys(each["imu"][name] for each in identified if each.get("imu", {}).get(name)):
                found[name] = listed(told)
        found |= {"note": "; ".join(filter(None, notes)), "despite": "; ".join(despite)}
        return {name: text for name, text in found.items() if text}

    def damage(self, witnesses: Witnesses | None = None) -> list[str]:
        """Return in words what is not as it was written: SQLite's own check, the chain, what stands beside it.

        `witnesses` were asked before this journal was, where somebody may be writing. A damaged file may also make
        this or any other read raise `sqlite3.DatabaseError`.
        """
        witnesses = witnesses or Witnesses.of(self.folder)
        found = [line for (line,) in self._connection.execute("PRAGMA integrity_check(5)") if line != "ok"]
        if not found:
            found += breaks(self._connection, witnesses.head)
            found += contradictions(self._connection, witnesses)
        return [f"{JOURNAL_NAME}: {shorten(each, _LONGEST)}" for each in found]

    def log_damage(self) -> list[str]:
        """Return in words what the log does not say any more: no result rests on it."""
        return list(forgotten(self._connection, self.folder))


def refuse(folder: Path, damage: Sequence[str]) -> None:
    """Raise `Damaged` with the first of what is damaged, and what to do; nothing where nothing is."""
    if damage:
        more = f" (and {len(damage) - 1} more: hil verify names them)" if len(damage) > 1 else ""
        repair = f"hil repair {folder} --out NEW brings back what is proven, where its plan is"
        raise Damaged(f"{folder}/{damage[0]}{more}; nothing that rests on it is stated; {repair}")


def is_night(folder: Path) -> bool:
    """Tell whether the folder holds a night, one of its units, or what is left of one that has lost its journal."""
    folder = night_of(folder)
    return os.path.lexists(folder / JOURNAL_NAME) or _written_beside(folder)


def _written_beside(folder: Path) -> bool:
    return os.path.lexists(folder / HEAD_NAME) or any(folder.glob(f"{BLOCKS}/*{SUFFIXES[SAMPLES]}"))


def refuse_existing(folder: Path) -> None:
    """Raise `InputError` where a night's new `folder` is there already and holds anything."""
    if not is_new(folder):
        what = "it holds a night already" if is_night(folder) else "it exists and is not empty"
        raise InputError(f"{folder}: {what}; name a new folder, or carry the night on with hil resume")


def journal_of(folder: Path) -> Path:
    """Return where a night's journal is; `InputError` where there is no night, `Damaged` where it is gone or empty."""
    path = folder / JOURNAL_NAME
    if path.is_file() and path.stat().st_size:
        return path
    check_folder(folder)
    if not _written_beside(folder) and (path.is_file() or not os.path.lexists(path)):
        what = f"{JOURNAL_NAME} is empty, and nothing is beside it" if path.is_file() else f"there is no {JOURNAL_NAME}"
        from hil.campaign.reader import HEADER_FILE  # imported late: only to refuse

        campaign = (folder / HEADER_FILE).is_file()
        instead = "; it is a campaign folder: hil solve, report, thermal, reconcile and what else reads nights take it"
        raise InputError(f"{folder}: holds no night ({what} in it){instead * campaign}")
    raise Damaged(
        f"{path}: {'is empty' if path.is_file() else 'is gone'}; {HEAD_NAME} or {BLOCKS} beside it say that there was "
        "a night. Without it nothing is proven: put it back from a copy. Whether the chamber is safe cannot be told: "
        "hil chamber BENCH stop makes it so"
    )


def open_readonly(folder: Path) -> JournalReader:
    """Open a night's or unit's journal to read it, also while it is written; raises as `journal_of`, `InputError`."""
    folder, unit = place_of(folder)
    path = journal_of(folder)
    uri = f"file:{quote(str(path.resolve()))}?mode=ro"
    if not os.access(folder, os.W_OK) and not path.with_name(f"{JOURNAL_NAME}-wal").exists():
        uri += "&immutable=1"  # an archived night on a read-only medium: nobody can be writing
    with worded(InputError, f"{path}: cannot be opened (", sqlite3.Error, ")"):
        connection = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=_BUSY_S)
    try:
        journal_schema.check(connection, path)
    except BaseException:
        connection.close()
        raise
    return JournalReader(folder, connection, unit)


def units_in(folder: Path) -> Mapping[str, Path]:
    """Return the folders of the units by name where `folder` is a night that lists them, and can be read; else none."""
    try:
        with open_readonly(folder) as journal:
            names = () if journal.unit else journal.whole_plan.units
    except (InputError, sqlite3.Error):
        return {}
    return {unit: unit_folder(folder, unit) for unit in names if unit}


@contextmanager
def reading(folder: Path, *, damaged_too: bool = False) -> Iterator[JournalReader]:
    """Open the journal of a night, see one instant of it, and prove that it is what was written.

    Raises `Damaged` where it is not; with `damaged_too` only where it cannot be understood, for those who say what
    stands in `journal.found` beside what they read. Within `proven_once` it is that instant, which is proven already.
    """
    found: Sequence[str] | None = None
    try:
        with _proven(folder) as journal:
            found = journal.found
            if not damaged_too:
                refuse(journal.folder, found)
            yield journal
    except (sqlite3.DatabaseError, ArithmeticError, ValueError, LookupError, TypeError, AttributeError) as error:
        if found == [] and not isinstance(error, journal_schema.UNREADABLE):
            raise  # a defect of ours, not of the records
        refuse(folder, found or [f"{JOURNAL_NAME}: cannot be understood ({shorten(str(error), _LONGEST)})"])


@contextmanager
def _proven(folder: Path) -> Iterator[JournalReader]:
    night, unit = place_of(folder)
    if (known := getattr(_once, "journal", None)) is not None and known.folder == night:
        yield known.of_unit(unit)
        return
    owner = living_owner(night)  # before the journal: who ends in between has written its end
    witnesses = Witnesses.of(night)
    with open_readonly(folder) as journal, journal.snapshot():
        journal.found, journal.owner = journal.damage(witnesses), owner
        yield journal


@contextmanager
def proven_once(night: Path) -> Iterator[None]:
    """Let what this thread reads of a night, of any unit, be one instant that is proven once, where it can be."""
    with ExitStack() as held:
        held.callback(setattr, _once, "journal", getattr(_once, "journal", None))
        with suppress(InputError):
            _once.journal = held.enter_context(reading(night, damaged_too=True))
        yield
