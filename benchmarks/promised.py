"""Is what `hil visibility` promises found: nights of averages, each with an effect of exactly the promised size in it.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.promised run --keep promised.jsonl      # goes on where it was
    OPENBLAS_NUM_THREADS=1 python -m benchmarks.promised run --keep few.jsonl --times 1 --nights 5 --only drift k2
    python -m benchmarks.promised run --keep triad.jsonl --sweep triad-six-positions --bench espec-stim300-example
    python -m benchmarks.promised table promised.jsonl

A night is the planned averages of a sweep in the noise that the map assumes. The parameter that shows best has the
promised size, with either sign; in the sensor of which that is said, or in all where the effect is common to them. Of
the two promises one is of the easiest shape, the other of any: then it is one of those that are searched, or between
them. What is there or not at all has no size.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any
from zlib import crc32

import numpy as np

from benchmarks.kept import Case, run_or_print
from hil.campaign import Campaign, Collects, Conditions
from hil.config import load_bench, load_sweep
from hil.design.conditions import planned_conditions
from hil.design.visibility.document import visibility_document
from hil.design.visibility.map import NoiseLevel, base_values
from hil.model.effects.base import Effect, effect_columns
from hil.model.effects.catalogue import effect_by_id
from hil.model.effects.prior import shapes_tried
from hil.reconcile import reconcile
from procedures.plan import make_plan

ANY, EASIEST = "any shape", "the easiest"


@cache
def promises(sweep: str, bench: str) -> tuple[Mapping[int, Conditions], str, Mapping[tuple[str, str], Any]]:
    """Return a sweep's conditions, the model that is asked, and what is promised by effect, in any or one shape."""
    conditions = planned_conditions(make_plan(load_sweep(sweep).procedure()), load_bench(bench))
    document: Any = visibility_document(conditions, sweep, changes=())
    found = {}
    for each in document["effects"]:
        told = each["smallest_visible"]
        sizes = {told["easiest"]["value"]: EASIEST, told["value"]: ANY}  # of one shape alone both are one
        for size, promise in sizes.items():
            if each["visible"] and size is not None and told["typical"][0] < told["typical"][1]:
                found[each["id"], promise] = {**each, "size": size}
    return conditions, next(iter(document["forms"].values())), found


def drawn(effect: Effect, rows: Conditions, rng: np.random.Generator) -> dict[str, float]:
    """Return one of the shapes that are searched, or one between them."""
    base = base_values(rows, None)
    tried = [shape for shape, _ in shapes_tried(effect, rows, lambda *_: base)]
    shape = dict(tried[int(rng.integers(len(tried)))])
    for each in effect.shapes_for(rows):
        if each.continuous and len(each.grid) > 1:
            at = rng.uniform(0.0, len(each.grid) - 1.0)
            shape[each.name] = float(np.exp(np.interp(at, np.arange(len(each.grid)), np.log(each.grid))))
    return shape


def case(job: tuple[str, str, str, str, float, int]) -> dict[str, Any]:
    """Hide one effect in one night, and say under which names it was found."""
    sweep, bench, name, promise, times, night = job
    conditions, model, promised = promises(sweep, bench)
    told, effect, noise = promised[name, promise], effect_by_id(name), NoiseLevel()
    smallest, number = told["smallest_visible"], told["sensor"]
    rng = np.random.default_rng([crc32(name.encode()), night])
    shape = drawn(effect, conditions[number], rng) if promise == ANY else smallest["easiest"]["shape"]
    size = float(times * told["size"] * rng.choice([-1.0, 1.0]))
    sensors = {}
    for n, rows in conditions.items():
        base, runs = base_values(rows, None), np.unique(rows.run, return_inverse=True)[1]
        rates = base.rates + rng.normal(0.0, noise.collect_deg_per_hr, base.rates.shape)
        rates += rng.normal(0.0, noise.run_bias_deg_per_hr, (runs.max() + 1, rates.shape[1]))[runs]
        values = [size * (each.name == smallest["parameter"]) for each in effect.parameters_for(rows)]
        if n == number or effect.common_to_sensors:
            rates += effect_columns(effect, rows, base, shape) @ np.array(values)
        sensors[n] = Collects(rows, rates, np.full_like(rates, noise.collect_deg_per_hr))
    result = reconcile(Campaign(f"{name}, night {night}", "simulated", sensors), model)
    found = {each.id: round(each.probability, 3) for each in result.effects}
    told_of = {*found, *(rival.id for each in result.effects for rival in each.confusable_with)}
    return {
        "sweep": sweep,
        "id": name,
        "promise": promise,
        "times": times,
        "night": night,
        "size": size,
        "shape": shape,
        "verdict": result.verdict,
        "found": found,
        "p_value": result.p_value,
        "right": bool(told_of & {name, effect.known_as, *told["class"]}),
    }


def table(found: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the share found by name or in its class, and the wrong names, by effect, promise and size."""
    times = sorted({each["times"] for each in found})
    yield f"| sweep | effect | of | {' | '.join(f'{t:g} times: found, wrong names, nights' for t in times)} |"
    yield "|---" * (3 + len(times)) + "|"
    for key in dict.fromkeys((each["sweep"], each["id"], each["promise"]) for each in found):
        cells = []
        for t in times:
            own = [e for e in found if (e["sweep"], e["id"], e["promise"], e["times"]) == (*key, t)]
            wrong = sum(bool(e["found"]) and not e["right"] for e in own)
            cells.append(f"{sum(e['right'] for e in own) / max(len(own), 1):.2f}, {wrong}, {len(own)}")
        yield f"| {key[0]} | `{key[1]}` | {key[2]} | {' | '.join(cells)} |"


def options(run: argparse.ArgumentParser) -> None:
    """Add which sweep, effects and sizes are asked about."""
    run.add_argument("--sweep", default="recommended")
    run.add_argument("--bench", default="simulated", help="that carries the sweep out")
    run.add_argument("--times", type=float, nargs="*", default=[0.5, 1.0], help="the promised size")
    run.add_argument("--nights", type=int, default=20)
    run.add_argument("--only", nargs="*")


@contextmanager
def left(asked: argparse.Namespace, there: list[Case]) -> Iterator[tuple[Callable[[Any], Case], Iterable[Any]]]:
    """Give the cases that are not there yet."""
    done = {(each["sweep"], each["id"], each["promise"], each["times"], each["night"]) for each in there}
    jobs = [
        (asked.sweep, asked.bench, name, promise, times, night)
        for night in range(asked.nights)
        for times in asked.times
        for name, promise in promises(asked.sweep, asked.bench)[2]
        if not asked.only or name in asked.only
    ]
    yield case, [job for job in jobs if (job[0], *job[2:]) not in done]


if __name__ == "__main__":
    run_or_print(__doc__, options, table, left)
