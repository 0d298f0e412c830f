"""What people read of a command's document: its schema's template in `hil/cli/answers` gives lines and tables.

    lines_of(document, {"out": out})      # hil.allan/1 by answers/allan.txt.j2, in which the document is `r`

A line of a template is a line that is printed. `{{ heads("term", "value", left=["term"]) }}` is a line that is a table,
`{% do row("N", term.value|written(".3g")) %}` adds a row to it, `{{ aside("note: " ~ note) }}` goes beside the answer.
"""

from collections.abc import Collection, Iterator, Mapping
from functools import cache
from typing import Any

from jinja2 import Environment
from rich.table import Table

from hil.archive.page import sentences, some
from hil.cli.output import Aside, listing
from hil.files.numbers import WHOSE, rounded
from hil.files.page import templates
from hil.solve.document import first_in_words
from hil.solve.omissions import in_words
from procedures.words import counted, harmless

_MARK = "\x1f"  # begins a line that is none of text; what is filled in has no control characters


class _Marked(str):
    """A line that stands for something else."""

    __slots__ = ()


def lines_of(document: Mapping[str, Any], beside: Mapping[str, Any]) -> Iterator[str | Table]:
    """Yield the lines and tables that say a document; `beside` is what its template knows besides."""
    made: list[Aside | Table] = []

    def kept(each: Aside | Table) -> _Marked:
        made.append(each)
        return _Marked(f"{_MARK}{len(made) - 1}")

    def heads(*headings: str, left: Collection[str] | None = None) -> _Marked:
        return kept(listing(*headings, left=left))

    def row(*cells: object, style: str | None = None) -> None:
        tables = [each for each in made if isinstance(each, Table)]
        tables[-1].add_row(*map(str, cells), style=style)

    template = _environment().get_template(f"{document['schema'].removeprefix('hil.').partition('/')[0]}.txt.j2")
    mark = "  SIMULATED" * bool(document.get("simulated"))
    known = {"heads": heads, "row": row, "aside": lambda text: kept(Aside(text)), "mark": mark, **beside}
    for line in template.render(r=document, **known).removesuffix("\n").split("\n"):
        yield made[int(line.removeprefix(_MARK))] if line.startswith(_MARK) else line


@cache
def _environment() -> Environment:
    environment = templates(
        "hil.cli", "answers", finalize=lambda value: value if isinstance(value, _Marked) else harmless(str(value))
    )
    environment.filters |= {
        "written": lambda value, form: "–" if value is None else format(value, form),
        "chance": lambda p: "not asked" if p is None else "below 0.0001" if p < 1e-4 else f"{p:.2g}",
    }
    known = (counted, first_in_words, in_words, rounded, sentences, some, zip)
    environment.globals |= {each.__name__: each for each in known} | {"whose": WHOSE}
    return environment
