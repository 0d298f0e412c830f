"""The catalogue as the JSON document of `hil effects` (hil.effects/1), and the shape of an effect in words."""

from collections.abc import Mapping, Sequence
from typing import Any

from drivers.strict_yaml import packaged
from hil.files.document import picked
from hil.model.effects.base import Described, Effect, VarianceEffect
from hil.model.effects.catalogue import entries
from hil.model.effects.inside import SeriesEffect

FAMILIES: Mapping[str, str] = packaged("hil.model.effects", "families.yaml")
"""What the effects of each family are."""

_WORKS_ON = {Effect: "averages of collects", VarianceEffect: "scatter of averages", SeriesEffect: "within a collect"}


_SHAPES = {
    "run": "in run {:g}",
    "about_degC": "T0 = {:.3g} °C",
    "tau_min": "time constant {:g} min",
    "tau_hr": "time constant {:g} h",
    "tau_s": "time constant {:g} s",
    "half_width_degC": "half width {:g} °C",
    "from_degC": "the unit coming from {:.3g} °C, which nobody recorded",
    "nominal_V": "nominal {:.4g} V",
    "nominal_us": "nominal {:.5g} µs",
}


def shape_in_words(shape: Mapping[str, float], may_be: Mapping[str, Sequence[float]] | None = None) -> str:
    """Say from where on a step holds, or what time constant or width an effect has, and `may_be` has from … to.

    Empty where there is none.
    """
    run, collects = shape.get("from_run"), shape.get("from_collect")
    if run is not None:
        after = f", after {collects:g} of its collects" if collects else ""
        return f"in run {run:g} alone" if shape.get("runs_held") else f"from run {run:g} on{after}"
    if shape.get("of_visit"):
        return "the same in all runs of a visit to a temperature"
    every = {name: text.format(shape[name]) for name, text in _SHAPES.items() if name in shape}
    known = {name: " ({:.3g} to {:.3g} is possible)".format(*ends) for name, ends in (may_be or {}).items()}
    return ", ".join(text + known.get(name, "") for name, text in every.items())


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
        **picked(entry, "id family title"),
        "works_on": [works_on(entry)],
        "what": summary(entry),
        "equation": entry.equation,
        "parameters": [
            picked(each, "name unit typical typical_other", per_channel=entry.per_channel) for each in entry.parameters
        ],
        "shape_parameters": [picked(each, "name unit grid") for each in entry.shapes],
        "needs": sorted(entry.needs),
        **picked(entry, "common_to_sensors signature confusable_with experiment"),
        "idealises": entry.idealises if isinstance(entry, Effect) else "",
    }


def summary(entry: Described) -> str:
    """Return the first paragraph of the class's docstring: the effect in a sentence."""
    return " ".join((type(entry).__doc__ or "").split("\n\n")[0].split())
