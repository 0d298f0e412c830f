"""`hil report`: the morning report of a night or a campaign folder, and its numbers beside it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from hil.cli.data import EARLIER, Source, read_source
from hil.cli.exit_status import Exit, Limits, Strict, of_unit
from hil.cli.output import messages, results
from hil.errors import InputError

if TYPE_CHECKING:
    from hil.campaign import Campaign
    from hil.report.content import ReportContent
    from hil.report.night import NightContent
    from hil.report.tables import TableFormat


def report(
    source: Source,
    out: Annotated[Path | None, Option(help="Where to write it; default: report.html in the folder.")] = None,
    against: Annotated[
        Path | None, Option(help="An earlier night or campaign of the same unit: what changed, flagged beyond 3 sigma.")
    ] = None,
    limits: Limits = None,
    strict: Strict = False,
    whole: Annotated[
        bool, Option("--whole", help="Nothing folded, and all of it printed; by default the evidence is.")
    ] = False,
    pdf: Annotated[bool, Option("--pdf", help="Beside it as PDF too; the browser here prints it.")] = False,
    csv: Annotated[bool, Option("--csv", help="Beside it its tables, for a spreadsheet.")] = False,
    parquet: Annotated[bool, Option("--parquet", help="Beside it its tables, for a program.")] = False,
) -> int:
    """Write the report: one self-contained HTML file that any browser shows and prints."""
    from hil.files.page import page_file
    from hil.records.reader import units_in
    from hil.report.content import good
    from hil.report.page import write_units
    from hil.report.pdf import find_browser, write_pdf
    from hil.report.tables import write_tables

    if pdf:
        find_browser()  # before anything is written
    units = units_in(source)
    if units and against is not None:
        raise InputError(f"{source}: --against is of one unit: hil report {next(iter(units.values()))} --against …")
    over_all = page_file(out or source / "report.html") if units else source
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
    from hil.analysis.against import compare
    from hil.analysis.in_spec import in_spec_of
    from hil.files.durable import write_result
    from hil.files.page import page_file
    from hil.records.reader import is_night
    from hil.records.units import writable
    from hil.report.content import gather
    from hil.report.night import night_content
    from hil.report.page import render

    night = night_content(source) if is_night(source) else None
    campaign = _campaign(source, night)
    path = page_file(out or writable(source) / "report.html")
    comparison = None if against is None else compare(campaign, read_source(against, EARLIER))
    content = gather(campaign, night, comparison)
    state = "" if night is None else night.state
    content = replace(content, in_spec=in_spec_of(source, campaign, content.solutions, limits, comparison, state))
    write_result(path, render(content, whole=whole))
    return path, content


def _campaign(source: Path, night: NightContent | None) -> Campaign:
    """Read what was measured; a night that came to no collect has its report too, which says why."""
    from hil.campaign import Campaign

    if night is not None and not night.collects:
        source_words = "recorded by hil; no collect was completed"
        return Campaign(night.title, source_words, {}, simulated=night.simulated, identity=night.identity)
    return read_source(source)


COMMANDS = (report,)
