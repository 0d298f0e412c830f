"""Pages for people, one HTML file in one design, light or dark, pictures inside it; and texts without markup."""

from __future__ import annotations

import hashlib
import html
import re
from collections.abc import Mapping
from textwrap import shorten
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, PrefixLoader, StrictUndefined
from markupsafe import Markup

from hil.files.figure import drawn
from hil.files.numbers import degrees, number
from procedures.words import counted, hours_minutes, percent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LONGEST_RUNNING = 90
_HYPHEN = re.compile(r"(?<![^\s(±])-(?=\d)")


def rendered(room: str, template: str, content: Mapping[str, Any]) -> str:
    """Return the page that `template` of the package `room` makes of `content`, its `r`; it extends files/page.

    Of the content it takes `title` and `simulated`; on paper a title runs along, and one that is not `whole` folds.
    """
    environment = Environment(
        loader=PrefixLoader({"room": PackageLoader(room, "."), "files": PackageLoader("hil.files", ".")}),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        # A hyphen is not read out, and parts from its number at the end of a line.
        finalize=lambda each: each if isinstance(each, Markup) else _HYPHEN.sub("\N{MINUS SIGN}", str(each)),
    )
    filters = {"number": number, "degrees": degrees, "hours_minutes": hours_minutes, "counted": counted}
    environment.filters |= {**filters, "percent": percent}
    return environment.get_template(f"room/{template}").render(
        r={"whole": False, "running_title": _in_style(content["title"]), **content}
    )


def _in_style(title: str) -> Markup:
    """Return a text, shortened, for a string of CSS, in which only letters and digits need no escape."""
    short = shorten(title, _LONGEST_RUNNING, placeholder=" …")
    return Markup("".join(c if c.isascii() and c.isalnum() else f"\\{ord(c):x} " for c in short))  # noqa: S704 - escaped


def inline_svg(figure: Figure, says: str) -> str:
    """Return the figure as an <svg> element for a page, the same bytes for the same data; `says` is its text for ears.

    Its ids are its own: a page may hold many such elements. It has no ground: the page's shows through.
    """
    figure.patch.set_visible(False)
    for axes in figure.axes:
        axes.patch.set_visible(False)
    text = drawn(figure).decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.DOTALL)
    label = html.escape(says, quote=True)
    text = re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', f'role="img" aria-label="{label}"', text, count=1)
    used = set(re.findall(r'["(]#([^")]+)', text))
    prefix = "f" + hashlib.sha256(text.encode()).hexdigest()[:10]
    text = re.sub(r' id="([^"]+)"', lambda found: f' id="{prefix}{found[1]}"' if found[1] in used else "", text)
    return re.sub(r'(["(])#([^")]+)', rf"\1#{prefix}\2", text)


def templates(room: str, folder: str = ".", **more: Any) -> Environment:
    """Return the templates of texts in a folder of the package `room`; `more` are options of jinja2."""
    return Environment(  # noqa: S701 - nothing in it is HTML
        loader=PackageLoader(room, folder),
        extensions=["jinja2.ext.do"],
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        **more,
    )


def filled(room: str, template: str, **known: Any) -> str:
    """Return the text that `template` of the package `room` makes of what is known."""
    return templates(room).get_template(template).render(known)
