"""Commands to a night that is running, from another shell: pause, continue, abort, confirm."""

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.answer import Answer
from hil.cli.exit_status import Exit
from hil.cli.output import Folder
from hil.errors import InputError
from procedures.requests import RequestKind

Why = Annotated[str, typer.Option("--why", help="The reason, for the record.")]
Wait = Annotated[float, typer.Option("--wait", help="Seconds to wait for the controller's answer.", min=0.0)]
_WAIT_S = 20.0


def pause(folder: Folder, why: Why, wait: Wait = _WAIT_S) -> Answer:
    """Hold a running night where it is. A collect in progress is finished first; a soak starts over afterwards."""
    return _ask(folder, RequestKind.PAUSE, why, wait)


def go_on(folder: Folder, why: Why = "", wait: Wait = _WAIT_S) -> Answer:
    """Let a paused night go on. Devices and position are checked again; the soak counts on if the band was held."""
    return _ask(folder, RequestKind.CONTINUE, why, wait)


def abort(folder: Folder, why: Why, wait: Wait = _WAIT_S) -> Answer:
    """End a running night: the chamber is brought to its safe state. `hil resume` carries on."""
    return _ask(folder, RequestKind.ABORT, why, wait)


def confirm(
    folder: Folder,
    no: Annotated[bool, typer.Option("--no", help="Refuse instead.")] = False,
    text: Annotated[str, typer.Option(help="The answer, where words are asked for.")] = "",
    why: Why = "",
    wait: Wait = _WAIT_S,
) -> Answer:
    """Answer the question that a running night asks its operator (`hil status` shows it)."""
    from hil.records.requests import standing_prompt

    prompt = standing_prompt(folder)
    if prompt is None:
        raise InputError(f"{folder}: no question waits for an answer; hil status {folder} says what is going on")
    kind = RequestKind.REFUSE if no else RequestKind.CONFIRM
    return _ask(folder, kind, text or why, wait, prompt.message, int(prompt.evidence["prompt"]))


def _ask(
    folder: Path, kind: RequestKind, why: str, wait_s: float, question: str = "", prompt: int | None = None
) -> Answer:
    from hil.records.requests import request, wait_for_answer, who_asks

    number = request(folder, kind, who_asks(), why, prompt=prompt)
    row = wait_for_answer(folder, number, wait_s)
    asked = {"number": number, "kind": kind.value, "who": row.who, "why": row.why}
    document = {"schema": "hil.request/1", **asked, "accepted": row.accepted, "answer": row.answer}
    said = f"{folder}: {kind.value}: {'' if row.accepted else 'refused: '}{row.answer}"
    if row.accepted is None:
        said = (
            f"{folder}: {kind.value} is asked for, and not answered after {wait_s:g} s. It will be acted upon when the "
            f"controller next looks; if hil status {folder} shows no sign of life, hil watchdog {folder} ends it safely"
        )
    status = {None: Exit.INCOMPLETE, True: Exit.DONE, False: Exit.FAILED}[row.accepted]
    return Answer(document, lambda: [*([question] if question else []), said], status=status)


COMMANDS = (pause, abort, confirm)
