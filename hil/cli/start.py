"""Commands to begin with: a bench file from six answers, and the documentation that came with the program."""

import inspect
import re
import sys
import tempfile
import webbrowser
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from hil.cli.ask import ask_words
from hil.cli.output import messages, results
from hil.errors import InputError
from hil.files.durable import check_new, write_result
from hil.files.strict import config_folders

_FACES = {
    "hil": "load_bench read_campaign read_night Measured Night Answer Picture",
    "hil.bench.bluesky": "bluesky_devices MovableChamber ReadableImu",
    "drivers.borrowed": "Value awaited",
    "drivers.chambers.controllers.borrowed": "BorrowedController",
    "drivers.positioners.borrowed": "BorrowedPositioner",
    "drivers.chambers.catalogue": "ChamberDriver ChamberOptions supervised",
    "hil.model.effects.base": "Effect VarianceEffect Parameter",
    "hil.model.effects.columns": "column per_channel",
    "hil.model.effects.inside": "SeriesEffect",
}
"""The names that scripts and others' packages may use: the end of `hil docs python`."""


def init(
    out: Path = Path("my-bench.yaml"),
    chamber: str = "",
    chamber_port: str = "",
    limits: str = "",
    unit: str = "",
    unit_port: str = "",
    latitude: str = "",
) -> None:
    """Write a first bench file from six answers; what is not given is asked. Look it over, then hil check it."""
    from drivers.chambers import CHAMBER_DRIVERS
    from hil.bench.new_file import EXAMPLES, new_bench

    check_new(out)
    ports = "/dev/ttyUSB0, COM3, socket://host:port"
    units = sorted(path.stem for folder in config_folders("imus") for path in folder.glob("*.yaml"))
    chambers = ", ".join(f"{name} ({driver.title})" for name, driver in CHAMBER_DRIVERS.items() if name != "box")
    asked = dict(zip(EXAMPLES, (chamber, chamber_port, limits, unit, unit_port, latitude), strict=True))
    new_bench(out.stem, asked)  # an option that cannot be is no question
    for key, question in {
        "chamber": f"Which controller has the chamber: {chambers}",
        "chamber_port": f"At which port is it ({ports})",
        "limits": f"Between which temperatures may it be set ({EXAMPLES['limits']})",
        "unit": f"Which unit: {', '.join(units)}",
        "unit_port": f"At which port is it ({ports})",
        "latitude": f"At which latitude does the bench stand ({EXAMPLES['latitude']})",
    }.items():
        while not asked[key]:
            if not sys.stdin.isatty():
                raise InputError(f"nobody can be asked here; give --{key.replace('_', '-')}")
            answered = asked | {key: ask_words(question)}
            try:
                new_bench(out.stem, answered)
                asked = answered
            except InputError as error:
                messages().print(str(error))
    write_result(out, new_bench(out.stem, asked))
    results().print(f"bench: {out}; look at what is marked ASSUMED in it, then: hil check {out}")


def docs(topic: str = "index", site: Path | None = None, show: bool = False) -> None:
    """Print a page of the documentation that came with the program; no network is needed."""
    from rich.markdown import Markdown

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


def api_reference() -> str:
    """Return `_FACES` with signatures and docstrings as Markdown: a list of all names, and a heading for each."""
    named = {
        f"{module}.{name}": getattr(import_module(module), name) for module in _FACES for name in _FACES[module].split()
    }
    listed = ", ".join(f"[{name}](#{re.sub(r'[^a-z_]', '', name.lower())})" for name in named)
    told = "\n\n".join(paragraph for name, thing in named.items() for paragraph in _told(name, thing))
    return f"\n\n## Every name, from its docstring\n\n{listed}\n\n{told}\n"


def _told(name: str, thing: Any) -> Iterator[str]:
    yield f"### {name}"
    yield f"    {_signature(name.rpartition('.')[2], thing)}"
    yield inspect.getdoc(thing) or ""
    for own, member in vars(thing).items() if inspect.isclass(thing) else ():
        if own.startswith("_") or not (inspect.isfunction(member) or isinstance(member, property)):
            continue
        yield f"`.{own if isinstance(member, property) else _signature(own, member)}`: {inspect.getdoc(member)}"


def _signature(name: str, thing: Any) -> str:
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", str(inspect.signature(thing)))
    text = re.sub(r"\b(?:[a-z_]\w*\.)+(\w)", r"\1", text.removesuffix(" -> None"))
    return name + re.sub(r"^\(self(, )?", "(", text)
