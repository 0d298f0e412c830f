"""The names that scripts and others' packages may use, with signature and docstring: the end of `hil docs python`."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from typing import Any

_FACES = {
    "hil": "load_bench read_campaign read_night Measured Night Answer Picture",
    "hil.bench.bluesky": "bluesky_devices MovableChamber ReadableImu",
    "drivers.borrowed": "Value awaited",
    "drivers.chambers.controllers.borrowed": "BorrowedController",
    "drivers.positioners.borrowed": "BorrowedPositioner",
    "drivers.chambers.catalogue": "ChamberDriver ChamberOptions supervised",
    "hil.model.effects.base": "Effect VarianceEffect Parameter column per_channel",
    "hil.model.effects.inside": "SeriesEffect",
}


def api_reference() -> str:
    """Return it as Markdown: a list of all names, and a heading for each."""
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
    """Return how it is called, without the quotes around annotations and the modules of types."""
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", str(inspect.signature(thing)))
    text = re.sub(r"\b(?:[a-z_]\w*\.)+(\w)", r"\1", text.removesuffix(" -> None"))
    return name + re.sub(r"^\(self(, )?", "(", text)
