"""A plot as a file: SVG or PNG by the end of its name, the same bytes for the same data."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.files.durable import check_file, write_result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SETTINGS: Any = {"svg.fonttype": "none", "svg.hashsalt": "hil", "font.family": "sans-serif", "font.size": 9.0}
_DOTS_PER_INCH = 150
PLOT = ("a plot", ".svg", ".png")

LOOKS: dict[str, dict[str, Any]] = {
    "matrix": {"color": "#0072B2", "marker": "o", "linestyle": "-"},
    "contractor": {"color": "#D55E00", "marker": "s", "linestyle": "--", "markerfacecolor": "white"},
    "single": {"color": "#009E73", "marker": "D", "linestyle": "-."},
    "fourth": {"color": "#CC79A7", "marker": "^", "linestyle": ":"},
}
"""Okabe-Ito colours, each with a marker and a line style of its own: told apart in black and white, too."""


def blank(width_in: float, height_in: float) -> tuple[Figure, Axes]:
    """Return a figure with one pair of axes in the house's style, size in inches."""
    from matplotlib.figure import Figure  # imported late: it is slow, and only a plot needs it

    figure = Figure(figsize=(width_in, height_in))
    axes = figure.add_subplot()
    # Margins in inches: as good as a computed layout here, and a quarter of the time that a report takes.
    figure.subplots_adjust(
        left=0.75 / width_in, right=1 - 0.15 / width_in, bottom=0.5 / height_in, top=1 - 0.65 / height_in
    )
    axes.spines[["right"]].set_visible(False)
    axes.grid(visible=True, color="0.92")
    axes.set_axisbelow(True)
    return figure, axes


def marked(title: str, *, simulated: bool) -> str:
    """Return a title, marked where it must be. It is drawn as it is: a dollar sign in a name begins no formula."""
    return f"SIMULATED  {title}" if simulated else title


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
    check_file(path, *PLOT)
    write_result(path, drawn(figure, path.suffix.lower().removeprefix(".")))
