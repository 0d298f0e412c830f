"""The report's own tables from a night, beside what it printed."""

from __future__ import annotations

from typing import Annotated

import typer

from hil.cli.answer import Answer, told
from hil.cli.data import Source, read_source


def reproduce(
    source: Source,
    sensor: Annotated[int, typer.Option(help="Which sensor; the report's tables are sensor 2's.")] = 2,
) -> Answer:
    """Give RD-GC-86-1's Table 1, Figures 2-5 and Table A-1 again from a night, beside the printed values."""
    from hil.analysis.published.reproduction import reproduce as give_again

    campaign = read_source(source)
    document = give_again(campaign, sensor).document()
    return Answer(document, told(document, campaign=campaign))


COMMANDS = (reproduce,)
