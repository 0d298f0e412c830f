"""A night in a folder: begin one, carry one on.

    night/
      journal.sqlite      the truth
      blocks/             samples and raw bytes
      configuration/      what the IMU sends and what is simulated, as the journal has it
      log.jsonl           who did what when, line by line
      controller.lock     who is at work here
      live.json, .trace   the newest state and a curve, for onlookers (hil.records.live)

Bad input leaves no folder. A folder, once it is there, holds a whole journal with its plan, and whatever happens after
that is in it. The chamber is in its safe state at every way out.
"""

import contextlib
import math
import platform
import shutil
import sqlite3
import threading
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import partial
from importlib.metadata import version
from pathlib import Path

from drivers.clock import PacedClock, VirtualClock
from hil.bench import LiveBench, build_bench
from hil.bench.lock import bench_lock
from hil.config import Bench
from hil.config.recorded import CONFIGURATION, configuration_of, configuration_text
from hil.config.sweep import Sweep, check_sweep_against_bench, planned
from hil.errors import InputError
from hil.files.durable import whole_or_nothing
from hil.files.lock import FolderLock
from hil.files.strict import NAME, one_line
from hil.night.log import NightLog, logged
from hil.night.notify import LAST_WORDS_S, in_words_at_the_beginning, in_words_at_the_end, notifier_of
from hil.night.remarks import Remarks, ask_serial
from hil.records import SqliteJournal, reading
from hil.records.blocks import FieldMeaning
from hil.records.damage import damaged_self_calibrations
from hil.records.ledger import read_key
from hil.records.live import TRACE_NAME, HeartbeatFile, LiveFiles
from hil.records.reader import proven_once, refuse_existing
from hil.records.requests import user
from hil.records.rows import Night
from hil.records.status import VERDICT
from hil.records.units import refuse_unit, unit_folder
from hil.records.witnesses import LOG_NAME, seal
from hil.twin.motion import Resumed
from procedures.attended import Attendant, Terminal
from procedures.plan import StepKind
from procedures.progress import Progress
from procedures.sequencer import Sequencer
from procedures.settings import Polling
from procedures.stop import StopRequest
from procedures.sweep_outcome import SweepOutcome, SweepState
from procedures.verdict import Judgement
from procedures.watch import Watch

SIMULATED_DOWN_TIME_S = 1800.0
"""How long a simulated bench is taken to have been without a controller before a resume."""

_WATCHED_S = 0.25  # of real time, between two polls of a simulated night that somebody watches


@dataclass(frozen=True)
class NightOutcome:
    """How a night, or the part of it that one controller carried out, ended.

    `state` is that of hil.status/1: complete, incomplete, aborted or failed. `exit_status` is 0 where every planned
    step is done, 9 where only steps of units are missing that were set aside, 3 where an interlock or a device ended it
    with the chamber in its safe state, 5 and 6 where the chamber is NOT SAFE or that is NOT KNOWN, else 1.
    """

    folder: Path
    state: str
    reason: str
    exit_status: int


def start_night(
    folder: Path | str,
    sweep: Sweep,
    bench: Bench,
    *,
    who: str | None = None,
    seed: int | None = None,
    onlookers: Sequence[Progress] = (),
    stop: StopRequest | None = None,
    terminal: Terminal | None = None,
    speed: float | None = None,
    opened: Callable[[LiveBench], None] | None = None,
    remarks: Remarks | None = None,
) -> NightOutcome:
    """Begin a night in the new `folder` and carry it out; returns when it has ended, whichever way.

    `seed` takes the place of the bench file's for a simulation; `terminal` shows the questions to the operator of a
    bench without indexing, which stand in the journal too; `speed` lets a simulated night be watched, so many times as
    fast as real time; `opened` is told the bench once it is open; `remarks` are for the record. Raises `InputError` for
    bad input and `DeviceError` for a port that cannot be opened; nothing is left behind then.
    """
    target = Path(folder)
    refuse_existing(target)
    check_sweep_against_bench(sweep, bench)
    text = configuration_text(bench, sweep, seed)
    read_key(bench.record.key)  # or nothing begins
    plan = planned(sweep, bench)
    who = one_line("--operator", who or user(), NAME)
    with bench_lock(bench, target):
        with whole_or_nothing(target) as partial:
            resolved, _ = configuration_of(text, partial / CONFIGURATION)
            attendant = Attendant(terminal)
            live = build_bench(resolved, ask=attendant, speed=speed)
            try:
                began = live.devices.clock.utc()
                chosen = resolved.simulation.seed if resolved.simulation else None
                night = Night(sweep.title, who, began, resolved.simulated, text, chosen, versions())
                SqliteJournal.create(partial, plan, night)
            except BaseException:
                live.close()
                raise
        clock, raw = live.devices.clock, resolved.record.raw
        with live, SqliteJournal.open(target, clock=clock, who=who, keep_raw=raw) as journal:
            unit, said = resolved.unit.model_dump(), remarks or Remarks()
            units = {"units": list(resolved.units)} if resolved.units else {"unit": unit}
            evidence = {"sweep": sweep.source, "bench": bench.source, **units, "note": said.note}
            told = f"{who} began the night{f': {said.note}' if said.note else ''}"
            journal.event("night-begins", told, **evidence)
            said.record(journal, who)
            return _carry_out(journal, live, attendant, who, onlookers, stop, opened)


