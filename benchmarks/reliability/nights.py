"""A small night for killing: begun, carried on, and judged against the same night that nobody disturbed.

Everything here runs in a fork of a process that has everything imported and parsed already.
"""

from __future__ import annotations

import copy
import gc
import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hil.config import Bench, Sweep, load_bench, parse_bench, parse_sweep
from hil.files.durable import PARTIAL
from hil.night import resume_night, start_night
from hil.night.log import LOG_NAME
from hil.records import open_readonly
from hil.records.export import campaign_of_night
from hil.records.reader import JOURNAL_NAME
from hil.records.status import night_status
from hil.records.verify import verify_night
from hil.solve import solve_campaign
from procedures.journal_protocol import Outcome
from procedures.stop import StopRequest

NIGHT = "tonight/night"
_SIGMAS = 6.0  # of 12 parameters in thousands of nights none should be further off by chance

_SWEEP = """
title: A small night
temperatures: [23 degC]
self_calibrations_per_temperature: 1
positions: [1, 2, 3]
restabilisation: {at_least: 2 min, window: 2 min, ceiling: 60 min, unit_band: 5 degC, unit_slope: 5 degC/min}
collect: {settle: 5 s, duration: 20 s}
"""


@cache
def sweep() -> Sweep:
    """One temperature, one self-calibration of three collects."""
    return parse_sweep(_SWEEP, "small.yaml")


@cache
def bench() -> Bench:
    """The simulated bench, with few signs of life, for they are all alike, and quick moves."""
    shipped = load_bench("simulated")
    text = shipped.text.replace("read_interval: 30 s}", "read_interval: 30 s, heartbeat: 2 min}")
    return parse_bench(text.replace("index_time: 5 s", "index_time: 0.5 s"), shipped.source)


def _remember_yaml() -> None:
    """Let this process read and write each YAML text once: thousands of nights have the same few."""
    load, dump, loaded, dumped = yaml.load, yaml.safe_dump, {}, {}

    def load_once(text: str, Loader: type) -> Any:
        if (text, Loader) not in loaded:
            loaded[text, Loader] = load(text, Loader=Loader)
        return copy.deepcopy(loaded[text, Loader])

    def dump_once(document: object, **style: Any) -> Any:
        key = (repr(document), repr(style))
        if key not in dumped:
            dumped[key] = dump(document, **style)
        return dumped[key]

    yaml.load, yaml.safe_dump = load_once, dump_once


def warm_up(base: Path) -> None:
    """Load everything that a night, a resume and a check load, so that a fork need not."""
    _remember_yaml()
    root = base / "warm"
    root.mkdir()
    stop = StopRequest()
    stop.request("enough")
    start_night(root / NIGHT, sweep(), bench(), who="first", stop=stop)
    carry_on(root)
    parameters(root / NIGHT)
    verify_night(root / NIGHT)
    shutil.rmtree(root)
    gc.freeze()  # what is there will stay: a fork need not copy it


def begin(root: Path) -> int:
    """Begin the night below `root` and carry it out; 0 where it became complete."""
    return 0 if start_night(root / NIGHT, sweep(), bench(), who="first").state == "complete" else 1


def carry_on(root: Path) -> int:
    """Carry the night on, or begin it again where the first process left none; 0 where it became complete."""
    if not (root / NIGHT / JOURNAL_NAME).exists():
        return begin(root)
    return 0 if resume_night(root / NIGHT, who="second").state == "complete" else 1


@dataclass(frozen=True)
class Kept:
    """What a journal and its blocks hold for good: results that are DONE or otherwise ended, events, block bytes."""

    attempts: Mapping[tuple[str, int], tuple[Any, ...]]
    events: Sequence[tuple[Any, ...]]
    blocks: Mapping[str, str]  # path to SHA-256 of the file as it is

    @classmethod
    def of(cls, root: Path) -> Kept:
        """Read what there is below `root`, nothing where there is no night."""
        folder = root / NIGHT
        if not (folder / JOURNAL_NAME).exists():
            return cls({}, (), {})
        with open_readonly(folder) as journal:
            attempts = {(each.step_key, each.attempt): _row(each) for each in journal.attempts() if each.outcome}
            events = [_row(each) for each in journal.events()]
            blocks = {row.block.path: _sha256(folder / row.block.path) for row in journal.blocks()}
        return cls(attempts, events, blocks)


