"""Commands that carry out a night: check, plan, run, resume, status, verify, repair, demo."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from drivers.clock import SystemClock
from hil.cli.ask import TerminalQuestions
from hil.cli.exit_status import Exit
from hil.cli.output import Folder, JsonFlag, messages, print_json, results, warn
from hil.cli.progress import TerminalProgress, onlooker
from hil.cli.watchdog import WatchdogBeside
from hil.errors import InputError
from procedures.progress import Audience, Progress
from procedures.words import hours_minutes, step_in_words

if TYPE_CHECKING:
    from hil.config import Bench, Sweep
    from hil.night import NightOutcome

SweepName = Annotated[str, typer.Argument(help="A sweep file, or the name of one that ships.", show_default=False)]
BenchName = Annotated[
    str, typer.Option("--bench", help="A bench file, or the name of one that ships.", show_default=False)
]
Speed = Annotated[
    float | None,
    typer.Option("--speed", help="Simulation only: so many times real time, to watch it.", show_default=False),
]
WithWatchdog = Annotated[
    bool, typer.Option(help="A second process that makes a real chamber safe if this one dies.", show_default=True)
]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress; only how it ended.")]


def plan(sweep: SweepName, bench: BenchName, as_json: JsonFlag = False) -> None:
    """Show every step and when it would happen. Nothing moves."""
    from hil.config import cautions, check_sweep_against_bench, load_bench, load_sweep
    from hil.night.plan_document import plan_document
    from procedures.plan import make_plan

    asked, on = load_sweep(sweep), load_bench(bench)
    check_sweep_against_bench(asked, on)
    warn(cautions(asked, on))
    steps = make_plan(asked.procedure())
    if as_json:
        print_json(plan_document(steps, simulated=on.simulated))
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading, justify in (("begins", "right"), ("lasts", "right"), ("step", "left")):
        table.add_column(heading, justify=justify)  # type: ignore[arg-type]
    for step in steps.steps:
        table.add_row(hours_minutes(step.starts_s), hours_minutes(step.duration_s), step_in_words(step))
    console = results()
    console.print(f"{steps.title} on {on.name}{'  SIMULATED' if on.simulated else ''}")
    console.print(table)
    console.print(
        f"{len(steps.steps)} steps, {len(steps.self_calibrations)} self-calibrations, {hours_minutes(steps.total_s)}; "
        "a soak that needs longer moves everything behind it"
    )


def check(
    target: Annotated[
        str,
        typer.Argument(metavar="BENCH", help="A bench; with --bench, the sweep.", show_default=False),
    ],
    bench: Annotated[
        str | None, typer.Option("--bench", help="The bench, where the argument is the sweep.", show_default=False)
    ] = None,
    sweep: Annotated[
        str | None, typer.Option("--sweep", help="What is to be run: a sweep file, or a name.", show_default=False)
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Look before anything moves: ports, identity, frames, chamber, limits, disk, clock, end; and what to do.

    `hil check BENCH`, `hil check BENCH --sweep SWEEP` and `hil check SWEEP --bench BENCH` are the three forms.
    """
    from hil.bench.preflight import check_document, preflight
    from hil.config import check_sweep_against_bench

    asked, on = _bench_and_sweep(target, bench, sweep)
    if asked is not None:
        check_sweep_against_bench(asked, on)
    found = preflight(asked, on, Path.cwd())
    if as_json:
        print_json(check_document(found, simulated=on.simulated))
    else:
        console = results()
        console.print(f"{on.name}{'  SIMULATED' if on.simulated else ''}")
        for finding in found.findings:
            console.print(f"{'ok  ' if finding.good else 'NOT '} {finding.subject}: {finding.message}")
            if finding.advice:
                console.print(f"     {'note' if finding.good else 'TO DO'}: {finding.advice}")
    if found.missing_ports:
        raise InputError(f"{on.source or on.name}: {'; '.join(found.missing_ports)}: there is no such port here")
    return Exit.DONE if found.good else Exit.STOPPED_SAFE


