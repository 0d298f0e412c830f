"""The night's chapter of the report: temperatures, soaks, the stream of each collect, what was rejected or happened."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hil.files.grid import Cell, Grid, degrees, number, text, wrap
from hil.files.page import inline_svg
from hil.report.figures import draw_night
from hil.report.night import CollectLine, NightContent
from procedures.verdict import Verdict
from procedures.words import counted, hours_minutes, listed, percent

MOST_EVENTS = 500
"""More events than this are not listed: a device that flaps all night must not make a report that nobody can open."""

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


def night_view(night: NightContent) -> dict[str, Any]:
    """Return what the template shows of a night."""
    listed = list(night.events)[:MOST_EVENTS]
    left = len(night.events) - len(listed)
    return {
        "svg": _picture(night),
        "margins": _margins(night) if night.margins else None,
        "worst": _worst(night),
        "soaks": _soaks(night) if night.soaks else None,
        "stream": stream_in_words(night.collects),
        "collects": _collects(night.collects) if night.collects else None,
        "rejected": _list("rejected", "Attempts that count for nothing.", ("what", "why"), night.rejected),
        "resumes": _list("resumes", "What a resume did, and why.", ("what", "said"), night.resumes),
        "events": _events(listed, left),
    }


def _worst(night: NightContent) -> str:
    """Say which limit was come nearest to, and how near; nothing where no collect was completed."""
    if not night.margins:
        return ""
    worst = night.margins[0]
    return f"{worst.what} {worst.value}, limit {worst.limit}: {percent(worst.used)} of it used ({worst.where})"


def stream_in_words(collects: Sequence[CollectLine]) -> str:
    """Say of all collects together what the stream brought, in one sentence."""
    if not collects:
        return ""
    total = {name: sum(_count(each, name) for each in collects) for _, _, name in _COUNTS}
    used, expected = sum(each.n_samples for each in collects), sum(each.n_expected for each in collects)
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
        f"{len(collects)} collects: {total['ok']} good frames; {came}{where}. "
        f"{used} of {expected} expected samples are in the averages{share}."
    )


def _troubled(collects: Sequence[CollectLine]) -> list[CollectLine]:
    """Return the collects in which anything but good frames came, samples lacked, or the verdict is not PASS."""
    return [
        each
        for each in collects
        if each.verdict != Verdict.PASS or any(_count(each, name) for _, _, name in _COUNTS[1:]) or _lacks(each)
    ]


def _lacks(each: CollectLine) -> bool:
    return each.n_samples < each.n_expected - 1


def _count(each: CollectLine, name: str) -> int:
    return each.bad if name == "bad" else each.counts.get(name, 0)


def _picture(night: NightContent) -> str:
    if len(night.hours) < 2:
        return ""
    low = {
        label: (min(v), max(v)) for label, values in night.temperatures.items() if (v := [x for x in values if x == x])
    }
    spans = ", ".join(f"{label} {least:.1f} to {most:.1f} °C" for label, (least, most) in low.items())
    says = (
        f"Temperatures through {night.hours[-1]:.1f} hours: {spans}; {len(night.soaks)} soaks, {len(night.collects)} "
        f"collects, {len(night.events)} events."
    )
    return inline_svg(draw_night(night), says)


def _soaks(night: NightContent) -> Grid:
    heads = [Cell("run"), Cell("at"), Cell("began", "h"), Cell("waited"), Cell("started over", "soak, window")]
    heads += [Cell("decided by", kind="text"), Cell("verdict", kind="text"), Cell("remark", kind="text")]
    return Grid(
        "soaks",
        "Restabilisation before each self-calibration: how long, and which criterion was the last to be met.",
        heads,
        [
            [
                number(each.run),
                Cell(degrees(each.temperature_degC)),
                number(each.began_h, 2),
                Cell(hours_minutes(each.waited_s)),
                Cell(f"{each.soak_restarts}, {each.window_restarts}"),
                text(each.decided_by),
                Cell(each.verdict, kind=each.verdict),
                wrap("" if each.verdict == Verdict.PASS else each.reason),
            ]
            for each in night.soaks
        ],
    )


def _collects(collects: Sequence[CollectLine]) -> Grid | None:
    """The collects with something to see, in columns with something to see; None where all are good."""
    shown = _troubled(collects)
    if not shown:
        return None
    counts = [of for of in _COUNTS if any(_count(each, of[2]) for each in shown)]
    heads = [Cell("run"), Cell("position"), Cell("at"), Cell("verdict", kind="text"), Cell("began", "UTC")]
    heads += [Cell("lasts", "s"), Cell("samples"), *(Cell(name, below) for name, below, _ in counts)]
    rows = [
        [
            number(each.run),
            Cell(each.position),
            Cell(degrees(each.temperature_degC)),
            Cell(each.verdict, kind=each.verdict),
            Cell(each.utc),
            Cell(f"{each.duration_s:g}"),
            Cell(str(each.n_samples), f"of {each.n_expected}"),
            *(number(_count(each, name)) for _, _, name in counts),
        ]
        for each in shown
    ]
    rest = len(collects) - len(shown)
    caption = f"Collects in which not everything was good; in the other {rest} it was. Bad: a wrong checksum or end."
    return Grid("collects", caption, heads, rows)


def _margins(night: NightContent) -> Grid:
    heads = [Cell(name, kind="text") for name in ("nearest to its limit", "was", "limit", "of it used", "where")]
    rows = [
        [text(each.what), Cell(each.value, kind="bold"), text(each.limit), text(percent(each.used)), wrap(each.where)]
        for each in night.margins
    ]
    return Grid("margins", "How near the night came to its limits.", heads, rows)


def _list(name: str, caption: str, columns: tuple[str, str], rows: Sequence[tuple[str, str, str]]) -> Grid | None:
    if not rows:
        return None
    if len(rows) > MOST_EVENTS:
        caption += f" {len(rows) - MOST_EVENTS} more are in the journal."
    heads = [Cell("when (UTC)", kind="text"), *(Cell(column, kind="text") for column in columns)]
    return Grid(name, caption, heads, [[text(when), text(what), wrap(why)] for when, what, why in rows[:MOST_EVENTS]])


def _events(events: Sequence[tuple[str, str, str]], left: int) -> Grid | None:
    if not events:
        return None
    caption = "Events; their numbers are those of the marks in the picture."
    if left:
        caption += f" {left} more are in the journal."
    heads = [Cell("no."), Cell("when (UTC)", kind="text"), Cell("what", kind="text"), Cell("said", kind="text")]
    rows = [[number(n), text(when), text(kind), wrap(said)] for n, (when, kind, said) in enumerate(events, start=1)]
    return Grid("events", caption, heads, rows)
