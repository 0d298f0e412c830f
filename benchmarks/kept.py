"""A long measurement that leaves a line for each case: it goes on where it was stopped, and prints its table."""

import argparse
import json
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

Case = dict[str, Any]
Left = Callable[[argparse.Namespace, list[Case]], AbstractContextManager[tuple[Callable[[Any], Case], Iterable[Any]]]]
"""Of what is asked, and the cases that are there: how one is measured, and which are left."""


def run_or_print(
    description: str | None,
    options: Callable[[argparse.ArgumentParser], None],
    table: Callable[[list[Case]], Iterable[str]],
    left: Left,
) -> None:
    """Measure what is not in the kept file yet, side by side (`run`), or print its table (`table`)."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    doing = parser.add_subparsers(dest="doing", required=True)
    run = doing.add_parser("run")
    run.add_argument("--keep", type=Path, required=True)
    run.add_argument("--workers", type=int)
    options(run)
    doing.add_parser("table").add_argument("keep", type=Path)
    asked = parser.parse_args()
    there = [json.loads(line) for line in asked.keep.read_text().splitlines()] if asked.keep.exists() else []
    if asked.doing == "table":
        print("\n".join(table(there)))
        return
    with (
        left(asked, there) as (measure, cases),
        ProcessPoolExecutor(asked.workers) as pool,
        asked.keep.open("a") as file,
    ):
        for found in pool.map(measure, cases):
            print(json.dumps(found), file=file, flush=True)
