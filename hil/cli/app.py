"""The `hil` application: its commands, gathered."""

from __future__ import annotations

import sys

import click
import typer

from hil.cli import data, device, night
from hil.cli.ending import Exit, run_to_exit

app = typer.Typer(
    name="hil",
    help="Run a gyro self-calibration bench by itself: chamber, collects, matrix solution, report.",
    epilog="Exit status: 0 done, 1 failed or aborted, 2 bad input, 3 stopped with the bench safe, 4 incomplete.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

for module in (night, data, device):
    module.add_to(app)


def main() -> None:
    """Run the command line; every way out has its exit status."""
    sys.exit(run_to_exit(_run))


def _run() -> int:
    try:
        status = app(standalone_mode=False)
    except click.exceptions.Exit as ending:
        return ending.exit_code
    except click.Abort:
        raise KeyboardInterrupt from None
    except click.ClickException as usage:
        usage.show()
        return Exit.BAD_INPUT
    return int(status or Exit.DONE)
