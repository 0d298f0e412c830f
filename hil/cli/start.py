"""Commands to begin with: a bench file from six answers, and the documentation that came with the program."""

from __future__ import annotations

import sys
import tempfile
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.ask import ask_words
from hil.cli.output import messages, results
from hil.errors import InputError


def init(
    out: Annotated[Path, typer.Argument(help="The bench file to write; must not exist yet.")] = Path("my-bench.yaml"),
    chamber: Annotated[str, typer.Option(help="Its controller, such as espec.")] = "",
    chamber_port: Annotated[str, typer.Option(help="/dev/ttyUSB1, COM3, socket://host:port.")] = "",
    limits: Annotated[str, typer.Option(help="What it may be set to: '-40 to 85 degC'.")] = "",
    unit: Annotated[str, typer.Option(help="The unit's frame description, such as stim300.")] = "",
    unit_port: Annotated[str, typer.Option(help="As --chamber-port.")] = "",
    latitude: Annotated[str, typer.Option(help="Of the bench: '59.9 deg'.")] = "",
) -> None:
    """Write a first bench file from six answers; what is not given is asked. Look it over, then hil check it."""
    from drivers.chambers import CHAMBER_DRIVERS
    from hil.bench.new_file import EXAMPLES, Asked, new_bench
    from hil.files.durable import write_result
    from hil.files.strict import config_folders

    if out.exists():
        raise InputError(f"{out}: exists already, and is left as it is; give another name")
    ports = "/dev/ttyUSB0, COM3, socket://host:port"
    units = sorted(path.stem for folder in config_folders("imus") for path in folder.glob("*.yaml"))
    chambers = ", ".join(f"{name} ({driver.title})" for name, driver in CHAMBER_DRIVERS.items() if name != "box")
    asked = Asked(chamber, chamber_port, limits, unit, unit_port, latitude)
    new_bench(out.stem, asked.with_examples())  # an option that cannot be is no question
    for key, question in {
        "chamber": f"Which controller has the chamber: {chambers}",
        "chamber_port": f"At which port is it ({ports})",
        "limits": f"Between which temperatures may it be set ({EXAMPLES.limits})",
        "unit": f"Which unit: {', '.join(units)}",
        "unit_port": f"At which port is it ({ports})",
        "latitude": f"At which latitude does the bench stand ({EXAMPLES.latitude})",
    }.items():
        while not getattr(asked, key):
            answered = replace(asked, **{key: _ask(question, f"--{key.replace('_', '-')}")})
            try:
                new_bench(out.stem, answered.with_examples())
                asked = answered
            except InputError as error:
                messages().print(str(error))
    write_result(out, new_bench(out.stem, asked))
    results().print(f"bench: {out}; look at what is marked ASSUMED in it, then: hil check {out}")


def _ask(question: str, option: str) -> str:
    if not sys.stdin.isatty():
        raise InputError(f"nobody can be asked here; give {option}")
    return ask_words(question)


def docs(
    topic: Annotated[str, typer.Argument(help="A page's name, such as wire-a-chamber; index lists them.")] = "index",
    site: Annotated[Path | None, typer.Option(help="Write all pages as HTML below this folder.")] = None,
    show: Annotated[bool, typer.Option("--open", help="Show it in the browser.")] = False,
) -> None:
    """Print a page of the documentation that came with the program; no network is needed."""
    from rich.markdown import Markdown

    from hil.cli.api import api_reference
    from hil.files.manual import manual, manual_folder, page, write_site

    text = page(topic)
    if site is not None or show:
        folder = site or Path(tempfile.mkdtemp(prefix="hil-docs-"))
        write_site(folder, {"python": api_reference()})
        name = topic.removesuffix(".md").rpartition("/")[2]
        shown = (folder / manual()[name].relative_to(manual_folder())).with_suffix(".html").resolve()
        results().print(f"page: {shown}")
        if show and not webbrowser.open(shown.as_uri()):
            raise InputError(f"no browser could be started here; open {shown} yourself")
        return
    text += api_reference() if topic == "python" else ""
    console = results()
    console.print(Markdown(text) if console.is_terminal else text)


COMMANDS = (init, docs)
