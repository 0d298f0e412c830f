"""Commands beside a night, from another shell: pause, continue, abort, confirm; dashboard; notify."""

from contextlib import suppress
from pathlib import Path

from drivers.given_file import check_folder
from hil.cli.answer import Answer
from hil.cli.exit_status import Exit
from hil.cli.output import messages, results
from hil.errors import InputError
from procedures.requests import RequestKind

_WAIT_S = 20.0


def pause(folder: Path, why: str, wait: float = _WAIT_S) -> Answer:
    """Hold a running night where it is. A collect in progress is finished first; a soak starts over afterwards."""
    return _ask(folder, RequestKind.PAUSE, why, wait)


def continue_(folder: Path, why: str = "", wait: float = _WAIT_S) -> Answer:
    """Let a paused night go on. Devices and position are checked again; the soak counts on if the band was held."""
    return _ask(folder, RequestKind.CONTINUE, why, wait)


def abort(folder: Path, why: str, wait: float = _WAIT_S) -> Answer:
    """End a running night: the chamber is brought to its safe state. `hil resume` carries on."""
    return _ask(folder, RequestKind.ABORT, why, wait)


def confirm(folder: Path, no: bool = False, text: str = "", why: str = "", wait: float = _WAIT_S) -> Answer:
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
    status = {None: Exit.INCOMPLETE, True: Exit.DONE, False: Exit.FAILED}[row.accepted]
    return Answer(document, {"folder": folder, "wait_s": wait_s, "question": question}, status=status)


def dashboard(
    folder: Path, host: str = "127.0.0.1", port: int = 8765, token_file: Path | None = None, archive: Path | None = None
) -> None:
    """Show running and finished nights on a live page in the browser, until Ctrl-C. Nights go on without it."""
    from asyncio import CancelledError

    from hil.dashboard.access import Access, is_loopback, new_token, token_from, url
    from hil.dashboard.server import create_app, listen, server
    from hil.dashboard.watcher import Watcher

    check_folder(folder)
    access = Access(token_from(token_file) if token_file else new_token(), host)
    if token_file and token_file.stat().st_mode & 0o077:
        messages().print(f"note: others of this machine may read {token_file}; chmod 600 {token_file}")
    watcher = Watcher(folder, archive=archive)
    if not watcher.journals():
        messages().print(f"note: there is no night in {folder} yet; one that begins appears on the page by itself")
    with suppress(KeyboardInterrupt, CancelledError), listen(host, port) as listener:  # by when Ctrl-C is pressed
        results().print(url(host, listener.getsockname()[1]))
        what = "pausing, continuing, aborting and answering"
        if not is_loopback(host):
            what = f"reading, {what}"
            messages().print("note: what goes over the network is not encrypted; see hil docs live-page")
        results().print(f"token for {what}: {f'in {token_file}' if token_file else access.token}")
        server(create_app(watcher, access)).run(sockets=[listener])


def notify(bench: str, text: str = "a trial message; nothing has happened") -> int:
    """Send a trial message to everybody whom the nights of a bench would tell; say who could not be reached."""
    from hil.config import load_bench
    from hil.night.notify import Notifier

    on = load_bench(bench)
    if on.notify is None:
        raise InputError(f"{on.source}: has no notify section, so nobody would be told")
    failures: list[str] = []
    everything = on.notify.model_copy(update={"about": ("trial",)})
    notifier = Notifier(everything, on.name, failures.append, attempts=1)
    notifier.tell("trial", text)
    notifier.close()
    for failure in failures:
        results().print(f"NOT told: {failure}")
    if not failures:
        results().print(f"told: {', '.join(on.notify.to)}")
    return Exit.FAILED if failures else Exit.DONE
