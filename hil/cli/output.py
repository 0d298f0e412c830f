"""Results to standard output, everything else to standard error."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from drivers.given_file import read_text
from hil.errors import InputError
from procedures.words import harmless

if TYPE_CHECKING:  # most commands read no campaign
    from hil.campaign import Campaign

_ANY_WIDTH = 10_000
PAGE = ("a page", ".html", ".htm")


class Aside(str):
    """A line that goes beside the result: a warning, a note; on standard error."""

    __slots__ = ()


def always_writable() -> None:
    """Let nothing that is printed end a command: a stream that was closed (`2>&-`), a terminal that has no degree sign.

    The numbers 0 to 2 are taken first, so that no file of a night gets one and with it what was meant for a terminal.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 - until the process ends
        else:
            stream.reconfigure(errors="replace")


def flushed() -> None:
    """Write out what is still to be printed; what a terminal that is gone cannot show changes no exit status."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            if error.errno not in (errno.EIO, errno.EPIPE):
                raise
            _to_nowhere(stream)


def _to_nowhere(stream: IO[str]) -> None:
    """Let the interpreter's last flush of a stream go nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


class Lasting(Console):
    """A console that outlives its reader: a night is not over because nobody looks any more."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as any console does, text without control characters, tables no narrower than their words."""
        wide = self.options.update(width=_ANY_WIDTH)
        for table in (each for each in objects if isinstance(each, Table)):
            for column in table.columns:
                cells = [Measurement.get(self, wide, cell) for cell in (column.header, *column.cells)]
                column.min_width = max(each.minimum for each in cells)
                column.no_wrap = column.min_width == max(each.maximum for each in cells)
            asked = Measurement.get(self, wide, table)
            table.collapse_padding = asked.minimum > self.width  # one space, not two
            for column in table.columns if asked.maximum > self.width else ():
                column.max_width = column.min_width if column.justify == "right" else None  # what is words makes room
            options["crop"] = False  # no number is cut, however narrow the terminal
        super().print(*(harmless(each) if isinstance(each, str) else each for each in objects), **options)

    def on_broken_pipe(self) -> None:
        """Say nothing more where whoever read (head, a pager) has gone; the interpreter's last flush goes nowhere."""
        self.quiet = True
        _to_nowhere(self.file)


def results() -> Console:
    """Standard output, for people; wide enough for any table where it is not a terminal."""
    terminal = sys.stdout.isatty()
    return Lasting(highlight=False, markup=False, soft_wrap=not terminal, width=None if terminal else _ANY_WIDTH)


def messages() -> Console:
    """Standard error; one line stays one line where it is not a terminal."""
    return Lasting(stderr=True, highlight=False, markup=False, soft_wrap=not sys.stderr.isatty())


def print_json(document: Mapping[str, Any]) -> None:
    """Write one JSON document. NaN is no JSON: a number that is not known must already be null."""
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    try:
        print(text, flush=True)  # noqa: T201 - no console changes a character
    except BrokenPipeError:
        results().on_broken_pipe()


def listing(*headings: str, left: Collection[str] | None = None) -> Table:
    """Return an empty table for people. Columns stand on the right but those of `left`; without it all on the left."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in headings:
        right = left is not None and heading not in left
        table.add_column(heading, justify="right" if right else "left")
    return table


def check_result_folder(out: Path, own: str = "", given: str = "", of: Campaign | None = None) -> None:
    """Raise `InputError` for an --out that is a file, lies in a night, cannot be written, or holds what would be lost.

    That is the `given` model, and whatever is not beside `own`, the document that the command writes into the folder
    `of` the same campaign.
    """
    _refuse_night(out)
    there = next(above for above in (out, *out.parents, Path.cwd()) if above.exists())
    if not there.is_dir():
        raise InputError(f"{there}: is a file; the result needs a folder")
    if not os.access(there, os.W_OK):
        raise InputError(f"{out}: cannot be written: nobody may who runs this; name another folder for the result")
    model = out / "model.yaml"
    if not own:
        return
    if model.exists() and Path(given).exists() and model.samefile(given):
        raise InputError(
            f"{model}: is the model to start from, which would be lost; name another folder for the result"
        )
    if out.is_dir() and any(out.iterdir()) and not (out / own).is_file():
        raise InputError(
            f"{out}: holds something, and no {own}; name a new folder, or one with a result of this command"
        )
    if of is None or not (path := out / own).is_file():
        return
    try:
        there = json.loads(read_text(path))
        title, source = there["campaign"], there["source"]
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path}: does not say of which campaign it is; name a new folder for the result") from None
    if (title, source) != (of.title, of.source):
        raise InputError(f"{path}: is of another campaign, {title} ({source}), and would be lost; name a new folder")


def _refuse_night(folder: Path) -> None:
    from hil.records.reader import is_night

    for above in (folder.absolute(), *folder.absolute().parents):
        if is_night(above):
            raise InputError(f"{folder}: is a night's folder, which keeps what was recorded; name another")


def check_named(path: Path, ending: str) -> None:
    """Raise `InputError` where a file's name does not end so, or is a campaign's own, or its folder is not there."""
    from hil.campaign.reader import COLLECTS_FILE, HEADER_FILE

    if path.name == COLLECTS_FILE and path.with_name(HEADER_FILE).exists():
        raise InputError(f"{path}: is what a campaign's averages stand in, which would be lost; give another name")
    if path.suffix.lower() != ending or not path.parent.is_dir():
        raise InputError(f"{path}: give a name that ends in {ending}, in a folder that exists")
    _refuse_night(path.absolute().parent.parent)  # a page may lie beside the journal, and nothing in a night's folders


def warn(warnings: list[str] | tuple[str, ...]) -> None:
    """Say on standard error what is suspicious about the input."""
    for line in warnings:
        messages().print(f"warning: {line}")
