"""`hil certificate`: a calibration certificate of one night's unit, as a page and on A4."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from drivers.clock import SystemClock
from hil.cli.answer import Answer, told
from hil.cli.exit_status import Limits, Strict, of_unit
from hil.cli.output import Folder
from hil.errors import InputError


def certificate(
    folder: Folder,
    unit: Annotated[str | None, typer.Option(help="The unit's serial number; default: the night's.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Where to write it; default: certificate.html in the folder.")
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Beside it as PDF on A4; the browser here prints it.")] = False,
    draft: Annotated[
        bool, typer.Option("--draft", help="Where there can be none, write a draft, which every page says.")
    ] = False,
    customer: Annotated[str, typer.Option(help="For whom.")] = "",
    number: Annotated[str, typer.Option(help="The certificate's own number; default: from serial and time.")] = "",
    limits: Limits = None,
    strict: Strict = False,
) -> Answer:
    """Write the calibration certificate of a night's unit: results with expanded uncertainty, traceability, budget."""
    from hil.files.durable import write_result
    from hil.files.page import page_file
    from hil.files.strict import NAME, one_line
    from hil.records.reader import units_in
    from hil.records.units import writable
    from hil.report.certificate import Asked
    from hil.report.certificate import certificate as made
    from hil.report.pdf import find_browser, write_pdf

    if pdf:
        find_browser()  # before anything is written
    folder = units_in(folder).get(unit or "", folder)
    asked = Asked(unit, one_line("--customer", customer), one_line("--number", number, NAME), limits)
    found = made(folder, asked, SystemClock().utc().date())
    path = page_file(out or writable(folder) / "certificate.html")
    if found.refused and not draft:
        raise InputError(f"{folder}: no certificate: {'; '.join(found.refused)}. --draft writes a draft that says so")
    write_result(path, found.page())
    written = [path]
    if pdf:
        write_pdf(path, path.with_suffix(".pdf"))
        written.append(path.with_suffix(".pdf"))
    document = found.document
    return Answer(document, told(document, written_to=written), status=of_unit(document["in_spec"], strict))


COMMANDS = (certificate,)
