"""Writes the pages of docs/effects again, one for each family, from the catalogue; a test compares them with it.

.venv/bin/python docs/effect_pages.py
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hil.model.effects.base import Described, Parameter
from hil.model.effects.catalogue import entries
from hil.model.effects.document import FAMILIES, summary, works_on


def family_pages() -> dict[str, str]:
    """Return the Markdown of every page by file name, README.md with the table of all effects among them."""
    by_family: dict[str, list[Described]] = {family: [] for family in FAMILIES}
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
            FAMILIES[family],
            "",
            "| id | effect | works on |",
            "|---|---|---|",
        ]
        lines += [f"| `{entry.id}` | {entry.title} | {works_on(entry)} |" for entry in found]
        lines.append("")
    return "\n".join(lines)


def _page(family: str, found: list[Described]) -> str:
    lines = [f"# Effects: {family}", "", FAMILIES[family], ""]
    for entry in found:
        lines += [f"## {entry.title} (`{entry.id}`)", "", summary(entry), "", f"    {entry.equation}", ""]
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
            f"- **Works on** the {works_on(entry)}"
            if works_on(entry) != "within a collect"
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
    write_pages(Path(__file__).parent / "effects")