def _bench_and_sweep(target: str, bench: str | None, sweep: str | None) -> tuple[Sweep | None, Bench]:
    """Read what `hil check` was given, in whichever of its forms."""
    from hil.config import load_bench, load_sweep

    if bench is not None:
        if sweep is not None:
            raise InputError(
                f"{target} cannot be a third: write hil check BENCH --sweep SWEEP, or hil check SWEEP --bench BENCH"
            )
        return load_sweep(target), load_bench(bench)
    try:
        on = load_bench(target)
    except InputError as error:
        if not _is_sweep(target):
            raise
        raise InputError(
            f"{target} is a sweep, not a bench; write hil check BENCH --sweep {target}, or hil check {target} "
            "--bench BENCH"
        ) from error
    return (None if sweep is None else load_sweep(sweep)), on


def _is_sweep(name: str) -> bool:
    from hil.config import load_sweep

    try:
        load_sweep(name)
    except InputError:
        return False
    return True


def run(
    sweep: SweepName,
    bench: BenchName,
    out: Annotated[
        Path,
        typer.Option(
            "--out", help="The night's folder; must not exist yet. {date} stands for today's (UTC).", show_default=False
        ),
    ],
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before hardware moves.")] = False,
    quiet: Quiet = False,
    speed: Speed = None,
    watchdog: WithWatchdog = True,
) -> int:
    """Carry out a sweep. Ctrl-C brings the chamber to its safe state; `hil resume` carries on."""
    from hil.config import cautions, check_sweep_against_bench, load_bench, load_sweep
    from procedures.plan import make_plan

    asked, on = load_sweep(sweep), load_bench(bench)
    out = Path(str(out).replace("{date}", f"{SystemClock().utc():%Y-%m-%d}"))
    check_sweep_against_bench(asked, on)
    warn(cautions(asked, on))
    if not on.simulated and not yes:
        steps = make_plan(asked.procedure())
        messages().print(f"{on.name}: the chamber and the unit will move for {hours_minutes(steps.total_s)}.")
        if not _confirmed():
            raise InputError("not begun: answer yes, or give --yes where nobody can be asked")
    return _end(_start(asked, on, out, quiet=quiet, speed=speed, watchdog=watchdog))


def _confirmed() -> bool:
    try:
        return typer.confirm("Begin?", err=True)
    except typer.Abort:
        return False


def resume(folder: Folder, quiet: Quiet = False, speed: Speed = None, watchdog: WithWatchdog = True) -> int:
    """Carry on with a night that was interrupted: done steps stay, the soak starts over."""
    from hil.config.recorded import bench_of_record
    from hil.night import resume_night
    from hil.records import reading

    with reading(folder) as journal:
        on = bench_of_record(journal.night.configuration)
    with _watching(folder, on, quiet=quiet, watchdog=watchdog) as progress:
        ended = resume_night(folder, progress=progress, terminal=TerminalQuestions(), speed=speed)
    return _end(ended)


def _start(
    sweep: Sweep, bench: Bench, out: Path, *, quiet: bool, speed: float | None = None, watchdog: bool = True
) -> NightOutcome:
    from hil.night import start_night

    with _watching(out, bench, quiet=quiet, watchdog=watchdog) as progress:
        return start_night(out, sweep, bench, progress=progress, terminal=TerminalQuestions(), speed=speed)


def _end(ended: NightOutcome) -> int:
    with suppress(OSError):  # the terminal was closed; the journal says it
        messages().print(f"{ended.folder}: {ended.state}: {ended.reason}")
        if ended.exit_status != Exit.DONE:
            messages().print(f"to carry on: hil resume {ended.folder}")
    return ended.exit_status


@contextmanager
def _watching(folder: Path, bench: Bench, *, quiet: bool, watchdog: bool) -> Iterator[Progress]:
    """Give the onlookers of a night: the terminal, and a watchdog beside the controller of a real chamber."""
    from hil.config.ports import SIMULATED_SCHEME

    progress = onlooker(messages(), quiet=quiet, simulated=bench.simulated)
    beside = [WatchdogBeside(folder)] if watchdog and not bench.chamber.port.startswith(SIMULATED_SCHEME) else []
    try:
        yield Audience([progress, *beside], lost=_passed_on)
    finally:
        if isinstance(progress, TerminalProgress):
            with suppress(OSError):
                progress.close()


