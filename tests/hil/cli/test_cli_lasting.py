"""What is printed to nobody harms nothing: a night goes on when the reader of its lines has gone."""

from __future__ import annotations

import os

from hil.cli.output import Lasting


def test_a_console_outlives_its_reader() -> None:
    """The first line after the reader has gone is lost in silence, and so are all others."""
    reads, writes = os.pipe()
    with os.fdopen(writes, "w") as pipe:
        console = Lasting(file=pipe)
        console.print("seen")
        os.close(reads)
        console.print("not seen")
        console.print("nor this")
        assert console.quiet
