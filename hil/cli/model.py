"""Commands about what a model lacks: reconcile, twin, visibility, effects."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.progress import Progress

from hil.cli.answer import Answer
from hil.cli.data import read_source
from hil.cli.output import check_named, check_result_folder, messages
from hil.errors import InputError
from procedures.words import hours_minutes, percent


def reconcile(
    campaign: Path,
    model: str,
    out: Path | None,
    alpha: float = 0.05,
    with_twin: bool = False,
    draws: int = 20,
    seed: int = 1,
) -> Answer:
    """Find where model and measurement disagree, name what is missing, add it, show that the gap shrinks."""
    from hil.reconcile import reconcile as search
    from hil.reconcile import write_result
    from hil.reconcile.outcome.page import place_in_words
    from hil.reconcile.outcome.sentences import errors_in_words, of_few, summary, what_to_do
    from hil.reconcile.result import before_and_after_in_words

    data = read_source(campaign)
    if out is not None:  # a notebook asks without files
        check_result_folder(out, "reconciliation.json", model, of=data)
    result = search(data, model, alpha=alpha)
    if out is not None:
        write_result(result, out)  # what is found stays found where nobody waits for the twin
    if with_twin and out is not None:
        from hil.likeness import likeness

        each_temperature = True if result.calibration == "per temperature" else None
        given, asked = result.input_model, {"draws": draws, "seed": seed}
        how: dict[str, Any] = {"calibrated": each_temperature, "wrong": result.rows, **asked}
        with _bar(2 * draws) as done:
            before, after = (
                likeness(campaign, each, keep=out / f"twin-{when}", done=done, **how)
                for when, each in (("before", given), ("after", result.model_after))
            )
        halves = {
            name: {key: of[key] for key in ("p_value", "parts", "places")}
            for name, of in (("before", before), ("after", after))
        }
        result = replace(result, twin={**asked, **halves})
        write_result(result, out)
    document, stated_by = result.document(), {"values_of": _values, "before_and_after": before_and_after_in_words}
    words = {"place_in_words": place_in_words, "percent": percent, **stated_by}
    said = {
        "act": what_to_do(result)[1],
        "summary": summary(result),
        "errors": errors_in_words(result),
        "of_few": of_few(draws),
    }
    return Answer(document, {"warnings": data.warnings, "result": result, "out": out, **said, **words})


def fleet(
    folders: list[Path],
    model: str,
    workers: int = 1,
    cluster: str | None = None,
    out: Path | None = None,
    csv: Path | None = None,
) -> Answer:
    """Screen many units that were measured in the same way: which deserve a full reconcile, what many lack."""
    from hil.files.durable import write_result
    from hil.reconcile.campaigns import screen_folders
    from hil.reconcile.outcome.fleet import fleet_csv, fleet_document, fleet_page, fleet_sentences

    for path, ending in ((out, ".html"), (csv, ".csv")):
        if path is not None:
            check_named(path, ending)
    found = screen_folders(folders, model, workers, cluster)
    for path, write in ((out, fleet_page), (csv, fleet_csv)):
        if path is not None:
            write_result(path, write(found))
    written = list(filter(None, (out, csv)))
    return Answer(fleet_document(found), {"found": list(fleet_sentences(found)), "written": written})


def _values(parameters: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """One line per parameter and sensor, however many temperatures it has a value at."""
    from hil.reconcile.result import stated

    lines: dict[str, list[str]] = {}
    for name, at, value in dict.fromkeys(stated(parameters)):
        lines.setdefault(name, []).append(f"{value} at {at}" if at else value)
    for name, values in lines.items():
        yield f"  {name}: {'; '.join(values)}"


def twin(campaign: Path, model: str, draws: int = 20, seed: int = 1, out: Path | None = None) -> Answer:
    """Simulate the same night with a model, many times, through bytes; say whether the measured one can be told."""
    from hil.likeness import likeness
    from hil.model.effects.prior import ALPHA
    from hil.reconcile.outcome.sentences import of_few
    from hil.records.units import place_of

    night, unit = place_of(campaign.resolve())
    keep = out or night.with_name("-".join(filter(None, (night.name, unit, "twin"))))
    check_result_folder(keep)
    with _bar(draws) as done:
        document = likeness(campaign, model, keep=keep, draws=draws, seed=seed, done=done)
    return Answer(document, {"keep": keep, "level": ALPHA, "of_few": of_few(draws)})


@contextmanager
def _bar(draws: int) -> Iterator[Callable[[int], None]]:
    console = messages()
    with Progress(
        console=console, transient=True, disable=not console.is_terminal, speed_estimate_period=math.inf
    ) as bar:
        task = bar.add_task("simulated nights", total=draws)
        bar.advance(task, 0)  # from now on one night tells how long it takes: of two at once the second adds nothing

        def done(_: int) -> None:
            bar.advance(task)
            if bar.disable:
                left_s = bar.tasks[0].time_remaining
                more = f", {hours_minutes(left_s)} to go" if left_s else ""
                console.print(f"simulated night {bar.tasks[0].completed:.0f} of {draws}{more}")

        yield done


def visibility(source: str, bench: str | None = None, model: str | None = None) -> Answer:
    """Before a night is spent: say which effects these collects can see, and which look alike.

    From the size that is said on, hil reconcile finds an effect in nine nights of ten.
    """
    from hil.config import load_bench, load_sweep
    from hil.design.visibility.document import campaign_document, sweep_document, visibility_text
    from hil.model import load_model

    chosen = None if model is None else load_model(model)
    if Path(source).is_dir():
        if bench is not None:
            raise InputError(f"--bench is for a sweep: {source} was measured, and nothing of a bench is asked of it")
        document = campaign_document(read_source(Path(source)), chosen)
    else:
        document = sweep_document(load_sweep(source), load_bench(bench or "simulated"), chosen)
    return Answer(document, {"text": visibility_text(document)})


def effects() -> Answer:
    """List the catalogue: every effect that the twin can simulate and reconcile can name."""
    from hil.model.effects.document import effects_document

    return Answer(effects_document())
