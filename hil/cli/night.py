"""Commands that carry out a night: check, plan, run, resume, status, verify, repair, demo."""

from __future__ import annotations

import re
import shutil
import sqlite3
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.clock import SystemClock
from drivers.given_file import check_folder
from drivers.strict_yaml import parse_yaml
from hil.cli.answer import Answer
from hil.cli.ask import TerminalQuestions, ask_words, must_agree
from hil.cli.check import check as check
from hil.cli.check import look_first
from hil.cli.exit_status import Exit, of_unit
from hil.cli.output import messages, print_json, results, warn
from hil.cli.progress import TerminalProgress, onlooker
from hil.cli.watchdog import WatchdogBeside
from hil.errors import InputError
from procedures.progress import Progress
from procedures.words import hours_minutes, step_in_words

if TYPE_CHECKING:
    from hil.config import Bench, Sweep
    from hil.night import NightOutcome

_DEMO = "hil demo"  # who carried a night out that another demo may replace
_OF_A_DEMO = ("journal", "blocks", "configuration", "controller", "heartbeat", "live", "log", "report")
"""What stands in a demo's folder, by the beginning of its name: the night's own files and the page."""
_LONGEST_SERIALS = 60  # characters of a folder's name


def plan(sweep: str, bench: str) -> Answer:
    """Show every step and when it would happen. Nothing moves."""
    from hil.config import load_bench
    from hil.config.sweep import cautions, check_sweep_against_bench, load_sweep, planned

    asked, on = load_sweep(sweep), load_bench(bench)
    check_sweep_against_bench(asked, on)
    warn(cautions(asked, on))
    steps, words = planned(asked, on), (hours_minutes, step_in_words)
    document = {
        "schema": "hil.plan/1",
        "title": steps.title,
        "simulated": on.simulated,
        "total_s": steps.total_s,
        "self_calibrations": len(steps.self_calibrations),
        "steps": [{**vars(step), "kind": step.kind.value, "parameters": dict(step.parameters)} for step in steps.steps],
    }
    return Answer(document, {"bench": on.name, "steps": steps.steps, **{each.__name__: each for each in words}})


def run(
    sweep: str,
    bench: str,
    out: str = "night-{serial}-{date}",
    serial: str | None = None,
    operator: str = "",
    note: str = "",
    despite: str = "",
    yes: bool = False,
    quiet: bool = False,
    speed: float | None = None,
    watchdog: bool = True,
) -> int:
    """Carry out a sweep, once hil check finds nothing wrong. Ctrl-C brings the chamber to its safe state."""
    from hil.bench.assemble import clock_of
    from hil.config import load_bench
    from hil.config.sweep import load_sweep, planned
    from hil.night import Remarks
    from hil.records.reader import refuse_existing

    asked, on = load_sweep(sweep), load_bench(bench)
    on = _of_unit(on, serial, out, attended=not yes and sys.stdin.isatty())
    shown = re.sub(r"[^\w.+-]+", "-", "-".join(list(on.units) or [on.unit.serial]))[:_LONGEST_SERIALS]
    folder = Path(out.replace("{date}", f"{SystemClock().utc():%Y-%m-%d}").replace("{serial}", shown))
    refuse_existing(folder)
    clock_of(on, speed=speed)
    wrong = look_first(asked, on, folder, despite)
    if not on.simulated and not yes:
        steps = planned(asked, on)
        messages().print(f"{on.name}: the chamber and the unit will move for {hours_minutes(steps.total_s)}.")
        must_agree("Begin?", "not begun")
    told = {"who": operator, "remarks": Remarks(note, wrong, despite), "speed": speed}
    return _end(_start(asked, on, folder, quiet=quiet, watchdog=watchdog, **told))


def _of_unit(bench: Bench, serial: str | None, out: str, *, attended: bool) -> Bench:
    """Return the bench with the unit whose serial number somebody gave; ask for it where the folder is named by it."""
    from hil.config.unit import ASK

    named, typed = "{serial}" in out, bench.asks_serial
    if serial is None and bench.unit.serial in ("", ASK) and (named or typed):
        if not attended:
            instead = "" if typed else ", or an --out without {serial}"
            raise InputError(f"{bench.source}: unit.serial: not known, and nobody can be asked; give --serial{instead}")
        if named or bench.clock == "virtual":
            serial = ask_words("Type or scan the serial number of the unit")
    return bench if serial is None else bench.of_unit(serial)


def resume(
    folder: Path,
    serial: str | None = None,
    operator: str = "",
    note: str = "",
    despite: str = "",
    quiet: bool = False,
    speed: float | None = None,
    watchdog: bool = True,
) -> int:
    """Carry on with a night that was interrupted: done steps stay, the soak starts over."""
    from hil.config.recorded import configuration_of
    from hil.files.lock import living_owner
    from hil.night import Remarks, resume_night
    from hil.records import reading
    from hil.records.units import refuse_unit

    refuse_unit(folder)
    with reading(folder) as journal, tempfile.TemporaryDirectory(prefix="hil-") as files:
        on, asked = configuration_of(journal.night.configuration, Path(files))
        done, owner = journal.completed().keys(), living_owner(folder)
        on = on if serial is None else on.of_unit(serial)
        left = len(done) < len(journal.plan.steps) and not journal.found and owner is None
        wrong = look_first(asked, on, folder, despite, done) if left else []
    remarks, who = Remarks(note, wrong, despite, serial or ""), operator or None
    with _watching(folder, on, quiet=quiet, watchdog=watchdog) as onlookers:
        told = TerminalQuestions()
        ended = resume_night(folder, who=who, onlookers=onlookers, terminal=told, speed=speed, remarks=remarks)
    return _end(ended)


