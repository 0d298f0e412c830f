"""`hil notify`: a trial message to everybody whom a bench's nights would tell."""

from typing import Annotated

import typer

from hil.cli.exit_status import Exit
from hil.cli.output import results
from hil.errors import InputError


def notify(
    bench: Annotated[str, typer.Argument(help="A bench file, or the name of one that ships.")],
    text: Annotated[str, typer.Option(help="What to say.")] = "a trial message; nothing has happened",
) -> int:
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


COMMANDS = (notify,)
