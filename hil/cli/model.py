"""Commands about what a model lacks: reconcile, visibility, effects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from hil.cli.data import Source, read_source
from hil.cli.output import JsonFlag, check_result_folder, listing, printed, results, warn

_SHOWN = 3


def reconcile(
    campaign: Source,
    model: Annotated[str, typer.Option(help="A model file, or the name of a built-in.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="The folder for the result.", show_default=False)],
    alpha: Annotated[float, typer.Option(help="How often the search may find something where nothing is.")] = 0.05,
    as_json: JsonFlag = False,
) -> None:
    """Find where model and measurement disagree, name what is missing, add it, show that the gap shrinks."""
    from hil.reconcile import reconcile as search
    from hil.reconcile import write_result

    data = read_source(campaign)
    check_result_folder(out, "thermal.json", "thermal")
    result = search(data, model, alpha=alpha)
    write_result(result, out)
    document = result.document()
    if printed(document, as_json):
        return
    warn(tuple(data.warnings))
    for line in _reconciled(document):
        results().print(line)
    results().print(f"\nwritten to {out}: reconciliation.html (for people), reconciliation.json, model.yaml")


def _reconciled(document: Mapping[str, Any]) -> Iterator[str]:
    """The result in a screenful."""
    from hil.reconcile.result import rival_in_words

    mark = "  SIMULATED" if document["simulated"] else ""
    yield f"{document['campaign']}, model {document['model_before']}{mark}"
    how = "" if document["calibration"] == "one set" else " (the model calibrated at each temperature)"
    yield f"\nverdict: {document['verdict']}{how}"
    for each in document["disagreements"][:5]:
        where = ", ".join(f"{name} {value}" for name, value in each["where"].items() if value not in (None, [], ""))
        yield f"  {each['size_deg_per_hr']:+.2f} ± {each['se_deg_per_hr']:.2f} deg/hr  {where}"
    for effect in document["effects"]:
        yield f"\n{effect['id']}: {effect['title']}, probability {effect['probability']:.2f}"
        yield f"  {effect['equation']}{', ' * bool(effect['shape_in_words'])}{effect['shape_in_words']}"
        yield from _values(effect["parameters"])
        for rival in effect["confusable_with"][:4]:
            why = rival_in_words(rival)
            yield f"  could also be {rival['id']}, probability {rival['probability']:.2f}{f': {why}' if why else ''}"
    gap = document["gap"]
    if gap["before"] is not None:
        after = "" if gap["after"] is None else f", after {gap['after']:.2f}"
        floor = "" if gap["noise_floor"] is None else f", noise floor {gap['noise_floor']:.2f}"
        yield f"\ngap: before {gap['before']:.2f}{after}{floor} {gap['unit']} ({gap['held_out']})"
    follows = [f"{each['driver'].replace('_', ' ')} {each['probability']:.2f}" for each in document["follows"][:3]]
    if follows:
        yield f"it follows: {', '.join(follows)}"
    for each in document["outliers"][:_SHOWN]:
        yield (
            f"left out: collect {each['collect']}, sensor {each['sensor']} {each['channel']}, off by "
            f"{each['size_deg_per_hr']:.4g} deg/hr"
        )
    if len(document["outliers"]) > _SHOWN:
        yield f"left out: {len(document['outliers']) - _SHOWN} more, in reconciliation.json"
    if document["next_experiment"]:
        what = document["next_experiment"].get("what")
        yield f"measure next: {f'{what}: ' if what else ''}{document['next_experiment']['why']}"
    for note in document.get("notes", []):
        yield f"note: {note}"
    yield "every ± is one standard error"


def _values(parameters: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """One line per parameter and sensor, however many temperatures it has a value at."""
    from hil.reconcile.result import stated

    lines: dict[str, list[str]] = {}
    for name, at, value in dict.fromkeys(stated(parameters)):
        lines.setdefault(name, []).append(f"{value} at {at}" if at else value)
    for name, values in lines.items():
        yield f"  {name}: {'; '.join(values)}"


def visibility(
    source: Annotated[
        str, typer.Argument(help="A sweep file (or its name), or a campaign folder.", show_default=False)
    ],
    bench: Annotated[str, typer.Option("--bench", help="For a sweep: the bench that would run it.")] = "simulated",
    model: Annotated[str | None, typer.Option(help="A model file, or the name of a built-in.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Before a night is spent: say which effects these collects can see, at what size, and which look alike."""
    from hil.config import load_bench, load_sweep
    from hil.design.visibility.document import campaign_document, sweep_document
    from hil.design.visibility.text import visibility_text
    from hil.model import load_model

    chosen = None if model is None else load_model(model)
    if Path(source).is_dir():
        document = campaign_document(read_source(Path(source)), chosen)
    else:
        document = sweep_document(load_sweep(source), load_bench(bench), chosen)
    if not printed(document, as_json):
        results().print(visibility_text(document))


def effects(as_json: JsonFlag = False) -> None:
    """List the catalogue: every effect that the twin can simulate and reconcile can name."""
    from hil.model.effects.pages import effects_document

    document = effects_document()
    if printed(document, as_json):
        return
    table = listing("id", "family", "what it is", "equation", no_wrap=False)
    for effect in document["effects"]:
        table.add_row(effect["id"], effect["family"], effect["title"], effect["equation"])
    results().print(table)


COMMANDS = (reconcile, visibility, effects)
