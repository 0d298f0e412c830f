"""The report's own tables from a night, beside what it printed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from hil.cli.answer import Answer, Aside
from hil.cli.data import Source, read_source
from hil.cli.output import listing

if TYPE_CHECKING:  # a command that is not this one does not wait for it
    from hil.analysis.published.reproduction import Cell, ContractorError, Printed, Reproduction, SevenBiases
    from hil.campaign import Campaign


def reproduce(
    source: Source,
    sensor: Annotated[int, typer.Option(help="Which sensor; the report's tables are sensor 2's.")] = 2,
) -> Answer:
    """Give RD-GC-86-1's Table 1, Figures 2-5 and Table A-1 again from a night, beside the printed values."""
    from hil.analysis.published.reproduction import reproduce as give_again

    campaign = read_source(source)
    found = give_again(campaign, sensor)
    return Answer(found.document(), lambda: _given_again(campaign, found))


def _given_again(campaign: Campaign, found: Reproduction) -> Iterator[str | Table]:
    yield from (Aside(f"warning: {line}") for line in campaign.warnings)
    yield f"{campaign.title}{'  SIMULATED' * campaign.simulated}"
    yield "\nTable 1: mean ± one sigma (n - 1); below it as printed, * where its own identities do not close"
    yield _table_1(found)
    yield "\nTable A-1: the bias BA seven ways, deg/hr; then the printed rows"
    yield _table_a1(found)
    yield "\nContractor's less matrix parameters, largest of all runs, and what of it the closed form explains"
    yield from _contractor(found.contractor_errors)


def _table_1(found: Reproduction) -> Table:
    temperatures = zip(found.temperatures_degC, found.printed_temperatures, strict=True)
    headings = (name or ("" if at is None else f"{at:.1f} degC") for at, name in temperatures)
    table = listing(" ", *headings, left={" "})
    for row in found.table_1:
        table.add_row(f"{row.label}, {row.unit}", *(_measured(cell) for cell in row.cells))
        table.add_row("  printed", *(_printed(cell.printed) for cell in row.cells), style="dim")
    return table


def _measured(cell: Cell) -> str:
    return f"{cell.mean:.2f}" + ("" if cell.sigma is None else f" ±{cell.sigma:.2f}")


def _printed(printed: Printed | None) -> str:
    if printed is None:
        return "–"
    sigma = "" if printed.sigma is None else f" ±{printed.sigma:.2f}"
    return f"{printed.mean:.2f}{sigma}{'*' if printed.doubt else ' '}"


def _table_a1(found: Reproduction) -> Table:
    from hil.analysis.published.reproduction import SEVEN

    table = listing("", *SEVEN, "MUB·G1", "MUB·G3", "G3/G1", left=())
    for each in found.table_a1:
        table.add_row(*_seven(each))
    for each in found.printed_a1:
        table.add_row(*_seven(each), style="dim")
    return table


def _seven(each: SevenBiases) -> list[str]:
    label = each.label if each.label.startswith("run") else f"printed {each.label}"
    return [
        label,
        *(f"{value:.4f}" for value in each.biases.values()),
        f"{each.mub_g1:.4f}",
        f"{each.mub_g3:.4f}",
        f"{each.g3_over_g1:.4f}",
    ]


def _contractor(errors: tuple[ContractorError, ...]) -> list[str]:
    from hil.analysis.published.reproduction import CONTRACTORS

    lines = []
    for i, name in enumerate(CONTRACTORS):
        worst = max(errors, key=lambda each: abs(each.found[i]))
        lines.append(
            f"  {name}: {worst.found[i]:+.4f} in run {worst.run}; by the closed form {worst.closed_form[i]:+.4f}, by "
            f"the report's G1 term alone {worst.g1_only[i]:+.4f}"
        )
    return lines


COMMANDS = (reproduce,)
