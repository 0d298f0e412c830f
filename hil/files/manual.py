"""The documentation that came with the program: its pages by name, and all of them as a site of HTML files."""

import json
import re
import shutil
from collections.abc import Mapping
from html import unescape
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markdown_it import MarkdownIt

from hil.errors import InputError, worded
from hil.files.strict import near

INDEX = "index"
_SEARCH = Path(__file__).with_name("search.js")
_LINK = re.compile(r'href="([^":#]*)\.md(#[^"]*)?"')
_HEADING = re.compile(r"<(h[1-6])>(.*)</\1>")


def manual_folder() -> Path:
    """Return the folder of the pages: the installed package's, or the checkout's."""
    package = Path(__file__).resolve().parents[1]
    return next(folder for folder in (package / "docs", package.parent / "docs") if folder.is_dir())


def manual() -> dict[str, Path]:
    """Return every page by its name: the file's, or its folder's where it is that folder's README, `index` of all."""
    above = manual_folder()
    found = {path: path.parent.name if path.stem == "README" else path.stem for path in sorted(above.rglob("*.md"))}
    return {INDEX if path.parent == above and path.stem == "README" else name: path for path, name in found.items()}


def page(topic: str) -> str:
    """Return the text of the page `topic`, Markdown; raise `InputError` naming the nearest where there is none."""
    name = topic.removesuffix(".md").rpartition("/")[2]
    pages = manual()
    if name not in pages:
        raise InputError(f"there is no page {topic!r}{near(name, list(pages))}")
    return pages[name].read_text("utf-8")


def write_site(folder: Path, more: Mapping[str, str]) -> None:
    """Write every page as HTML below `folder`, with pictures; links lead from page to page and to their headings.

    `more` is what follows in pages, by their name. Every page has a search over all of them, which needs no server.
    Raises `InputError` where it cannot be written.
    """
    above, render = manual_folder(), MarkdownIt("commonmark").enable("table")
    template = Environment(
        loader=PackageLoader("hil.files", "."), autoescape=True, undefined=StrictUndefined
    ).get_template("manual.html.j2")
    with worded(InputError, f"{folder}: cannot be written: ", OSError):
        found = []
        for name, path in manual().items():
            there = path.relative_to(above)
            text = path.read_text("utf-8") + more.get(name, "")
            body = _HEADING.sub(_with_anchor, _LINK.sub(r'href="\1.html\2"', render.render(text)))
            target = folder / there.with_suffix(".html")
            target.parent.mkdir(parents=True, exist_ok=True)
            top = "../" * (len(there.parts) - 1)
            title = text.partition("\n")[0].removeprefix("# ")
            target.write_text(template.render(body=body, title=title, top=top), "utf-8")
            found.append(
                [title, there.with_suffix(".html").as_posix(), " ".join(re.sub(r"<[^>]*>", " ", body).split())]
            )
        (folder / "search.js").write_text(f"const PAGES = {json.dumps(found)};\n{_SEARCH.read_text('utf-8')}", "utf-8")
        for kind in ("images", "notebooks"):
            shutil.copytree(above / kind, folder / kind, dirs_exist_ok=True)


def _with_anchor(heading: re.Match[str]) -> str:
    """Give a heading the anchor by which links name it: its words in small letters, with hyphens between them."""
    tag, inside = heading.groups()
    words = re.sub(r"[^\w\- ]", "", re.sub(r"<[^>]*>", "", unescape(inside)).lower()).strip()
    return f'<{tag} id="{words.replace(" ", "-")}">{inside}</{tag}>'
