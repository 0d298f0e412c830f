"""`hil status`: a night from another shell, once or, with `--watch`, until it ends."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live

from drivers.clock import Clock, SystemClock
from hil.cli.progress import panel, rows
from hil.errors import Damaged
from hil.records import reading
from hil.records.damage import refuse_damaged_samples
from hil.records.live import snapshot_of
from hil.records.status import WORKING, in_brief, night_status, recorded_verdict, without_samples
from hil.records.troubles import to_do
from procedures.progress import Snapshot
from procedures.words import first_few

Show = Callable[[Path, dict[str, Any], Snapshot | None], None]
EVERY_S = 1.0
_MOST_LEFT = 6
_HEAD, _TAIL = 170, 50  # of a long line
_PHRASES = re.compile(r"(?<=[;:,])\s|\s(?=\()")  # what parts them
_WORTH_SAYING_ONCE = 30  # characters


def watch(folder: Path, console: Console, clock: Clock | None = None) -> None:
    """Show a night until it ends, or until Ctrl-C. Raises `InputError` where the folder holds none."""
    clock = clock or SystemClock()
    drawn = console.is_terminal and not console.is_dumb_terminal
    with suppress(KeyboardInterrupt), _panel(console) if drawn else _lines(console) as show:
        while True:
            status, now = look_at(folder)
            show(folder, status, now)
            if status["state"] not in WORKING:
                return
            clock.sleep(EVERY_S)


def look_at(folder: Path) -> tuple[dict[str, Any], Snapshot | None]:
    """Return hil.status/1 of a night, with its verdict where it has ended, and what its controller shows now, if any.

    Raises `InputError` where the folder holds no night.
    """
    status, verdict = night_status(folder), None
    if status["state"] not in WORKING:
        try:
            with reading(folder) as journal:
                refuse_damaged_samples(journal)
                verdict = recorded_verdict(journal)
        except Damaged as damage:
            status, verdict = without_samples(status), {"verdict": "ERROR", "reason": str(damage)}
    status |= {"verdict": verdict, "judgement": verdict}
    status["to_do"] = to_do(folder, status)
    if status["now"] is None:
        return status, None
    with reading(folder) as journal:
        return status, snapshot_of(status["now"], journal.steps_by_key())


def say(folder: Path, status: dict[str, Any], now: Snapshot | None, console: Console) -> None:
    """Print once how it stands, then what to do: a chamber that is not safe before all else, and nothing twice."""
    from hil.cli.told import lines_of  # a program that reads JSON waits for no template

    verdict, said = status["verdict"], list[str]()
    mark = "  SIMULATED" if status["simulated"] else ""
    working, judged = status["state"] in WORKING, f", {verdict['verdict']}" if verdict else ""

    def alarm(word: str, text: str, short: Callable[[str], str] = _cut) -> None:
        if text:
            console.print(short(f"{word}: {_without(said, text)}"), style="bold red")
            said.extend(text.split("; "))

    danger = [line for line in status["problems"] if "THE CHAMBER" in line]
    for line in danger:
        alarm(str(folder), line)
    stands = [f"{folder}: {status['state']}{judged}{mark}", f"to do: {status['to_do']}"]
    for line in reversed(stands) if danger else stands:
        console.print(line, style="bold")
    if not danger and status["chamber_in_words"]:
        console.print(_cut(status["chamber_in_words"]))
    for line in status["problems"]:
        alarm("PROBLEM", "" if line in danger else line)
    alarm("OLD", status["old"])
    alarm(status["state"], "" if working or status["state"] == "complete" else status["reason"])
    # Why a night is not judged that is not whole, its state has said.
    if verdict and verdict["verdict"] != "PASS" and (status["state"] == "complete" or verdict["verdict"] == "ERROR"):
        alarm(verdict["verdict"], verdict["reason"], _first)
    if unit := status["in_spec"]:
        console.print(_first(f"{unit['verdict'].upper()}: {unit['reason']}"), style="bold")
    known: dict[str, Any] = {"folder": folder, "now": now, "working": working, "asked": _asked(status), "rows": rows}
    known |= {"cut": _cut, "without": partial(_without, said), "time": datetime.fromisoformat}
    for line in filter(None, lines_of(status, known | {"missing": first_few(in_brief(status["missing"]), _MOST_LEFT)})):
        console.print(line)


@contextmanager
def _panel(console: Console) -> Iterator[Show]:
    """Draw in place, on a screen of its own: what was on the terminal comes back afterwards."""
    with Live(console=console, screen=True, auto_refresh=False) as live:

        def show(folder: Path, status: dict[str, Any], now: Snapshot | None) -> None:
            head = f"{folder}: {status['title']}: {status['state']}"
            live.update(panel(head, now, _trouble(status), simulated=status["simulated"]), refresh=True)

        yield show


@contextmanager
def _lines(console: Console) -> Iterator[Show]:
    """Print a line with the time for every change of state or step."""
    last = ""

    def show(folder: Path, status: dict[str, Any], now: Snapshot | None) -> None:  # noqa: ARG001 - one signature
        nonlocal last
        mark = " SIMULATED" if status["simulated"] else ""
        trouble = _trouble(status).replace("\n", "; ")
        parts = (f"{status['state']}{mark}", status["step_in_words"], status["reason"], trouble)
        line = ": ".join(part for part in parts if part)
        if line != last:
            at = datetime.fromisoformat(status["last_utc"])
            done = f"{status['steps_done']}/{status['steps_total']}"
            console.print(f"{at:%Y-%m-%dT%H:%M:%SZ}  {done:>7}  {line}", soft_wrap=True)
            console.file.flush()
            last = line

    yield show


def _trouble(status: dict[str, Any]) -> str:
    """Return what must be seen first: what is wrong, data that are old, a question, and what to do."""
    lines = [*map(_cut, status["problems"]), *filter(None, [status["old"]]), *_asked(status)]
    return "\n".join([*lines, f"to do: {status['to_do']}"] if lines or status["state"] == "paused" else [])


def _without(said: list[str], text: str) -> str:
    for each in said:
        text = text.replace(each, "…") if len(each) > _WORTH_SAYING_ONCE else text
    return text


def _cut(line: str) -> str:
    """Return what can be read at a glance, in whole phrases: how it begins and how it ends; a device's are between."""
    first, *phrases = _PHRASES.split(line)
    while phrases and len(first) + len(phrases[0]) < _HEAD:
        first += f" {phrases.pop(0)}"
    last = ""
    while phrases and len(last) + len(phrases[-1]) < _TAIL:
        last = f" {phrases.pop()}{last}"
    return f"{first} …{last}" if phrases else f"{first}{last}"


def _first(line: str) -> str:
    """Return the first causes of a line, each whole, and how many more there are."""
    causes = line.split("; ")
    fit = sum(len("; ".join(causes[:number])) < _HEAD for number in range(len(causes)))
    shown, left = first_few(causes, fit)
    return "; ".join(shown) + f"; and {left} more (hil report says all)" * bool(left)


def _asked(status: dict[str, Any]) -> list[str]:
    prompt, paused = status["prompt"], status["paused"]
    return [f"ASKS: {prompt['question']}"] if prompt else [f"paused by {paused['by']}"] if paused else []
