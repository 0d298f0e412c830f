"""One page over the units of a night: how each stands, what ended each soak, and where each one's report is."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from hil.files.durable import write_result
from hil.files.page import in_style, rendered
from hil.records import reading
from hil.records.reader import JournalReader
from hil.records.status import night_status, recorded_verdict
from hil.records.troubles import to_do
from hil.report.content import ReportContent
from hil.report.statements import good
from procedures.plan import StepKind


def write_units(
    source: Path, path: Path, reports: Mapping[str, tuple[Path, ReportContent]], without: Mapping[str, str]
) -> None:
    """Write the page over the units of the night in `source`.

    `reports` are theirs, by unit: where, and what they say; `without` is why a unit has none. Raises `InputError` where
    it cannot be written.
    """
    status = night_status(source)
    with reading(source) as journal:
        verdict, soaks = recorded_verdict(journal), list(_soaks(journal))
    units = []
    for each in status["units"]:
        page: str | None = None
        brief: Mapping[str, str] | None = None
        judged, why = "ERROR", without.get(each["unit"], "")
        if each["unit"] in reports:
            at, content = reports[each["unit"]]
            page, (judged, why) = os.path.relpath(at, path.parent), good(content)
            brief = None if content.in_spec is None else content.in_spec.brief()
        reason = each["reason"] if page and each["set_aside"] else why
        units.append({**each, "page": page, "verdict": judged, "in_spec": brief, "why": reason})
    document = {
        "title": status["title"],
        "running_title": in_style(status["title"]),
        "identity": status["identity"],
        "simulated": status["simulated"],
        "verdict": verdict["verdict"] if verdict else "INCONCLUSIVE",
        "state": status["state"],
        "reason": status["reason"],
        "to_do": to_do(Path(source.name), {**status, "verdict": verdict}),
        "units": units,
        "soaks": soaks,
        "whole": False,
    }
    write_result(path, rendered("hil.report", "units.html.j2", document))


def _soaks(journal: JournalReader) -> Iterator[tuple[int | None, float | None, float, str]]:
    """Yield of each soak its self-calibration, °C, minutes, and the criterion that decided, with its unit."""
    done = journal.completed()
    for step in journal.plan.of_kind(StepKind.RESTABILISE):
        if (result := done.get(step.key)) is not None:
            by = result.data.get("decided_by") or "the ceiling"
            yield step.self_calibration, step.temperature_degC, result.data.get("waited_s", 0.0) / 60.0, by
