"""Commands that stand in for devices: simulate."""

import sys
from typing import Annotated

import typer


def simulate(
    bench: Annotated[
        str, typer.Argument(help="A bench file with a simulation section, or the name of one that ships.")
    ] = "simulated",
    tcp: Annotated[bool, typer.Option("--tcp", help="TCP ports on this machine instead of pseudo-terminals.")] = False,
) -> None:
    """Serve a bench's simulated unit and chamber to any client, in real time, until Ctrl-C.

    One JSON line on standard output says where they are.
    """
    from hil.config import load_bench
    from hil.twin.serve import serve_bench

    serve_bench(load_bench(bench), _announce, tcp=tcp)


def _announce(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


COMMANDS = (simulate,)
