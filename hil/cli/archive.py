"""Commands about a unit: its certificate, the archive, its life: certificate, archive, units, history."""

from collections.abc import Iterable, Mapping
from datetime import date
from pathlib import Path
from typing import Any

from drivers.clock import SystemClock
from hil.cli.answer import Answer
from hil.cli.exit_status import of_unit
from hil.cli.output import PAGE, check_named, messages
from hil.errors import InputError
from hil.files.durable import check_file, write_result
from hil.files.strict import NAME, one_line
from hil.report.pdf import find_browser, write_pdf


def certificate(
    folder: Path,
    unit: str | None = None,
    out: Path | None = None,
    pdf: bool = False,
    draft: bool = False,
    customer: str = "",
    number: str = "",
    limits: str | None = None,
    strict: bool = False,
) -> Answer:
    """Write the calibration certificate of a night's unit: results with expanded uncertainty, traceability, budget."""
    from hil.records.reader import units_in
    from hil.records.units import writable
    from hil.report.certificate import certificate as made

    if pdf:
        find_browser()  # before anything is written
    folder = units_in(folder).get(unit or "", folder)
    asked = unit, one_line("--customer", customer), one_line("--number", number, NAME), limits
    found = made(folder, SystemClock().utc().date(), *asked)
    path = check_file(out or writable(folder) / "certificate.html", *PAGE)
    if found.refused and not draft:
        raise InputError(f"{folder}: no certificate: {'; '.join(found.refused)}. --draft writes a draft that says so")
    write_result(path, found.page())
    written = [path]
    if pdf:
        write_pdf(path, path.with_suffix(".pdf"))
        written.append(path.with_suffix(".pdf"))
    return Answer(found.document, {"written_to": written}, status=of_unit(found.document["in_spec"], strict))


def archive(
    folder: Path,
    sources: list[Path] | None = None,
    serial: str | None = None,
    day: str | None = None,
    rebuild: bool = False,
    found: bool = False,
) -> Answer:
    """Take nights and campaigns up into the laboratory's archive, and bring its index to what is in the folders."""
    from hil.archive.folder import found_archive, take_up
    from hil.archive.places import MARK
    from hil.archive.taking_in import update
    from hil.records.reader import units_in

    try:
        on = None if day is None else date.fromisoformat(day)
    except ValueError:
        raise InputError(f"--date {day}: is no date; write it as 2026-03-01") from None
    who = None if serial is None else one_line("--serial", serial, NAME)
    new = not (folder / MARK).is_file()
    if found:
        found_archive(folder)
    taken, refused = [], {}
    for source in (unit for night in sources or () for unit in (*units_in(night).values(),) or (night,)):
        try:
            taken.append(take_up(folder, source, who, on))
        except InputError as error:
            if len(sources or ()) == 1:
                raise
            refused[str(source)] = str(error)
    console = messages()
    done = update(folder, rebuild=rebuild, each=lambda entry: console.print(f"reading {entry}"))
    document = {
        "schema": "hil.archive/1",
        "archive": str(folder),
        "new": new,
        "taken_up": [vars(each) for each in taken],
        "not_taken_up": refused,
        **done,
    }
    return Answer(document, status=4 if refused or done["cannot_be_read"] else 0)


def units(archive: Path | None = None, csv_file: Path | None = None) -> Answer:
    """List the units of the archive: how often each was calibrated, when last, and how that was."""
    from hil.archive.index import opened_index

    with opened_index(_named(archive)) as index:
        rows, behind = index.units(), index.behind()
    if csv_file is not None:
        _write_csv(csv_file, rows)
    simulated = any(each["simulated"] for each in rows)
    return Answer({"schema": "hil.units/1", "simulated": simulated, "units": rows, "said": behind})


def history(
    serial: str,
    archive: Path | None = None,
    model: str | None = None,
    limits: str | None = None,
    csv_file: Path | None = None,
    page: Path | None = None,
    out: Path | None = None,
) -> Answer:
    """Say what became of a unit through the years: drift, jumps, control limits, when the next calibration is due."""
    from hil.archive.folder import life
    from hil.archive.history import history as became
    from hil.archive.index import opened_index
    from hil.archive.page import history_page
    from hil.campaign.writer import write_campaign
    from hil.config.limits import load_limits

    if page is not None:
        check_file(page, *PAGE)  # before anything is written
    folder, chosen = _named(archive), None if limits is None else load_limits(limits)
    with opened_index(folder) as index:
        document = became(index, serial, model, chosen)
    if csv_file is not None:
        rows = (
            {**{key: of[key] for key in ("sensor", "parameter")}, "temperature_degC": at["temperature_degC"], **each}
            for of in document["parameters"]
            for at in of["temperatures"]
            for each in at["values"]
        )
        _write_csv(csv_file, rows)
    if page is not None:
        write_result(page, history_page(document))
    if out is not None:
        write_campaign(life(folder, [each["entry"] for each in document["campaigns"] if each["used"]]), out)
    return Answer(document, {"written_to": list(filter(None, (csv_file, page, out)))})


def _named(archive: Path | None) -> Path:
    if archive is None:
        raise InputError("which archive? --archive names its folder, or once for all the environment's HIL_ARCHIVE")
    return archive


def _write_csv(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    from hil.files.columns import rows_as_csv

    check_named(path, ".csv")
    write_result(path, rows_as_csv(list(rows)))
