"""Score the discrepancy workflow on sealed cases, once, and print the tables of docs/reconcile-benchmark.md.

    python -m benchmarks.blind.score --cases 40                          # what the tables ask for, 40 cases a row
    python -m benchmarks.blind.score --only nulls --cases 200 --alpha 0.01
    python -m benchmarks.blind.score --only singles --cases 40 --keep outcomes.jsonl
    python -m benchmarks.blind.score --only slow --engine new=NEW:reconcile --engine old=hil.reconcile:reconcile@../old

Each case is written as a campaign folder, read back, reconciled with the public function, and compared with its truth
here, where the workflow cannot see it. Engines that are named are given the same files, and stand side by side; one may
be of another checkout.
`--keep` adds one line of JSON per case and engine to a file; `--tables FILE` prints the tables of such a file again.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.cases import Case, make_case, write_case
from benchmarks.blind.engines import TODAY, answer, label
from benchmarks.blind.jobs import GROUPS, Job
from benchmarks.blind.judge import (
    CONFIDENT,
    all_right,
    confidently_wrong,
    false_alarm,
    first_is_right,
    follow_up,
    followed,
    in_the_noise,
    kind_hidden,
    listed,
    ninety_percent_classes,
    ninety_percent_set,
    on_the_mean,
    oracle_gap,
    places_f1,
    scatter_named,
    stated,
    told,
)
from benchmarks.blind.poses import write_quiet_triad, write_triad
from benchmarks.blind.real import write_real
from benchmarks.blind.tables import tables
from benchmarks.blind.wider import WIDER

AGAIN = "measured again as advised"
_MANY_ROWS = 500
"""Rows from which one who knows the truth is not asked: it takes their cube."""


@dataclass(frozen=True)
class Sealed:
    """What is known of a case that was written. What is not made from a bench's night has no `case`."""

    case: Case | None = None
    collects: frozenset[int] = frozenset()  # that are spoiled, where not all are
    runs: frozenset[int] = frozenset()


def sealed(job: Job, folder: Path) -> Sealed:
    """Make the case of a job and write it."""
    mistake = next(iter(job.hidden), "")
    if job.form == "triad":
        write_triad(job.seed, job.d if job.hidden else 0.0, folder)
        return Sealed()
    if job.form == "quiet triad":
        _, collect = write_quiet_triad(job.seed, mistake, folder)
        return Sealed(collects=frozenset() if collect is None else frozenset({collect}))
    if job.form == "log":
        write_real(job.seed, job.log, job.hidden, job.d, folder)
        return Sealed()
    case = make_case(
        job.seed,
        job.hidden,
        job.d,
        model=job.model,
        design=job.design,
        noise=job.noise,
        times_white=job.times_white,
    )
    write_case(case, folder, without=job.without)
    if case.spoiled.all():
        return Sealed(case)
    rows = np.flatnonzero(case.spoiled)
    return Sealed(case, frozenset((rows + 1).tolist()), frozenset(case.night.run[rows].tolist()))


def judged(job: Job, known: Sealed, document: dict[str, Any], engine: str = TODAY) -> dict[str, Any]:
    """The document, with what the truth says of it; where asked for, with the case measured again as it advises."""
    case = known.case
    again = None if case is None or job.row == AGAIN or not job.follow else follow_up(job, document)
    if again:
        document["again"] = outcome(again, reconcile_job(again, engine))
    if case is not None:
        few = bool(case.hidden) and len(case.night) < _MANY_ROWS
        document["kept"] = case.kept
        # What a mistake does to one run cannot be foretold from the others, whoever knows that it is there.
        foretold = few and not case.spoiled.any()
        document["oracle_deg_per_hr"] = oracle_gap(case, job) if foretold else None
        document["places"] = places_f1(document, case, job) if few and case.signals else None
    document["told"] = told(document, known.collects, known.runs)
    return document


