"""The `hil` application: its commands, gathered."""

import logging
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any

import typer
from typer import Option
from typer.core import TyperGroup

from hil.cli import archive, chamber, coefficients, data, model, night, recordings, start, watchdog
from hil.cli import requests as beside
from hil.cli.exit_status import OPTIONS, run_to_exit, with_status
from hil.cli.output import always_writable, flushed
from hil.errors import InputError

GROUPS = {
    "To begin with": "init docs",
    "Before a night": "plan check visibility design budget",
    "A night": "demo run status dashboard pause continue confirm abort resume watchdog notify",
    "Its results": "report solve reconcile fleet twin scatter thermal allan plot export verify repair replay",
    "A unit": "certificate archive units history",
    "Tables and the catalogue": "import audit reproduce effects",
    "Devices": "simulate chamber decode frames",
}
"""Under which title `hil --help` has which commands, in the order in which they are needed; there are no others."""
_ROOMS = (night, data, archive, model, recordings, beside, watchdog, coefficients, start, chamber)
_BELOW: Mapping[str, Sequence[Callable[..., Any]]] = {
    "frames": (recordings.check, recordings.guess),
    "import": (recordings.table, recordings.log),
    "plot": (data.series, data.temperatures, data.parameters),
}
"""Commands that have commands of their own, and which."""


class Grouped(TyperGroup):
    """The commands by what they are for, not by where they were written."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a list of commands for each group."""
        wide = max(map(len, self.list_commands(ctx)))
        for title, names in GROUPS.items():
            with formatter.section(title):
                about = ((name, self.commands[name]) for name in names.split())
                space = formatter.width - wide - 6
                formatter.write_dl([(name.ljust(wide), own.get_short_help_str(space)) for name, own in about])


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"hil {version('hil')}")
        raise typer.Exit


app = typer.Typer(
    name="hil",
    cls=Grouped,
    help="Run a gyro self-calibration bench by itself: chamber, collects, matrix solution, report.",
    epilog="Exit status: 0 done, 1 failed or aborted, 2 bad input, 3 stopped with the bench safe, 4 incomplete, "
    "5 the chamber is NOT SAFE, 6 whether it is safe is NOT KNOWN; with --strict 7 out of spec, 8 nobody can tell; "
    "9 complete for some of several units.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

for name in " ".join(GROUPS.values()).split():
    if name in _BELOW:
        group = recordings.TableUnlessSaid if name == "import" else None
        below = typer.Typer(name=name, cls=group, help=OPTIONS[name], no_args_is_help=True, rich_markup_mode=None)
        for own in _BELOW[name]:
            below.command()(with_status(f"{name} {own.__name__}", own))
        app.add_typer(below)
    else:  # an argument of chamber such as -20 is a temperature, not an option that nobody knows
        own = next(vars(room)[each] for each in (name, f"{name}_") for room in _ROOMS if each in vars(room))
        app.command(name, context_settings={"ignore_unknown_options": name == "chamber"})(with_status(name, own))


@app.callback()
def _options(
    asked: Annotated[
        bool, Option("--version", callback=_version, is_eager=True, help="Say which version this is.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; every way out has its exit status."""
    always_writable()
    status = run(sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # what has ended keeps its status; the interpreter takes a while to go
    flushed()
    sys.exit(status)


def run(arguments: Sequence[str]) -> int:
    """Carry out one command and return its exit status."""

    def carried_out() -> None:
        for each in arguments:
            if each.encode(errors="replace").decode() != each:
                raise InputError(f"{each}: the name is not UTF-8 text, as records are; give it another")
        logging.getLogger("matplotlib").setLevel(logging.ERROR)  # a service's user has no folder for its cache
        _command()(args=list(arguments), prog_name="hil")

    return run_to_exit(carried_out)


@cache
def _command() -> Any:
    """Return the commands as they are read, made once: that takes longer than most of them."""
    return typer.main.get_command(app)
