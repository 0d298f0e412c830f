"""The catalogue as the JSON document of `hil effects` (hil.effects/1)."""

from collections.abc import Mapping
from typing import Any

from hil.model.effects.base import Described, Effect, VarianceEffect
from hil.model.effects.catalogue import entries
from hil.model.effects.inside import SeriesEffect

FAMILIES: Mapping[str, str] = {
    "thermal": "What temperature, its rate and its history do to the bias.",
    "g-linear": "What follows acceleration linearly: GS, MU, and a triad's full matrix.",
    "g-squared": "What follows the square of acceleration.",
    "pickoff": "Phase, scale and alignment of the pickoff.",
    "setup": "How the bench stands, turns, and what it believes about gravity and the Earth.",
    "data": "Mistakes in the record.",
    "noise": "Time and chance: drift, ageing, jumps, and all that only scatters.",
    "dynamics": "Motion: settling after an index move, and the rotor's speed.",
    "vibration": "Vibration and tones.",
    "electronics": "Quadrature, supply, magnetic field, limits.",
    "environment": "Condensation, and a base that moves.",
}
"""What the effects of each family are."""

_WORKS_ON = {Effect: "averages of collects", VarianceEffect: "scatter of averages", SeriesEffect: "within a collect"}


def effects_document() -> dict[str, Any]:
    """Return the catalogue as JSON-able data: one entry per id, with each of the things that it works on."""
    merged: dict[str, dict[str, Any]] = {}
    for entry in entries():
        told = _entry(entry)
        if entry.id in merged:
            merged[entry.id]["works_on"] += told["works_on"]
            merged[entry.id]["also"].append(told)
        else:
            merged[entry.id] = {**told, "also": []}
    return {"schema": "hil.effects/1", "families": dict(FAMILIES), "effects": list(merged.values())}


def works_on(entry: Described) -> str:
    """Return in words what an effect works on."""
    return next(words for kind, words in _WORKS_ON.items() if isinstance(entry, kind))


def _entry(entry: Described) -> dict[str, Any]:
    return {
        "id": entry.id,
        "family": entry.family,
        "title": entry.title,
        "works_on": [works_on(entry)],
        "what": summary(entry),
        "equation": entry.equation,
        "parameters": [
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "typical": list(parameter.typical),
                "typical_other": {name: list(size) for name, size in parameter.typical_other.items()},
                "per_channel": entry.per_channel,
            }
            for parameter in entry.parameters
        ],
        "shape_parameters": [{"name": s.name, "unit": s.unit, "grid": list(s.grid)} for s in entry.shapes],
        "needs": sorted(entry.needs),
        "common_to_sensors": entry.common_to_sensors,
        "signature": entry.signature,
        "confusable_with": list(entry.confusable_with),
        "experiment": entry.experiment,
        "idealises": entry.idealises if isinstance(entry, Effect) else "",
    }


def summary(entry: Described) -> str:
    """Return the first paragraph of the class's docstring: the effect in a sentence."""
    return " ".join((type(entry).__doc__ or "").split("\n\n")[0].split())
