"""Hide every entry of the catalogue in the simulated unit, through bytes, at three sizes in three sweeps; look for it.

    python -m benchmarks.coverage run --keep coverage.jsonl                    # all of it, hours; goes on where it was
    python -m benchmarks.coverage run --keep few.jsonl --sweep published --only MU_real k2 --size middle
    python -m benchmarks.coverage run --keep few.jsonl --sweep triad --twin    # also told apart before, and not after
    python -m benchmarks.coverage run --keep few.jsonl --sweep published --only settle --seed 12   # another night
    python -m benchmarks.coverage table coverage.jsonl                         # for docs/, wrong names first

The unit is what `matrix-6-thermal` says (a triad: `triad-12`; for an effect that this has, a smaller model without it),
with white noise, and one effect on top, with all its parameters at the low, middle or high end of what is typical;
`hil reconcile` looks for it with that model.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.kept import Case, run_or_print
from hil.campaign import Campaign, Collects, Conditions, FloatArray
from hil.campaign.stand_ins import with_stand_ins
from hil.config import load_bench, load_sweep
from hil.config.bench import Bench, parse_bench
from hil.design.visibility.document import campaign_document
from hil.errors import InputError
from hil.likeness import likeness
from hil.likeness.draws import Agrees
from hil.model import built_in_model, load_model
from hil.model.effects.base import Described, effect_columns
from hil.model.effects.catalogue import EFFECTS, FORM_EFFECTS, SERIES_EFFECTS, VARIANCE_EFFECTS, effect_by_id
from hil.model.effects.columns import flattened
from hil.model.forms import named_form
from hil.night import start_night
from hil.reconcile import Reconciliation, reconcile
from hil.records.export import export_campaign, open_source

SWEEPS = {"published": "rd-gc-86-1", "recommended": "recommended", "triad": "triad-six-positions"}
SIZES = ("low", "middle", "high")
SEED = 2301
STARTS_DEGC = 23.0
"""Where every sweep says that its chamber begins."""
_WHITE = {"angle_random_walk": {"unit": "deg/sqrt(hr)", "value": 0.12}}


def asked_of(name: str, triad: bool) -> str:
    """Return the built-in that looks for an effect, and that the unit is without it: one that has it not already.

    Raises `InputError` where every model of the sensor has it.
    """
    rotor = ("matrix-6-thermal", "matrix-6", "collins-4")
    for model in ("triad-12",) if triad else rotor:
        if name not in FORM_EFFECTS[model]:
            return model
    raise InputError("every model of this sensor has it")


def unit(model: str) -> dict[str, Any]:
    """Return the model file of the unit without an effect: what `model` can say."""
    if model == "triad-12":
        names = {f"B{a}": ("deg/hr", 20.0 - 9.0 * k) for k, a in enumerate("XYZ")}
        names |= {
            f"G{a}{b}": ("deg/hr/g", 30.0 - 7.0 * k + 11.0 * m)
            for k, a in enumerate("XYZ")
            for m, b in enumerate("XYZ")
        }
        sensors = {1: {name: {"unit": u, "value": value} for name, (u, value) in names.items()}}
    else:
        rotor = {"BA": (15.0, -0.22, 0.003), "BB": (-10.0, 0.85, -0.004), "GSA": (60.0, 0.2, 0.0005)}
        rotor |= {"GSB": (-25.0, -0.09, 0.0003), "MUA": (9.0, -0.12, 0.002), "MUB": (-7.0, 0.1, 0.001)}
        powers = 3 if model == "matrix-6-thermal" else 1
        for name in ("MUA", "MUB") if model == "collins-4" else ():
            rotor[name] = (0.0, 0.0, 0.0)
        sensors = {
            n: {
                name: {
                    "unit": "deg/hr" + "/g" * (name[0] != "B"),
                    "polynomial": list(each[:powers]),
                    "reference_degC": 25.0,
                }
                for name, each in rotor.items()
            }
            for n in (1, 2)
        }
    form = "triad-12" if model == "triad-12" else "matrix-6"
    return {
        "schema": "hil.model/1",
        "title": "unit",
        "form": form,
        "sensors": sensors,
        "noise": {number: dict(_WHITE) for number in sensors},
    }


def bench_with(model: Path, triad: bool, seed: int = SEED) -> Bench:
    """Return the simulated bench whose unit is a model file: the one that ships, or the triad's example simulated."""
    document = yaml.safe_load(load_bench("espec-stim300-example" if triad else "simulated").text)
    if triad:
        del document["chamber"]["model"]
        document["imu"]["port"], document["chamber"]["port"] = "sim://imu", "sim://chamber"
        document |= {"clock": "virtual", "simulation": {"seed": seed, "start": {"position": "x-up"}}}
    document["simulation"] |= {"model": str(model), "seed": seed}
    document |= {"polling": {"interval": "90 s", "read_interval": "90 s"}, "record": {"raw": False}}
    return parse_bench(yaml.safe_dump(document), str(model.with_name("bench.yaml")))


