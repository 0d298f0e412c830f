"""The `hil` application: its commands, gathered."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import typer

from hil.cli import (
    chamber,
    coefficients,
    dashboard,
    data,
    design,
    frames,
    model,
    night,
    notify,
    plot,
    replay,
    report,
    reproduction,
    watchdog,
)
from hil.cli import requests as control
from hil.cli import simulate as device
from hil.cli.exit_status import run_to_exit, with_status
from hil.cli.output import always_writable

app = typer.Typer(
    name="hil",
    help="Run a gyro self-calibration bench by itself: chamber, collects, matrix solution, report.",
    epilog="Exit status: 0 done, 1 failed or aborted, 2 bad input, 3 stopped with the bench safe, 4 incomplete, "
    "5 the chamber is NOT SAFE, 6 whether it is safe is NOT KNOWN.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

for command in (
    *night.COMMANDS,
    *data.COMMANDS,
    *report.COMMANDS,
    *model.COMMANDS,
    *frames.COMMANDS,
    *device.COMMANDS,
    *replay.COMMANDS,
):
    app.command()(with_status(command))
for request in (*control.COMMANDS, *notify.COMMANDS, *watchdog.COMMANDS):
    app.command()(with_status(request))
app.command("continue")(with_status(control.go_on))
for analysis in (*coefficients.COMMANDS, *design.COMMANDS, *reproduction.COMMANDS):
    app.command()(with_status(analysis))
app.command("import")(with_status(data.import_table))
app.command()(with_status(dashboard.dashboard))
# An argument such as -20 is a temperature, not an option that nobody knows.
app.command(context_settings={"ignore_unknown_options": True})(with_status(chamber.chamber))
for about_frames in (frames.check, frames.guess):
    frames.frames_app.command()(with_status(about_frames))
app.add_typer(frames.frames_app)
for picture in plot.COMMANDS:
    plot.plot_app.command()(with_status(picture))
app.add_typer(plot.plot_app)


def main() -> None:
    """Run the command line; every way out has its exit status."""
    always_writable()
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Carry out one command and return its exit status."""
    return run_to_exit(lambda: app(args=list(arguments), prog_name="hil"))
