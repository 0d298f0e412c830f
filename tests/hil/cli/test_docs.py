"""The documentation: every link leads somewhere, every command and option named in it exists, no page is unlisted."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

import hil
from hil.cli.app import GROUPS, app
from hil.files.manual import manual

ROOT = Path(__file__).resolve().parents[3]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
CLI = typer.main.get_command(app)

_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
_CODE = re.compile(r"^(?: {4,}|\t)(.*)$|`([^`]+)`", re.MULTILINE)
_COMMAND = re.compile(r"(?:^|[\s/(])(?:-u hil )?hil((?: +[a-z][a-z-]*)+)((?:\s+[^#;&]*)?)")


def name_of(page: Path) -> str:
    """Return where the page is in the project."""
    return str(page.relative_to(ROOT))


def anchors(page: Path) -> set[str]:
    """Return the anchors that a page's headings have."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def below(command: Any) -> dict[str, Any]:
    """Return the commands of a group by name; none where it is a command itself."""
    found: dict[str, Any] = getattr(command, "commands", {})
    return found


def commands_in(page: Path) -> Iterator[tuple[str, Any, str]]:
    """Yield each `hil` command that a page names: as written, as the program has it, and the rest of its line."""
    for indented, inline in _CODE.findall(page.read_text()):
        for words, rest in _COMMAND.findall(indented or inline):
            command: Any = CLI
            for word in words.split():
                if not below(command):
                    break
                found = below(command).get(word)
                assert found is not None, f"{name_of(page)}: hil{words}: there is no command {word}"
                command = found
            yield f"hil{words}{rest}", command, rest


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_relative_link_leads_somewhere(page: Path) -> None:
    """To a file or folder of the project, and to a heading that is in it."""
    for target in _LINK.findall(page.read_text()):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        there = (page.parent / file).resolve() if file else page
        assert there.exists(), f"{name_of(page)}: {target} leads nowhere"
        assert there.is_relative_to(ROOT), f"{name_of(page)}: {target} leads out of the project"
        if anchor and there.suffix == ".md":
            assert anchor in anchors(there), f"{name_of(page)}: {target}: no such heading"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_and_option_that_is_named_exists(page: Path) -> None:
    """What a reader copies must not be refused as unknown."""
    for written, command, rest in commands_in(page):
        known = {name for each in command.params for name in (*each.opts, *each.secondary_opts)} | {"--help"}
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", rest):
            assert option in known, f"{name_of(page)}: {written}: there is no option {option}"


def test_commands_are_found_in_the_pages_at_all() -> None:
    """The search itself works: in blocks, in sentences, in tables."""
    found = [written for page in PAGES for written, _, _ in commands_in(page)]
    assert len(found) > 100
    assert any(each.startswith("hil plot series") for each in found)


def test_every_command_is_in_the_reference() -> None:
    """Nothing that the program can do is without its line in docs/reference/commands.md."""
    listed = {command.name for _, command, _ in commands_in(ROOT / "docs" / "reference" / "commands.md")}
    for name, command in below(CLI).items():
        missing = (set(below(command)) or {name}) - listed
        assert not missing, f"hil {name}: {missing} not in docs/reference/commands.md"


def test_every_page_is_in_the_index() -> None:
    """docs/README.md has a line for each page; decisions and effects have indexes of their own."""
    index = ROOT / "docs" / "README.md"
    listed = {(index.parent / target.partition("#")[0]).resolve() for target in _LINK.findall(index.read_text())}
    own = {ROOT / "docs" / folder for folder in ("decisions", "effects")}
    for page in PAGES[1:]:
        if page != index and (page.parent not in own or page.name == "README.md"):
            assert page in listed, f"{name_of(page)} is not in docs/README.md"
    for folder in own:
        lists = (folder / "README.md").read_text()
        for page in folder.glob("*.md"):
            assert page.name == "README.md" or f"({page.name}" in lists, f"{name_of(page)} is not in its index"


def test_advice_names_pages_that_the_program_has() -> None:
    """`hil docs NAME` wherever it is written: in the program, in what ships with it, in the documentation itself."""
    files = [path for top in ("hil", "drivers", "procedures", "configs", "docs") for path in (ROOT / top).rglob("*.*")]
    named = 0
    for path in (*files, ROOT / "README.md"):
        if path.suffix in {".py", ".yaml", ".service", ".md", ".j2"}:
            text = path.read_text("utf-8")
            for name in re.findall(r"hil docs ([a-z][a-z-]+)", text):
                named += 1
                assert name in manual(), f"{name_of(path)}: there is no page {name}"
            if path.suffix != ".md":
                assert not re.findall(r"docs/[\w/-]+\.md", text), f"{name_of(path)}: who installed hil has no such file"
    assert named > 10


def test_the_installed_program_has_every_page() -> None:
    """The wheel takes each page, picture and notebook of the documentation, and nothing of it twice."""
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    taken = {source: target for source, target in wheel["force-include"].items() if source.startswith("docs")}
    assert {f"hil/{source}" for source in taken} == set(taken.values())
    kept = [path for path in (ROOT / "docs").rglob("*.*") if path.suffix in {".md", ".png", ".ipynb"}]
    for path in (each for each in kept if not {"pictures", "site"} & {*each.parts}):
        holding = [source for source in taken if path == ROOT / source or (ROOT / source) in path.parents]
        assert len(holding) == 1, f"{name_of(path)} is in {holding}"


@pytest.mark.slow
def test_the_site_holds_together(tmp_path: Path) -> None:
    """Every link of every page, to a page, its heading, a picture or a notebook; only the project's own files lack."""
    assert CliRunner().invoke(app, ["docs", "wire-a-chamber", "--site", str(tmp_path)]).exit_code == 0
    pages = {path.resolve(): path.read_text("utf-8") for path in tmp_path.rglob("*.html")}
    assert len(pages) == len(manual()) == len(PAGES) - 1
    assert sum(len(re.findall(r'href="[^":]+\.html#', text)) for text in pages.values()) > 10
    searched = (tmp_path / "search.js").read_text("utf-8")
    assert all(f'"{path.relative_to(tmp_path.resolve()).as_posix()}"' in searched for path in pages)
    python = pages[tmp_path.resolve() / "reference" / "python.html"]
    for name in hil.__all__:
        assert f"{name}</h3>" in python
        assert str(getattr(hil, name).__doc__).partition("\n")[0].partition("`")[0] in unescape(python), name
    for path, text in pages.items():
        for target in re.findall(r'(?:href|src)="([^":]*)"', text):
            file, _, anchor = target.partition("#")
            there = (path.parent / file).resolve() if file else path
            if there.is_relative_to(tmp_path.resolve()):
                assert there.exists(), f"{path}: {target}"
                assert not anchor or f'id="{anchor}"' in pages[there], f"{path}: {target}"


def test_every_command_stands_in_one_group_of_the_help() -> None:
    """What is in none could be found by nobody; what is in two is told twice."""
    grouped = " ".join(GROUPS.values()).split()
    assert sorted(grouped) == sorted(below(CLI))
    text = CliRunner().invoke(app, ["--help"]).output
    titles = [text.index(f"{title}:") for title in GROUPS]
    assert titles == sorted(titles)
    assert text.index("A night:") < text.index("  run ") < text.index("Its results:") < text.index("  reconcile ")


def test_the_version_is_that_of_the_project() -> None:
    """As pyproject.toml states it."""
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert CliRunner().invoke(app, ["--version"]).output == f"hil {stated}\n"
