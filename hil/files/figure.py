"""A plot as a file: SVG or PNG by the end of its name, the same bytes for the same data."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.errors import InputError
from hil.files.durable import RealDisk, write_durably

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SETTINGS: Any = {"svg.fonttype": "none", "svg.hashsalt": "hil", "font.family": "sans-serif", "font.size": 9.0}
_DOTS_PER_INCH = 150


def check_name(path: Path) -> None:
    """Raise `InputError` where a plot's name ends in neither .svg nor .png, or its folder is not there."""
    if path.suffix.lower() not in {".svg", ".png"}:
        raise InputError(f"{path}: a plot is written as .svg or .png; give a name that ends so")
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist")


def drawn(figure: Figure, kind: str = "svg") -> bytes:
    """Return the bytes of a picture, svg or png."""
    import matplotlib as mpl  # imported late: it is slow, and only a plot needs it

    details: Any = {"metadata": {"Date": None, "Creator": None}} if kind == "svg" else {"dpi": _DOTS_PER_INCH}
    stream = io.BytesIO()
    with mpl.rc_context(SETTINGS):
        figure.savefig(stream, format=kind, **details)
    return stream.getvalue()


def save_figure(figure: Figure, path: Path) -> None:
    """Write `figure` to `path`, whole or not at all; raise `InputError` where the file cannot be written."""
    check_name(path)
    try:
        write_durably(RealDisk(), path, drawn(figure, path.suffix.lower().removeprefix(".")))
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
