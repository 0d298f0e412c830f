"""Two faults at a time, and a device that lies from any step on: nobody is left without a word.

    python -m benchmarks.reliability.combined pairs --take 200 --seed 1   # of all pairs of kinds of fault
    python -m benchmarks.reliability.combined lies                        # every false acknowledgement, from every step

The first fault of a pair strikes as the soak begins, the second with the first collect; both last an hour. A lie begins
with a step and lasts. Judged as rehearsed nights are (`rehearsal`), except that a chamber that no controller could make
safe must be called NOT SAFE or NOT KNOWN. It prints one JSON document; the exit status is 1 where anything was silent.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from itertools import combinations_with_replacement
from pathlib import Path

from benchmarks.reliability import nights
from benchmarks.reliability.rehearsal import rehearse, with_faults
from benchmarks.reliability.rehearse import bench
from hil.config import parse_sweep
from hil.config.simulation import CATALOGUE, Fault
from procedures.plan import make_plan

SWEEP = parse_sweep(nights._SWEEP.replace("23 degC", "40 degC") + "final: 23 degC\n", "combined.yaml")
LIES = (
    *(
        ("chamber", kind)
        for kind in ("not_carried_out", "sensor_frozen", "setpoint_not_followed", "runaway", "program")
    ),
    *(("imu", kind) for kind in ("index_slips", "index_wrong_position", "frozen_values", "wrong_counter", "exchanged")),
    ("imu", "repeated_frames"),
)
"""What acknowledges, shows or sends something else than what it does."""
_SAID = "the chamber is not in its safe state"  # where nobody was told, the rehearsal says so in other words


def pairs() -> Iterator[tuple[Fault, ...]]:
    """Yield every two kinds of fault that a bench without an operator can have."""
    kinds = [(device, kind) for device, each in CATALOGUE.items() if device != "operator" for kind in each]
    for first, second in combinations_with_replacement(kinds, 2):
        yield tuple(
            Fault.model_validate(
                {"at": at, "device": device, "kind": kind}
                | ({"duration": "1 h"} if CATALOGUE[device][kind].lasts else {})  # type: ignore[index]
            )
            for at, (device, kind) in (("T1/S1/restabilise", first), ("T1/S1/C1/collect", second))
        )


def lies() -> Iterator[tuple[Fault, ...]]:
    """Yield every lie, from every step on."""
    for step in make_plan(SWEEP.procedure()).steps:
        for device, kind in LIES:
            yield (Fault.model_validate({"at": step.key, "device": device, "kind": kind}),)


def main() -> None:
    """Carry out a night with each, and print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("pairs", "lies"))
    parser.add_argument("--take", type=int, help="so many, drawn with the seed; all where not given")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    every = list({"pairs": pairs, "lies": lies}[asked.what]())
    chosen = every if asked.take is None else random.Random(asked.seed).sample(every, min(asked.take, len(every)))
    wrong, ends = list[str](), Counter[str]()
    with tempfile.TemporaryDirectory(prefix="hil-combined-") as scratch:
        for number, faults in enumerate(chosen):
            faulty, folder = with_faults(bench(), faults), Path(scratch) / str(number)
            (night,) = rehearse(SWEEP, faulty, nights=1, seed=asked.seed, folder=folder, faults=(0, 0))
            ends[night.state] += 1
            ends["not safe, and said"] += not night.safe and _SAID in night.wrong
            what = " and ".join(map(str, faults))
            wrong += [f"{what}: {night.state}: {night.reason}: {each}" for each in night.wrong if each != _SAID]
    print(json.dumps({"tried": len(chosen), "of": len(every), **ends, "problems": wrong}, indent=1, ensure_ascii=False))
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
