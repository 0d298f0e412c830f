"""Held-back units: are effects, drawn blindly, found in a night that came out as bytes, and then not told apart.

    python -m benchmarks.held_back run --units 12 --seed 4100 --keep held_back.jsonl  # goes on where it was
    python -m benchmarks.held_back run --units 100 --averages --keep few.jsonl  # nights drawn as averages
    python -m benchmarks.held_back table held_back.jsonl

A unit has base values of its own and an effect on the mean, one on the scatter, or both, in one of its two sensors, of
a size in the upper half of what is typical: on the mean one that `hil visibility` promises beside that scatter, on the
scatter one that leaves four times the white noise. The published and the recommended sweep take turns. A night is laid
beside twenty nights of the model that was asked and twenty of the one that `hil reconcile` wrote, as `--twin` does.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks import coverage
from benchmarks.kept import Case, run_or_print
from hil.campaign import Campaign
from hil.likeness import likeness
from hil.likeness.draws import drawn_model, fitted, night_of_averages
from hil.likeness.features import features
from hil.likeness.verdict import verdict
from hil.model import Model, load_model
from hil.model.effects.base import Described, effect_columns
from hil.model.effects.catalogue import EFFECTS, VARIANCE_EFFECTS
from hil.model.effects.scatter import drawn as drawn_scatter
from hil.reconcile import reconcile

ASKED = "matrix-6-thermal"
KINDS = ("mean", "scatter", "both")
SCATTER_TIMES, MEAN_TIMES = 4.0, 8.0
DRAWS = 20


def term(entry: Described, campaign: Campaign, number: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return an effect's term with sizes drawn from the upper half of what is typical, of either sign on the mean."""
    conditions = campaign.sensors[number].conditions
    parameters = {}
    for each in entry.parameters_for(conditions):
        value = rng.uniform(np.mean(each.typical), each.typical[1])
        turns = entry in EFFECTS and each.typical[0] < each.typical[1]  # what is there or not has no sign
        sign = rng.choice([-1.0, 1.0]) if turns else 1.0
        parameters[each.name] = {"unit": each.unit, "value": float(sign * value)}
    shape = {each.name: float(rng.choice(each.grid or (1.0,))) for each in entry.shapes_for(conditions)}
    if "from_degC" in shape:
        shape["from_degC"] = coverage.STARTS_DEGC
    return {"effect": entry.id, "shape": shape, "parameters": parameters}


