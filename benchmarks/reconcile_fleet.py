"""Screen a fleet of simulated units whole: how long it takes, and whether its error rates are what they are said to be.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.reconcile_fleet --units 10000
    OPENBLAS_NUM_THREADS=1 python -m benchmarks.reconcile_fleet --units 100000 --file fleet.parquet --workers 2

24 runs of four collects each, every unit with a noise of its own (collects 0.9 deg/hr, give or take a third; runs 1.3
deg/hr, give or take a half; correlated .2 to .9 from run to run). A tenth of the units lacks a supply effect where
`--faulty` is asked for; nothing is missing from the others.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

import numpy as np

from hil.campaign import Campaign
from hil.campaign.fleet_file import write_fleet_file
from hil.reconcile.campaigns import screen_folders
from hil.reconcile.fleet import Screen
from tests.hil.reconcile.hidden_effects import base_rates, both, campaign_of, lay_out, noise

ROWS = lay_out(np.random.default_rng(0), runs_each=3)
EVERY = 10
LEVEL = 0.05


def unit(seed: int, size_deg_per_hr_per_v: float = 0.0) -> Campaign:
    """One unit with its own noise, and a supply effect of this size on both channels."""
    rng = np.random.default_rng(seed)
    own = {"sigma": 0.9 * np.exp(0.3 * rng.normal()), "run_bias": 1.3 * np.exp(0.5 * rng.normal())}
    errors = noise(ROWS, rng, rho=float(rng.uniform(0.2, 0.9)), **own)
    effect = both(ROWS.supply - 28.0, size_deg_per_hr_per_v, -size_deg_per_hr_per_v)
    return campaign_of(ROWS, base_rates(ROWS) + errors + effect)


def fleet_rates(screen: Screen, seed: int, size: float, fleets: int, units: int) -> str:
    """False discoveries, power and the pooled test over fleets of which a tenth lacks a supply effect of this size."""
    false, right, shared = [], [], []
    for k in range(fleets):
        campaigns = [unit(seed + k * units + i, size * (i % EVERY == 0)) for i in range(units)]
        weighed = screen.weigh([screen.rates(each) for each in campaigns])
        findings = screen.asked.findings(weighed)
        found = [i for i, finding in enumerate(findings) if finding.q_value < LEVEL]
        wrong = sum(size == 0.0 or i % EVERY != 0 for i in found)
        false.append(wrong / max(len(found), 1))
        right.append((len(found) - wrong) / (units // EVERY))
        together = screen.asked.in_common(screen.asked.mixed(weighed)[None], units)
        shared.append(together.p_value < LEVEL and (size == 0.0 or together.name == "supply"))
    power = "" if size == 0.0 else f", faulty units found {np.mean(right):.3f}"
    return f"false discoveries {np.mean(false):.3f}{power}, shared effect found {np.mean(shared):.3f}"


def from_file(path: Path, units: int, seed: int, workers: int) -> str:
    """Screen a file of units, which is written where it is not there, and say what it took."""
    if not path.exists():
        write_fleet_file(((f"u{i}", unit(seed + i)) for i in range(units)), path)
    start, before = time.perf_counter(), time.process_time()
    found = screen_folders([path], "matrix-6-thermal", workers)
    whole, own = time.perf_counter() - start, time.process_time() - before
    most = [resource.getrusage(who).ru_maxrss / 1e6 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    theirs = resource.getrusage(resource.RUSAGE_CHILDREN)
    size, called = path.stat().st_size / 1e6, sum(each.worth for each in found.units)
    return (
        f"{size:.0f} MB, {len(found.units)} units by {workers} workers: {whole:.0f} s ({own:.0f} s of processor "
        f"time, of the workers {theirs.ru_utime + theirs.ru_stime:.0f} s), {called} called; "
        f"most memory {most[0]:.2f} GB, of a worker {most[1]:.2f} GB"
    )


def main() -> None:
    """Time a fleet, then count what is found in fleets with and without a fault."""
    parser = argparse.ArgumentParser(description="Screen a fleet of simulated units.")
    parser.add_argument("--units", type=int, default=10_000, help="units of the fleet that is timed")
    parser.add_argument("--fleets", type=int, default=40, help="fleets of fifty units whose discoveries are counted")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--file", type=Path, help="a Parquet file to be screened, made of so many units if not there")
    parser.add_argument("--workers", type=int, default=1)
    chosen = parser.parse_args()
    if chosen.file is not None:
        print(from_file(chosen.file, chosen.units, chosen.seed, chosen.workers))
        return
    campaigns = [unit(chosen.seed + i) for i in range(chosen.units)]
    start = time.process_time()
    screen = Screen.of(campaigns, "matrix-6-thermal")
    layout = time.process_time() - start
    findings = screen.units(campaigns)
    whole = time.process_time() - start
    each = 1e3 * (whole - layout) / chosen.units
    print(f"layout {layout:.1f} s; {chosen.units} units {whole - layout:.1f} s, {each:.2f} ms each; all {whole:.1f} s")
    p_values = np.array([finding.p_value for finding in findings])
    shares = ", ".join(f"below {p:g}: {np.mean(p_values < p):.4f}" for p in (0.05, 0.01, 0.001))
    print(f"p-values of these units, from which nothing is missing: {shares}")
    print(f"discovered among them at q < {LEVEL}: {sum(f.q_value < LEVEL for f in findings)}")
    for size in (0.0, 4.0, 6.0, 8.0, 12.0):
        said = fleet_rates(screen, chosen.seed + 1_000_000, size, chosen.fleets, 50)
        print(f"{chosen.fleets} fleets of 50, {size:g} deg/hr/V in a tenth: {said}")


if __name__ == "__main__":
    main()