def resume_night(
    folder: Path | str,
    *,
    who: str | None = None,
    onlookers: Sequence[Progress] = (),
    stop: StopRequest | None = None,
    terminal: Terminal | None = None,
    down_s: float = SIMULATED_DOWN_TIME_S,
    speed: float | None = None,
    opened: Callable[[LiveBench], None] | None = None,
    remarks: Remarks | None = None,
) -> NightOutcome:
    """Carry on the night in `folder`, with the configuration with which it began.

    Steps that are done stay done; a partial collect is taken again and the soak starts over. A self-calibration whose
    samples are damaged is done again as a whole (hil.records.damage). Under a virtual clock
    `down_s` have passed since the last record. Raises `InputError` where the folder holds no night, one that another
    controller is working on, or one whose bench cannot be put together; `Damaged` where its journal is damaged.
    """
    folder, who, said = Path(folder), one_line("--operator", who or user(), NAME), remarks or Remarks()
    refuse_unit(folder)
    with reading(folder) as reader:
        night, controllers, plan = reader.night, reader.controllers(), reader.plan
        damaged = damaged_self_calibrations(reader)
        withdrawn = {key for key in reader.completed() if reader.steps_by_key()[key].self_calibration in damaged}
        done = reader.completed().keys() - withdrawn
        begun = {each.step_key for each in reader.attempts()}
        serial = reader.identity().get("serial", said.serial)
    if said.serial not in ("", serial):
        raise InputError(f"{folder}: it is a night of unit {serial}, and {said.serial} was typed; which?")
    if len(done) == len(plan.steps):
        return NightOutcome(folder, "complete", "every planned step was done before", 0)
    last_s = max((controller.seen_s for controller in controllers), default=0.0)
    first_run = next((n for n, steps in plan.self_calibrations.items() if any(s.key not in done for s in steps)), 1)
    half_done = plan.self_calibrations.get(first_run, ())
    visited = [s.position for s in half_done if s.kind is StepKind.COLLECT and s.key in done and s.position]
    with ExitStack() as held:
        lock, attendant = held.enter_context(FolderLock(folder).acquire()), Attendant(terminal)
        bench, _ = configuration_of(night.configuration, folder / CONFIGURATION)
        bench = bench.of_unit(said.serial) if said.serial else bench
        held.enter_context(bench_lock(bench, folder))
        gone_s = last_s + down_s
        resumed = Resumed(first_run, visited, len(controllers), gone_s, begun)
        live = build_bench(bench, start_utc=night.utc(gone_s), resumed=resumed, ask=attendant, speed=speed)
        held.enter_context(live)
        clock, raw = live.devices.clock, bench.record.raw
        journal = held.enter_context(SqliteJournal.open(folder, clock=clock, who=who, keep_raw=raw, lock=lock))
        _record_resumption(journal, who, night, len(done), last_s, said.note)
        said.record(journal, who)
        for number, what in damaged.items():
            keys = {step.key for step in plan.self_calibrations[number]} & withdrawn
            journal.withdraw(keys, f"done again, because samples were damaged: {what}")
            message = f"self-calibration {number} is done again as a whole: {what}"
            journal.event("damage", message, self_calibration=number, withdrawn=sorted(keys))
        return _carry_out(journal, live, attendant, who, onlookers, stop, opened)


