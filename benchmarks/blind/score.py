"""Score the discrepancy workflow on sealed cases, once, and print the tables of docs/reconcile-benchmark.md.

    python -m benchmarks.blind.score --cases 40            # everything, 40 cases per row
    python -m benchmarks.blind.score --only nulls --cases 200

Each case is written as a campaign folder, read back, reconciled with the public function, and compared with its truth
here, where the workflow cannot see it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scipy.stats import beta

from benchmarks.blind.cases import CATALOGUE, OUTSIDE, Noise, make_case, write_case
from benchmarks.blind.night import Design

UP_AND_DOWN = (-29.7, -6.8, 23.4, 48.9, 60.0, 37.8, 6.3, -14.4)
FOUR = Design(temperatures_degC=UP_AND_DOWN, positions=("1", "2", "3", "4"))
HEADINGS = Design(temperatures_degC=UP_AND_DOWN, positions=("1", "2", "3", "4"), headings_deg=(30.0, 120.0, 210.0))
CONFIDENT = 0.8
PLAIN = Noise()


@dataclass(frozen=True)
class Job:
    """One sealed case to be reconciled."""

    row: str
    seed: int
    hidden: tuple[str, ...] = ()
    d: float = 8.0
    model: str = "matrix-6-thermal"
    design: Design = FOUR
    noise: Noise = PLAIN


def reconcile_job(job: Job) -> dict[str, Any]:
    """Make the case, write it, read it, reconcile it; return the document."""
    from hil.campaign_reader import read_campaign
    from hil.reconcile import reconcile

    case = make_case(job.seed, job.hidden, job.d, model=job.model, design=job.design, noise=job.noise)
    with tempfile.TemporaryDirectory() as scratch:
        folder = write_case(case, Path(scratch) / "case")
        return dict(reconcile(read_campaign(folder), job.model).document())


def named_ids(document: dict[str, Any]) -> list[set[str]]:
    """For each added effect, its id and those that the result calls the same within the data (overlap above .95)."""
    out = []
    for effect in document["effects"]:
        same = {rival["id"] for rival in effect["confusable_with"] if rival.get("overlap", 0.0) > 0.95}
        out.append({effect["id"]} | same)
    return out


def first_is_right(document: dict[str, Any], hidden: Sequence[str]) -> bool:
    """Whether the first effect's class holds a hidden one."""
    classes = named_ids(document)
    return bool(classes) and any(name in classes[0] for name in hidden)


def all_right(document: dict[str, Any], hidden: Sequence[str]) -> bool:
    """Whether exactly the hidden effects were found, each by its class."""
    classes = named_ids(document)
    return len(classes) == len(hidden) and all(any(name in c for c in classes) for name in hidden)


def confidently_wrong(document: dict[str, Any], hidden: Sequence[str]) -> bool:
    """Whether any effect is named at .8 or more that is not hidden."""
    if document["verdict"] != "named":
        return False
    return any(
        effect["probability"] >= CONFIDENT and not ids & set(hidden)
        for effect, ids in zip(document["effects"], named_ids(document), strict=True)
    )


def share(flags: Iterable[bool]) -> str:
    """A proportion with its exact 95 % interval."""
    values = list(flags)
    k, n = sum(values), len(values)
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return f"{k / n:.3f} [{low:.3f}, {high:.3f}]"


NULLS = {kind: Noise(kind=kind) for kind in ("plain", "white", "heavy", "walk", "run_mu", "cold", "row_ar")}


def null_jobs(cases: int) -> list[Job]:
    """Campaigns in which nothing is missing, by kind of noise."""
    return [Job(kind, 10_000 + i, noise=noise) for kind, noise in NULLS.items() for i in range(cases)]


def single_jobs(cases: int) -> list[Job]:
    """One catalogue effect hidden, at four sizes, effects in turn."""
    names = [name for name in CATALOGUE if name not in {"MU_real", "earth"}]
    jobs = [
        Job(f"d = {d:g}", 20_000 + i, (names[i % len(names)],), d) for d in (4.0, 6.0, 8.0, 12.0) for i in range(cases)
    ]
    return jobs + [Job("earth, three headings", 25_000 + i, ("earth",), 8.0, design=HEADINGS) for i in range(cases)]


