"""Turn a report's content into one self-contained HTML file: the whole, the night's chapter, a page over all units."""

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.files.durable import write_result
from hil.files.numbers import decimals_for
from hil.files.page import inline_svg, rendered
from hil.records import reading
from hil.records.status import in_brief, night_status, recorded_verdict
from hil.records.troubles import to_do as to_do_now
from hil.report.content import ReportContent, assumed, cannot_tell, good, headline, largest, to_do
from hil.report.night import NightContent, campaign_files
from hil.report.plots import draw_night
from hil.report.sensor_view import key_numbers, sensor_view
from hil.solve.document import reasons
from hil.solve.omissions import in_words, what_is_wrong
from procedures.plan import StepKind
from procedures.verdict import Verdict
from procedures.words import counted, listed

MOST_EVENTS = 500
"""More events than this are not listed: a device that flaps all night must not make a report that nobody can open."""

RESUMING = ("night-resumed", "resumed", "restoring", "restored", "damage", "lock_taken_over")
"""The kinds of events by which a resume says what it did and why."""

_COUNTS = (
    ("ok", "frames", "ok"),
    ("bad", "frames", "bad"),
    ("lost", "frames", "lost"),
    ("twice", "frames", "duplicate"),
    ("late", "frames", "timed_out"),
    ("unknown", "frames", "unknown_id"),
    ("resyncs", "", "resyncs"),
    ("skipped", "bytes", "skipped_bytes"),
)


def render(content: ReportContent, *, whole: bool = False) -> str:
    """Return the report as HTML, `whole` with nothing folded. Nothing in it needs a network."""
    return rendered("hil.report", "report.html.j2", {**_page(content), "whole": whole})


def _page(content: ReportContent) -> dict[str, Any]:
    campaign, night = content.campaign, content.night
    verdict, sentence = good(content)
    # The report's own sensor, beside which the contractor's solution stands, before any other.
    sensors = sorted(content.sensors, key=lambda each: not each.has_contractor)
    order, compared = [each.number for each in sensors], content.comparison
    differences = sorted(compared.differences if compared else (), key=lambda each: order.index(each.sensor))
    files = night.files if night is not None else campaign_files(campaign)
    name = campaign.folder.resolve().name if campaign.folder else campaign.title
    provenance = [("campaign", name), *([("source", campaign.source)] if campaign.source else [])]
    warnings = dict.fromkeys([*in_words(what_is_wrong(campaign)), *campaign.warnings, *campaign.notes.splitlines()])
    published = any(each.has_contractor for each in sensors)
    why = list(reasons([solution for each in sensors for solution in each.solutions]))
    return {
        "title": campaign.title,
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
        "comparison": compared
        and {
            "of": compared,
            "flagged": [each.sentence for each in compared.first],
            "remarks": [each for each in compared.remarks if each not in compared.doubts],
            "differences": [(each, decimals_for([each.difference.sd])) for each in differences],
        },
        "night": None if night is None else night_view(night),
        "cautions": len(campaign.warnings),
        "warnings": list(warnings),
        "assumed": assumed(content),
        "cannot_tell": cannot_tell(content),
        "provenance": night.provenance if night is not None else provenance,
        "files": files,
    }


def write_units(
    source: Path, path: Path, reports: Mapping[str, tuple[Path, ReportContent]], without: Mapping[str, str]
) -> None:
    """Write the page over the units of the night in `source`.

    `reports` are theirs, by unit: where, and what they say; `without` is why a unit has none. Raises `InputError` where
    it cannot be written.
    """
    status = night_status(source)
    with reading(source) as journal:
        verdict, done = recorded_verdict(journal), journal.completed()
        soaks = [(step, done[step.key].data) for step in journal.plan.of_kind(StepKind.RESTABILISE) if step.key in done]
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
        **{name: status[name] for name in ("title", "identity", "simulated", "state", "reason")},
        "verdict": verdict["verdict"] if verdict else "INCONCLUSIVE",
        "to_do": to_do_now(Path(source.name), {**status, "verdict": verdict}),
        "units": units,
        "soaks": soaks,
    }
    write_result(path, rendered("hil.report", "units.html.j2", document))


def night_view(night: NightContent) -> dict[str, Any]:
    """Return what the template shows of a night: of its lists at most so many, and how many more there are."""
    resumes = [event for event in night.events if event[1] in RESUMING]
    lists = {"rejected": night.rejected, "resumes": resumes, "events": night.events}
    troubled = _troubled(night.collects)
    return {
        "svg": _picture(night),
        "margins": night.margins,
        "soaks": night.soaks,
        "stream": stream_in_words(night.collects),
        "troubled": [(each, {name: _count(each, name) for _, _, name in _COUNTS}) for each in troubled],
        "counts": [of for of in _COUNTS[1:] if any(_count(each, of[2]) for each in troubled)],
        "good": len(night.collects) - len(troubled),
        **{name: list(of)[:MOST_EVENTS] for name, of in lists.items()},
        "more": {name: max(len(of) - MOST_EVENTS, 0) for name, of in lists.items()},
    }


def stream_in_words(collects: Sequence[Mapping[str, Any]]) -> str:
    """Say of all collects together what the stream brought, in one sentence."""
    if not collects:
        return ""
    total = {name: sum(_count(each, name) for each in collects) for _, _, name in _COUNTS}
    used, expected = (sum(each[n] for each in collects) for n in ("n_samples", "n_expected"))
    bad = [
        f"{counted(total[name], below.removesuffix('s') or 'resync')} {what if below else ''}".rstrip()
        for what, below, name in _COUNTS[1:]
        if total[name]
    ]
    came = listed(bad) if bad else "nothing else came"
    most = min(used, expected)  # an edge sample more is no more than all of them
    share = f" ({math.floor(10_000 * most / expected) / 100:.2f} %)" if expected else ""
    if used > expected + 2 * len(collects):
        share = f", {used / max(expected, 1) - 1.0:.2%} more than the description's rate gives: the unit is faster"
    where = f", in {len(_troubled(collects))} of them" if bad else ""
    return (
        f"{counted(len(collects), 'collect')}: {counted(total['ok'], 'good frame')}; {came}{where}. "
        f"{used} of {expected} expected samples are in the averages{share}."
    )


def _troubled(collects: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the collects in which anything but good frames came, samples lacked, or the verdict is not PASS."""
    return [
        each
        for each in collects
        if each["verdict"] != Verdict.PASS
        or any(_count(each, name) for _, _, name in _COUNTS[1:])
        or each["n_samples"] < each["n_expected"] - 1
    ]


def _count(each: Mapping[str, Any], name: str) -> int:
    names = ("bad_checksum", "bad_delimiter") if name == "bad" else (name,)
    return sum(each["counts"].get(one, 0) for one in names)


def _picture(night: NightContent) -> str:
    if len(night.hours) < 2:
        return ""
    low = {
        label: (min(v), max(v)) for label, values in night.temperatures.items() if (v := [x for x in values if x == x])
    }
    spans = ", ".join(f"{label} {least:z.1f} to {most:z.1f} °C" for label, (least, most) in low.items())
    says = (
        f"Temperatures through {night.hours[-1]:.1f} hours: {spans}; {counted(len(night.soaks), 'soak')}, "
        f"{counted(len(night.collects), 'collect')}, {counted(len(night.events), 'event')}."
    )
    return inline_svg(draw_night(night), says)
