"""The result for people: one self-contained page that tells what is missing in the order in which it was found out."""

import json
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from hil.files.page import in_style, rendered
from hil.model import save_model
from hil.reconcile.outcome.pictures import beside_simulated, driver_of, panels_of, pictures
from hil.reconcile.outcome.sentences import LEAST, at_most, gap_in_words, number, summary, titled, what_to_do
from hil.reconcile.result import FoundEffect, Reconciliation, rival_in_words, stated
from procedures.words import hours_minutes, numbered, unit_in_words

_MOST_PLACES = 12


def page(result: Reconciliation) -> str:
    """Return the page as one HTML document: no scripts, no other files."""
    rows = list(result.picture.get("rows", []))
    panels, driver = panels_of(rows), driver_of(result, rows)
    on_mean = any(effect.acts_on == "mean" and not effect.inside_collects for effect in result.effects)
    minutes = result.picture.get("minutes_per_collect")
    following = dict(result.next_experiment or {})
    count = sum(each["runs"] for each in following.get("collects", [])) * following.get("repeats", 1)
    # What only scatters stands out of what the model before explains; the band that it widens is the noise of after.
    only_scatters = bool(result.effects) and not on_mean
    known = {(n["sensor"], n["channel"]): n["explained_deg_per_hr"] for n in result.noise if only_scatters}
    view = {
        "title": f"{result.campaign}: what the model lacks",
        "running_title": in_style(result.campaign),
        "simulated": result.simulated,
        "whole": False,
        "result": result,
        "act": what_to_do(result),
        "summary": summary(result),
        "driver": driver,
        "scatters_more": bool(at_most(result.noise)),
        "held_out": np.isfinite(result.gap.improved_p_value),
        "before": list(pictures(panels, driver, "held_before", "before", known)),
        "curves": list(pictures(panels, driver, "left", "with what was added", {}, curve=True)) if on_mean else [],
        "after": list(pictures(panels, driver, "held_after", "after", {})) if result.effects else [],
        "nights": list(beside_simulated(result.twin or {}, panels)),
        "most_places": _MOST_PLACES,
        "place_in_words": place_in_words,
        "effects": [_effect(effect) for effect in result.effects],
        "gap": gap_in_words(result),
        "next": following,
        "why": titled(result, str(following.get("why", ""))),
        "takes": hours_minutes(60.0 * count * minutes) if minutes and count else "",
        "number": number,
        "chance": _chance,
        "rival_in_words": rival_in_words,
    }
    return rendered("hil.reconcile.outcome", "page.html.j2", view)


def _chance(value: float) -> str:
    return f"below {LEAST:.4f}" if value < LEAST else f"{value:.2g}"


def _effect(effect: FoundEffect) -> dict[str, Any]:
    """What the page shows of one effect: its values by sensor, its size beside what is typical."""
    tables = []
    for sensor, own in groupby(sorted(effect.parameters, key=_sensor), key=_sensor):
        told = list(dict.fromkeys(stated([{**each, "sensor": None} for each in own])))
        cells = {(at, name): value for name, at, value in told}
        places, names = (list(dict.fromkeys(each[i] for each in told)) for i in (1, 0))
        tables.append((sensor, names, [(at or "value", [cells.get((at, n), "–") for n in names]) for at in places]))
    return {"of": effect, "tables": tables, "size": _size(effect)}


def _sensor(parameter: Mapping[str, Any]) -> str:
    return str(parameter.get("sensor") or "")


def _size(effect: FoundEffect) -> str:
    """Say how large an effect is beside what is typical of it; nothing where nobody knows."""
    known = [each for each in effect.parameters if "typical" in each]
    if not known:
        return ""
    each = max(known, key=lambda each: abs(each["value"]))
    size, (low, high) = abs(each["value"]), each["typical"]
    word = "larger than" if size > high else "smaller than" if size < low else "within"
    return f"At most {size:.3g} {unit_in_words(each['unit'])}: {word} what is typical, {low:g} to {high:g}."


def place_in_words(where: Mapping[str, Any]) -> str:
    """Say a place in words."""
    parts = [f"sensor {where['sensor']}, channel {where['channel']}"]
    if "position" in where:
        parts.append(f"position {where['position']}")
    if "temperature_degC" in where:
        low, high = where["temperature_degC"]
        parts.append(f"at {low:.0f} °C" if high - low < 1.0 else f"from {low:.0f} to {high:.0f} °C")
    if "runs" in where:
        parts.append(numbered("run", where["runs"]))
    return ", ".join(parts)


def write_result(result: Reconciliation, out_dir: Path) -> None:
    """Write reconciliation.json, model.yaml and reconciliation.html into `out_dir`, which is made if need be."""
    out_dir.mkdir(parents=True, exist_ok=True)
    document = json.dumps(result.document(), indent=2, ensure_ascii=False, allow_nan=False)
    (out_dir / "reconciliation.json").write_text(document + "\n", encoding="utf-8")
    save_model(result.model_after, out_dir / "model.yaml")
    (out_dir / "reconciliation.html").write_text(page(result), encoding="utf-8")
