"""Commands that work on measured data: solve, export."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from hil.cli.output import JsonFlag, listing, messages, printed, results, warn

if TYPE_CHECKING:  # `hil --help` loads no arithmetic
    from hil.campaign import Campaign
    from hil.solve import RunSolution
    from hil.solve.repeats import SensorRepeats

Source = Annotated[Path, typer.Argument(help="A campaign folder, or a night's folder.", show_default=False)]


def read_source(source: Path) -> Campaign:
    """Read a campaign folder, or the collects of a night as one; raise `InputError` where it is neither."""
    from hil.records.export import open_source

    return open_source(source).campaign


def solve(
    source: Source,
    model: Annotated[
        str | None,
        typer.Option(
            help="matrix-6, collins-4, matrix-6-thermal, constant, triad-12 or a model file; default: what fits."
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Solve every self-calibration for bias and acceleration-sensitive drift, with uncertainties."""
    from hil.model.forms import MODEL_NAMES
    from hil.solve import repeats, solve_campaign
    from hil.solve.both_sensors import common_and_differential
    from hil.solve.document import solution_document
    from hil.solve.wrong_rows import in_words

    campaign = read_source(source)
    warn(tuple(campaign.warnings))
    for note in campaign.notes.splitlines():
        messages().print(f"note: {note}")
    if model is None or model in MODEL_NAMES:
        solutions = solve_campaign(campaign, model)
    else:
        from hil.model import load_model
        from hil.solve.beside_terms import solve_beside

        solutions = solve_beside(campaign, load_model(model))
    shown, both = repeats(campaign, solutions), common_and_differential(campaign)
    document = solution_document(campaign, solutions)
    document["both_sensors"] = None if both is None else both.document()
    if printed(document, as_json):
        return
    console = results()
    mark = "  SIMULATED" if campaign.simulated else ""
    console.print(f"{campaign.title}{mark}")
    for line in in_words(document["rows"]):
        console.print(line)
    for sensor in campaign.sensors:
        own = [each for each in solutions if each.sensor == sensor]
        models = ", ".join(dict.fromkeys(each.model for each in own))
        console.print(f"\nsensor {sensor}, {models}; value ± one standard deviation, what repeats show included")
        console.print(_solution_table(own, shown[sensor]))
        for sentence in shown[sensor].sentences():
            console.print(sentence)
    for text in dict.fromkeys(
        f"run {each.run}, sensor {each.sensor}: {each.reason}" for each in solutions if _odd(each)
    ):
        console.print(text)
    for text in dict.fromkeys(text for each in solutions for text in each.assumed):
        console.print(f"assumed: {text}")
    for sentence in () if both is None else both.sentences():
        console.print(sentence)


def _odd(solution: RunSolution) -> bool:
    return solution.verdict != "PASS"


def _solution_table(solutions: list[RunSolution], shown: SensorRepeats) -> Table:
    units = {name: each.unit for solution in solutions for name, each in solution.parameters.items()}
    table = listing("run", *(f"{name}\n{unit}" for name, unit in units.items()), "verdict", left={"verdict"})
    for solution in solutions:
        cells, uncertain = [], shown.of_run(solution)
        for name in units:
            found = uncertain.get(name)
            sd = "" if found is None or found.sd != found.sd else f" ±{found.sd:.2f}"
            cells.append("–" if found is None else f"{found.value:.2f}{sd}")
        table.add_row("all" if solution.run is None else str(solution.run), *cells, str(solution.verdict))
    return table


def export(
    folder: Annotated[Path, typer.Argument(help="A night's folder.", show_default=False)],
    out: Annotated[Path, typer.Argument(help="The campaign folder to make.", show_default=False)],
) -> None:
    """Write the night as a campaign folder: CSV that a spreadsheet reads."""
    from hil.records.export import export_campaign

    written = export_campaign(folder, out)
    for note in written.notes:
        messages().print(f"note: {note}")
    results().print(f"campaign: {out}, {written.rows} rows")


COMMANDS = (solve, export)
