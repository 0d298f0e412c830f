"""Turn a report's content into one self-contained HTML file."""

from __future__ import annotations

import re
from pathlib import Path
from textwrap import shorten
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from hil.files.durable import RealDisk, write_durably
from hil.records.status import in_brief
from hil.report.against import Comparison, Difference
from hil.report.content import ReportContent
from hil.report.grid import Cell, Grid, decimals_for, degrees, estimate, number, text
from hil.report.night_view import night_view
from hil.report.provenance import campaign_files, campaign_provenance
from hil.report.sensor_view import sensor_view
from hil.report.statements import assumed, cannot_tell, good, headline, summary
from hil.solve.wrong_rows import in_words, rows_of

_MOST_IN_WORDS = 20
_LONGEST_RUNNING = 90
_HYPHEN = re.compile(r"(?<![^\s(±])-(?=\d)")
_RECORDED = "Standard errors come from the samples within the collects, correlation allowed for"
_STATED = "Standard errors follow from those that the campaign states for its rates"


def render(content: ReportContent) -> str:
    """Return the report as HTML. Nothing in it needs a network."""
    environment = Environment(
        loader=PackageLoader("hil.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        finalize=_with_minus,
    )
    return environment.get_template("report.html.j2").render(r=_page(content))


def write_page(content: ReportContent, path: Path) -> None:
    """Write the report to `path`, whole or not at all."""
    write_durably(RealDisk(), path, render(content).encode())


def _with_minus(shown: object) -> object:
    """Give numbers below zero a minus: a hyphen is not read out, and parts from its number at the end of a line."""
    return shown if isinstance(shown, Markup) else _HYPHEN.sub("\N{MINUS SIGN}", str(shown))


def _in_style(title: str) -> Markup:
    """Return a text for a string of CSS, in which only letters and digits need no escape."""
    return Markup("".join(c if c.isascii() and c.isalnum() else f"\\{ord(c):x} " for c in title))  # noqa: S704 - escaped


def _page(content: ReportContent) -> dict[str, Any]:
    campaign, night = content.campaign, content.night
    verdict, sentence = good(content)
    # The report's own sensor, beside which the contractor's solution stands, before any other.
    sensors = sorted(content.sensors, key=lambda each: not each.has_contractor)
    order = [each.number for each in sensors]
    files = night.files if night is not None else campaign_files(campaign)
    return {
        "title": campaign.title,
        "running_title": _in_style(shorten(campaign.title, _LONGEST_RUNNING, placeholder=" …")),
        "subtitle": campaign.source,
        "identity": {name: text for name, text in campaign.identity.items() if name != "despite"},
        "despite": campaign.identity.get("despite", ""),
        "simulated": campaign.simulated,
        "verdict": verdict,
        "good": sentence,
        "headline": headline(content),
        "asked": night.asked if night is not None else "",
        "done": night.done if night is not None else "",
        "summary": list(summary(content)),
        "missing": in_brief(night.missing) if night is not None else [],
        "sensors": [sensor_view(each) for each in sensors],
        "both": list(content.both_sensors),
        "uncertainty_note": f"{_STATED if night is None else _RECORDED}; what repeats show beside them is in every ±.",
        "comparison": None if content.comparison is None else _comparison(content.comparison, order),
        "night": None if night is None else night_view(night),
        "warnings": list(
            dict.fromkeys([*in_words(rows_of(campaign)), *campaign.warnings, *campaign.notes.splitlines()])
        ),
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
        "remarks": list(comparison.remarks),
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