def double_jobs(cases: int) -> list[Job]:
    """Two catalogue effects at d = 8 each."""
    names = [name for name in CATALOGUE if name not in {"MU_real", "earth"}]
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    return [Job("doubles, d = 8", 30_000 + i, pairs[(7 * i) % len(pairs)]) for i in range(cases)]


def outside_jobs(cases: int) -> list[Job]:
    """Effects that no catalogue entry describes."""
    return [Job(name, 40_000 + i, (name,), 10.0) for name in OUTSIDE for i in range(cases)]


def report_jobs(cases: int) -> list[Job]:
    """The report's own case: the contractor's model, MU hidden, three and four collects."""
    three = [Job("MU, three collects", 50_000 + i, ("MU_real",), 30.0, "collins-4", Design()) for i in range(cases)]
    four = [Job("MU, four collects", 50_000 + i, ("MU_real",), 30.0, "collins-4", FOUR) for i in range(cases)]
    return three + four


def hard_jobs(cases: int) -> list[Job]:
    """Few runs, many missing rows."""
    eight = Design(temperatures_degC=(-20.0, 0.0, 20.0, 60.0), runs_per_temperature=2, positions=("1", "2", "3", "4"))
    holes = Design(temperatures_degC=UP_AND_DOWN, positions=("1", "2", "3", "4"), missing=0.3)
    return [
        job
        for i in range(cases)
        for job in (
            Job("8 runs, nothing hidden", 60_000 + i, (), model="matrix-6", design=eight),
            Job("30 % missing, nothing hidden", 61_000 + i, (), design=holes),
            Job("30 % missing, supply at d = 8", 62_000 + i, ("supply",), 8.0, design=holes),
        )
    ]


GROUPS: dict[str, Callable[[int], list[Job]]] = {
    "nulls": null_jobs,
    "singles": single_jobs,
    "doubles": double_jobs,
    "outside": outside_jobs,
    "report": report_jobs,
    "hard": hard_jobs,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the chosen groups on two processes and print one table each."""
    parser = argparse.ArgumentParser(description="Score the discrepancy workflow on sealed cases.")
    parser.add_argument("--cases", type=int, default=20, help="cases per row")
    parser.add_argument("--only", choices=sorted(GROUPS), action="append")
    parser.add_argument("--seed", type=int, default=0, help="added to every case's seed: fresh sealed cases")
    parser.add_argument("--verbose", action="store_true", help="one line per case")
    chosen = parser.parse_args(arguments)
    with ProcessPoolExecutor(2) as pool:
        for group in chosen.only or GROUPS:
            jobs = [Job(**{**vars(job), "seed": job.seed + chosen.seed}) for job in GROUPS[group](chosen.cases)]
            documents = list(pool.map(reconcile_job, jobs, chunksize=1))
            if chosen.verbose:
                for job, document in zip(jobs, documents, strict=True):
                    found = [(e["id"], round(e["probability"], 2)) for e in document["effects"]]
                    print(job.row, job.seed, job.hidden, document["verdict"], found, file=sys.stderr)
            print(f"\n### {group}\n")
            print("| case | n | finds something | first class right | all right | confidently wrong | empirical |")
            print("|---|---|---|---|---|---|---|")
            for row in dict.fromkeys(job.row for job in jobs):
                print(_row(row, [(j, d) for j, d in zip(jobs, documents, strict=True) if j.row == row]))


def _row(name: str, pairs: list[tuple[Job, dict[str, Any]]]) -> str:
    cells = (
        share(d["verdict"] != "none" for _, d in pairs),
        share(first_is_right(d, j.hidden) for j, d in pairs),
        share(all_right(d, j.hidden) for j, d in pairs),
        share(confidently_wrong(d, j.hidden) for j, d in pairs),
        share(d["verdict"] == "empirical" for _, d in pairs),
    )
    return f"| {name} | {len(pairs)} | " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
