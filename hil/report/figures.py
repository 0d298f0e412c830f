"""The report's plots: readable in colour, in black and white, and with colour-blind eyes.

    figure = draw_against_temperature("Bias A", "deg/hr", lines)

Every series has its own colour (Okabe-Ito), marker and line style, and every axis its unit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hil.campaign import FloatArray
from hil.files.figure import LOOKS, blank
from hil.report.night import NightContent

_TRACES: tuple[dict[str, Any], ...] = (
    {"color": "0.35", "linestyle": ":", "linewidth": 1.2},
    {"color": "#0072B2", "linestyle": "-", "linewidth": 1.3},
    {"color": "#D55E00", "linestyle": "--", "linewidth": 1.3},
    {"color": "#009E73", "linestyle": "-.", "linewidth": 1.3},
    {"color": "#CC79A7", "linestyle": (0, (5, 1)), "linewidth": 1.3},
)
_NUMBERED = 40  # more events than this are marked without their numbers, which could not be read


@dataclass(frozen=True)
class Line:
    """One line graph: mean and one sigma against temperature, each of shape (t,), with its legend entry."""

    label: str
    temperature_degC: FloatArray
    mean: FloatArray
    sigma: FloatArray  # NaN where it is not known
    style: str = "matrix"  # a key of LOOKS


def draw_against_temperature(title: str, unit: str, lines: Sequence[Line], *, fahrenheit: bool = True) -> Figure:
    """Draw parameters against temperature, °C below; with °F above it is the layout of the report's Figures 2-5."""
    figure, axes = blank(*((5.2, 2.5) if fahrenheit else (4.4, 2.6)))
    for line in lines:
        axes.errorbar(
            line.temperature_degC,
            line.mean,
            yerr=np.nan_to_num(line.sigma),
            label=line.label,
            capsize=3,
            markersize=5,
            linewidth=1.4,
            **LOOKS[line.style],
        )
    axes.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    axes.set_xlabel("temperature, °C")
    axes.set_ylabel(unit)
    axes.set_title(title, loc="left", fontsize=10, pad=8)
    if fahrenheit:
        above = axes.secondary_xaxis("top", functions=(_fahrenheit, _celsius))
        above.set_xlabel("temperature, °F", labelpad=3, fontsize=8)
        above.tick_params(labelsize=8)
    else:
        figure.subplots_adjust(top=0.88)
    if len(lines) > 1:
        axes.legend(frameon=False, fontsize=8)
    return figure


def draw_night(night: NightContent) -> Figure:
    """Draw the temperatures through a night: soaks shaded, a tick for every collect, a numbered mark for every event.

    The numbers are those of the list of events, from 1.
    """
    figure, axes = blank(10.0, 3.3)
    for (label, values), look in zip(night.temperatures.items(), _TRACES, strict=False):
        axes.plot(night.hours, values, label=label, **look)
    for place, soak in enumerate(night.soaks):
        label = "_" if place else "restabilising"
        axes.axvspan(soak.began_h, soak.ended_h, color="0.9", linewidth=0.0, zorder=0, label=label)
    along, floor, top = axes.get_xaxis_transform(), 0.03, 1.02
    began = [each.began_h for each in night.collects]
    if began:
        axes.plot(began, [floor] * len(began), "|", transform=along, color="black", markersize=9, label="collect")
    if len(night.event_hours):
        heights = [top] * len(night.event_hours)
        axes.plot(
            night.event_hours, heights, "v", transform=along, color="black", markersize=5, clip_on=False, label="event"
        )
        last_h = -np.inf
        for number, hour in enumerate(night.event_hours.tolist(), start=1):
            # Events that come together share the place of one number: the list tells them apart.
            if len(night.event_hours) <= _NUMBERED and hour - last_h > 0.015 * (np.nanmax(night.hours) or 1.0):
                axes.annotate(str(number), (hour, top + 0.03), xycoords=along, ha="center", va="bottom", fontsize=7.5)
                last_h = hour
    axes.set_xlabel("time since the night began, hours")
    axes.set_ylabel("temperature, °C")
    axes.margins(x=0.01)
    figure.subplots_adjust(bottom=0.22, top=0.89)
    figure.legend(frameon=False, fontsize=8, ncols=7, loc="lower center")
    return figure


def _fahrenheit(celsius: Any) -> Any:
    return celsius * 1.8 + 32.0


def _celsius(fahrenheit: Any) -> Any:
    return (fahrenheit - 32.0) / 1.8