def _passed_on(error: Exception) -> None:
    raise error  # the night records it, and shows nothing any more


def status(
    folder: Folder,
    as_json: JsonFlag = False,
    watch: Annotated[bool, typer.Option("--watch", help="Keep looking, until the night ends or Ctrl-C.")] = False,
) -> int:
    """Say what a night is doing, or what became of it; also while it runs, from another shell."""
    from hil.cli.watch import watch as keep_looking
    from hil.records.status import night_status

    if watch and as_json:
        raise InputError("--watch is for people, --json for programs: give one of them")
    if watch:
        keep_looking(folder, results())
    document = night_status(folder)
    if as_json:
        print_json(document)
    else:
        console = results()
        mark = "  SIMULATED" if document["simulated"] else ""
        console.print(f"{folder}: {document['state']}{mark}")
        console.print(f"{document['steps_done']} of {document['steps_total']} steps")
        done, total = document["self_calibrations_done"], document["self_calibrations_total"]
        console.print(f"{done} of {total} self-calibrations")
        if document["reason"]:
            console.print(f"reason: {document['reason']}")
        if document.get("prompt"):
            console.print(f"ASKS: {document['prompt']['question']} (hil confirm {folder}, or --no)")
        working = document["state"] in {"running", "paused"}
        if working and document["eta_utc"]:
            console.print(f"expected end {datetime.fromisoformat(document['eta_utc']):%Y-%m-%d %H:%M} UTC")
        for line in document["missing"]:
            console.print(f"{'to do' if working else 'missing'}: {line}")
        for line in document["problems"]:
            console.print(f"problem: {line}")
    well = document["state"] in {"complete", "running", "paused"} and not document["problems"]
    return Exit.DONE if well else Exit.INCOMPLETE


def verify(folder: Folder, as_json: JsonFlag = False) -> int:
    """Check a night's records: every step, every block, every hash."""
    from hil.records.verify import verify_night

    document = verify_night(folder)
    if as_json:
        print_json(document)
    else:
        console = results()
        for problem in document["problems"]:
            console.print(f"problem: {problem}")
        complete = "complete" if document["complete"] else "NOT complete"
        console.print(f"{folder}: {complete}, {document['blocks_checked']} blocks checked")
    return Exit.DONE if document["complete"] and not document["problems"] else Exit.INCOMPLETE


def repair(
    folder: Folder,
    out: Annotated[Path, typer.Option("--out", help="The new folder to make.", show_default=False)],
    as_json: JsonFlag = False,
) -> int:
    """Bring what is proven of a damaged night into a new folder, and say what is lost. The old one is not touched."""
    from hil.night.repair import repair_night
    from hil.records.requests import who_asks

    document = repair_night(folder, out, who_asks())
    if as_json:
        print_json(document)
    else:
        console = results()
        for what in ("restored", "lost"):
            for line in document[what]:
                console.print(f"{what}: {line}")
        console.print(f"{out}: {document['steps_done']} of {document['steps_total']} steps are proven")
    return Exit.INCOMPLETE if document["lost"] else Exit.DONE


def demo(
    out: Annotated[Path, typer.Option("--out", help="The night's folder; an earlier demo there is replaced.")] = Path(
        "demo"
    ),
    quiet: Quiet = False,
) -> int:
    """Carry out the published sweep of RD-GC-86-1 on the simulated bench, to a report."""
    from hil.cli.report import write_report
    from hil.config import load_bench, load_sweep
    from hil.records.reader import JOURNAL_NAME

    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; the night needs a folder, give another with --out")
    if out.exists() and any(out.iterdir()):
        from hil.records import open_readonly

        if not (out / JOURNAL_NAME).is_file():
            raise InputError(f"{out}: exists and holds something else; give another folder with --out")
        with open_readonly(out) as journal:
            if not journal.night.simulated:
                raise InputError(f"{out}: holds a night that was measured; give another folder with --out")
        shutil.rmtree(out)
    ended = _end(_start(load_sweep("rd-gc-86-1"), load_bench("simulated"), out, quiet=quiet))
    if ended == Exit.DONE:
        results().print(f"report: {write_report(out).resolve()}")
    return ended


COMMANDS = (demo, check, plan, run, resume, status, verify, repair)