def reconcile_job(job: Job, engine: str = TODAY) -> dict[str, Any]:
    """Make the case, write it, read it, reconcile it; return the document, with what the truth says of it."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "case"
        known = sealed(job, folder)
        document = answer(engine, folder, job.model, job.alpha)
    return judged(job, known, document, engine)


def outcomes(job: Job, engines: Sequence[str]) -> list[dict[str, Any]]:
    """One line for each engine, all of them on the same files; what an engine raises is its answer."""
    out = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "case"
        known = sealed(job, folder)
        for engine in engines:
            try:
                line = outcome(job, judged(job, known, answer(engine, folder, job.model, job.alpha), engine))
            except Exception as error:  # an engine on trial may fail: that is a result, and the others go on
                line = {**_FAILED, "error": f"{type(error).__name__}: {error}", **_of_job(job)}
            out.append({"engine": label(engine), **line})
    return out


def _of_job(job: Job) -> dict[str, Any]:
    return {
        "row": job.row,
        "seed": job.seed,
        "alpha": job.alpha,
        "d": job.d,
        "model": job.model,
        "positions": len(job.design.positions),
        "hidden": list(job.hidden),
        "asks": kind_hidden(job.hidden),
    }


def outcome(job: Job, document: dict[str, Any]) -> dict[str, Any]:
    """What one case came to, as one line of the kept file."""
    gap, pointed, noise = document["gap"], bool(document.get("told")), in_the_noise(job)
    scatter = scatter_named(document, job.hidden)
    return {
        **_of_job(job),
        "kept": list(document.get("kept", ())),
        "verdict": document["verdict"],
        "effects": [(e["id"], round(e["probability"], 4)) for e in document["effects"]],
        "found": document["verdict"] != "none" or (pointed and kind_hidden(job.hidden) == "fault"),
        "alarm": false_alarm(document, job),
        "mean": on_the_mean(document, job.hidden),
        "sure": on_the_mean(document, job.hidden, CONFIDENT),
        "listed": listed(document, job.hidden),
        "first": first_is_right(document, job.hidden),
        "exact": all_right(document, job.hidden, noise),
        "wrong": confidently_wrong(document, job.hidden, pointed=pointed, noise=noise),
        "empirical": document["verdict"] == "empirical",
        "scatter": None if scatter is None else scatter[0],
        "kin": None if scatter is None else scatter[1],
        "told": document.get("told"),
        "follows": followed(document, job.hidden, noise),
        "stated": stated(document, job.hidden, pointed=pointed, noise=noise),
        "set": sorted(ninety_percent_set(document)),
        "classes": ninety_percent_classes(document),
        "gap_ratio": _ratio(document),
        "worse": bool(gap["before"] and gap["after"] and gap["after"] > gap["before"] * 1.001),
        "under": None if not gap["after"] else gap["after"] < 0.999 * gap["noise_floor"],
        "places": document.get("places"),
        "advice": (document["next_experiment"] or {}).get("what", "none" if document["verdict"] == "ambiguous" else ""),
        "again": document.get("again"),
        "seconds": document.get("seconds"),
    }


_FAILED: dict[str, Any] = {
    **dict.fromkeys(("kept", "effects", "stated", "set", "classes"), ()),
    **dict.fromkeys(("found", "mean", "sure", "listed", "first", "exact", "wrong", "empirical", "worse"), False),
    **dict.fromkeys(("alarm", "scatter", "kin", "told", "follows", "gap_ratio", "under", "places", "again", "seconds")),
    "verdict": "failed",
    "advice": "",
}


def _ratio(document: dict[str, Any]) -> float | None:
    """Held-out mean square after, over that of one who knows the truth."""
    oracle, after = document.get("oracle_deg_per_hr"), document["gap"]["after"]
    return (after / oracle) ** 2 if oracle and after and document["effects"] else None


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the chosen groups and print the tables."""
    parser = argparse.ArgumentParser(description="Score the discrepancy workflow on sealed cases.")
    parser.add_argument("--cases", type=int, default=20, help="cases per row")
    parser.add_argument("--only", choices=sorted({**GROUPS, **WIDER}), action="append")
    parser.add_argument("--seed", type=int, default=0, help="added to every case's seed: fresh sealed cases")
    parser.add_argument("--alpha", type=float, default=0.05, help="false-alarm rate that the search is asked for")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="add one line of JSON per case to this file")
    parser.add_argument("--tables", type=Path, nargs="+", help="print the tables of kept files, and run nothing")
    parser.add_argument("--follow", action="store_true", help="measure ambiguous cases again, as the result advises")
    parser.add_argument(
        "--engine",
        action="append",
        metavar="[LABEL=]MODULE:FUNCTION[@CHECKOUT]",
        help=f"who is judged, {TODAY}; of another checkout in a process of its own; twice: side by side",
    )
    parser.add_argument("--verbose", action="store_true", help="one line per case")
    chosen = parser.parse_args(arguments)
    if chosen.tables:
        lines = [line for path in chosen.tables for line in path.read_text().splitlines()]
        print(tables([json.loads(line) for line in lines]))
        return
    groups = {**GROUPS, **WIDER}
    jobs = [job for group in chosen.only or GROUPS for job in groups[group](chosen.cases)]
    given = {"alpha": chosen.alpha, "follow": chosen.follow}
    jobs = [replace(job, seed=job.seed + chosen.seed, **given) for job in jobs]
    engines, lines = chosen.engine or [TODAY], []
    with ProcessPoolExecutor(chosen.processes) as pool:
        for done in pool.map(partial(outcomes, engines=engines), jobs, chunksize=1):
            lines += done
            if chosen.keep:
                with chosen.keep.open("a") as file:
                    file.writelines(json.dumps(o) + "\n" for o in done)
            for o in done if chosen.verbose else ():
                said = o.get("error", f"{o['verdict']} {o['effects']} {o['set']}")
                print(o["engine"], o["row"], o["seed"], o["hidden"], o["kept"], said, file=sys.stderr)
    print(tables(lines))


if __name__ == "__main__":
    main()