def _record_resumption(journal: SqliteJournal, who: str, night: Night, done: int, last_s: float, note: str) -> None:
    """Say who carries on, after how long, and whether with another program than the one that began."""
    down_s = journal.now_s() - last_s
    total = len(journal.plan.steps)
    message = f"{who} carried on with {done} of {total} steps done, {down_s / 60.0:.0f} min after the last record"
    message += f": {note}" if note else ""
    now, before = versions(), night.versions or {}
    changed = {name: [before.get(name), now[name]] for name in now if before.get(name) != now[name]}
    journal.event("night-resumed", message, down_s=down_s, done=done, changed_versions=changed, note=note)


def _carry_out(
    journal: SqliteJournal,
    live: LiveBench,
    attendant: Attendant,
    who: str,
    onlookers: Sequence[Progress],
    stop: StopRequest | None,
    opened: Callable[[LiveBench], None] | None,
) -> NightOutcome:
    """Run what is not done yet, and record how it ended. The sequencer leaves the chamber in its safe state."""
    stop = stop or StopRequest()
    clock = live.devices.clock
    if opened is not None:
        opened(live)
    log = NightLog(journal.folder, clock, who)
    heartbeat = HeartbeatFile(journal.folder)
    notifier = notifier_of(live.bench, journal)
    polling = _polling(live)
    announced_s = polling.read_interval_s
    # Of real time: next to none on a clock that jumps.
    speed = clock.speed if isinstance(clock, PacedClock) else math.inf if isinstance(clock, VirtualClock) else 1.0
    shown = [
        LiveFiles(journal.folder, devices.imu.sensors, every_s=announced_s / speed, announced_s=announced_s, unit=name)
        for name, devices in live.devices.units.items()
    ]
    try:
        journal.listen(log.say)
        journal.listen(notifier.hear)
        notifier.tell("started", in_words_at_the_beginning(journal, who))
        for name, each in live.each.items():
            journal.block_writer.meanings[name] = field_meanings(each)
        if live.faults is not None:
            journal.block_writer.disk = live.faults.disk
        watch = Watch(
            live.devices.with_all(lambda device: logged(device, log.say)),
            journal,
            stop,
            began=journal.began_utc,
            interlocks=live.bench.interlocks,
            polling=polling,
            onlookers=[*([live.faults] if live.faults else []), *shown, *onlookers],
            control=journal,
            vital=heartbeat.alive,
            disk_free_mb=lambda: shutil.disk_usage(journal.folder).free / 1e6,
        )
        simulated = live.bench.simulation if live.faults else None  # of others nobody knows when they were switched on
        on = clock.utc() - timedelta(seconds=simulated.start.powered_for) if simulated else None
        first = partial(ask_serial, journal, live, attendant)
        sequencer = Sequencer(journal.plan, watch, powered_on=on, attendant=attendant, first=first)
        with stop.on_signals() if threading.current_thread() is threading.main_thread() else contextlib.nullcontext():
            ended = sequencer.run()
        outcome = _outcome(journal.folder, ended)
        log.say("night ends", {"state": outcome.state, "reason": outcome.reason, "error": ended.error})
        with contextlib.suppress(sqlite3.Error, OSError):  # a full disk: the state is derived without it
            wear = live.devices.chamber.wear_warning
            if wear is not None:
                journal.event("wear", f"chamber: {wear}")
            for files in shown:
                files.close()  # what they show is recorded with the verdict
            judge(journal, outcome.state)
            _archive(journal, live.bench, outcome.state)
            journal.finish(f"{outcome.state}: {outcome.reason}")
            notifier.tell("finished", in_words_at_the_end(journal, f"{outcome.state}: {outcome.reason}"))
        return outcome
    finally:
        heartbeat.alive(LAST_WORDS_S)
        notifier.close()
        for files in shown:
            files.close()
        heartbeat.close()
        log.close()


