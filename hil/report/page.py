"""Turn a report's content into one self-contained HTML file."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hil.analysis.against import Comparison, Difference
from hil.files.durable import write_result
from hil.files.numbers import decimals_for, degrees
from hil.files.page import in_style, rendered
from hil.records import reading
from hil.records.reader import JournalReader
from hil.records.status import in_brief, night_status, recorded_verdict
from hil.records.troubles import to_do as to_do_now
from hil.report.content import ReportContent
from hil.report.night_view import night_view
from hil.report.provenance import campaign_files, campaign_provenance
from hil.report.sensor_view import key_numbers, sensor_view
from hil.report.statements import assumed, cannot_tell, good, headline, largest, to_do
from hil.solve.omissions import in_words, what_is_wrong
from hil.solve.runs import reasons
from procedures.plan import StepKind
from procedures.verdict import Verdict

_MOST_IN_WORDS = 3


def render(content: ReportContent, *, whole: bool = False) -> str:
    """Return the report as HTML, `whole` with nothing folded. Nothing in it needs a network."""
    return rendered("hil.report", "report.html.j2", {**_page(content), "whole": whole})


def _page(content: ReportContent) -> dict[str, Any]:
    campaign, night = content.campaign, content.night
    verdict, sentence = good(content)
    # The report's own sensor, beside which the contractor's solution stands, before any other.
    sensors = sorted(content.sensors, key=lambda each: not each.has_contractor)
    order = [each.number for each in sensors]
    files = night.files if night is not None else campaign_files(campaign)
    warnings = dict.fromkeys([*in_words(what_is_wrong(campaign)), *campaign.warnings, *campaign.notes.splitlines()])
    published = any(each.has_contractor for each in sensors)
    why = list(reasons([solution for each in sensors for solution in each.solutions]))
    return {
        "title": campaign.title,
        "running_title": in_style(campaign.title),
        "subtitle": campaign.source,
        "identity": {name: text for name, text in campaign.identity.items() if name != "despite"},
        "despite": campaign.identity.get("despite", ""),
        "simulated": campaign.simulated,
        "verdict": verdict,
        "good": sentence,
        "in_spec": content.in_spec,
        "no_residual": not any(each.degrees_of_freedom for each in content.solutions),
        "to_do": list(to_do(content)),
        "headline": headline(content),
        "numbers": key_numbers(content.sensors),
        "why": [each for each in why if each[0] is not Verdict.PASS],
        "passed": [each for each in why if each[0] is Verdict.PASS],
        "largest": list(largest(content)),
        "asked": night.asked if night is not None else "",
        "done": night.done if night is not None else "",
        "missing": in_brief(night.missing) if night is not None else [],
        "sensors": [sensor_view(each, published=published) for each in sensors],
        "both": [] if content.both is None else content.both.sentences(),
        "comparison": None if content.comparison is None else _comparison(content.comparison, order),
        "night": None if night is None else night_view(night),
        "cautions": len(campaign.warnings),
        "warnings": list(warnings),
        "assumed": assumed(content),
        "cannot_tell": cannot_tell(content),
        "provenance": night.provenance if night is not None else campaign_provenance(campaign),
        "files": files,
    }


def _comparison(comparison: Comparison, order: list[int]) -> dict[str, Any]:
    """Return what the template shows of a comparison; sensors stand in `order`, as elsewhere on the page."""
    differences = sorted(comparison.differences, key=lambda each: order.index(each.sensor))
    return {
        "of": comparison,
        "flagged": [_in_words(each) for each in comparison.flagged[:_MOST_IN_WORDS]],
        "remarks": [each for each in comparison.remarks if each not in comparison.doubts],
        "differences": [(each, decimals_for([each.sigma])) for each in differences],
    }


def _in_words(each: Difference) -> str:
    digits = decimals_for([each.sigma])
    return (
        f"sensor {each.sensor}, {degrees(each.temperature_degC)}: {each.parameter} is {each.now:.{digits}f} now "
        f"and was {each.earlier:.{digits}f}, a difference of {each.difference:.{digits}f} ±{each.sigma:.{digits}f} "
        f"{each.unit}"
    )


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
        "to_do": to_do_now(Path(source.name), {**status, "verdict": verdict}),
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
