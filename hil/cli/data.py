"""Commands that work on measured data: report, solve, export, replay, plot."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hil.cli.answer import Answer
from hil.cli.exit_status import Exit, of_unit
from hil.cli.output import PAGE, check_named, messages, results, warn
from hil.errors import InputError
from hil.files.durable import check_file, write_result
from hil.files.figure import PLOT, save_figure
from hil.report.pdf import find_browser, write_pdf
from procedures.words import counted

if TYPE_CHECKING:  # `hil --help` loads no arithmetic
    from matplotlib.figure import Figure

    from hil.campaign import Campaign
    from hil.report.content import ReportContent
    from hil.report.tables import TableFormat

Format = Literal["hdf5", "netcdf", "mat", "documents"]
EARLIER = "the earlier one: "


def read_source(source: Path, which: str = "") -> Campaign:
    """Read a campaign folder, or the collects of a night as one, and say what is suspicious, `which` of two it is.

    It is said whatever becomes of the command. Raises `InputError` where it is neither.
    """
    from hil.records.export import open_source

    campaign = open_source(source)
    warn([f"{which}{each}" for each in campaign.warnings])
    return campaign


def report(
    source: Path,
    out: Path | None = None,
    against: Path | None = None,
    limits: str | None = None,
    strict: bool = False,
    whole: bool = False,
    pdf: bool = False,
    csv: bool = False,
    parquet: bool = False,
) -> int:
    """Write the report: one self-contained HTML file that any browser shows and prints."""
    from hil.records.reader import units_in
    from hil.report.content import good
    from hil.report.page import write_units
    from hil.report.tables import write_tables

    if pdf:
        find_browser()  # before anything is written
    units = units_in(source)
    if units and against is not None:
        raise InputError(f"{source}: --against is of one unit: hil report {next(iter(units.values()))} --against …")
    over_all = check_file(out or source / "report.html", *PAGE) if units else source
    written: dict[str, tuple[Path, ReportContent]] = {}
    without: dict[str, str] = {}
    for unit, folder in (units or {"": source}).items():
        try:
            written[unit] = write_report(folder, None if units else out, against, limits, whole=whole)
        except InputError as error:
            without[unit] = str(error)
            if len(without) == max(len(units), 1):  # none has one
                raise
            messages().print(f"ERROR: {error}")
    formats: list[TableFormat] = [*(["csv"] if csv else []), *(["parquet"] if parquet else [])]  # type: ignore[list-item]
    for path, content in written.values():
        results().print(f"report: {path}: {': '.join(good(content))}")
        for line in () if content.comparison is None else content.comparison.sentences():
            results().print(line)
        for line in () if content.in_spec is None else content.in_spec.sentences()[:1]:
            results().print(line)
        for kind in formats:
            for table in write_tables(content, path.with_suffix(""), kind):
                results().print(f"table: {table}")
        if pdf:
            write_pdf(path, path.with_suffix(".pdf"))
            results().print(f"pdf: {path.with_suffix('.pdf')}")
    if units:
        write_units(source, over_all, written, without)
        results().print(f"over all: {over_all}")
    if without:
        return Exit.INCOMPLETE
    return max(of_unit(None if each.in_spec is None else each.in_spec.brief(), strict) for _, each in written.values())


def write_report(
    source: Path,
    out: Path | None = None,
    against: Path | None = None,
    limits: str | None = None,
    *,
    whole: bool = False,
) -> tuple[Path, ReportContent]:
    """Write the report of a night or a campaign folder; return where it is, and what it says.

    Raises `InputError` where the source cannot be read, or `out` is a folder, in none, or not named .html.
    """
    from hil.analysis.against import Comparison
    from hil.analysis.in_spec import in_spec_of
    from hil.campaign import Campaign
    from hil.records.reader import is_night
    from hil.records.units import writable
    from hil.report.content import gather
    from hil.report.night import night_content
    from hil.report.page import render

    night = night_content(source) if is_night(source) else None
    if night is None or night.collects:
        campaign = read_source(source)
    else:  # it came to none, and has its report too, which says why
        told = "recorded by hil; no collect was completed"
        campaign = Campaign(night.title, told, {}, simulated=night.simulated, identity=night.identity)
    path = check_file(out or writable(source) / "report.html", *PAGE)
    comparison = None if against is None else Comparison(campaign, read_source(against, EARLIER))
    content = gather(campaign, night, comparison)
    state = "" if night is None else night.state
    content = replace(content, in_spec=in_spec_of(source, campaign, content.solutions, limits, comparison, state))
    write_result(path, render(content, whole=whole))
    return path, content


def solve(
    source: Path, model: str | None = None, limits: str | None = None, against: Path | None = None, strict: bool = False
) -> Answer:
    """Solve every self-calibration for bias and acceleration-sensitive drift, with uncertainties."""
    from hil.analysis.against import Comparison
    from hil.analysis.in_spec import in_spec_of
    from hil.model.forms import MODEL_NAMES
    from hil.solve import repeats, solve_campaign
    from hil.solve.both_sensors import common_and_differential
    from hil.solve.document import reasons, solution_document

    campaign = read_source(source)
    if model is None or model in MODEL_NAMES:
        solutions = solve_campaign(campaign, model)
    else:
        from hil.model import fitting_campaign
        from hil.solve.beside_terms import beside, solve_beside

        chosen = fitting_campaign(model, campaign)
        campaign = beside(campaign, chosen)
        solutions = solve_beside(campaign, chosen)
    both = common_and_differential(campaign)
    document = solution_document(campaign, solutions)
    document["both_sensors"] = None if both is None else both.document()
    comparison = None if against is None else Comparison(campaign, read_source(against, EARLIER))
    unit = in_spec_of(source, campaign, solutions, limits, comparison)
    if against is not None and (unit is None or all(each.of != "change" for each in unit.characteristics)):
        compared = f"hil report {shlex.quote(str(source))} --against {shlex.quote(str(against))}"
        raise InputError(f"--against is for limits of changes, and none are given (--limits): {compared} compares them")
    document["in_spec"] = None if unit is None else unit.document()
    of_all = [*(() if both is None else both.sentences()), *(() if unit is None else unit.sentences())]

    def drawn(sensor: int | None) -> Figure:
        from hil.report.plots import draw_parameters

        return draw_parameters(source, campaign, sensor)

    shown = {number: each.sentences() for number, each in repeats(campaign, solutions).items()}
    why, notes = list(reasons(solutions)), campaign.notes.splitlines()
    beside_it = {"reasons": why, "notes": notes, "repeats": shown, "of_all": of_all}
    return Answer(document, beside_it, drawn, of_unit(document["in_spec"], strict))


def export(folder: Path, out: Path, form: Format | None = None, fleet: bool = False) -> None:
    """Write the night as a campaign folder: CSV that a spreadsheet reads; or as HDF5, NetCDF or MATLAB's format.

    documents: the journal as Bluesky's event-model documents, a JSON line for each.
    """
    from hil.campaign.fleet_file import write_fleet_file
    from hil.records.documents import export_documents
    from hil.records.export import export_campaign
    from hil.records.folders import in_turn, pieces_in

    if fleet:
        check_named(out, ".parquet")
        if form is not None:
            raise InputError("--fleet and --format: a file for hil fleet is Parquet; give one of the two")
        for place, why in write_fleet_file(in_turn(map, pieces_in([folder])), out).items():
            messages().print(f"warning: {place}: {why}")
        results().print(f"fleet: {out}")
        return
    rows, notes = (export_documents(folder, out), ()) if form == "documents" else export_campaign(folder, out, form)
    for note in notes:
        messages().print(f"note: {note}")
    results().print(f"{form or 'campaign'}: {out}, {counted(rows, 'row')}")


def replay(folder: Path) -> Answer:
    """Compute a recorded night again from its raw bytes: every average, to the digit."""
    from hil.night.replay import replay_night

    document = replay_night(folder)
    return Answer(document, {"folder": folder}, status=Exit.DONE if document["identical"] else Exit.INCOMPLETE)


def _plot(out: Path, draw: Callable[[], Figure]) -> None:
    check_file(out, *PLOT)
    save_figure(draw(), out)
    results().print(f"plot: {out}")


def series(
    source: Path,
    out: Path,
    sensor: int | None = None,
    collect: int | None = None,
    run: int | None = None,
    position: str | None = None,
) -> None:
    """Draw the samples of one collect, their short means, and the average that was taken of them."""
    from hil.report.plots import collect_series, draw_series

    _plot(out, lambda: draw_series(collect_series(source, sensor=sensor, collect=collect, run=run, position=position)))


def temperatures(folder: Path, out: Path) -> None:
    """Draw chamber and unit temperature through a night, with soaks, collects and events."""
    from hil.report.plots import draw_temperatures

    _plot(out, lambda: draw_temperatures(folder))


def parameters(source: Path, out: Path, sensor: int | None = None) -> None:
    """Draw every parameter of a sensor against temperature, with the curves that `hil thermal` fits."""
    from hil.report.plots import draw_parameters

    _plot(out, lambda: draw_parameters(source, read_source(source), sensor))
