"""How often hil twin tells a night from nights of the true model, at a level of 5 %: it should be in 3 to 7 of 100.

    python -m benchmarks.twin_calibration --nights 200                # the true model's file, values drawn about it
    python -m benchmarks.twin_calibration --nights 200 --model built-in  # the true form, fitted to each night first
    python -m benchmarks.twin_calibration --nights 200 --model reconciled   # what reconcile writes of each night
    python -m benchmarks.twin_calibration --nights 20 --bytes         # the first, every night through bytes

Without --bytes a night is its averages, drawn directly: collects, noise, refits and p-values are those of the command.
Beside the rate and its exact interval it says how the p-values lie: Kolmogorov-Smirnov against uniform, with those of a
rank spread over its step. Nights have their own seeds, so that runs from another --first add up.
"""

from __future__ import annotations

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.stats import binomtest, kstest

from hil.campaign import Campaign
from hil.config import load_bench, load_sweep
from hil.config.sweep import parse_sweep
from hil.likeness import likeness
from hil.likeness.draws import drawn_model, fitted, night_of_averages
from hil.likeness.features import features
from hil.likeness.verdict import verdict
from hil.model import load_model
from hil.night import start_night
from hil.reconcile import reconcile
from hil.records.export import open_source

DRAWS = 20
TRUTH = "rd-gc-86-1-truth"


def one(number: int, *, start: Campaign, how: str) -> float:
    """The p-value of one night drawn from the truth, beside nights drawn from the model."""
    rng = np.random.default_rng([number, 23])
    truth = load_model(TRUTH)
    if how == "built-in":  # values that do not follow temperature, and no noise but the errors'
        truth = fitted(start, load_model("matrix-6"), calibrated=False)
    measured = night_of_averages(start, truth, rng)
    model, calibrated = truth, how != "built-in"
    if how == "built-in":
        model = fitted(measured, load_model("matrix-6"), calibrated=False)
    if how == "reconciled":
        result = reconcile(measured, "matrix-6", prove=False)
        model, calibrated = result.model_after, result.calibration == "per temperature"
    if how == "before":
        model = fitted(measured, load_model("matrix-6"), calibrated=True)
    form = model.model_copy(update={"sensors": {}})
    nights = [measured]
    for _ in range(DRAWS):
        values = drawn_model(model, measured, form, rng, calibrated=calibrated)
        nights.append(night_of_averages(start, values, rng))
    return float(verdict([features(each, form, calibrated=calibrated) for each in nights])["p_value"])


def through_bytes(number: int) -> float:
    """The p-value of one simulated night beside nights of the model that simulated it."""
    text = load_sweep("rd-gc-86-1").text.replace(
        "temperatures: [-21.5 degF, 6.1 degF, 19.7 degF, 43.3 degF, 74.1", "temperatures: [74.1"
    )
    with tempfile.TemporaryDirectory(prefix="hil-") as name:
        folder = Path(name)
        start_night(folder / "night", parse_sweep(text, "sweep.yaml"), load_bench("simulated"), seed=10_000 + number)
        found = likeness(folder / "night", load_model(TRUTH), draws=DRAWS, seed=number, keep=folder / "kept", workers=1)
    return float(found["p_value"])


def main() -> None:
    """Print the rate and the distribution."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--nights", type=int, default=200)
    options.add_argument("--model", choices=("true", "built-in", "reconciled", "before"), default="true")
    options.add_argument("--bytes", action="store_true")
    options.add_argument("--first", type=int, default=0, help="the seed of the first night; others follow")
    options.add_argument("--workers", type=int, help="processes; one for each core otherwise")
    asked = options.parse_args()
    with tempfile.TemporaryDirectory(prefix="hil-") as name:
        start_night(Path(name) / "night", load_sweep("rd-gc-86-1"), load_bench("simulated"), seed=1)
        start = replace(open_source(Path(name) / "night"), recorded={})
    job = through_bytes if asked.bytes else partial(one, start=start, how=asked.model)
    with ProcessPoolExecutor(asked.workers) as pool:
        found = np.array(list(pool.map(job, range(asked.first, asked.first + asked.nights))))
    told = int(np.sum(found < 0.05))
    within = binomtest(told, len(found)).proportion_ci()
    print(f"{asked.model}{', through bytes' if asked.bytes else ''}: told apart at 5 %: {told} of {len(found)}", end="")
    print(f", {within.low:.1%} to {within.high:.1%}")
    step = 1.0 / (DRAWS + 1)
    spread = found - np.where(found > step, step * np.random.default_rng(asked.first).random(len(found)), 0.0)
    print(f"p-values against uniform (Kolmogorov-Smirnov): p = {kstest(spread, 'uniform').pvalue:.2g}")
    print(
        "quantiles 0, 5, 25, 50, 75, 100 %:",
        *(f"{each:.2g}" for each in np.quantile(found, [0, 0.05, 0.25, 0.5, 0.75, 1])),
    )


if __name__ == "__main__":
    main()
