"""Rehearse many nights with random faults, and say what was survived.

    python -m benchmarks.reliability.rehearse --nights 1000 --seed 1

The nights have two temperatures and one self-calibration at each, with the full soak of 45 minutes, on the simulated
bench with its chamber's own timer armed (`dead_man`), because no controller can stop a chamber that does not hear it.
`--sweep` and `--bench` rehearse others, such as your own.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from benchmarks.reliability.rehearsal import Rehearsal, rehearse
from hil.config import Bench, Sweep, load_bench, load_sweep, parse_bench, parse_sweep

_SWEEP = """
title: A rehearsal
temperatures: [23 degC, 40 degC]
self_calibrations_per_temperature: 1
positions: [1, 2, 3]
restabilisation: {at_least: 45 min, window: 10 min, ceiling: 2 h}
collect: {settle: 60 s, duration: 60 s}
final: 23 degC
"""


def sweep() -> Sweep:
    """Two temperatures, a self-calibration at each."""
    return parse_sweep(_SWEEP, "rehearsal.yaml")


def bench() -> Bench:
    """The simulated bench with its chamber's own timer."""
    shipped = load_bench("simulated")
    text = shipped.text.replace(
        "  safe_state: {action: standby}", "  dead_man: 10 min\n  safe_state: {action: standby}"
    )
    return parse_bench(text, shipped.source)


def main() -> None:
    """Rehearse, print one JSON document, and end with 1 where a night was not survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sweep", help="another sweep: the name of a shipped one, or a file")
    parser.add_argument("--bench", help="another simulated bench: the name of a shipped one, or a file")
    parser.add_argument("--nights", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--faults", type=int, nargs=2, default=(1, 5), metavar=("LEAST", "MOST"))
    parser.add_argument("--longest", type=float, help="glitches: no fault lasts longer than so many seconds")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no night after so many")
    parser.add_argument("--keep", type=Path, help="where nights that were not survived are kept")
    asked = parser.parse_args()
    began_s = time.monotonic()
    found: list[Rehearsal] = []
    with tempfile.TemporaryDirectory(prefix="hil-rehearse-") as scratch:
        nights = rehearse(
            load_sweep(asked.sweep) if asked.sweep else sweep(),
            load_bench(asked.bench) if asked.bench else bench(),
            nights=asked.nights,
            seed=asked.seed,
            folder=asked.keep or Path(scratch),
            faults=tuple(asked.faults),
            longest_s=asked.longest,
        )
        for night in nights:
            found.append(night)
            if not night.survived:
                print(json.dumps(night.document(), ensure_ascii=False), file=sys.stderr, flush=True)
            if time.monotonic() - began_s > 60.0 * asked.minutes:
                break
    document = summary(found)
    document["seconds"] = round(time.monotonic() - began_s, 1)
    print(json.dumps(document, indent=1, ensure_ascii=False))
    sys.exit(0 if document["survived"] == document["nights"] else 1)


def summary(found: list[Rehearsal]) -> dict[str, object]:
    """Return the figures: how nights ended and why, and what was wrong."""
    verdicts: Counter[str] = sum((Counter(night.verdicts) for night in found), Counter())
    return {
        "nights": len(found),
        "faults": sum(len(night.faults) for night in found),
        "survived": sum(night.survived for night in found),
        "states": dict(Counter(night.state for night in found)),
        "killed_and_carried_on": sum(night.carried_on > 0 for night in found),
        "safe_at_the_end": sum(night.safe for night in found),
        "reasons": dict(
            Counter(re.split(r"[:(]", night.reason)[0].strip() for night in found if night.state != "complete")
        ),
        "self_calibrations": dict(verdicts),
        "wrong": dict(Counter(re.sub(r"[-+]?[\d.]+", "#", what) for night in found for what in night.wrong)),
    }


if __name__ == "__main__":
    main()
