"""Draw the power curve and the calibration of stated probabilities from kept outcomes.

    python -m benchmarks.blind.score --cases 40 --only singles --keep outcomes.jsonl
    python -m benchmarks.blind.figures outcomes.jsonl --out pictures

The dashed line is what nobody can pass on these designs: a search that knows the noise exactly and looks at the true
column alone, at the same rate of false alarms (a chi-squared test with two amplitudes and non-centrality d squared).
"""

from __future__ import annotations

import argparse
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import beta, chi2, ncx2

from benchmarks.blind.jobs import SIZES

_TESTS = 60  # effectively independent names and shapes among which the search chooses
_BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0001)


def interval(right: int, n: int) -> tuple[float, float]:
    """Exact 95 % interval of a proportion."""
    low = float(beta.ppf(0.025, right, n - right + 1)) if right else 0.0
    return low, float(beta.ppf(0.975, right + 1, n - right)) if right < n else 1.0


def bound(d: float, alpha: float) -> float:
    """Power of the test that knows column and noise, at the level that a search over `_TESTS` names needs."""
    return float(ncx2.sf(chi2.isf(alpha / _TESTS, 2), 2, d**2))


def power(outcomes: list[dict[str, Any]]) -> Figure:
    """How often the first class is right, against the size of the hidden effect."""
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for group, label, marker in (("one effect", "one effect", "o"), ("triad, g", "triad, g-sensitivity", "s")):
        points = []
        for d in SIZES:
            mine = [o["first"] for o in outcomes if o["row"].startswith(group) and o["d"] == d]
            if mine:
                points.append((d, sum(mine) / len(mine), *interval(sum(mine), len(mine))))
        if points:
            x, y, low, high = np.array(points).T
            axes.errorbar(x, y, [y - low, high - y], marker=marker, capsize=3, label=label)
    alpha = outcomes[0]["alpha"]
    fine = np.linspace(2.0, 12.0, 100)
    axes.plot(fine, [bound(d, alpha) for d in fine], "k--", label="knows noise and column")
    axes.set(
        xlabel="size of the hidden effect beside the base, d / sigma", ylabel="first class right", ylim=(0.0, 1.02)
    )
    axes.legend(loc="lower right")
    axes.grid(alpha=0.3)
    return figure


def calibration(outcomes: list[dict[str, Any]]) -> Figure:
    """How often a name is right, against the probability that was stated for it."""
    figure = Figure(figsize=(4.5, 4.5), layout="constrained")
    axes = figure.subplots()
    said = [(p, right) for o in outcomes for p, right in o["stated"]]
    for low, high in pairwise(_BINS):
        inside = [(p, right) for p, right in said if low <= p < high]
        if inside:
            n, right = len(inside), sum(r for _, r in inside)
            x, y = float(np.mean([p for p, _ in inside])), right / n
            bottom, top = interval(right, n)
            axes.errorbar([x], [y], [[y - bottom], [top - y]], marker="o", capsize=3, color="C0")
            axes.annotate(str(n), (x, y), xytext=(6, -10), textcoords="offset points", fontsize=8)
    axes.plot([0, 1], [0, 1], "k--", lw=1)
    axes.set(xlabel="probability stated for the name", ylabel="share that is right", xlim=(0, 1.02), ylim=(0, 1.02))
    axes.grid(alpha=0.3)
    return figure


def main() -> None:
    """Write power.svg and calibration.svg."""
    parser = argparse.ArgumentParser(description="Draw what the blind benchmark measured.")
    parser.add_argument("kept", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=Path("pictures"))
    chosen = parser.parse_args()
    outcomes = [json.loads(line) for path in chosen.kept for line in path.read_text().splitlines()]
    chosen.out.mkdir(parents=True, exist_ok=True)
    power(outcomes).savefig(chosen.out / "power.svg")
    calibration(outcomes).savefig(chosen.out / "calibration.svg")


if __name__ == "__main__":
    main()
