"""`hil plot`: pictures for analysis, SVG or PNG."""

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.data import Source, read_source
from hil.cli.output import results, warn

plot_app = typer.Typer(
    name="plot",
    help="Draw a collect, a night or parameters against temperature, as SVG or PNG.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Out = Annotated[Path, typer.Option("--out", help="The file to write; .svg or .png says which.")]
OfSensor = Annotated[int | None, typer.Option("--sensor", help="Which sensor, where there are several.")]


def series(
    source: Source,
    out: Out,
    sensor: OfSensor = None,
    collect: Annotated[int | None, typer.Option(help="Its number, as in collects.csv.")] = None,
    run: Annotated[int | None, typer.Option(help="Or its self-calibration, with --position.")] = None,
    position: Annotated[str | None, typer.Option(help="Its position: 1, 2, 3, …")] = None,
) -> None:
    """Draw the samples of one collect, their short means, and the average that was taken of them."""
    from hil.files.figure import check_name, save_figure
    from hil.report.plots import collect_series, draw_series

    check_name(out)
    found = collect_series(source, sensor=sensor, collect=collect, run=run, position=position)
    save_figure(draw_series(found), out)
    results().print(f"plot: {out}")


def temperatures(folder: Annotated[Path, typer.Argument(help="A night's folder.")], out: Out) -> None:
    """Draw chamber and unit temperature through a night, with soaks, collects and events."""
    from hil.files.figure import check_name, save_figure
    from hil.report.plots import draw_temperatures

    check_name(out)
    save_figure(draw_temperatures(folder), out)
    results().print(f"plot: {out}")


def parameters(source: Source, out: Out, sensor: OfSensor = None) -> None:
    """Draw every parameter of a sensor against temperature, with the curves that `hil thermal` fits."""
    from hil.files.figure import check_name, save_figure
    from hil.report.plots import draw_parameters

    check_name(out)
    campaign = read_source(source)
    warn(tuple(campaign.warnings))
    save_figure(draw_parameters(source, campaign, sensor), out)
    results().print(f"plot: {out}")


COMMANDS = (series, temperatures, parameters)
