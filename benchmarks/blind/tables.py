"""Kept outcomes as tables: one engine by row, or several side by side; each share with its exact 95 % interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.blind.judge import CONFIDENT, share

Outcome = dict[str, Any]

_HEARD = (
    ("finds something", "found", "nothing mean scatter both fault"),
    ("something on the mean", "mean", "nothing scatter"),
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
    by_engine = {engine: [o for o in outcomes if o.get("engine", "") == engine] for engine in engines}
    if len(engines) == 1:
        return "\n".join([*_wide(outcomes), "", *_by_effect(outcomes), "", *_summary(outcomes)])
    lines = ["| case | n | measure | " + " | ".join(engines) + " |", "|---|---|---|" + "---|" * len(engines)]
    for row in dict.fromkeys(o["row"] for o in outcomes):
        mine = [[o for o in by_engine[engine] if o["row"] == row] for engine in engines]
        lines += _side_by_side(row, len(mine[0]), [_row(part) for part in mine])
    totals = [_totals(by_engine[engine]) for engine in engines]
    return "\n".join([*lines, *_side_by_side("all of them", len(by_engine[engines[0]]), totals)])


def _side_by_side(row: str, n: int, columns: Sequence[dict[str, str]]) -> list[str]:
    """One line per measure that any engine has a value of."""
    names = dict.fromkeys(name for column in columns for name, said in column.items() if said != "–")
    return [f"| {row} | {n} | {name} | " + " | ".join(c.get(name, "–") for c in columns) + " |" for name in names]


def _asked(outcomes: Sequence[Outcome], key: str, where: str) -> list[bool]:
    """The flags of those outcomes that are asked for this measure."""
    chosen = [o for o in outcomes if o.get("asks", "mean" if o["hidden"] else "nothing") in where.split()]
    return [o[key] for o in chosen if o.get(key) is not None]


def _row(outcomes: Sequence[Outcome]) -> dict[str, str]:
    """Each measure of a row, as text."""
    out = {name: share(_asked(outcomes, key, where)) for name, key, where in _HEARD}
    seconds = [o["seconds"] for o in outcomes if o.get("seconds") is not None]
    out["seconds"] = f"{np.median(seconds):.2f}" if seconds else "–"
    failed = sum(o["verdict"] == "failed" for o in outcomes)
    return {**out, "failed": str(failed)} if failed else out


def _wide(outcomes: Sequence[Outcome]) -> list[str]:
    names = [name for name, _, _ in _HEARD]
    lines = ["| case | n | " + " | ".join([*names, "seconds"]) + " |", "|---|---|" + "---|" * (len(names) + 1)]
    for row in dict.fromkeys(o["row"] for o in outcomes):
        mine = [o for o in outcomes if o["row"] == row]
        said = _row(mine)
        failed = f" ({said['failed']} failed)" if "failed" in said else ""
        lines.append(f"| {row} | {len(mine)}{failed} | " + " | ".join(said[n] for n in [*names, "seconds"]) + " |")
    return lines


def _totals(outcomes: Sequence[Outcome]) -> dict[str, str]:
    """What is asked over all rows: names stated, what is followed, sets, the gap."""
    said = [(p, right) for o in outcomes for p, right in o["stated"]]
    driven = [o["follows"] for o in outcomes if o.get("follows")]
    sets = [o for o in outcomes if o.get("asks") == "mean" and len(o["hidden"]) == 1 and o["set"]]
    ratios = [o["gap_ratio"] for o in outcomes if o["gap_ratio"] is not None]
    # One name on the mean beside nothing but noise is one too many, whatever its class.
    noise = [o for o in outcomes if o.get("asks") in ("nothing", "scatter")]
    return {
        f"stated {CONFIDENT} or more": str(sum(p >= CONFIDENT for p, _ in said)),
        "of these right": share(right for p, right in said if p >= CONFIDENT),
        f"what it follows, stated {CONFIDENT} or more": str(sum(p >= CONFIDENT for p, _ in driven)),
        "of these followed": share(right for p, right in driven if p >= CONFIDENT),
        "confidently wrong where only noise is": share(o["wrong"] for o in noise),
        "90 % sets hold the truth": share(_holds(o) for o in sets),
        "held out over the oracle, median": f"{np.median(ratios):.3f}" if ratios else "–",
        "worse than before": share(o["worse"] for o in outcomes if o["effects"]),
        "seconds": _row(outcomes)["seconds"],
        "failed": str(sum(o["verdict"] == "failed" for o in outcomes)),
    }


def _holds(outcome: Outcome) -> bool:
    """Whether the first effect's 90 % set of classes has the one that is hidden."""
    true = outcome["hidden"][0].partition("@")[0]
    return any(true in names for names in outcome["classes"])


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
    named = [o for o in outcomes if len(o["hidden"]) == 1 and o["row"].startswith(("one effect", "MU,", "earth"))]
    sets = [o for o in named if o["set"]]
    if sets:
        lines.append(f"\n90 % sets hold the truth: {share(set(o['hidden']) <= set(o['set']) for o in sets)}")
        lines[-1] += f", mean size {np.mean([len(o['set']) for o in sets]):.2f} names"
    sets = [o for o in named if o.get("classes")]
    if sets:
        held = share(any(o["hidden"][0] in names for names in o["classes"]) for o in sets)
        lines.append(f"90 % sets of classes hold the truth: {held}, mean size {_mean_size(sets):.2f} classes")
    places = [o["places"] for o in outcomes if o.get("places") and o["effects"]]
    if places:
        means = [f"{reading} {np.mean([p[reading] for p in places]):.2f}" for reading in places[0]]
        lines.append(f"\nplaces, mean F1 of {len(places)}: {'; '.join(means)}")
    again = [o["again"] for o in outcomes if o["again"]]
    if again:
        settled = share(a["verdict"] == "named" and a["exact"] for a in again)
        lines.append(f"\nambiguous, then measured again as advised: named and right in {settled} of {len(again)}")
    ratios = [o["gap_ratio"] for o in outcomes if o["gap_ratio"] is not None]
    if ratios:
        lines.append(f"\nheld-out mean square over the oracle's, median of {len(ratios)}: {np.median(ratios):.3f}")
        lines[-1] += f"; worse than before in {share(o['worse'] for o in outcomes if o['effects'])}"
    lines += [f"\n{name}: {text}" for name, text in _totals(outcomes).items() if text != "–"]
    return lines


def _mean_size(outcomes: Sequence[Outcome]) -> float:
    return float(np.mean([len(o["classes"]) for o in outcomes]))