def drawn(number: int, bare: Campaign, folder: Path, rng: np.random.Generator) -> dict[str, Any]:
    """Return the model file of a unit, drawn until its effects are there to be seen."""
    kind, document = KINDS[number // 2 % len(KINDS)], coverage.unit(ASKED)
    for values in document["sensors"].values():
        for each in values.values():
            each["polynomial"] = [float(p * rng.uniform(0.5, 1.5)) for p in each["polynomial"]]
    sensor, white = int(rng.integers(1, 3)), document["noise"]
    rows = bare.sensors[sensor].conditions
    while True:
        made = {**document, "title": f"unit {number}"}
        if kind != "mean":
            scatters = [each for each in VARIANCE_EFFECTS if each.applies_to(rows.sensor) and not each.missing(rows)]
            own = term(scatters[int(rng.integers(len(scatters)))], bare, sensor, rng)
            made["noise"] = {**white, sensor: {**white[sensor], "scatter": [own]}}
        scattered, beside = model_of(made, folder), 1.0
        if kind != "mean" and (beside := scatter_beside_base(scattered, bare, sensor, rng)) < SCATTER_TIMES:
            continue
        if kind != "scatter":
            effects = [each for each in EFFECTS if each.applies_to(rows.sensor) and not each.missing(rows)]
            effect = effects[int(rng.integers(len(effects)))]
            if not effect.in_models:  # a mistake in a record
                continue
            own = term(effect, bare, sensor, rng)
            columns = effect_columns(effect, rows, scattered.base_for(rows), own["shape"])
            values = [each["value"] for each in own["parameters"].values()]
            shown = coverage.beside_base(bare.sensors[sensor], ASKED, columns) @ values
            if np.linalg.norm(shown) < MEAN_TIMES * beside:
                continue
            made["terms"] = [{**own, "sensor": sensor}]
        return made


def model_of(document: Mapping[str, Any], folder: Path) -> Model:
    """Return a model file as a model."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "drawn.yaml").write_text(yaml.safe_dump(dict(document)))
    return load_model(folder / "drawn.yaml")


def scatter_beside_base(model: Model, campaign: Campaign, number: int, rng: np.random.Generator) -> float:
    """Return the rms that a model's named scatter leaves beside the base, in units of the standard errors."""
    rows = campaign.sensors[number]
    parts = model.stated_scatter(rows.conditions)
    draws = np.stack([drawn_scatter([parts], [rows.conditions], rng)[0] for _ in range(40)], axis=2)
    return float(np.sqrt(np.mean(coverage.beside_base(rows, ASKED, draws) ** 2)))


def case(number: int, *, seed: int, keep: Path, averages: bool) -> dict[str, Any]:
    """Draw a unit, carry its night out, look for what it hides, and lay twins beside it before and after."""
    sweep = ("published", "recommended")[number % 2]
    rng = np.random.default_rng([seed, number])
    bare = replace(coverage.without(sweep, ASKED, seed), recorded={})
    folder = keep / f"unit-{seed}-{number}"
    document = drawn(number, bare, folder, rng)
    if averages:
        campaign = night_of_averages(bare, model_of(document, folder), rng)
    else:
        campaign = coverage.night(folder / "with", sweep, document, seed=seed + number)
    result = reconcile(campaign, ASKED)
    hidden = [each["effect"] for each in document.get("terms", [])]
    hidden += [each["effect"] for noise in document["noise"].values() for each in noise.get("scatter", [])]
    out: dict[str, Any] = {"number": number, "seed": seed, "sweep": sweep, "hidden": hidden, "verdict": result.verdict}
    out["found"] = {each.id: round(each.probability, 3) for each in result.effects}
    out["rivals"] = sorted({rival.id for each in result.effects for rival in each.confusable_with})
    each_temperature = True if result.calibration == "per temperature" else None
    for when, model in (("before", result.input_model), ("after", result.model_after)):
        how = {"calibrated": each_temperature}
        if averages:
            asked = without_bytes(campaign, bare, model, rng, **how)
        else:
            asked = likeness(folder / "with" / "night", model, draws=DRAWS, keep=folder / when, workers=1, **how)
        out[when] = {key: asked[key] for key in ("p_value", "parts")} | {"places": asked["places"][:5]}
    return out


def without_bytes(
    measured: Campaign, bare: Campaign, model: Model, rng: np.random.Generator, *, calibrated: bool | None
) -> dict[str, Any]:
    """Return what `likeness` says, of nights that are drawn as averages."""
    form = model.model_copy(update={"sensors": {}})
    own = [curve for curves in model.sensors.values() for curve in curves.values()]
    follows = any(curve.depends_on_temperature for curve in own) if calibrated is None else calibrated
    known = model if own else fitted(measured, form, calibrated=follows)
    nights = [measured]
    for _ in range(DRAWS):
        values = drawn_model(known, measured, form, rng, calibrated=follows)
        nights.append(night_of_averages(bare, values, rng))
    return verdict([features(each, form, calibrated=follows) for each in nights])


def table(found: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the table: those that are told apart after their effect was added first."""
    yield "| unit | sweep | hidden | found, probability | also possible | told apart before, p | after, p |"
    yield "|---" * 7 + "|"
    for each in sorted(found, key=lambda each: each["after"]["p_value"]):
        names = ", ".join(f"`{name}` {p:.2f}" for name, p in each["found"].items()) or "nothing"
        cells = (each["sweep"], ", ".join(f"`{name}`" for name in each["hidden"]), names, ", ".join(each["rivals"]))
        before, after = (f"{each[when]['p_value']:.2g}" for when in ("before", "after"))
        yield f"| {each['number']} | {' | '.join(cells)} | {before} | {after} |"


def options(run: argparse.ArgumentParser) -> None:
    """Add which units are drawn, and whether their nights go through bytes."""
    run.add_argument("--units", type=int, default=12)
    run.add_argument("--seed", type=int, default=4100)
    run.add_argument("--folder", type=Path, help="keeps the units and their nights")
    run.add_argument("--averages", action="store_true")


@contextmanager
def left(
    asked: argparse.Namespace, there: list[Case]
) -> Iterator[tuple[Callable[[int], dict[str, Any]], Iterable[int]]]:
    """Give the units that are not there yet, and a folder for their nights."""
    done = {each["number"] for each in there if each["seed"] == asked.seed}
    with tempfile.TemporaryDirectory(prefix="hil-") as at:
        job = partial(case, seed=asked.seed, keep=asked.folder or Path(at), averages=asked.averages)
        yield job, [n for n in range(asked.units) if n not in done]


if __name__ == "__main__":
    run_or_print(__doc__, options, table, left)