def night(folder: Path, sweep: str, document: Mapping[str, Any], seed: int = SEED) -> Campaign:
    """Carry a sweep out with a unit, through bytes, and return it as the campaign folder that is kept of it."""
    folder.mkdir()
    (folder / "model.yaml").write_text(yaml.safe_dump(dict(document)))
    bench = bench_with(folder / "model.yaml", sweep == "triad", seed)
    ended = start_night(folder / "night", load_sweep(SWEEPS[sweep]), bench, terminal=Agrees(), seed=seed)
    if ended.exit_status:
        raise InputError(ended.reason)
    export_campaign(folder / "night", folder / "campaign")
    return open_source(folder / "campaign")


@cache
def without(sweep: str, model: str, seed: int) -> Campaign:
    """Return the night of the unit without any effect, which is every entry's to be compared with."""
    with tempfile.TemporaryDirectory(prefix="hil-") as at:
        return night(Path(at) / "without", sweep, unit(model), seed)


def hidden(entry: Described, conditions: Conditions, size: str) -> dict[str, Any]:
    """Return the term of an effect at a size, its parameters of different sizes and signs: alike, some cancel.

    What is there or not, as a sign that was turned, is there.
    """
    shapes = {each.name: each.grid or (1.0,) for each in entry.shapes_for(conditions)}
    shapes["from_degC"] = (STARTS_DEGC,) if "from_degC" in shapes else ()
    parameters = {}
    for place, each in enumerate(entry.parameters_for(conditions)):
        low, high = each.typical
        share = 1.0 if low == high else np.cos(place) if entry in EFFECTS else 0.9**place
        value = share * {"low": max(low, 0.1 * high), "middle": each.size, "high": high}[size]
        parameters[each.name] = {"unit": each.unit, "value": float(value)}
    return {
        "effect": entry.id,
        "shape": {n: float(g[len(g) // 2]) for n, g in shapes.items() if g},
        "parameters": parameters,
    }


def entries() -> Iterator[tuple[str, Described]]:
    """Yield how each entry acts, and the entry."""
    yield from (("mean", each) for each in EFFECTS)
    yield from (("scatter", each) for each in VARIANCE_EFFECTS)
    yield from (("inside", each) for each in SERIES_EFFECTS)


def case(job: tuple[str, str, str, str], *, twin: bool, seed: int = SEED) -> dict[str, Any]:
    """Hide one effect, look for it, and say what came of it."""
    sweep, kind, name, size = job
    out: dict[str, Any] = {"sweep": sweep, "kind": kind, "id": name, "size": size, "seed": seed}
    triad, number = sweep == "triad", 1 if sweep == "triad" else 2
    entry = next(each for of, each in entries() if (of, each.id) == (kind, name))
    if kind == "inside" and name not in {each.id for each in (*EFFECTS, *VARIANCE_EFFECTS)}:
        return {**out, "why_not": "the simulated unit has none"}
    with tempfile.TemporaryDirectory(prefix="hil-") as at:
        folder = Path(at)
        try:
            model = asked_of(name, triad)
            bare = without(sweep, model, seed)
            conditions = bare.sensors[number].conditions
            if not entry.applies_to(conditions.sensor):
                return {**out, "why_not": "cannot be in this sensor"}
            of = next(each for each in (*EFFECTS, *VARIANCE_EFFECTS) if each.id == name) if kind == "inside" else entry
            document, term = unit(model), hidden(of, conditions, size)
            if of in EFFECTS:
                document["terms"] = [{**term, "sensor": number}]
            else:
                document["noise"] = {**document["noise"], number: {**_WHITE, "scatter": [term]}}
            campaign = night(folder / "with", sweep, document, seed)
        except InputError as error:
            return {**out, "why_not": str(error)[:160]}
        added = campaign.sensors[number].rates_deg_per_hr - bare.sensors[number].rates_deg_per_hr
        if kind == "mean":
            rows, truth = campaign.sensors[number].conditions, load_model(folder / "with" / "model.yaml")
            values = [each["value"] for each in term["parameters"].values()]
            columns = effect_columns(effect_by_id(name), rows, truth.base_for(rows), term["shape"])
            column = np.einsum("ncp,p->nc", columns, values)
            if np.any(column):  # nothing, where the condition was not recorded
                out["off_deg_per_hr"] = float(np.abs(added - column).max())
                out["off"] = out["off_deg_per_hr"] / float(np.abs(column).max())
            rows = with_stand_ins(campaign).sensors[number].conditions
            columns = effect_columns(effect_by_id(name), rows, truth.base_for(rows), term["shape"])
            out |= promised(campaign, number, model, name, columns, values)
        out["rms"] = float(np.sqrt(np.mean(added**2)))
        result = reconcile(campaign, model)
        out |= judged(result, name, term)
        if twin:
            for when, of_model in (("before", built_in_model(model)), ("after", result.model_after)):
                asked = likeness(folder / "with" / "campaign", of_model, keep=folder / when, workers=1)
                out[f"twin_{when}"] = asked["p_value"]
    return out


def promised(
    campaign: Campaign, number: int, model: str, name: str, columns: FloatArray, values: Sequence[float]
) -> dict[str, Any]:
    """Return whether `hil visibility` promises that an effect (n, c, p) is found at values (p,), and by how much.

    It promises of each parameter alone; several at once show as much as what they leave together beside the base: `d`,
    in standard errors.
    """
    asked = built_in_model(model)
    seen: Any = campaign_document(campaign, asked, changes=())["sensors"]
    told = {each["id"]: each for each in seen[str(number)]["effects"]}
    collects = campaign.sensors[number]
    own = beside_base(collects, model, columns)
    d = float(np.linalg.norm(own @ np.asarray(values)))
    if name not in told:
        return {"d": d, "promised": False, "class": []}
    smallest = told[name]["smallest_visible"]
    parameters = [p.name for p in effect_by_id(name).parameters_for(collects.conditions)]
    least = float(np.linalg.norm(own[:, parameters.index(smallest["parameter"])]) * (smallest["value"] or np.inf))
    return {"d": d, "promised": d >= least, "beside_visible": d / least, "class": told[name]["class"]}


def beside_base(collects: Collects, model: str, columns: FloatArray) -> FloatArray:
    """Return what columns (n, c, p) leave beside a built-in model's own, (N, p), in standard errors of the averages."""
    weight = 1.0 / collects.rates_se_deg_per_hr.ravel()
    form = named_form(built_in_model(model).form, collects.conditions)
    base = weight[:, None] * flattened(form.columns(collects.conditions))
    own = weight[:, None] * flattened(columns)
    return np.asarray(own - base @ np.linalg.lstsq(base, own)[0])


def judged(result: Reconciliation, name: str, term: Mapping[str, Any]) -> dict[str, Any]:
    """Return what reconcile said of it."""
    found = {each.id: each for each in result.effects}
    known = effect_by_id(name).known_as if name in {each.id for each in EFFECTS} else ""
    mine = found.get(name) or found.get(known)
    values = {each["name"]: each for each in (mine.parameters if mine else ()) if each.get("se")}
    near = [
        values[key]["low"] <= each["value"] <= values[key]["high"]
        for key, each in term["parameters"].items()
        if key in values
    ]
    gap = result.gap
    return {
        "verdict": result.verdict,
        "found": {key: round(each.probability, 3) for key, each in found.items()},
        "rivals": sorted({rival.id for each in result.effects for rival in each.confusable_with}),
        "named": mine is not None,
        "covered": int(sum(near)),
        "of": len(near),
        "gap": [gap.before, gap.after, gap.noise_floor],
    }


def in_class(each: Mapping[str, Any]) -> bool:
    """Whether what was found is called by its name, or by one that these collects cannot tell from it."""
    names = set(each["found"])
    return each["named"] or bool(names & {*each.get("class", ())}) or (bool(names) and each["id"] in each["rivals"])


def table(found: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the table, wrong names first."""
    heads = ("sweep", "effect", "size", "rms, deg/hr", "d", "off the column", "times visible", "found, probability")
    yield f"| {' | '.join((*heads, 'named', 'values covered', 'gap', 'twin'))} |"
    yield "|---" * 12 + "|"

    def wrong(each: Mapping[str, Any]) -> int:
        if "why_not" in each:
            return 3
        return 1 if not each["found"] else 2 if in_class(each) else 0

    for each in sorted(found, key=wrong):
        head = f"| {each['sweep']} | `{each['id']}` ({each['kind']}) | {each['size']} |"
        if "why_not" in each:
            yield f"{head} – | – | – | – | not simulated: {each['why_not']} | – | – | – | – |"
            continue
        names = ", ".join(f"{name} {p:.2f}" for name, p in each["found"].items()) or "nothing"
        said = "yes" if each["named"] else "class" if in_class(each) else "no"
        gap = " → ".join("–" if value is None else f"{value:.2f}" for value in each["gap"])
        twin = " → ".join(f"{each[key]:.2g}" for key in ("twin_before", "twin_after") if key in each) or "–"
        off = f"{each['off']:.1%}, {each['off_deg_per_hr']:.3f} deg/hr" if "off" in each else "–"
        seen = (
            f"{each['beside_visible']:.1f}"
            if "beside_visible" in each
            else "–"
            if each["kind"] == "mean"
            else "not promised"
        )
        near = f"{each['covered']} of {each['of']}"
        d = f"{each['d']:.1f}" if "d" in each else "–"
        yield f"{head} {each['rms']:.2f} | {d} | {off} | {seen} | {names} | {said} | {near} | {gap} | {twin} |"


def options(run: argparse.ArgumentParser) -> None:
    """Add which sweeps, sizes and effects are asked about, and whether a twin is."""
    run.add_argument("--sweep", choices=SWEEPS, nargs="*", default=list(SWEEPS))
    run.add_argument("--size", choices=SIZES, nargs="*", default=list(SIZES))
    run.add_argument("--only", nargs="*")
    run.add_argument("--seed", type=int, default=SEED, help="of the noise")
    run.add_argument("--twin", action="store_true")


@contextmanager
def left(asked: argparse.Namespace, there: list[Case]) -> Iterator[tuple[Callable[[Any], Case], Iterable[Any]]]:
    """Give the cases that are not there yet."""
    own = [each for each in there if each.get("seed", SEED) == asked.seed]
    done = {(each["sweep"], each["kind"], each["id"], each["size"]) for each in own}
    jobs = [
        (sweep, kind, entry.id, size)
        for sweep in asked.sweep
        for size in asked.size
        for kind, entry in entries()
        if not asked.only or entry.id in asked.only
    ]
    yield partial(case, twin=asked.twin, seed=asked.seed), [job for job in jobs if job not in done]


if __name__ == "__main__":
    run_or_print(__doc__, options, table, left)