def promised(log: bytes) -> set[str]:
    """Return the keys of the steps that the night's log calls done: who reads it may rely on them."""
    done = set()
    for line in log.decode(errors="replace").splitlines(keepends=True):
        if line.endswith("\n") and '"step ends"' in line:
            facts = json.loads(line)
            if facts["outcome"] == Outcome.DONE:
                done.add(facts["step"])
    return done


def problems(
    root: Path, before: Kept, promises: set[str], reference: Mapping[str, tuple[float, float]]
) -> Iterator[str]:
    """Yield what is wrong with the night below `root` after it was carried on; nothing where all is well.

    `before` is what it held when it was cut off, `promises` the steps that it had called done by then, `reference` the
    parameters of the undisturbed night.
    """
    folder = root / NIGHT
    status = night_status(folder)
    if status["state"] != "complete":
        yield f"the night is {status['state']}: {status['reason']}"
    found = verify_night(folder)
    yield from (f"verify: {problem}" for problem in found["problems"])
    yield from (f"verify notes: {note}" for note in found["notes"] if "no journal row names" not in note)
    after = Kept.of(root)
    for key, row in before.attempts.items():
        if after.attempts.get(key) != row:
            yield f"the record of {key} is not what it was"
    if list(after.events[: len(before.events)]) != list(before.events):
        yield "the events are not those that were recorded"
    for path, sha256 in before.blocks.items():
        if after.blocks.get(path) != sha256:
            yield f"{path}: its bytes are not what they were"
    with open_readonly(folder) as journal:
        done = [each.step_key for each in journal.attempts() if each.outcome is Outcome.DONE]
        planned = [step.key for step in journal.plan.steps]
    yield from (f"{key} is done {done.count(key)} times" for key in planned if done.count(key) != 1)
    yield from (f"the log said that {key} is done, and it was lost" for key in promises - _done(before))
    left = [path.name for path in (*folder.parent.iterdir(), *folder.rglob("*")) if path.name.startswith(PARTIAL)]
    yield from (f"{name} was left behind" for name in left if not is_shown(name))
    yield from _disagreements(parameters(folder), reference)


def is_shown(path: str) -> bool:
    """Tell a file that onlookers and the watchdog are shown: it is written anew at the next poll, and need not last."""
    return Path(path).name.removeprefix(PARTIAL) in ("live.json", "heartbeat.json")


def _done(kept: Kept) -> set[str]:
    return {key for (key, _), row in kept.attempts.items() if Outcome.DONE in row}


def parameters(folder: Path) -> dict[str, tuple[float, float]]:
    """Return every parameter with its standard error."""
    return {
        f"{each.sensor} {name}": (estimate.value, estimate.se or 0.0)
        for each in solve_campaign(campaign_of_night(folder))
        for name, estimate in each.parameters.items()
        if estimate.value is not None
    }


def _disagreements(
    found: Mapping[str, tuple[float, float]], reference: Mapping[str, tuple[float, float]]
) -> Iterator[str]:
    if set(found) != set(reference):
        yield f"parameters {sorted(found)} where there should be {sorted(reference)}"
        return
    for name, (value, se) in found.items():
        expected, its_se = reference[name]
        if abs(value - expected) > _SIGMAS * float(np.hypot(se, its_se)):
            yield f"{name} is {value:.3f} ± {se:.3f}, undisturbed {expected:.3f} ± {its_se:.3f}"


def _row(each: object) -> tuple[Any, ...]:
    return tuple(
        json.dumps(value, sort_keys=True) if isinstance(value, dict) else value for value in vars(each).values()
    )


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "missing"


def log_of(root: Path) -> bytes:
    """Return the night's log as it is, nothing where there is none."""
    path = root / NIGHT / LOG_NAME
    return path.read_bytes() if path.is_file() else b""
