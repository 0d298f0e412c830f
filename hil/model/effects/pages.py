"""The catalogue for people and programs: the JSON document of `hil effects`, and a page per family for the docs.

effects_document()                        # schema hil.effects/1
python -m hil.model.effects.pages docs/effects  # write the pages again; a test compares them with the catalogue
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.model.effects.base import Described, Effect, Parameter, VarianceEffect
from hil.model.effects.catalogue import entries
from hil.model.effects.inside import SeriesEffect

_FAMILIES: Mapping[str, str] = {
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
    return {"schema": "hil.effects/1", "families": dict(_FAMILIES), "effects": list(merged.values())}


def family_pages() -> dict[str, str]:
    """Return the Markdown of every page by file name, README.md with the table of all effects among them."""
    by_family: dict[str, list[Described]] = {family: [] for family in _FAMILIES}
    for entry in entries():
        by_family[entry.family].append(entry)
    pages = {f"{family}.md": _page(family, found) for family, found in by_family.items()}
    pages["README.md"] = _index(by_family)
    return pages


def write_pages(folder: Path) -> None:
    """Write every page into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in family_pages().items():
        (folder / name).write_text(text, encoding="utf-8")


def _works_on(entry: Described) -> str:
    return next(words for kind, words in _WORKS_ON.items() if isinstance(entry, kind))


def _entry(entry: Described) -> dict[str, Any]:
    return {
        "id": entry.id,
        "family": entry.family,
        "title": entry.title,
        "works_on": [_works_on(entry)],
        "what": _summary(entry),
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
    }


def _summary(entry: Described) -> str:
    """Return the first paragraph of the class's docstring: the effect in a sentence."""
    return " ".join((type(entry).__doc__ or "").split("\n\n")[0].split())


def _index(by_family: Mapping[str, list[Described]]) -> str:
    lines = [
        "# The catalogue of effects",
        "",
        "A model is a sum of these. `hil effects` prints them, `hil reconcile` looks for them, the simulated unit can",
        "have them. How to add one: [add an effect](../how-to/add-an-effect.md). Sizes are orders of magnitude.",
        "",
    ]
    for family, found in by_family.items():
        lines += [
            f"## [{family}]({family}.md)",
            "",
            _FAMILIES[family],
            "",
            "| id | effect | works on |",
            "|---|---|---|",
        ]
        lines += [f"| `{entry.id}` | {entry.title} | {_works_on(entry)} |" for entry in found]
        lines.append("")
    return "\n".join(lines)


def _page(family: str, found: list[Described]) -> str:
    lines = [f"# Effects: {family}", "", _FAMILIES[family], ""]
    for entry in found:
        lines += [f"## {entry.title} (`{entry.id}`)", "", _summary(entry), "", f"    {entry.equation}", ""]
        lines += ["| parameter | unit | typical, rotor | elsewhere |", "|---|---|---|---|"]
        lines += [_parameter_row(parameter, per_channel=entry.per_channel) for parameter in entry.parameters]
        lines.append("")
        lines += [
            f"- **Searched over** {s.name}: {', '.join(f'{value:g}' for value in s.grid)} {s.unit}"
            for s in entry.shapes
        ]
        if entry.needs:
            columns = ", ".join(f"`{need}`".replace("|", "` or `") for need in sorted(entry.needs))
            lines.append(f"- **Needs** {columns}")
        lines += [
            f"- **Works on** the {_works_on(entry)}"
            if _works_on(entry) != "within a collect"
            else "- **Works** within a collect",
            f"- **Signature.** {entry.signature}",
            f"- **Easily taken for** {', '.join(f'`{other}`' for other in entry.confusable_with)}",
            f"- **What separates it.** {entry.experiment}",
            *([f"- **Its column idealises.** {entry.idealises}"] if entry.idealises else []),
            "",
        ]
    return "\n".join(lines)


def _parameter_row(parameter: Parameter, *, per_channel: bool) -> str:
    elsewhere = ", ".join(f"{name} {low:g} – {high:g}" for name, (low, high) in parameter.typical_other.items())
    name = f"{parameter.name} per channel" if per_channel else parameter.name
    low, high = parameter.typical
    size = f"{low:g} – {high:g}" if low != high else f"{low:g}"
    return f"| {name} | {parameter.unit} | {size} | {elsewhere or '–'} |"


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]))
