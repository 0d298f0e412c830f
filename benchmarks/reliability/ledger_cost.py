"""What the ledger costs: the published night with its chain, head and emptied write-ahead log, and without, in turns.

    python -m benchmarks.reliability.ledger_cost --nights 5

It prints one JSON document: processor seconds and seconds of the wall clock per night, the median of so many, and what
part of a simulated night and of a night on a bench (as long as its plan) the difference is.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

from hil.config import load_bench, load_sweep
from hil.night import start_night
from hil.records import JournalReader, SqliteJournal
from hil.records.ledger import Ledger
from procedures.plan import make_plan


@contextmanager
def _plain(self: Ledger, *, durable: bool = True) -> Iterator[None]:  # noqa: ARG001 - as the one that it stands for
    self._connection.execute("BEGIN IMMEDIATE")
    yield
    self._connection.execute("COMMIT")


def night(folder: Path) -> tuple[float, float]:
    """Carry out the published night; return the seconds that it took, of the processor and of the wall clock."""
    processor_s, wall_s = time.process_time(), time.monotonic()
    assert start_night(folder, load_sweep("rd-gc-86-1"), load_bench("simulated")).state == "complete"
    return time.process_time() - processor_s, time.monotonic() - wall_s


def without(carry_out: Callable[[Path], tuple[float, float]], folder: Path) -> tuple[float, float]:
    """Carry it out as it was before there was a ledger."""
    with (
        patch.object(Ledger, "transaction", _plain),
        patch.object(SqliteJournal, "_empty_write_ahead_log", lambda _: None),
        patch.object(JournalReader, "damage", lambda *_: []),
    ):
        return carry_out(folder)


def main() -> None:
    """Measure, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nights", type=int, default=5)
    nights = range(parser.parse_args().nights)
    with tempfile.TemporaryDirectory(prefix="hil-ledger-") as scratch:
        base = Path(scratch)
        night(base / "warm")
        pairs = [(night(base / f"with-{n}"), without(night, base / f"without-{n}")) for n in nights]
    cost = {
        f"{kind}_{name}_s": round(statistics.median(pair[way][clock] for pair in pairs), 2)
        for clock, kind in enumerate(("processor", "wall"))
        for way, name in enumerate(("with", "without"))
    }
    more_s = statistics.median(one[0] - other[0] for one, other in pairs)
    real_s = make_plan(load_sweep("rd-gc-86-1").procedure()).total_s
    parts = {
        "more_processor_s": round(more_s, 2),
        "percent_of_a_simulated_night": round(100.0 * more_s / cost["processor_without_s"], 1),
        "percent_of_a_real_night": round(100.0 * more_s / real_s, 4),
    }
    print(json.dumps({"nights": len(pairs), **cost, **parts}, indent=1))


if __name__ == "__main__":
    main()