def judge(journal: SqliteJournal, state: str) -> None:
    """Record what the report will say of the night, so that whoever only asks how it stands need not solve it.

    Of several units it is said of each, and then of the night, which is as good as the worst of them.
    """
    from hil.analysis.night_verdict import of_units  # only an end needs what solves

    with proven_once(journal.folder):
        done = journal.completed().keys()
        judged = {unit: _judged(journal, unit, state, done) for unit in journal.plan.units}
    ends = {unit: each for unit, each in judged.items() if each is not None}
    if ends and "" not in judged:
        verdict, in_spec = of_units({u: v for u, (v, _) in ends.items()}, {u: i for u, (_, i) in ends.items() if i})
        ends[""] = verdict, in_spec
    for unit, (verdict, in_spec) in ends.items():
        whose, said = ({"unit": unit}, f"unit {unit}: ") if unit else ({}, "")
        trace = {"trace": seal(unit_folder(journal.folder, unit) / TRACE_NAME)} if unit in judged else {}
        log = [seal(path) for path in sorted(journal.folder.glob(f"{LOG_NAME}*"))]
        told = f"{said}{verdict.verdict}: {verdict.reason}"
        journal.event(VERDICT, told, **vars(verdict), **trace, log=log, in_spec=in_spec, **whose)


def _judged(
    journal: SqliteJournal, unit: str, state: str, done: Collection[str]
) -> tuple[Judgement, dict[str, str] | None] | None:
    """Return how good a unit's part of the night is, and whether the unit is; None where its records are damaged."""
    from hil.analysis.in_spec import in_spec_of
    from hil.analysis.night_verdict import night_solutions, night_verdict

    folder = unit_folder(journal.folder, unit)
    if unit and all(step.key in done for step in journal.plan.of_unit(unit).steps):
        state = "complete"
    try:
        campaign, solutions = night_solutions(folder)
        judged = night_verdict(state, solutions)
    except InputError:
        return None  # whoever reads it is told why
    found = in_spec_of(folder, campaign, solutions, state=state)
    return judged, None if found is None else found.brief()


def _archive(journal: SqliteJournal, bench: Bench, state: str) -> None:
    """Take the night up into the archive that its bench names; where that cannot be done, the record says why."""
    if bench.archive is None:
        return
    from hil.archive.folder import take_up  # only an end needs what solves
    from hil.archive.taking_in import take_in

    for unit in bench.each:
        try:
            taken = take_up(bench.archive, unit_folder(journal.folder, unit), state=state)
            take_in(bench.archive, taken.entry)
            journal.event("archived", f"taken up into {bench.archive} as {taken.entry}")
        except (InputError, OSError) as error:
            journal.event("not-archived", f"the archive does not have this night: {error}. Later: hil archive")


def _polling(live: LiveBench) -> Polling:
    """Return how often to look: oftener than the bench file says where somebody watches a simulated night."""
    clock, polling = live.devices.clock, live.bench.polling
    if not isinstance(clock, PacedClock):
        return polling
    usual, look_s = Polling(), _WATCHED_S * clock.speed
    return replace(
        polling,
        interval_s=min(polling.interval_s, max(usual.interval_s, look_s)),
        read_interval_s=min(polling.read_interval_s, max(usual.read_interval_s, look_s)),
    )


def _outcome(folder: Path, ended: SweepOutcome) -> NightOutcome:
    state = "failed" if ended.state is SweepState.ERROR else ended.state.value
    reason = ended.reason if ended.left.safe else f"{ended.reason}; {ended.left}"
    status = ended.left.exit_status(
        {SweepState.COMPLETE: 0, SweepState.FAILED: 3}.get(ended.state, 9 if ended.partly else 1)
    )
    return NightOutcome(folder, state, reason, status)


def field_meanings(live: LiveBench) -> dict[str, FieldMeaning]:
    """Return what every decoded field of the bench's unit is: unit, and role for one of the sensors."""
    units = {name: field.unit for frame in live.bench.frames.frames.values() for name, field in frame.fields.items()}
    meanings = {name: FieldMeaning(unit) for name, unit in units.items()}
    for number, channels in live.devices.imu.sensors.items():
        thermometer = {} if channels.temperature is None else {"": channels.temperature}
        roles = {"rate": channels.rates, "acceleration": channels.accelerations, "temperature": thermometer}
        for role, fields in roles.items():
            meanings |= {of: FieldMeaning(units.get(of, ""), role, number, name) for name, of in fields.items()}
    return meanings


def versions() -> dict[str, str]:
    """Return the versions of what a result may depend on."""
    libraries = {name: version(name) for name in ("hil", "numpy", "scipy", "pyarrow")}
    return {**libraries, "python": platform.python_version(), "sqlite": sqlite3.sqlite_version}
