"""The night's chapter of the report: temperatures, soaks, the stream of each collect, what was rejected or happened."""

import math
from collections.abc import Sequence
from typing import Any

from hil.files.page import inline_svg
from hil.report.night import CollectLine, NightContent
from hil.report.plots import draw_night
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
        if each.verdict != Verdict.PASS
        or any(_count(each, name) for _, _, name in _COUNTS[1:])
        or each.n_samples < each.n_expected - 1
    ]


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