def _start(
    sweep: Sweep, bench: Bench, out: Path, *, quiet: bool, watchdog: bool = True, **options: Any
) -> NightOutcome:
    from hil.night import start_night

    with _watching(out, bench, quiet=quiet, watchdog=watchdog) as onlookers:
        return start_night(out, sweep, bench, onlookers=onlookers, terminal=TerminalQuestions(), **options)


def _end(ended: NightOutcome) -> int:
    from hil.cli.watch import look_at

    with suppress(OSError, InputError, sqlite3.Error):  # a closed terminal, a full disk; the journal says what it can
        messages().print(f"{ended.folder}: {ended.state}: {ended.reason}")
        status = look_at(ended.folder)[0]
        if judged := status["verdict"]:
            messages().print(f"{judged['verdict']}: {judged['reason']}")
        if unit := status["in_spec"]:
            messages().print(f"{unit['verdict'].upper()}: {unit['reason']}")
        messages().print(f"{status['chamber_in_words']}\nto do: {status['to_do']}".strip())
    return ended.exit_status


@contextmanager
def _watching(folder: Path, bench: Bench, *, quiet: bool, watchdog: bool) -> Iterator[list[Progress]]:
    from hil.config.ports import SIMULATED_SCHEME

    progress = onlooker(messages(), quiet=quiet, simulated=bench.simulated)
    beside = [WatchdogBeside(folder)] if watchdog and not bench.chamber.port.startswith(SIMULATED_SCHEME) else []
    try:
        yield [progress, *beside]
    finally:
        if isinstance(progress, TerminalProgress):
            with suppress(OSError):
                progress.close()


def status(folder: Path, as_json: bool = False, watch: bool = False, strict: bool = False) -> int:
    """Say what a night is doing, or what became of it; also while it runs, from another shell."""
    from hil.cli.watch import look_at, say
    from hil.cli.watch import watch as keep_looking

    if watch and as_json:
        raise InputError("--watch is for people, --json for programs: give one of them")
    if watch:
        keep_looking(folder, results())
    document, now = look_at(folder)
    if as_json:
        print_json(document)
    else:
        say(folder, document, now, results())
    well = document["state"] in {"complete", "running", "paused"} and not document["problems"]
    well = well and (document["verdict"] or {}).get("verdict") != "ERROR"
    return of_unit(document["in_spec"], strict) if well else Exit.INCOMPLETE


def verify(folder: Path, key: Path | None = None) -> Answer:
    """Check a night's records: every step, every block, every hash."""
    from hil.records.status import in_brief
    from hil.records.verify import MISSING, verify_night

    document = verify_night(folder, key)
    problems, whole = document["problems"], document["complete"] and not document["problems"]
    lacking = in_brief([each.removeprefix(MISSING) for each in problems if each.startswith(MISSING)])
    wrong = [each for each in problems if not each.startswith(MISSING)]
    beside = {"folder": folder, "wrong": wrong, "lacking": lacking}
    return Answer(document, beside, status=Exit.DONE if whole else Exit.INCOMPLETE)


def repair(folder: Path, out: Path) -> Answer:
    """Bring what is proven of a damaged night into a new folder, and say what is lost. The old one is not touched."""
    from hil.night.repair import repair_night
    from hil.records.requests import who_asks

    document = repair_night(folder, out, who_asks())
    return Answer(document, status=Exit.INCOMPLETE if document["lost"] else Exit.DONE)


def demo(out: Path = Path("demo"), quiet: bool = False) -> int:
    """Carry out the published sweep of RD-GC-86-1 on the simulated bench, to a report."""
    from hil.cli.data import write_report
    from hil.config import load_bench, load_sweep

    sweep, bench = load_sweep("rd-gc-86-1"), load_bench("simulated")
    if out.exists():
        check_folder(out)
        if any(out.iterdir()):
            refuse_but_demo(out, sweep)
    look_first(sweep, bench, out, "")
    if out.exists():
        shutil.rmtree(out)
    ended = _end(_start(sweep, bench, out, quiet=quiet, who=_DEMO))
    if ended == Exit.DONE:
        results().print(f"report: {write_report(out)[0].resolve()}")
    return ended


def refuse_but_demo(folder: Path, sweep: Sweep) -> None:
    """Raise `InputError` where a folder holds anything but a simulated night of that sweep, as a demo leaves it."""
    from hil.config.recorded import understood
    from hil.records import open_readonly
    from hil.records.reader import is_night

    lost = ""
    if not is_night(folder):
        lost = "something else"
    elif strays := sorted(each.name for each in folder.iterdir() if each.name.split(".")[0] not in _OF_A_DEMO):
        lost = f"{strays[0]} beside a night"
    else:
        with open_readonly(folder) as journal:
            night, own = journal.night, parse_yaml(sweep.text, sweep.source)
        if night.who != _DEMO:
            lost = f"the night {night.title!r} that {night.who} carried out"
        elif not night.simulated or understood(night.configuration).get("sweep") != own:
            lost = f"the night {night.title!r} of another sweep, or measured"
    if lost:
        raise InputError(f"{folder}: exists and holds {lost}, which would be lost; give another folder with --out")
