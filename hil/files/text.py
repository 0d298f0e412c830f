"""Texts without markup, for people and as files to begin with: templates beside the code that fills them."""

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined


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
