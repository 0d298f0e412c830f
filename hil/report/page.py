"""Turn a report's content into one self-contained HTML file."""

from __future__ import annotations

from pathlib import Path
from textwrap import shorten
from typing import Any

from hil.files.durable import RealDisk, write_durably
from hil.files.grid import Cell, Grid, decimals_for, degrees, estimate, number, text
from hil.files.page import in_style, rendered
from hil.records.status import in_brief
from hil.report.against import Comparison, Difference
from hil.report.content import ReportContent
from hil.report.night_view import night_view
from hil.report.provenance import campaign_files, campaign_provenance
from hil.report.sensor_view import key_numbers, reasons, sensor_view
from hil.report.statements import assumed, cannot_tell, changed, good, headline, judged, largest, to_do
from hil.solve.wrong_rows import in_words, rows_of
from procedures.verdict import Verdict

_MOST_IN_WORDS = 3
_LONGEST_RUNNING = 90


def render(content: ReportContent, *, whole: bool = False) -> str:
    """Return the report as HTML, `whole` with nothing folded. Nothing in it needs a network."""
    return rendered("hil.report", "report.html.j2", {**_page(content), "whole": whole})


def write_page(content: ReportContent, path: Path, *, whole: bool = False) -> None:
    """Write the report to `path`, whole or not at all."""
    write_durably(RealDisk(), path, render(content, whole=whole).encode())


def _page(content: ReportContent) -> dict[str, Any]:
    campaign, night = content.campaign, content.night
    verdict, sentence = good(content)
    # The report's own sensor, beside which the contractor's solution stands, before any other.
    sensors = sorted(content.sensors, key=lambda each: not each.has_contractor)
    order = [each.number for each in sensors]
    files = night.files if night is not None else campaign_files(campaign)
    warnings = dict.fromkeys([*in_words(rows_of(campaign)), *campaign.warnings, *campaign.notes.splitlines()])
    published = any(each.has_contractor for each in sensors)
    why = list(reasons(sensors))
    return {
        "title": campaign.title,
        "running_title": in_style(shorten(campaign.title, _LONGEST_RUNNING, placeholder=" …")),
        "subtitle": campaign.source,
        "identity": {name: text for name, text in campaign.identity.items() if name != "despite"},
        "despite": campaign.identity.get("despite", ""),
        "simulated": campaign.simulated,
        "verdict": verdict,
        "good": sentence,
        "judged": judged(content),
        "to_do": list(to_do(content)),
        "changed": changed(content),
        "headline": headline(content),
        "numbers": key_numbers(content),
        "why": [each for each in why if each["verdict"] != Verdict.PASS],
        "passed": [each for each in why if each["verdict"] == Verdict.PASS],
        "largest": list(largest(content)),
        "asked": night.asked if night is not None else "",
        "done": night.done if night is not None else "",
        "missing": in_brief(night.missing) if night is not None else [],
        "sensors": [sensor_view(each, published=published) for each in sensors],
        "both": list(content.both_sensors),
        "comparison": None if content.comparison is None else _comparison(content.comparison, order),
        "night": None if night is None else night_view(night),
        "cautions": len(campaign.warnings),
        "warnings": list(warnings),
        "assumed": assumed(content),
        "cannot_tell": cannot_tell(content),
        "provenance": night.provenance if night is not None else campaign_provenance(campaign),
        "files": _files(files) if files else None,
    }


def _comparison(comparison: Comparison, order: list[int]) -> dict[str, Any]:
    """Return what the template shows of a comparison; sensors stand in `order`, as elsewhere on the page."""
    heads = [Cell("sensor"), Cell("at"), Cell("parameter", kind="text"), Cell("now"), Cell("earlier")]
    heads += [Cell("runs", "now, earlier"), Cell("difference"), Cell("beyond 3 sigma", kind="text")]
    rows = []
    for each in sorted(comparison.differences, key=lambda each: order.index(each.sensor)):
        digits = decimals_for([each.sigma])
        rows.append(
            [
                number(each.sensor),
                Cell(degrees(each.temperature_degC)),
                Cell(each.parameter, each.unit, "text"),
                number(each.now, digits),
                number(each.earlier, digits),
                Cell(f"{each.runs[0]}, {each.runs[1]}"),
                estimate(each.difference, each.sigma, digits),
                Cell("BEYOND", kind="FAIL") if each.flagged else text("no"),
            ]
        )
    return {
        "sentence": comparison.sentence,
        "simulated": comparison.simulated,
        "earlier": comparison.source,
        "flagged": [_in_words(each) for each in comparison.flagged[:_MOST_IN_WORDS]],
        "doubts": list(comparison.doubts),
        "remarks": [each for each in comparison.remarks if each not in comparison.doubts],
        "grid": Grid(
            "differences",
            "This campaign's mean less the earlier one's, ± its standard uncertainty: that of both means, what "
            "repeats show included, widened (Student's t) where few runs tell it.",
            heads,
            rows,
        )
        if rows
        else None,
    }


def _in_words(each: Difference) -> str:
    digits = decimals_for([each.sigma])
    return (
        f"sensor {each.sensor}, {degrees(each.temperature_degC)}: {each.parameter} is {each.now:.{digits}f} now "
        f"and was {each.earlier:.{digits}f}, a difference of {each.difference:.{digits}f} ±{each.sigma:.{digits}f} "
        f"{each.unit}"
    )


def _files(files: Any) -> Grid:
    heads = [Cell("file", kind="text"), Cell("bytes"), Cell("SHA-256", kind="text")]
    rows = [[text(path), number(size), Cell(digest, kind="hash")] for path, size, digest in files]
    return Grid("files", "The files that the numbers come from, as they were when they were written.", heads, rows)
