"""`hil rehearse`: nights with random faults on a simulated bench, and what was survived."""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli.exit_status import Exit
from hil.cli.night import BenchName, SweepName
from hil.cli.output import JsonFlag, messages, print_json, results
from hil.errors import InputError

if TYPE_CHECKING:
    from hil.night.rehearse import Rehearsal

SCHEMA = "hil.rehearsal/1"


def rehearse(
    sweep: SweepName,
    bench: BenchName,
    nights: Annotated[int, typer.Option("--nights", min=1, help="How many nights.")] = 1,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the first night; the next has the next.")] = 1,
    faults: Annotated[
        str, typer.Option("--faults", help="How many random faults a night has, beside the bench file's own.")
    ] = "1-5",
    keep: Annotated[
        Path | None,
        typer.Option(
            "--keep", help="Where nights that were not survived are kept, to be looked at.", show_default=False
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Carry out nights with random faults on a simulated bench, and say what was survived.

    A night is survived when it ends complete, or incomplete for a true reason; with a safe chamber and sound records;
    and with no wrong number called PASS. Exit status 1 where one was not.
    """
    from hil.config import load_bench, load_sweep
    from hil.night.rehearse import rehearse as rehearsals

    count = _count(faults)
    asked, on = load_sweep(sweep), load_bench(bench)
    done: list[Rehearsal] = []
    with tempfile.TemporaryDirectory(prefix="hil-rehearse-") as scratch:
        for night in rehearsals(asked, on, nights=nights, seed=seed, folder=keep or Path(scratch), faults=count):
            done.append(night)
            if not as_json:
                _show(night)
    survived = sum(night.survived for night in done)
    if as_json:
        print_json(_document(done))
    else:
        ends = ", ".join(f"{number} {state}" for state, number in Counter(night.state for night in done).items())
        results().print(f"SIMULATED: {survived} of {len(done)} nights survived ({ends})")
    if survived < len(done) and keep is not None:
        messages().print(f"the nights that were not survived are in {keep}")
    return Exit.DONE if survived == len(done) else Exit.FAILED


def _document(done: list[Rehearsal]) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "simulated": True,
        "nights": [night.document() for night in done],
        "survived": sum(night.survived for night in done),
        "states": dict(Counter(night.state for night in done)),
        "verdicts": dict(sum((Counter(night.verdicts) for night in done), Counter())),
    }


def _show(night: Rehearsal) -> None:
    console = results()
    mark = "survived" if night.survived else "NOT survived"
    console.print(f"{mark}: seed {night.seed}: {night.state}: {night.reason}")
    for fault in night.faults:
        console.print(f"    {fault}: {fault.meaning.means}")
    for what in night.wrong:
        console.print(f"    WRONG: {what}")


def _count(text: str) -> tuple[int, int]:
    low, _, high = text.partition("-")
    if not (low.isdecimal() and (high or low).isdecimal()) or int(low) > int(high or low):
        raise InputError(f"--faults {text}: write how many a night has, such as 3 or 1-5")
    return int(low), int(high or low)


COMMANDS = (rehearse,)
