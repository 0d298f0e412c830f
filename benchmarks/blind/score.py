"""Score the discrepancy workflow on sealed cases, once, and print the tables of docs/reconcile-benchmark.md.

    python -m benchmarks.blind.score --cases 40                          # everything, 40 cases per row
    python -m benchmarks.blind.score --only nulls --cases 200 --alpha 0.01
    python -m benchmarks.blind.score --only singles --cases 40 --keep outcomes.jsonl

Each case is written as a campaign folder, read back, reconciled with the public function, and compared with its truth
here, where the workflow cannot see it. `--keep` adds one line of JSON per case to a file; `--tables FILE` prints the
tables of such a file again.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.cases import make_case, write_case
from benchmarks.blind.jobs import GROUPS, Job
from benchmarks.blind.judge import (
    CONFIDENT,
    all_right,
    confidently_wrong,
    first_is_right,
    follow_up,
    ninety_percent_classes,
    ninety_percent_set,
    oracle_gap,
    places_f1,
    share,
    stated,
)
from benchmarks.blind.poses import write_triad

AGAIN = "measured again as advised"


def reconcile_job(job: Job) -> dict[str, Any]:
    """Make the case, write it, read it, reconcile it; return the document, with what the truth says of it."""
    from hil.campaign.reader import read_campaign
    from hil.reconcile import reconcile

    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "case"
        if job.triad:
            write_triad(job.seed, job.d if job.hidden else 0.0, folder)
        else:
            case = make_case(job.seed, job.hidden, job.d, model=job.model, design=job.design, noise=job.noise)
            write_case(case, folder)
        document = dict(reconcile(read_campaign(folder), job.model, alpha=job.alpha).document())
    again = None if job.triad or job.row == AGAIN else follow_up(job, document)
    if job.follow and again:
        document["again"] = outcome(again, reconcile_job(again))
    if not job.triad:
        document["kept"] = case.kept
        document["oracle_deg_per_hr"] = oracle_gap(case, job) if case.signals else None
        document["places"] = places_f1(document, case, job) if case.signals else None
    return document


def outcome(job: Job, document: dict[str, Any]) -> dict[str, Any]:
    """What one case came to, as one line of the kept file."""
    gap = document["gap"]
    return {
        "row": job.row,
        "seed": job.seed,
        "alpha": job.alpha,
        "d": job.d,
        "model": job.model,
        "positions": len(job.design.positions),
        "hidden": list(job.hidden),
        "kept": list(document.get("kept", ())),
        "verdict": document["verdict"],
        "effects": [(e["id"], round(e["probability"], 4)) for e in document["effects"]],
        "found": document["verdict"] != "none",
        "first": first_is_right(document, job.hidden),
        "exact": all_right(document, job.hidden),
        "wrong": confidently_wrong(document, job.hidden),
        "empirical": document["verdict"] == "empirical",
        "stated": stated(document, job.hidden),
        "set": sorted(ninety_percent_set(document)),
        "classes": ninety_percent_classes(document),
        "gap_ratio": _ratio(document),
        "worse": gap["after"] > gap["before"] * 1.001,
        "places": document.get("places"),
        "advice": (document["next_experiment"] or {}).get("what", "none" if document["verdict"] == "ambiguous" else ""),
        "again": document.get("again"),
    }


def _ratio(document: dict[str, Any]) -> float | None:
    """Held-out mean square after, over that of one who knows the truth."""
    oracle, after = document.get("oracle_deg_per_hr"), document["gap"]["after"]
    return (after / oracle) ** 2 if oracle and after and document["effects"] else None


def tables(outcomes: Sequence[dict[str, Any]]) -> str:
    """The tables, as Markdown."""
    lines = [
        "| case | n | finds something | first class right | all right | confidently wrong | empirical |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in dict.fromkeys(o["row"] for o in outcomes):
        mine = [o for o in outcomes if o["row"] == row]
        cells = [share(o[key] for o in mine) for key in ("found", "first", "exact", "wrong", "empirical")]
        lines.append(f"| {row} | {len(mine)} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", *_by_effect(outcomes), "", *_summary(outcomes)])


def _by_effect(outcomes: Sequence[dict[str, Any]]) -> list[str]:
    """Of the single effects at d of 8 and more: how often the first class is right, by effect."""
    mine = [o for o in outcomes if o["row"].startswith("one effect") and o["d"] >= 8.0]
    lines = ["| one effect, d = 8 and 12 | n | first class right |", "|---|---|---|"] if mine else []
    for name in sorted({o["hidden"][0] for o in mine}):
        of_name = [o for o in mine if o["hidden"][0] == name]
        lines.append(f"| {name} | {len(of_name)} | {share(o['first'] for o in of_name)} |")
    return lines


def _summary(outcomes: Sequence[dict[str, Any]]) -> list[str]:
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
    lines.append(f"\nstated {CONFIDENT} or more is right: {share(r for p, r in said if p >= CONFIDENT)}")
    return lines


def _mean_size(outcomes: Sequence[dict[str, Any]]) -> float:
    return float(np.mean([len(o["classes"]) for o in outcomes]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the chosen groups and print the tables."""
    parser = argparse.ArgumentParser(description="Score the discrepancy workflow on sealed cases.")
    parser.add_argument("--cases", type=int, default=20, help="cases per row")
    parser.add_argument("--only", choices=sorted(GROUPS), action="append")
    parser.add_argument("--seed", type=int, default=0, help="added to every case's seed: fresh sealed cases")
    parser.add_argument("--alpha", type=float, default=0.05, help="false-alarm rate that the search is asked for")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="add one line of JSON per case to this file")
    parser.add_argument("--tables", type=Path, nargs="+", help="print the tables of kept files, and run nothing")
    parser.add_argument("--follow", action="store_true", help="measure ambiguous cases again, as the result advises")
    parser.add_argument("--verbose", action="store_true", help="one line per case")
    chosen = parser.parse_args(arguments)
    if chosen.tables:
        lines = [line for path in chosen.tables for line in path.read_text().splitlines()]
        print(tables([json.loads(line) for line in lines]))
        return
    jobs = [job for group in chosen.only or GROUPS for job in GROUPS[group](chosen.cases)]
    given = {"alpha": chosen.alpha, "follow": chosen.follow}
    jobs = [replace(job, seed=job.seed + chosen.seed, **given) for job in jobs]
    outcomes = []
    with ProcessPoolExecutor(chosen.processes) as pool:
        for job, document in zip(jobs, pool.map(reconcile_job, jobs, chunksize=1), strict=True):
            outcomes.append(outcome(job, document))
            if chosen.keep:
                with chosen.keep.open("a") as file:
                    file.write(json.dumps(outcomes[-1]) + "\n")
            if chosen.verbose:
                o = outcomes[-1]
                print(job.row, job.seed, job.hidden, o["kept"], o["verdict"], o["effects"], o["set"], file=sys.stderr)
    print(tables(outcomes))


if __name__ == "__main__":
    main()
