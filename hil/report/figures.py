"""The report's plots as inline SVG: readable in colour, in black and white, and with colour-blind eyes.

Every series has its own colour (Okabe–Ito), marker and line style, and every axis its unit.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_MATRIX = {"color": "#0072B2", "marker": "o", "linestyle": "-"}
_CONTRACTOR = {"color": "#D55E00", "marker": "s", "linestyle": "--"}
_SINGLE = {"color": "#009E73", "marker": "D", "linestyle": "-"}
_SVG_SETTINGS: Any = {"svg.fonttype": "none", "svg.hashsalt": "hil", "font.family": "sans-serif", "font.size": 9.0}


@dataclass(frozen=True)
class Line:
    """One line graph: mean and one-sigma scatter against temperature, each of shape (t,), with its legend entry."""

    label: str
    temperature_degC: FloatArray
    mean: FloatArray
    sigma: FloatArray  # NaN where a temperature has a single self-calibration
    style: str = "matrix"  # matrix, contractor or single


def against_temperature(title: str, unit: str, lines: Sequence[Line]) -> str:
    """Draw the layout of the report's Figures 2–5: a parameter against temperature, °C below and °F above."""
    figure, axes = _figure(6.2, 3.4)
    styles = {"matrix": _MATRIX, "contractor": _CONTRACTOR, "single": _SINGLE}
    for line in lines:
        axes.errorbar(
            line.temperature_degC,
            line.mean,
            yerr=np.nan_to_num(line.sigma),
            label=line.label,
            capsize=3,
            markersize=5,
            linewidth=1.4,
            **styles[line.style],  # type: ignore[arg-type]
        )
    axes.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    axes.set_xlabel("temperature, °C")
    axes.set_ylabel(unit)
    axes.set_title(title, loc="left", fontsize=10, pad=22)
    fahrenheit = axes.secondary_xaxis("top", functions=(_fahrenheit, _celsius))
    fahrenheit.set_xlabel("°F", labelpad=1, fontsize=8)
    fahrenheit.tick_params(labelsize=8)
    axes.grid(visible=True, color="0.92")
    if len(lines) > 1:
        axes.legend(frameon=False, fontsize=8)
    return _svg(figure)


@dataclass(frozen=True)
class Trace:
    """One temperature through the night, shape (t,)."""

    label: str
    hours: FloatArray
    temperature_degC: FloatArray


def through_the_night(traces: Sequence[Trace], collect_hours: FloatArray) -> str:
    """Draw chamber, setpoint and unit temperature against hours, with a tick below for every collect."""
    figure, axes = _figure(10.0, 3.2)
    looks = ({"color": "0.45", "linestyle": "-"}, {"color": "#0072B2"}, {"color": "#D55E00", "linestyle": "--"})
    for trace, look in zip(traces, looks, strict=False):
        axes.plot(trace.hours, trace.temperature_degC, linewidth=1.3, label=trace.label, **look)  # type: ignore[arg-type]
    if len(collect_hours):
        bottom = axes.get_ylim()[0]
        axes.plot(collect_hours, np.full(len(collect_hours), bottom), "|", color="black", markersize=9, label="collect")
    axes.set_xlabel("hours since the sweep began")
    axes.set_ylabel("temperature, °C")
    axes.grid(visible=True, color="0.92")
    axes.legend(frameon=False, fontsize=8, ncols=4, loc="upper left")
    return _svg(figure)


def _figure(width_in: float, height_in: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    axes = figure.add_subplot()
    axes.spines[["right"]].set_visible(False)
    return figure, axes


def _svg(figure: Figure) -> str:
    """Return the figure as an <svg> element without prologue, the same bytes for the same data."""
    import matplotlib as mpl  # imported late: it is slow, and only a report needs it

    stream = io.StringIO()
    with mpl.rc_context(_SVG_SETTINGS):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    return re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', 'role="img"', text, count=1)


def _fahrenheit(celsius: Any) -> Any:
    return celsius * 1.8 + 32.0


def _celsius(fahrenheit: Any) -> Any:
    return (fahrenheit - 32.0) / 1.8
