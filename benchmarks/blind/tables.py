"""Kept outcomes as tables: one engine by row, or several side by side; each share with its exact 95 % interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.blind.judge import CONFIDENT, answers, share

Outcome = dict[str, Any]

_HEARD = (
    ("finds something", "found", "nothing mean scatter both fault"),
    ("false alarm", "alarm", "nothing"),
    ("something on the mean", "mean", "nothing scatter"),
    ("a name on the mean, sure", "sure", "nothing scatter"),
    ("class listed", "listed", "mean both"),
    ("first class right", "first", "mean both scatter fault"),
    ("all right", "exact", "mean both scatter fault"),
    ("scatter named", "scatter", "scatter both"),
    ("scatter or its kin", "kin", "scatter both"),
    ("points at the rows", "told", "fault"),
    ("confidently wrong", "wrong", "nothing mean scatter both fault"),
    ("empirical", "empirical", "nothing mean scatter both fault"),
)
"""Measure, key of the outcome, and what must be hidden for it to be asked."""


def tables(outcomes: Sequence[Outcome]) -> str:
    """The tables, as Markdown: a line per row for one engine, a line per row and measure for several."""
    engines = list(dict.fromkeys(o.get("engine", "") for o in outcomes))
    by_engine = [[o for o in outcomes if o.get("engine", "") == engine] for engine in engines]
    if len(engines) == 1:
        return "\n".join([*_wide(outcomes), "", *_by_effect(outcomes), "", *_summary(outcomes)])
    alone = " only the first / the last |" if len(engines) == 2 else ""
    lines = [
        f"| case | n | measure | {' | '.join(engines)} |{alone}",
        "|---|---|---|" + "---|" * (len(engines) + bool(alone)),
    ]
    for row in dict.fromkeys(o["row"] for o in outcomes):
        lines += _side_by_side(row, [[o for o in mine if o["row"] == row] for mine in by_engine])
    return "\n".join([*lines, *_of_all(by_engine)])


def _side_by_side(row: str, parts: Sequence[Sequence[Outcome]]) -> list[str]:
    """One line per measure that is asked of this row; of two engines also in how many cases one alone says so."""
    said = [_row(part) for part in parts]
    lines = []
    for name in dict.fromkeys(name for one in said for name, text in one.items() if text != "–"):
        cells = [one.get(name, "–") for one in said]
        if len(parts) == 2:
            cells.append(_alone(name, *parts))
        lines.append(f"| {row} | {len(parts[0])} | {name} | {' | '.join(cells)} |")
    return lines


def _alone(name: str, first: Sequence[Outcome], last: Sequence[Outcome]) -> str:
    """In how many of the same cases only one of two engines says so: what to test them by, the cases being paired."""
    key = next((key for measure, key, _ in _HEARD if measure == name), None)
    if key is None:
        return ""
    others = {(o["seed"], o["d"]): bool(o.get(key)) for o in last}
    pairs = [(bool(o.get(key)), others[o["seed"], o["d"]]) for o in first if (o["seed"], o["d"]) in others]
    return f"{sum(a and not b for a, b in pairs)} / {sum(b and not a for a, b in pairs)}"


def _of_all(by_engine: Sequence[Sequence[Outcome]]) -> list[str]:
    totals = [_totals(mine) for mine in by_engine]
    return [
        f"| all of them | {len(by_engine[0])} | {name} | {' | '.join(one[name] for one in totals)} |"
        for name in totals[0]
        if any(one[name] != "–" for one in totals)
    ]


def _asks(outcome: Outcome) -> str:
    """What was hidden; of lines that were kept before it was said, by whether anything was."""
    return str(outcome.get("asks", "mean" if outcome["hidden"] else "nothing"))


def _row(outcomes: Sequence[Outcome]) -> dict[str, str]:
    """Each measure of a row, as text."""
    out = {}
    for name, key, where in _HEARD:
        asked = [o for o in outcomes if _asks(o) in where.split()]
        out[name] = share(bool(o[key]) for o in asked if o.get(key) is not None)
    seconds = [o["seconds"] for o in outcomes if o.get("seconds") is not None]
    out["seconds"] = f"{np.median(seconds):.2f}" if seconds else "–"
    failed = sum(o["verdict"] == "failed" for o in outcomes)
    return {**out, "failed": str(failed)} if failed else out


def _wide(outcomes: Sequence[Outcome]) -> list[str]:
    """A line per row, with those measures that any row is asked."""
    rows = list(dict.fromkeys(o["row"] for o in outcomes))
    said = {row: _row([o for o in outcomes if o["row"] == row]) for row in rows}
    order = [*(name for name, _, _ in _HEARD), "seconds", "failed"]
    names = [name for name in order if any(one.get(name, "–") != "–" for one in said.values())]
    lines = ["| case | n | " + " | ".join(names) + " |", "|---|---|" + "---|" * len(names)]
    for row in rows:
        n = sum(o["row"] == row for o in outcomes)
        lines.append(f"| {row} | {n} | " + " | ".join(said[row].get(name, "–") for name in names) + " |")
    return lines


def _totals(outcomes: Sequence[Outcome]) -> dict[str, str]:
    """What is asked over all rows: names stated, what is followed, sets, the gap."""
    said = [(p, right) for o in outcomes for p, right in o["stated"]]
    driven = [o["follows"] for o in outcomes if o.get("follows")]
    large = [o for o in outcomes if _asks(o) == "mean" and o["d"] >= 8.0 and o["found"]]
    sets = [o for o in outcomes if _asks(o) in ("mean", "scatter") and len(o["hidden"]) == 1 and o.get("classes")]
    ratios = [o["gap_ratio"] for o in outcomes if o["gap_ratio"] is not None]
    noise = [o for o in outcomes if _asks(o) in ("nothing", "scatter") and "sure" in o]
    return {
        f"stated {CONFIDENT} or more is right": share(right for p, right in said if p >= CONFIDENT),
        "how many": str(sum(p >= CONFIDENT for p, _ in said)),
        f"what it follows is stated at {CONFIDENT} or more, where found, d of 8 and more": share(
            bool(o.get("follows")) and o["follows"][0] >= CONFIDENT for o in large
        ),
        f"what it follows, stated {CONFIDENT} or more, is right": share(right for p, right in driven if p >= CONFIDENT),
        f"a name on the mean stated {CONFIDENT} or more where there is only noise": share(o["sure"] for o in noise),
        "false alarms where nothing is": share(o["alarm"] for o in outcomes if o.get("alarm") is not None),
        "90 % sets of names hold the truth": share(set(answers(o["hidden"])) <= set(o["set"]) for o in sets),
        "90 % sets of classes hold the truth": share(
            any(set(answers(o["hidden"])) <= set(names) for names in o["classes"]) for o in sets
        ),
        "their mean size": f"{np.mean([len(o['classes']) for o in sets]):.2f} classes" if sets else "–",
        "held-out mean square over the oracle's, median": f"{np.median(ratios):.3f}" if ratios else "–",
        "worse than before": share(o["worse"] for o in outcomes if o["effects"]),
        "gap under its own noise floor": share(o["under"] for o in outcomes if o.get("under") is not None),
        "seconds, median": _row(outcomes)["seconds"],
    }


def _by_effect(outcomes: Sequence[Outcome]) -> list[str]:
    """Of the single effects at d of 8 and more: how often the first class is right, by effect."""
    mine = [o for o in outcomes if o["row"].startswith("one effect") and o["d"] >= 8.0]
    lines = ["| one effect, d = 8 and 12 | n | first class right |", "|---|---|---|"] if mine else []
    for name in sorted({o["hidden"][0] for o in mine}):
        of_name = [o for o in mine if o["hidden"][0] == name]
        lines.append(f"| {name} | {len(of_name)} | {share(o['first'] for o in of_name)} |")
    return lines


def _summary(outcomes: Sequence[Outcome]) -> list[str]:
    """Probabilities, sets, places, gap."""
    said = [(p, right) for o in outcomes for p, right in o["stated"]]
    lines = ["| stated probability | n | right |", "|---|---|---|"]
    for low, high in ((0.0, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.01)):
        inside = [(p, right) for p, right in said if low <= p < high]
        mean = f", mean {np.mean([p for p, _ in inside]):.2f}" if inside else ""
        lines.append(f"| {low:g} to {min(high, 1.0):g}{mean} | {len(inside)} | {share(r for _, r in inside)} |")
    places = [o["places"] for o in outcomes if o.get("places") and o["effects"]]
    if places:
        means = [f"{reading} {np.mean([p[reading] for p in places]):.2f}" for reading in places[0]]
        lines.append(f"\nplaces, mean F1 of {len(places)}: {'; '.join(means)}")
    again = [o["again"] for o in outcomes if o["again"]]
    if again:
        settled = share(a["verdict"] == "named" and a["exact"] for a in again)
        lines.append(f"\nambiguous, then measured again as advised: named and right in {settled} of {len(again)}")
    lines += [f"\n{name}: {text}" for name, text in _totals(outcomes).items() if text != "–"]
    return lines
